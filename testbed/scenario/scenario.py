"""The scenario that everything else works with: validated, frozen, and able to say where each of its parts was written."""

from __future__ import annotations

import enum
import hashlib
import json
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from testbed.report.cameras import CameraSpec
from testbed.scenario.claims import Claim
from testbed.scenario.model import ActorSection, PriorModel, Section, SurveyModel, TagRule
from testbed.scenario.problems import Loc, ScenarioError
from testbed.scenario.published import Publication
from testbed.scenario.reporting import ReportModel
from testbed.scenario.source import Source

OUTSIDE_HASH = ("trials", "seed", "expect", "block", "published", "files", "cameras", "report")  # files are hashed as the tags they hold


@dataclass(frozen=True)
class Scenario:
    """A scenario file, checked as a whole; units as in the fields' names.

    document : the plain mapping behind it, after --set and with its tables under `files`: `from_dict(document)` is this scenario again
    expect   : the bounds under `expect`, then those that cells of `published` want kept; published belongs to the whole, not to a point
    text     : the source as it was read; path : its file, None where there is none
    """

    name: str
    title: str
    seed: int
    trials: int
    block: int
    duration_s: float
    world: Section
    actors: tuple[ActorSection, ...]
    sensors: tuple[Section, ...]
    estimators: tuple[Section, ...]
    metrics: tuple[Section, ...]
    cameras: tuple[CameraSpec, ...]
    tags: tuple[TagRule, ...]
    targets: tuple[str, ...]
    references: tuple[str, ...]
    prior: PriorModel
    report_hz: float
    hold_s: float
    step_hz: int
    truth_hz: int
    rays: str
    survey: SurveyModel
    expect: tuple[Claim, ...]
    sweep: Mapping[str, list[Any]]
    document: dict[str, Any] = field(repr=False, compare=False)
    text: str = field(repr=False, compare=False)
    path: Path | None = field(repr=False, compare=False)
    source: Source = field(repr=False, compare=False)
    swept: tuple[Point, ...] = field(default=(), repr=False, compare=False)
    published: tuple[Publication, ...] = ()
    report: ReportModel = field(default_factory=ReportModel)

    def points(self) -> list[Point]:
        """The points of the sweep in the order of the file, the last path fastest; one point, as it is, without a sweep."""
        return list(self.swept) or [Point(0, {}, self)]

    @cached_property
    def hash(self) -> str:
        """sha256 (hex) of what is simulated and estimated: all values, defaults included, without trials, seed, expectations and cameras.

        The same for the same values, however the file is ordered, commented or written (YAML, a mapping, "30 cm" for 0.3).
        """
        content = {
            name: canonical(value)
            for name, value in ((n, getattr(self, n)) for n in self.__dataclass_fields__ if self.__dataclass_fields__[n].compare)
            if name not in OUTSIDE_HASH
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()).hexdigest()

    def problem(self, loc: Loc, message: str) -> ScenarioError:
        """The error for a mistake that only a later stage can see, placed at `loc` (a section's or tag rule's `loc`, or beneath it)."""
        return ScenarioError([self.source.problem(loc, message)])


@dataclass(frozen=True)
class Point:
    """One point of a sweep: what it sets (path to value) and the scenario that results, which has no sweep."""

    index: int
    set: dict[str, Any]
    scenario: Scenario


def canonical(value: Any) -> Any:
    """A value as JSON that does not depend on the order of keys or sets, nor on where it stands in the file."""
    if isinstance(value, BaseModel):
        return {name: canonical(getattr(value, name)) for name in type(value).model_fields}
    if isinstance(value, (Section, ActorSection)):
        return {name: canonical(getattr(value, name)) for name in value.__dataclass_fields__ if name != "loc"}
    if isinstance(value, Mapping):
        return {str(name): canonical(item) for name, item in value.items()}
    if isinstance(value, Set):
        return sorted((canonical(item) for item in value), key=lambda item: json.dumps(item, sort_keys=True))
    if isinstance(value, (list, tuple)):
        return [canonical(item) for item in value]
    if isinstance(value, enum.Enum):
        return canonical(value.value)
    return value if value is None or isinstance(value, (bool, int, float, str)) else to_jsonable_python(value)
