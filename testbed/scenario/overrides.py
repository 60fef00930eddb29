"""Values set from outside the file's own place: `--set path=value`, and the points of a sweep.

A path is dotted; items of a list are named by their id (or kind, where that is the id) or their index:
`sensors.portal.antennas.count`, `actors.t1.route.speed_mps`, `tags.0.model`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from testbed.plugins import suggest
from testbed.scenario.model import MAX_POINTS
from testbed.scenario.nodes import checked, read
from testbed.scenario.problems import Loc, Problem, ScenarioError
from testbed.scenario.source import Override, Review, Source

SET = "--set"
MAX_STEPS = 20


def assignments(sets: Iterable[str] | Mapping[str, Any]) -> dict[str, Any]:
    """Path to value, in order, from texts "path=value" (the value as in YAML) or from a mapping. ScenarioError for bad ones."""
    if isinstance(sets, Mapping):
        return {path: checked(value, SET) for path, value in sets.items()}
    if isinstance(sets, str):
        raise TypeError("sets must be a list of texts, not one text")
    found: dict[str, Any] = {}
    problems: list[Problem] = []
    for text in sets:
        path, equals, value = text.partition("=")
        path = path.strip()
        if not equals or not path:
            problems.append(Problem(SET, None, None, "", f"{text[:80]!r} is not path=value, as in trials=8"))
        elif path in found:
            problems.append(Problem(SET, None, None, path, "set twice"))
        else:
            try:
                found[path] = read(value, SET).plain() if value.strip() else None
            except ScenarioError as error:
                problems += [Problem(SET, None, None, path, problem.message) for problem in error.problems]
    if problems:
        raise ScenarioError(problems)
    return found


def resolve(document: Any, path: str) -> tuple[Loc, tuple[str, ...]]:
    """The place that a path names, and the words of the path, one a step. A key that a mapping lacks is a place to be made.

    ValueError, in a sentence, where the path goes through something that isn't there.
    """
    words = path.split(".")
    if not all(words) or len(words) > MAX_STEPS:
        raise ValueError("a path is words with dots between them, as in sensors.portal.antennas.count")
    loc: list[str | int] = []
    steps: list[str] = []
    here = document
    while words:
        taken = 1
        if isinstance(here, Mapping):  # keys of a sweep and names of files hold dots themselves
            taken = next((n for n in range(len(words), 0, -1) if ".".join(words[:n]) in here), 1)
            step: str | int = ".".join(words[:taken])
            here = here.get(step, {})
        elif isinstance(here, list):
            step = _item(here, words[0], ".".join(steps))
            here = here[step]
        else:
            raise ValueError(f"{'.'.join(steps)} is a single value: nothing in it can be set")
        loc.append(step)
        steps.append(".".join(words[:taken]))
        words = words[taken:]
    return tuple(loc), tuple(steps)


def _item(items: list[Any], word: str, where: str) -> int:
    names = [next((str(item[k]) for k in ("id", "prefix", "kind") if k in item), "") if isinstance(item, Mapping) else "" for item in items]
    if word in names:
        return names.index(word)
    if word.isascii() and word.isdecimal() and len(word) < 9 and int(word) < len(items):
        return int(word)
    known = [name for name in names if name]
    if not items:
        raise ValueError(f"there is nothing in {where}")
    if word.isdecimal() or not known:
        raise ValueError(f"{where} has no item {word}: it has {len(items)}, counted from 0")
    raise ValueError(f"nothing in {where} is named {word!r}{suggest(word, known)}")


def assign(document: Any, loc: Loc, value: Any) -> tuple[Any, Loc]:
    """The document with the value at `loc`, and the first place that is new. What is not on the way is shared, not copied."""
    if not loc:
        return value, ()
    step, rest = loc[0], loc[1:]
    if isinstance(document, list):
        items = list(document)
        items[step], created = assign(document[step], rest, value)  # type: ignore[call-overload]
        return items, (step, *created)
    inner, created = assign(document.get(step, {}), rest, value)
    return {**document, step: inner}, (step, *created) if step in document else (step,)


def apply(document: dict[str, Any], sets: Mapping[str, Any], source: Source) -> tuple[dict[str, Any], Source]:
    """The document with everything set that --set asks for. ScenarioError for paths that lead nowhere."""
    overrides: list[Override] = []
    problems: list[Problem] = []
    for path, value in sets.items():
        try:
            loc, steps = resolve(document, path)
        except ValueError as error:
            problems.append(Problem(SET, None, None, path, str(error)))
            continue
        document, created = assign(document, loc, value)
        overrides.append(Override(created, steps, SET))
    if problems:
        raise ScenarioError(problems)
    return document, source.overridden(overrides)


Choice = tuple[str, Loc, tuple[str, ...], list[Any]]  # path, its place, its words, the values


def choices(document: dict[str, Any], review: Review) -> list[Choice]:
    """What a document's sweep varies, in its order; mistakes are put down."""
    found: list[Choice] = []
    raw = document.get("sweep")
    for path, values in raw.items() if isinstance(raw, dict) else ():
        here: Loc = ("sweep", path)
        if not isinstance(values, list) or not values:
            review.note(here, "a list of values is wanted, as in [2, 3, 4]")
            continue
        try:
            loc, steps = resolve(document, path)
        except ValueError as error:
            review.note(here, str(error), at_key=True)
            continue
        clash = next((other for other, place, _, _ in found if place[: len(loc)] == loc[: len(place)]), None)
        outside = next((o for o in review.source.overrides if o.path == SET and ".".join(o.steps) == path), None)
        if loc[0] in ("sweep", "files"):
            review.note(here, f"{loc[0]} can't be swept over", at_key=True)
        elif clash is not None:
            review.note(here, f"sets the same value as {clash}", at_key=True)
        elif outside is not None:
            review.problems.append(outside.problem(loc, f"the sweep sets this as well: set sweep.{path} to a list instead"))
        else:
            found.append((path, loc, steps, values))
    size = math.prod(len(values) for *_, values in found)
    if size > MAX_POINTS:
        review.note(("sweep",), f"{size:,} points, at most {MAX_POINTS:,} are run", at_key=True)
        return []
    return found


def combinations(found: Sequence[Choice], singly: bool) -> Iterable[tuple[int, ...]]:
    """Indices into the values of each choice: all combinations, or each value once (enough to find what is wrong with it)."""
    if not singly:
        return itertools.product(*(range(len(values)) for *_, values in found))
    longest = max((len(values) for *_, values in found), default=0)
    return (tuple(min(i, len(values) - 1) for *_, values in found) for i in range(longest))


def varied(document: dict[str, Any], source: Source, found: Sequence[Choice], indices: Sequence[int]) -> tuple[dict[str, Any], Source]:
    """The document of one point of the sweep, without the sweep, and without what is published of other points."""
    overrides: list[Override] = []
    document = {name: value for name, value in document.items() if name not in ("sweep", "published")}
    for (path, loc, steps, values), i in zip(found, indices, strict=True):
        place = source.problem(("sweep", path, i), "")
        document, created = assign(document, loc, values[i])
        overrides.append(Override(created, steps, place.path, place.line, place.column, i))
    return document, source.overridden(overrides)
