"""What pydantic found, in plain sentences: the place in the document, what is wanted there, and the word that was meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.errors import PydanticUserError
from pydantic_core import ErrorDetails

from testbed.plugins import suggest
from testbed.scenario.problems import Loc

UNITS = {
    "m": "metres", "s": "seconds", "hz": "hertz", "mps": "metres per second", "mps2": "metres per second squared",
    "deg": "degrees", "dps": "degrees per second", "db": "decibels", "dbi": "decibels over an isotropic radiator",
    "dbm": "decibel-milliwatts", "kg": "kilograms",
}  # fmt: skip
_FOREIGN = {
    "mm", "cm", "dm", "km", "ft", "feet", "in", "inch", "inches", "yd", "metre", "metres", "meter", "meters", "ms", "us", "ns",
    "sec", "secs", "second", "seconds", "min", "minutes", "h", "khz", "mhz", "ghz", "kmh", "kph", "mph", "fps", "knots", "rad",
    "rads", "degree", "degrees", "dbw", "mw", "w", "watt", "watts", "g", "lb", "lbs", "kilograms",
}  # fmt: skip
_MAPPING = "a mapping (key: value)"
_WANTED = {
    "float": "a number", "int": "a whole number", "bool": "true or false", "string": "a text", "none_required": "nothing",
    "list": "a list", "tuple": "a list", "set": "a list", "frozen_set": "a list", "is_instance_of": "a fitting value",
    "dict": _MAPPING, "model": _MAPPING, "mapping": _MAPPING, "model_attributes": _MAPPING, "dataclass": _MAPPING,
}  # fmt: skip
_BOUNDS = {
    "greater_than": ("gt", "greater than"), "greater_than_equal": ("ge", "at least"), "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"), "multiple_of": ("multiple_of", "a multiple of"),
}  # fmt: skip

Finding = tuple[Loc, str, bool]  # place, sentence, whether the place is a key


def shown(value: Any) -> str:
    """A value as a file would have it, short."""
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    if isinstance(value, (Mapping, list, tuple)):
        return "a mapping" if isinstance(value, Mapping) else "a list"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:56]}...{text[-1]}"


def findings(error: ValidationError, model: type[BaseModel], data: Any, known: Iterable[str] = ()) -> list[Finding]:
    """Every mistake of a mapping that `model` refused. `known` are keys that belong there besides the model's own."""
    found: list[Finding] = []
    for detail in _branches(error.errors(include_url=False), data):
        place, _ = _follow(detail["loc"], data, detail["type"] in ("missing", "extra_forbidden"))
        if detail["type"] == "extra_forbidden":
            keys = _keys(model, place[:-1]) | (set(known) if len(place) == 1 else set())
            found.append((place, extra(str(place[-1]), sorted(keys)), True))
        else:
            beneath: Loc = getattr(detail.get("ctx", {}).get("error"), "place", ())  # `testbed.quantity.Misplaced`
            found.append(((*place, *beneath), _sentence(detail), False))
    return list(dict.fromkeys(found))


def extra(word: str, known: list[str]) -> str:
    """What to say of a key that nobody knows: the unit it should have, or the name it may be meant for."""
    stem, _, unit = word.rpartition("_")
    stems = {word, stem} if stem and unit.lower() in _FOREIGN | UNITS.keys() else {word}
    for field in known:
        base, _, own = field.rpartition("_")
        if own in UNITS and base in stems:
            return f"extra field: it is wanted in {UNITS[own]}, as {field}"
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if not near and len(word) >= 3:  # rate_hz for read_rate_hz, per_bay for per_group: what they share drowns in the rest
        starts = f"{word.partition('_')[0]}_"
        near = [k for k in known if word in k.split("_") or k.endswith(f"_{word}") or ("_" in word and k.startswith(starts))][:1]
    if near:
        return f"extra field, did you mean {near[0]}?"
    return f"extra field{suggest(word, known)}"


def _follow(loc: tuple[int | str, ...], data: Any, to_the_end: bool) -> tuple[Loc, int | None]:
    """The part of pydantic's place that exists in the data, and the index of the first step that is a union's branch.

    The last step may be missing from the data where that is just the complaint.
    """
    place: list[str | int] = []
    branch = None
    for i, step in enumerate(loc):
        if (isinstance(data, Mapping) and step in data) or (isinstance(data, (list, tuple)) and isinstance(step, int) and step < len(data)):
            data = data[step]  # type: ignore[index]
            place.append(step)
        elif to_the_end and i == len(loc) - 1:
            place.append(step)
        elif branch is None:
            branch = i
    return tuple(place), branch


def _branches(details: list[ErrorDetails], data: Any) -> list[ErrorDetails]:
    """Of a union that fits no branch, the branch that came furthest; where none got inside, one complaint for all."""
    kept: list[ErrorDetails] = []
    unions: dict[tuple[int | str, ...], dict[int | str, list[ErrorDetails]]] = {}
    for detail in details:
        _, branch = _follow(detail["loc"], data, detail["type"] in ("missing", "extra_forbidden"))
        if branch is None:
            kept.append(detail)
        else:
            unions.setdefault(detail["loc"][:branch], {}).setdefault(detail["loc"][branch], []).append(detail)
    for place, branches in unions.items():
        inside = {name: found for name, found in branches.items() if any(len(d["loc"]) > len(place) + 1 for d in found)}
        if len(branches) == 1 or inside:
            kept.extend(min((inside or branches).values(), key=len))
        else:
            every = [found[0] for found in branches.values()]
            kept.append({**every[0], "loc": place, "type": "testbed_union", "msg": _either(every)})
    return kept


