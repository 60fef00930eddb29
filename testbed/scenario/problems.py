"""What is wrong with a scenario, and where: the error that shows all mistakes at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple


class Row(NamedTuple):
    """A step of a place that leads into a table beside the scenario: its name and line."""

    table: str
    line: int

    def __str__(self) -> str:
        return f"{self.table}:{self.line}"


Loc = tuple[str | int | Row, ...]  # a place in the document: keys and list indices from the top


def dotted(loc: Loc) -> str:
    """A place as it is shown and written with --set: ("sensors", 0, "rate_hz") -> "sensors.0.rate_hz"."""
    return ".".join(str(step) for step in loc)


@dataclass(frozen=True)
class Problem:
    """One mistake. line and column count from 1 and are None where there is no text to point into."""

    path: str
    line: int | None
    column: int | None
    where: str
    message: str

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.path, self.line, self.column) if part is not None)
        return f"{place} {self.where}: {self.message}" if self.where else f"{place}: {self.message}"


class ScenarioError(ValueError):
    """A scenario that can't be used. `problems` holds every mistake, in the order of the file; str() is one line each."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        distinct = dict.fromkeys(problems)  # a mistake that every point of a sweep meets is told once
        self.problems = sorted(distinct, key=lambda p: (p.path, p.line or 0, p.column or 0))
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


class DataMissing(ScenarioError):
    """A scenario that is right, but needs data that are not on this machine. A test of it is skipped, with this message."""


def refuse(path: str, message: str, line: int | None = None, column: int | None = None, where: str = "") -> ScenarioError:
    """An error of one problem."""
    return ScenarioError([Problem(path, line, column, where, message)])
