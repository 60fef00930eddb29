"""Tag rules of a scenario: written out, or row by row in a table beside it."""

from __future__ import annotations

import csv
import io
from typing import Any

from testbed.scenario.model import MAX_TAGS, TagRule
from testbed.scenario.problems import Loc, Problem, Row
from testbed.scenario.source import Review, Source
from testbed.scenario.wording import extra

_COLUMNS = {
    "id": "id", "on": "on", "x_m": "position_m", "y_m": "position_m", "z_m": "position_m", "yaw_deg": "yaw_deg",
    "roll_deg": "roll_deg", "model": "model",
}  # fmt: skip
_NEEDED = ("id", "x_m", "y_m", "z_m")
_POINT = ("x_m", "y_m", "z_m")


def rules(raw: Any, loc: Loc, owner: str | None, review: Review) -> tuple[TagRule, ...]:
    """The tag rules of a list, tables expanded. `owner` is the actor whose tags they are; its frame is theirs."""
    found: list[TagRule] = []
    memo = review.source.memo
    for i, item in enumerate(raw if isinstance(raw, list) else []):
        key = ("tags", id(item), *loc, i, owner)
        before = len(review.problems)
        made = memo[key][0] if key in memo else _rule(item, (*loc, i), owner, review)
        if len(review.problems) == before:
            memo[key] = (made, item)  # the item is kept so that its identity stays its own
        found.extend(made)
    return tuple(found)


def distinct(tags: list[TagRule], actors: set[str], review: Review) -> None:
    """Put down every id that is given twice, or is an actor's as well (targets name both), and too many tags."""
    first: dict[str, TagRule] = {}
    for tag in tags:
        if tag.id is None:
            continue
        if tag.id in actors:
            review.note(tag.loc, f"the id {tag.id!r} is an actor's already")
        elif tag.id in first:
            other = review.source.problem(first[tag.id].loc, "")
            review.note(tag.loc, f"the id {tag.id!r} is given twice, first at {str(other).rstrip(': ')}")
        else:
            first[tag.id] = tag
    if len(tags) > MAX_TAGS:
        review.note(("tags",), f"{len(tags):,} tags, at most {MAX_TAGS:,} can be simulated")


def _rule(item: Any, loc: Loc, owner: str | None, review: Review) -> list[TagRule]:
    if not isinstance(item, dict):
        review.note(loc, "a mapping is wanted, as in {id: tag1, position_m: [1.0, 2.0, 0.5]}")
        return []
    rule = review.check(TagRule, item, loc)
    if rule is None:
        return []
    if owner is not None and rule.on is not None:
        review.note((*loc, "on"), "an actor's own tags are on the actor: remove this", at_key=True)
        return []
    if owner is None and rule.on is None and (rule.mount or rule.per_group):
        review.note(loc, 'missing: on, the bodies whose mounts are meant, as in on: "rack*"')
        return []
    if rule.csv is None:
        return [rule.at(loc, owner or rule.on)]
    try:
        text = review.source.table(rule.csv)
    except ValueError as error:
        review.note((*loc, "csv"), str(error))
        return []
    return _table(text, rule, loc, owner, review)


def _table(text: str, rule: TagRule, loc: Loc, owner: str | None, review: Review) -> list[TagRule]:
    name = str(rule.csv)
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    found: list[TagRule] = []

    def note(line: int, message: str, where: str = "") -> None:
        review.problems.append(Problem(name, line, None, where, message))

    try:
        header = [word.strip() for word in next(rows, [])]
        complaints = _header(header)
        for complaint in complaints:
            note(1, complaint)
        for row in rows if not complaints else ():
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                note(rows.line_num, f"{len(row)} values, and the header names {len(header)}")
                continue
            if len(found) > MAX_TAGS:
                note(rows.line_num, f"over {MAX_TAGS:,} tags")
                break
            made = _row(dict(zip(header, row, strict=True)), rule, rows.line_num, owner, review)
            if made is not None:
                found.append(made.at((*loc, Row(name, rows.line_num)), owner or made.on))
    except csv.Error as error:
        note(rows.line_num, f"not a table of values with commas between them: {error}")
    return found


def _header(header: list[str]) -> list[str]:
    complaints = [f"the column {word!r} is an {extra(word, list(_COLUMNS))}" for word in header if word not in _COLUMNS]
    complaints += [f"the column {word!r} stands there twice" for word in dict.fromkeys(header) if header.count(word) > 1]
    missing = [word for word in _NEEDED if word not in header]
    if missing:
        complaints.append(f"columns are missing: {', '.join(missing)} (a table begins with a line such as id,on,x_m,y_m,z_m)")
    return complaints


def _row(row: dict[str, str], rule: TagRule, line: int, owner: str | None, review: Review) -> TagRule | None:
    """One tag of a table; empty cells mean what the rule says for all of its rows, or the default."""
    cells = {name: text.strip() for name, text in row.items() if text.strip()}
    data: dict[str, Any] = {"model": rule.model, "on": rule.on, "roll_deg": rule.roll_deg}
    data.update({name: text for name, text in cells.items() if name not in _POINT})
    data["position_m"] = [cells.get(name, "0") for name in _POINT]
    judge = Review(Source(""))  # a place in the row is no place in the document
    made = judge.check(TagRule, data, ())
    for name in _NEEDED:
        if name not in cells:
            judge.note((name,), "missing")
    if owner is not None and "on" in cells:
        judge.note(("on",), "an actor's own tags are on the actor: leave this cell empty")
    for problem in judge.problems:
        steps = problem.where.split(".")
        where = _POINT[int(steps[1])] if steps[0] == "position_m" and len(steps) > 1 else steps[0]
        review.problems.append(Problem(str(rule.csv), line, None, where, problem.message))
    return None if judge.problems else made
