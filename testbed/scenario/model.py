"""The schema of a scenario file: every field but those of the plug-ins, with its unit, its limits and its default.

Sections of plug-ins (world, actors, sensors, estimators, metrics) are `kind`, `id` and the fields of the plug-in's own
Config; they are left as mappings here and judged by `testbed.scenario.build`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Field, PrivateAttr, model_validator

from testbed.errand import Errand
from testbed.guided.section import GuidedWalk
from testbed.quantity import Config, Degrees, Hertz, Metres, MetresPerSecond, Point2, Point3, Seconds
from testbed.route import Route
from testbed.scenario.problems import Loc
from testbed.scenario.published import PublishedModel, one_is_a_list
from testbed.scenario.reporting import ReportModel
from testbed.walk import RoadWalk

MAX_POINTS = 10_000  # of a sweep
MAX_TAGS = 100_000
MAX_RUNS = 10_000_000  # trials × points × estimators
MAX_INSTANTS = 20_000_000  # duration × truth_hz, a body
MAX_REPORTS = 1_000_000  # duration × report_hz
ID_PATTERN = r"^[A-Za-z][A-Za-z0-9_-]*$"
TAG_ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.:-]*$"  # EPCs and serial numbers begin with a digit as well

_GLOB = frozenset("*?[")
Glob = Annotated[str, Field(min_length=1, max_length=200)]
Spread = Annotated[Metres, Field(gt=0, le=1000)]
SpeedSpread = Annotated[MetresPerSecond, Field(gt=0, le=100)]


def _threefold(value: Any) -> Any:
    """One number for a deviation means the same along each axis."""
    return value if isinstance(value, (list, tuple)) else [value] * 3


_three, _three_speeds = tuple[Spread, Spread, Spread], tuple[SpeedSpread, SpeedSpread, SpeedSpread]
_Spreads = Annotated[_three, BeforeValidator(_threefold, json_schema_input_type=_three | Spread)]
_SpeedSpreads = Annotated[_three_speeds, BeforeValidator(_threefold, json_schema_input_type=_three_speeds | SpeedSpread)]


_Publications = Annotated[
    list[PublishedModel],
    Field(max_length=20),
    BeforeValidator(one_is_a_list, json_schema_input_type=PublishedModel | list[PublishedModel]),
]


class PriorModel(Config):
    """What an estimator is told before it starts: a normal distribution, drawn around the truth at t = 0 or given.

    `age_s`: how old that knowledge is when the recording begins. A filter predicts over it before its first update.
    """

    position_std_m: _Spreads = (0.5, 0.5, 0.5)
    velocity_std_mps: _SpeedSpreads = (0.25, 0.25, 0.25)
    position_m: Point3 | None = None
    velocity_mps: tuple[MetresPerSecond, MetresPerSecond, MetresPerSecond] | None = None
    age_s: Annotated[Seconds, Field(ge=0, le=3600)] = 0.0


class SurveyModel(Config):
    """How well the installer knows the antennas' poses: standard deviations of the errors, drawn once a trial."""

    antenna_position_std_m: Annotated[Metres, Field(ge=0, le=100)] = 0.0
    antenna_yaw_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 0.0


class TagRule(Config):
    """One tag, or a rule that makes many: at a position, on mounts, so many a group of mounts, or from a table.

    `on` is a glob over names of bodies; without it a position is in the world frame. Exactly one of `position_m`, `mount`,
    `per_group` and `csv` is given. A rule that makes many tags names them after `prefix`. A tag's face looks along its +x and its
    dipole lies along its +y, level, unless `roll_deg` turns it about +x; 90 stands it upright.
    """

    id: Annotated[str, Field(pattern=TAG_ID_PATTERN, max_length=100)] | None = None
    prefix: Annotated[str, Field(pattern=TAG_ID_PATTERN, max_length=60)] | None = None
    on: Glob | None = None
    mount: Glob | None = None
    per_group: Annotated[int, Field(ge=1, le=10_000)] | None = None
    position_m: Point3 | None = None
    yaw_deg: Degrees = 0.0
    tilt_deg: Degrees = 0.0
    roll_deg: Degrees = 0.0
    model: Annotated[str, Field(min_length=1, max_length=60)] = "monza_4"
    csv: Annotated[str, Field(min_length=1, max_length=200)] | None = None

    _loc: Loc = PrivateAttr(default=())

    @property
    def loc(self) -> Loc:
        """Where the rule stands in the scenario, for `Scenario.problem`."""
        return self._loc

    @property
    def makes_many(self) -> bool:
        """Whether the rule may stand for more than one tag. A position is one tag's, whatever pattern finds its body."""
        patterns = (self.on, self.mount) if self.mount is not None else ()
        return self.csv is not None or self.per_group is not None or any(_GLOB & set(text or "") for text in patterns)

    def at(self, loc: Loc, on: str | None) -> TagRule:
        """The same rule, knowing where it stands and whose tag it is."""
        rule = self.model_copy(update={"on": on})
        rule._loc = loc
        return rule

    @model_validator(mode="after")
    def _one_way(self) -> TagRule:
        ways = [name for name in ("position_m", "mount", "per_group", "csv") if getattr(self, name) is not None]
        if len(ways) != 1:
            given = " and ".join(ways) if ways else "none of them"
            raise ValueError(f"exactly one of position_m, mount, per_group and csv says where tags are; here is {given}")
        turned = {"yaw_deg", "tilt_deg"} & self.model_fields_set
        if turned and self.position_m is None:
            raise ValueError(f"{min(turned)} goes with position_m alone: a mount or a table gives the direction itself")
        if self.makes_many and self.id is not None:
            raise ValueError("this rule makes many tags, which one id can't name: use prefix")
        if self.prefix is not None and (not self.makes_many or self.csv is not None):
            raise ValueError("prefix is for rules that make many tags without naming them: use id")
        return self