def _either(details: list[ErrorDetails]) -> str:
    sentences = list(dict.fromkeys(_sentence(detail) for detail in details))
    wanted = [s.partition(" is wanted, not ")[0] for s in sentences]
    if all(" is wanted, not " in s for s in sentences):
        return f"{' or '.join(wanted)} is wanted, not {shown(details[0]['input'])}"
    return ", or ".join(sentences)


def _sentence(detail: ErrorDetails) -> str:
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    if kind == "missing":
        return "missing"
    if kind in ("value_error", "assertion_error"):
        return str(context.get("error", detail["msg"]))
    if kind == "testbed_union":
        return detail["msg"]
    if kind in _BOUNDS and isinstance(value, bool):
        return f"a number is wanted, not {shown(value)}"
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"must be {words} {_brief(context[name])}, is {shown(value)}"
    if kind in ("literal_error", "enum"):
        return _choice(str(context["expected"]), value)
    if kind in ("too_short", "too_long"):
        limit = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']:,}"
        actual = f", has {context['actual_length']:,}" if context.get("actual_length") is not None else ""
        return f"needs {limit} items{actual}" if kind == "too_short" else f"has {limit} items{actual.replace(', has', ', not')}"
    if kind in ("string_too_short", "string_too_long"):
        limit = f"at least {context['min_length']}" if kind == "string_too_short" else f"at most {context['max_length']}"
        return f"must have {limit} characters, has {len(str(value))}"
    if kind == "string_pattern_mismatch":
        return _pattern(str(context["pattern"]), value)
    if kind == "finite_number":
        return f"a finite number is wanted, not {shown(value)}"
    if kind == "union_tag_invalid":
        return f"{shown(context['tag'])} is none of {context['expected_tags']}"
    if kind == "union_tag_not_found":
        name = str(context["discriminator"]).strip("'")
        return f"{name} is missing: it says what this is"
    return _type(kind, detail["msg"], value)


def _type(kind: str, message: str, value: Any) -> str:
    stem = kind.removesuffix("_type").removesuffix("_parsing")
    if kind == "int_from_float":
        return f"a whole number is wanted, not {shown(value)}"
    if stem not in _WANTED:
        return message[:1].lower() + message[1:].replace("Input should", "should")
    mend = ""
    if stem == "string" and isinstance(value, (int, float)):
        mend = ": put it in quotes"
    elif _WANTED[stem] == "a list" and isinstance(value, (str, int, float)) and not isinstance(value, bool):
        mend = f": put it in brackets, [{value}]"
    return f"{_WANTED[stem]} is wanted, not {shown(value)}{mend}"


def _brief(limit: Any) -> str:
    return str(int(limit)) if isinstance(limit, float) and limit.is_integer() and abs(limit) < 1e15 else str(limit)


def _choice(expected: str, value: Any) -> str:
    words = [word.strip("'\"") for word in expected.replace(" or ", ", ").split(", ")]
    near = difflib.get_close_matches(value, words, n=1) if isinstance(value, str) else []
    return f"{shown(value)} is none of {', '.join(words)}{f', did you mean {near[0]}?' if near else ''}"


def _pattern(pattern: str, value: Any) -> str:
    if pattern.startswith("^[A-Za-z][A-Za-z0-9_-]*"):
        return f"{shown(value)} can't be a name: letters, digits, _ and - are, beginning with a letter"
    if pattern.startswith("^[A-Za-z0-9][A-Za-z0-9_.:-]*"):
        return f"{shown(value)} can't be a tag's name: letters, digits, _ . : and - are, beginning with a letter or digit"
    return f"{shown(value)} does not fit the pattern {pattern}"


@cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    try:
        return model.model_json_schema()
    except PydanticUserError:  # a plug-in's field that JSON can't describe: only the suggestions are lost
        return {"properties": {name: {} for name in model.model_fields}}


def _keys(model: type[BaseModel], place: Loc) -> set[str]:
    """The keys that the model knows at a place of its document, over all branches of unions."""
    root = _schema(model)
    nodes = _opened([root], root)
    for step in place:
        inner: list[Any] = []
        for node in nodes:
            if isinstance(step, int):
                items = node.get("prefixItems", [])
                inner.append(items[step] if step < len(items) else node.get("items"))
            else:
                inner.append(node.get("properties", {}).get(step, node.get("additionalProperties")))
        nodes = _opened([node for node in inner if isinstance(node, dict)], root)
    if not any("properties" in node for node in nodes):  # a list that may be written as its only item
        nodes = _opened([node["items"] for node in nodes if isinstance(node.get("items"), dict)], root)
    return {name for node in nodes for name in node.get("properties", {})}


def _opened(nodes: list[dict[str, Any]], root: dict[str, Any]) -> list[dict[str, Any]]:
    """Nodes of a JSON schema with references and unions resolved."""
    found: list[dict[str, Any]] = []
    while nodes:
        node = nodes.pop()
        if "$ref" in node:
            nodes.append(root["$defs"][node["$ref"].rpartition("/")[2]])
        nodes.extend(branch for word in ("anyOf", "oneOf", "allOf") for branch in node.get(word, []))
        if "properties" in node or "items" in node or "prefixItems" in node or "additionalProperties" in node:
            found.append(node)
    return found
