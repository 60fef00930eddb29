"""Where a scenario's values come from: the file, the tables beside it, --set and the sweep. Every mistake is placed through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path, PureWindowsPath
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from testbed.scenario.nodes import Node
from testbed.scenario.problems import Loc, Problem, Row, ScenarioError, dotted
from testbed.scenario.wording import findings, shown

MAX_TABLE_BYTES = 10_000_000

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class Override:
    """A value that did not come from its own place: `steps` are the words of its path, `created` the first loc that is new.

    path, line, column point at the value; index is its place in a sweep's list (None for --set).
    """

    created: Loc
    steps: tuple[str, ...]
    path: str
    line: int | None = None
    column: int | None = None
    index: int | None = None

    def problem(self, loc: Loc, message: str) -> Problem:
        """A mistake at or beneath what was set, told in the words of the path that set it."""
        words: list[str | int | Row] = [] if self.index is None else ["sweep"]
        words += self.steps[: len(loc)]
        if self.index is not None and len(loc) >= len(self.steps):
            words.append(self.index)
        words += loc[len(self.steps) :]
        return Problem(self.path, self.line, self.column, dotted(tuple(words)), message)


@dataclass(frozen=True)
class Source:
    """A document's origin. `root` is None where it came from Python; `folder` is where its tables lie, None without a file.

    faults : what is wrong with the text itself, found while it was read
    tables : contents of the tables read so far; memo : what was judged already, shared by the points of a sweep
    """

    path: str
    root: Node | None = None
    folder: Path | None = None
    overrides: tuple[Override, ...] = ()
    faults: tuple[Problem, ...] = ()
    tables: dict[str, str] = field(default_factory=dict)
    memo: dict[Any, Any] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "memo": {}}  # its keys are identities of this process

    def problem(self, loc: Loc, message: str, at_key: bool = False) -> Problem:
        """The mistake, placed: in a table's row, in --set or the sweep, or in the text."""
        for i, step in enumerate(loc):
            if isinstance(step, Row):
                return Problem(step.table, step.line, None, dotted(loc[i + 1 :]), message)
        for override in reversed(self.overrides):
            if loc[: len(override.created)] == override.created:
                return override.problem(loc, message)
        line, column = self.root.place(loc, at_key) if self.root else (None, None)
        return Problem(self.path, line, column, dotted(loc), message)

    def line(self, loc: Loc) -> int | None:
        """Line of a place in the text (of its key where it has one), None for one that is not in the text."""
        return self.problem(loc, "", at_key=True).line

    def overridden(self, overrides: Iterable[Override]) -> Source:
        """The same origin with more values set."""
        return replace(self, overrides=(*self.overrides, *overrides))

    def table(self, name: str) -> str:
        """Text of a table beside the scenario. ValueError, in a sentence, for one that can't or must not be read."""
        if name in self.tables:
            return self.tables[name]
        if Path(name).is_absolute() or PureWindowsPath(name).drive or "\\" in name or "\0" in name:
            raise ValueError(f"{name!r} must be a path relative to the scenario's folder, with / between its parts")
        if self.folder is None:
            raise ValueError(f"there is no folder to look for {name!r} in: load the scenario from a file")
        folder = self.folder.resolve()
        place = (folder / name).resolve()
        if not place.is_relative_to(folder):
            raise ValueError(f"{name!r} lies outside the scenario's folder")
        try:
            with place.open("rb") as file:
                content = file.read(MAX_TABLE_BYTES + 1)
        except OSError as error:
            raise ValueError(f"{name!r} can't be read: {(error.strerror or str(error)).lower()}") from None
        if len(content) > MAX_TABLE_BYTES:
            raise ValueError(f"{name!r} is over {MAX_TABLE_BYTES // 1_000_000} MB")
        try:
            self.tables[name] = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise ValueError(f"{name!r} is not UTF-8 text (byte {error.start})") from None
        return self.tables[name]


class Review:
    """The mistakes found so far in one document, and the way to find more."""

    def __init__(self, source: Source, faults: Iterable[Problem] = ()) -> None:
        self.source = source
        self.problems: list[Problem] = list(faults)
        self._faulty = {(fault.line, fault.column) for fault in faults if fault.column}

    def note(self, loc: Loc, message: str, at_key: bool = False) -> None:
        """Put down a mistake."""
        problem = self.source.problem(loc, message, at_key)
        if (problem.line, problem.column) not in self._faulty:  # what stands there in place of a faulty value is nobody's mistake
            self.problems.append(problem)

    def check(self, model: type[M], data: Any, loc: Loc, known: Iterable[str] = ()) -> M | None:
        """The validated model, or None with its mistakes put down. `known` are keys that belong there besides the model's.

        A model's validators find tables beside the scenario by `info.context["table"](name)`, which gives the text, and the
        scenario's folder as `info.context["folder"]`, None where it came from no file.
        """
        try:
            checked = model.model_validate(data, context={"table": self.source.table, "folder": self.source.folder})
        except ValidationError as error:
            for place, message, at_key in findings(error, model, data, known):
                self.note((*loc, *place), message, at_key)
            return None
        wrong = list(_booleans_as_numbers(data, checked, loc))
        for place, value in wrong:
            self.note(place, f"a number is wanted, not {shown(value)}")
        return None if wrong else checked

    def finish(self) -> None:
        """ScenarioError if anything was put down."""
        if self.problems:
            raise ScenarioError(self.problems)


def _booleans_as_numbers(raw: Any, value: Any, loc: Loc) -> Iterable[tuple[Loc, bool]]:
    """Places, with the value, where a truth value was taken for 0 or 1, as pydantic does."""
    if isinstance(raw, bool):
        numbers = value if isinstance(value, (list, tuple)) else [value]
        if any(isinstance(number, (int, float)) and not isinstance(number, bool) for number in numbers):
            yield loc, raw
    elif isinstance(raw, dict):
        for name, item in raw.items():
            inner = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
            yield from _booleans_as_numbers(item, inner, (*loc, name))
    elif isinstance(raw, (list, tuple)) and isinstance(value, (list, tuple)) and len(raw) == len(value):
        for i, (item, inner) in enumerate(zip(raw, value, strict=True)):
            yield from _booleans_as_numbers(item, inner, (*loc, i))