class ActorModel(Config):
    """What every actor has besides the fields of its kind."""

    kind: str
    id: Annotated[str, Field(pattern=ID_PATTERN, max_length=60)]
    motion: Literal["dynamic", "kinematic", "parked", "guided"]
    route: Route | None = None
    walk: RoadWalk | None = None
    errand: Errand | None = None
    guided: GuidedWalk | None = None
    position_m: Point2 | None = None
    yaw_deg: Degrees = 0.0
    tags: list[Any] = Field(default_factory=list)

    @model_validator(mode="after")
    def _place(self) -> ActorModel:
        if (self.guided is not None) != (self.motion == "guided"):
            raise ValueError("motion guided and the section guided, with how well the person follows, belong together")
        if self.motion == "guided":
            if self._ways():
                raise ValueError(f"a guided actor goes where its guide says: remove its {self._ways()[0]}")
            if self.position_m is None and self.guided is not None and self.guided.start_distance_m is None:
                raise ValueError("a guided actor starts at its position_m, or at start_distance_m from the tag: give one")
        elif self.motion == "parked":
            if self.position_m is None:
                raise ValueError("a parked actor needs position_m, [x, y] in metres")
            for name in self._ways():
                raise ValueError(f"a parked actor has no {name}: remove it, or set motion to kinematic or dynamic")
        else:
            if not self._ways():
                raise ValueError(
                    f"motion {self.motion} needs a route, with its waypoints_m (or a walk along roads, or an errand at a gate)"
                )
            if len(self._ways()) > 1:
                raise ValueError(f"a {self._ways()[0]} and a {self._ways()[1]} are two ways to go: remove one of them")
            extra = {"position_m", "yaw_deg"} & self.model_fields_set
            if extra:
                raise ValueError(f"{min(extra)} is for parked actors: this one starts at its first way point")
            if self.motion == "dynamic" and self.route is not None and self.route.pace == "steady":
                raise ValueError("pace steady is for motion kinematic: no body with a mass goes round a sharp corner at full speed")
        return self

    def _ways(self) -> list[str]:
        """Names of the sections that say how it goes."""
        return [name for name in ("route", "walk", "errand") if getattr(self, name) is not None]


class Document(Config):
    """A scenario file. Sections of plug-ins, tags, expectations and sweep are judged one by one elsewhere."""

    name: Annotated[str, Field(pattern=ID_PATTERN, max_length=60)]
    title: Annotated[str, Field(max_length=200)] = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    trials: Annotated[int, Field(ge=1, le=1_000_000)]
    block: Annotated[int, Field(ge=1, le=1_000)] = 4
    duration_s: Annotated[Seconds, Field(gt=0, le=86_400)]
    world: dict[str, Any]
    actors: Annotated[list[Any], Field(max_length=1000)] = Field(default_factory=list)
    sensors: Annotated[list[Any], Field(max_length=1000)] = Field(default_factory=list)
    tags: Annotated[list[Any], Field(max_length=MAX_TAGS)] = Field(default_factory=list)
    targets: Annotated[list[Glob], Field(max_length=1000)] = Field(default_factory=list)
    references: Annotated[list[Glob], Field(max_length=1000)] = Field(default_factory=list)
    prior: PriorModel = PriorModel()
    estimators: Annotated[list[Any], Field(max_length=100)] = Field(default_factory=list)
    metrics: Annotated[list[Any], Field(max_length=100)] | None = None
    cameras: Annotated[list[Any], Field(max_length=100)] = Field(default_factory=list)
    report_hz: Annotated[Hertz, Field(gt=0, le=10_000)] = 10.0
    hold_s: Annotated[Seconds, Field(ge=0, le=3_600)] = 0.0
    step_hz: Annotated[int, Field(ge=10, le=10_000)] = 240
    truth_hz: Annotated[int, Field(ge=1, le=10_000)] = 120
    rays: Literal["boxes", "bullet"] = "boxes"
    survey: SurveyModel = SurveyModel()
    expect: dict[str, Any] = Field(default_factory=dict)
    sweep: dict[str, Any] = Field(default_factory=dict)
    published: _Publications = Field(default_factory=list)
    report: ReportModel = ReportModel()
    files: dict[str, str] = Field(default_factory=dict)


@dataclass(frozen=True)
class Section:
    """A plug-in that a scenario uses: which one, under which id, with its own configuration, and where that stands."""

    id: str
    kind: str
    config: BaseModel
    loc: Loc = field(compare=False)


@dataclass(frozen=True)
class ActorSection:
    """An actor of a scenario. `tags` are in its own frame and have `on` set to its id; position and yaw are those of a parked one.

    `route` is a walk for one that wanders, an errand for one that has one, and how it follows instructions for one that is guided.
    """

    id: str
    kind: str
    motion: str
    route: Route | RoadWalk | Errand | GuidedWalk | None
    position_m: tuple[float, float] | None
    yaw_deg: float
    config: BaseModel
    tags: tuple[TagRule, ...]
    loc: Loc = field(compare=False)

    @property
    def moves(self) -> bool:
        """Whether it ever leaves its place."""
        return self.motion != "parked"
