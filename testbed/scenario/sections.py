"""Sections of plug-ins: `kind` picks one that is registered, the rest of the section is judged by its own Config."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel

from testbed import plugins
from testbed.scenario import tags
from testbed.scenario.claims import WORLD
from testbed.scenario.model import ID_PATTERN, ActorModel, ActorSection, Section
from testbed.scenario.problems import Loc
from testbed.scenario.source import Review
from testbed.scenario.wording import shown

_ACTOR_KEYS = tuple(ActorModel.model_fields)


def one(group: str, raw: Any, loc: Loc, review: Review, id: str | None = None) -> Section | None:
    """A section, or None with its mistakes put down. `id` is the one it has, where a section can't choose it."""
    if not isinstance(raw, dict):
        review.note(loc, f"a mapping with a kind is wanted, as in {{kind: {_example(group, raw)}}}, not {shown(raw)}")
        return None
    config = _config(group, raw, loc, ("kind",) if id else ("kind", "id"), review)
    name = id or raw.get("id", raw.get("kind"))
    if id is None and "id" in raw and not _is_id(name):
        review.note((*loc, "id"), f"{shown(name)} can't be an id: letters, digits, _ and - are, beginning with a letter")
        return None
    return None if config is None else Section(str(name), raw["kind"], config, loc)


def actor(raw: Any, loc: Loc, review: Review) -> ActorSection | None:
    """An actor's section: what all actors have, and what its kind adds."""
    if not isinstance(raw, dict):
        return one("actors", raw, loc, review)  # type: ignore[return-value]
    config = _config("actors", raw, loc, _ACTOR_KEYS, review)
    common = {key: value for key, value in raw.items() if key in _ACTOR_KEYS}
    common.setdefault("id", raw.get("kind"))
    if config is None and not isinstance(raw.get("kind"), str):
        common["kind"] = "actor"  # the kind has been complained of already
        common["id"] = raw.get("id", "actor")
    model = review.check(ActorModel, common, loc)
    own_tags = tags.rules(raw.get("tags"), (*loc, "tags"), str(raw.get("id", raw.get("kind"))), review)
    if model is None or config is None:
        return None
    return ActorSection(
        model.id, model.kind, model.motion, model.route or model.walk or model.errand or model.guided, model.position_m, model.yaw_deg,
        config, own_tags, loc,
    )  # fmt: skip


def every(raw: Any, loc: Loc, review: Review, make: Callable[[Any, Loc], Any]) -> list[Any]:
    """`make` for each item of a list; what was made of the very same item before is used again (the points of a sweep share it)."""
    found = []
    for i, item in enumerate(raw if isinstance(raw, list) else ()):
        here = (*loc, i)
        key = (id(item), *here)
        if key not in review.source.memo:
            before = len(review.problems)
            made = make(item, here)
            if made is None or len(review.problems) > before:
                continue
            review.source.memo[key] = (made, item)  # the item is kept so that its identity stays its own
        found.append(review.source.memo[key][0])
    return found


def distinct(raw: Any, group: str, review: Review) -> None:
    """Put down every id that is used twice in a group, whether or not the sections are right otherwise."""
    first: dict[str, Loc] = {}
    for i, item in enumerate(raw if isinstance(raw, list) else ()):
        name = item.get("id", item.get("kind")) if isinstance(item, dict) else None
        if not isinstance(name, str):
            continue
        if name in first:
            line = review.source.line(first[name])
            where = f"in line {line}" if line else f"as item {first[name][-1]}"
            review.note((group, i, "id"), f"the id {name!r} is used twice in {group}, first {where}")
        elif group == "estimators" and name == WORLD:
            review.note((group, i, "id"), f"{WORLD!r} can't be an estimator's id: under expect it means the world")
        first.setdefault(name, (group, i))


def columns(metrics: list[Section], review: Review) -> list[str] | None:
    """Columns that the metrics compute, None where one of them doesn't say. Two that compute the same are a mistake.

    A metric with an id of its own has it before its columns, so that two of one kind can stand side by side.
    """
    owner: dict[str, Section] = {}
    known = bool(metrics)
    for section in metrics:
        named = getattr(plugins.load("metrics", section.kind), "columns", None)
        if not isinstance(named, dict):
            known = False
            continue
        for column in named:
            column = column if section.id == section.kind else f"{section.id}.{column}"
            if column in owner and owner[column].id != section.id:  # equal ids are told as such
                review.note(section.loc, f"{column} is computed by {owner[column].id!r} already: give one of the two another id")
                break
            owner.setdefault(column, section)
    return list(owner) if known else None


def _is_id(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 60 and re.fullmatch(ID_PATTERN, value) is not None


def _example(group: str, raw: Any) -> str:
    known = plugins.names(group)
    return raw if raw in known else (known or ["..."])[0]


def _config(group: str, raw: dict[str, Any], loc: Loc, own: tuple[str, ...], review: Review) -> BaseModel | None:
    kind = raw.get("kind")
    if kind is None:
        review.note(loc, f"missing: kind, one of {', '.join(plugins.names(group)) or 'none'}")
        return None
    if not isinstance(kind, str):
        review.note((*loc, "kind"), f"a name is wanted, not {shown(kind)}")
        return None
    try:
        plugin: Any = plugins.load(group, kind[:100])
    except (plugins.UnknownPlugin, plugins.BrokenPlugin) as error:
        review.note((*loc, "kind"), str(error))
        return None
    return review.check(plugin.Config, {key: value for key, value in raw.items() if key not in own}, loc, known=own)
