"""The JSON Schema of a scenario file, for editors: completion and checks while one types, over every plug-in that is installed."""

from __future__ import annotations

import inspect
from typing import Any

from pydantic.errors import PydanticUserError

from testbed import plugins
from testbed.report.cameras import CameraSpec
from testbed.scenario.model import ID_PATTERN, MAX_TAGS, ActorModel, Document, TagRule

_REF = "#/$defs/"
_BOUNDS: dict[str, Any] = {
    "type": "object",
    "properties": {"min": {"type": "number"}, "max": {"type": "number"}},
    "additionalProperties": False,
    "minProperties": 1,
}
_ID = {"type": "string", "pattern": ID_PATTERN, "description": "how the rest of the scenario calls it; its kind, where left out"}


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a scenario. Sections of plug-ins are told apart by `kind`; one that can't be imported is left out."""
    whole = _owned(Document.model_json_schema(), "")
    definitions: dict[str, Any] = whole.pop("$defs", {})
    properties = whole["properties"]
    for group in plugins.GROUPS:
        kinds = _kinds(group, definitions)
        section: dict[str, Any] = {"oneOf": kinds} if kinds else {"type": "object", "required": ["kind"]}
        definitions[group] = {"description": f"one of the {group} that are installed", **section}
    properties["world"] = {"$ref": f"{_REF}worlds"}
    for group in ("actors", "sensors", "estimators", "metrics"):
        properties[group] = {"type": "array", "items": {"$ref": f"{_REF}{group}"}}
    definitions["tag"] = _lifted(TagRule.model_json_schema(), "tag", definitions)
    properties["tags"] = {"type": "array", "items": {"$ref": f"{_REF}tag"}, "maxItems": MAX_TAGS}
    definitions["camera"] = _lifted(CameraSpec.model_json_schema(), "camera", definitions)
    properties["cameras"] = {"type": "array", "items": {"$ref": f"{_REF}camera"}, "maxItems": 100}
    properties["expect"] = {"type": "object", "additionalProperties": {"type": "object", "additionalProperties": _expected()}}
    properties["sweep"] = {"type": "object", "additionalProperties": {"type": "array", "minItems": 1}}
    _describe(properties)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A scenario of the warehouse radio testbed"}
    return {**head, **{k: v for k, v in whole.items() if k not in ("title", "description")}, "$defs": dict(sorted(definitions.items()))}


def _expected() -> dict[str, Any]:
    """Bounds on a metric of one figure, or on some of its statistics."""
    return {"anyOf": [_BOUNDS, {"type": "object", "additionalProperties": _BOUNDS, "minProperties": 1}]}


def _kinds(group: str, definitions: dict[str, Any]) -> list[dict[str, Any]]:
    found = []
    for name in plugins.names(group):
        try:
            plugin: Any = plugins.load(group, name)
            own = plugin.Config.model_json_schema()
        except (plugins.BrokenPlugin, PydanticUserError):
            continue
        label = f"{group}.{name}"
        section = _lifted(own, label, definitions)
        common: dict[str, Any] = {"kind": {"const": name}}
        required = ["kind", *section.get("required", [])]
        if group == "actors":
            base = _lifted(ActorModel.model_json_schema(), "actor", definitions)
            base["properties"]["tags"] = {"type": "array", "items": {"$ref": f"{_REF}tag"}}
            common = {**base["properties"], **common, "id": _ID}
            required += [word for word in base["required"] if word not in ("kind", "id")]
        elif group != "worlds":
            common["id"] = _ID
        told = (inspect.getdoc(plugin) or "").partition("\n")[0]
        found.append({
            **section, "type": "object", "title": name, "description": told, "properties": {**common, **section.get("properties", {})},
            "required": required, "additionalProperties": False,
        })  # fmt: skip
    return found


def _lifted(schema: dict[str, Any], owner: str, definitions: dict[str, Any]) -> dict[str, Any]:
    """A model's schema with its definitions put among the whole's, under names that can't clash."""
    owned = _owned(schema, f"{owner}.")
    definitions.update({f"{owner}.{name}": value for name, value in owned.pop("$defs", {}).items()})
    if "$ref" in owned:  # a model that contains itself
        return {**definitions[owned["$ref"].removeprefix(_REF)]}
    return owned


def _owned(value: Any, prefix: str) -> Any:
    """A copy with all references renamed."""
    if isinstance(value, dict):
        return {
            k: _REF + prefix + v.removeprefix(_REF) if k == "$ref" and isinstance(v, str) else _owned(v, prefix) for k, v in value.items()
        }
    return [_owned(item, prefix) for item in value] if isinstance(value, list) else value


def _describe(properties: dict[str, Any]) -> None:
    for name, told in _TOLD.items():
        properties[name]["description"] = told


_TOLD = {
    "name": "what results are filed under",
    "seed": "root of all random numbers: the same seed gives the same results, bit for bit",
    "trials": "independent repetitions, each with its own draws",
    "block": "trials that are simulated and estimated in one call: more of them are faster for short trials, and take more memory",
    "duration_s": "length of a trial, s",
    "world": "the hall: its geometry and how things move in it",
    "actors": "what moves, or could: trolleys, forklifts, people",
    "sensors": "what hears and measures: readers, odometers, compasses",
    "tags": "tags that no actor carries; an actor's own are in its section",
    "targets": "patterns over ids of tags and actors that are to be located; left out: every tag on an actor that moves",
    "references": "patterns over ids of tags that stand still and whose place the installer knows",
    "prior": "what every estimator is told before it starts",
    "cameras": "what is to be seen of it: where pictures are taken from, and when",
    "estimators": "the methods to compare, all on the same data",
    "metrics": "figures of merit; left out: all that are installed",
    "report_hz": "how often estimates are recorded and scored, Hz",
    "hold_s": "how long the driver waits for late events before it goes on, s",
    "step_hz": "steps of the physics, Hz",
    "truth_hz": "instants of the truth that are kept, Hz; divides step_hz",
    "rays": "the ray caster: boxes (fast) or bullet (the physics engine's own, for comparison)",
    "survey": "how well the installer knows where the antennas are",
    "expect": "bounds on the results: by estimator, by paired difference (\"ekf - ukf\"), and on the world itself",
    "published": "tables that others published of the same study, set beside ours in the report",
    "report": "what is to be seen in the report besides: a coverage map of the site's readers",
    "sweep": "paths and the values that each takes; every combination is run",
    "files": "contents of the tables that tags name, kept with the results of a run",
}  # fmt: skip
