"""The JSON Schema for editors says what the loader says; the starter is a scenario."""

import json
import re

import pytest

from testbed import plugins
from testbed.scenario import from_dict, from_text, json_schema, listing, load, starter
from testbed.scenario.nodes import read


def fits(value, schema, root):
    """Whether a value fits the part of JSON Schema that is used here: small enough to be seen to be right."""
    if "$ref" in schema:
        return fits(value, root["$defs"][schema["$ref"].removeprefix("#/$defs/")], root)
    kinds = {
        "object": dict, "array": list, "string": str, "boolean": bool, "null": type(None), "integer": int, "number": (int, float)
    }  # fmt: skip
    kind = schema.get("type")
    if kind and (not isinstance(value, kinds[kind]) or (kind in ("integer", "number") and isinstance(value, bool))):
        return False
    checks = [
        "const" not in schema or value == schema["const"],
        "enum" not in schema or value in schema["enum"],
        "anyOf" not in schema or any(fits(value, s, root) for s in schema["anyOf"]),
        "oneOf" not in schema or sum(fits(value, s, root) for s in schema["oneOf"]) == 1,
    ]
    if isinstance(value, str) and "pattern" in schema:
        checks.append(re.search(schema["pattern"], value) is not None)
    if isinstance(value, (int, float)):
        checks += [
            value >= schema.get("minimum", value),
            value <= schema.get("maximum", value),
            value > schema.get("exclusiveMinimum", value - 1),
        ]
    if isinstance(value, list):
        prefix = schema.get("prefixItems", [])
        checks += [fits(v, s, root) for v, s in zip(value, prefix, strict=False)]
        checks += [fits(v, schema.get("items", {}), root) for v in value[len(prefix) :]]
        checks += [len(value) >= schema.get("minItems", 0), len(value) <= schema.get("maxItems", len(value))]
    if isinstance(value, dict):
        known, other = schema.get("properties", {}), schema.get("additionalProperties", True)
        checks += [name in value for name in schema.get("required", [])]
        checks += [len(value) >= schema.get("minProperties", 0)]
        for name, item in value.items():
            if name in known:
                checks.append(fits(item, known[name], root))
            else:
                checks.append(other if isinstance(other, bool) else fits(item, other, root))
    return all(checks)


def references(value):
    if isinstance(value, dict):
        yield from (v for k, v in value.items() if k == "$ref")
        for item in value.values():
            yield from references(item)
    elif isinstance(value, list):
        for item in value:
            yield from references(item)


def test_a_valid_scenario_fits_the_schema(fakes, document):
    schema = json_schema()
    assert fits(document, schema, schema)
    document["sweep"] = {"world.gates": [1, 2]}
    document["prior"]["velocity_std_mps"] = [0.1, 0.2, "0.3 km/h"]
    assert from_dict(document)
    assert fits(document, schema, schema)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("trials",), 10**9), (("seed",), "x"), (("trails",), 1), (("world", "kind"), "hal"), (("world", "gates"), 99),
        (("sensors", 0, "rate"), 3),
        (("actors", 0, "motion"), "kinetic"), (("actors", 0, "route"), {"waypoints_m": [[0, 0]]}), (("actors", 0, "tags"), [{"id": 3}]),
        (("estimators", 0), {"kind": "best"}), (("estimators", 0), {"id": "x"}), (("estimators", 0), "ekf"),
        (("expect",), {"ekf": {"m": {"mean": {"mx": 1}}}}),
        (("sweep",), {"trials": []}), (("tags",), [{"per_bay": 3}]), (("rays",), "none"), (("prior", "position_std_m"), [1, 2]),
    ],
)  # fmt: skip
def test_what_the_loader_refuses_does_not_fit_the_schema(fakes, document, path, value):
    schema = json_schema()
    here = document
    for step in path[:-1]:
        here = here[step]
    here[path[-1]] = value
    assert not fits(document, schema, schema)
    with pytest.raises(ValueError):
        from_dict(document)


def test_every_reference_of_the_schema_leads_somewhere(fakes):
    schema = json_schema()
    found = set(references(schema))
    assert found
    assert {ref.removeprefix("#/$defs/") for ref in found} <= schema["$defs"].keys()
    json.dumps(schema, allow_nan=False)


def test_sections_are_told_apart_by_kind_and_hold_the_fields_of_their_plug_in(fakes):
    kinds = {entry["properties"]["kind"]["const"]: entry for entry in json_schema()["$defs"]["sensors"]["oneOf"]}
    assert kinds.keys() == {"portal_reader"}
    assert {"kind", "id", "antennas", "range_m"} <= kinds["portal_reader"]["properties"].keys()
    assert kinds["portal_reader"]["properties"]["range_m"]["unit"] == "m"
    assert kinds["portal_reader"]["description"] == "A sensor for tests."
    assert kinds["portal_reader"]["additionalProperties"] is False


def test_a_plug_in_that_cannot_be_imported_is_left_out(fakes):
    fakes["estimators"]["broken"] = "broken"
    assert [entry["title"] for entry in json_schema()["$defs"]["estimators"]["oneOf"]] == ["best", "ekf", "ukf"]


def test_without_plug_ins_there_is_still_a_schema(fakes):
    for kinds in fakes.values():
        kinds.clear()
    schema = json_schema()
    assert fits({"name": "x", "seed": 1, "trials": 1, "duration_s": 1, "world": {"kind": "any"}}, schema, schema)


# ---------------------------------------------------------------- with what ships


def test_the_starter_is_a_scenario_and_fits_the_schema(tmp_path):
    path = tmp_path / "my-dock.yaml"
    path.write_text(starter("my-dock"))
    s = load(path)
    assert (s.name, len(s.estimators)) == ("my-dock", 3)
    schema = json_schema()
    assert fits(read(starter(), "starter").plain(), schema, schema)


def test_what_the_starter_keeps_in_comments_is_right_as_well():
    text = re.sub(r"^( *)# (?=(tags|sweep|metrics|\"|- \{|  *[\w.\"]|  *- \{))", r"\1", starter(), flags=re.MULTILINE)
    text = text.replace(", ...}", "}").replace("- {csv: tags.csv}", "- {id: still, position_m: [1, 1, 1]}")
    s = from_text(re.sub(r" {4}# .*", "", text))
    assert (len(s.points()), len(s.estimators), len(s.tags)) == (3, 4, 2)


def test_the_starter_has_no_other_name_than_a_scenario_can_have():
    with pytest.raises(ValueError, match="can't be a name"):
        starter("my dock: x")


@pytest.mark.parametrize("group", plugins.GROUPS)
def test_every_plug_in_that_ships_is_in_the_schema(group):
    offered = {entry["title"] for entry in json_schema()["$defs"][group].get("oneOf", [])}
    assert offered == set(plugins.names(group))


@pytest.mark.parametrize("name", [name for name, _, _ in listing()])
def test_every_scenario_that_ships_is_valid_fits_the_schema_and_has_a_title(name):
    s, schema = load(name), json_schema()
    assert s.title
    assert s.name == name.rpartition("/")[2]
    assert fits(read(s.text, name).plain(), schema, schema)
    assert from_dict(s.document) == s
