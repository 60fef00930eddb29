"""Whatever stands in a document, the answer is a Scenario or a ScenarioError: never another exception, never silence."""

import copy
import json

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from testbed.scenario import Scenario, ScenarioError, from_dict, from_text

RELAXED = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None
)  # the fakes never change
WORDS = [
    "id",
    "kind",
    "name",
    "trials",
    "position_m",
    "csv",
    "on",
    "per_group",
    "mount",
    "t1",
    "ekf",
    "hall",
    "cart",
    "world",
    "3 km/h",
    "1 kg",
    "é",
    "",
]
PATHS = [
    "trials",
    "world.gates",
    "actors.t1",
    "actors.0.tags",
    "tags",
    "sensors.portal.kind",
    "expect",
    "sweep",
    "files",
    "name",
    "a.b",
    "x",
]
scalars = st.none() | st.booleans() | st.integers(-5, 10**12) | st.floats() | st.sampled_from(WORDS) | st.text(max_size=6)
anything = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(WORDS), inner, max_size=3), max_leaves=6
)


def outcome(make, *args):
    made = problems = None
    try:
        made = make(*args)
    except ScenarioError as error:
        problems = error.problems
    if problems is None:
        assert isinstance(made, Scenario)
        assert from_dict(made.document).hash == made.hash
    else:
        assert problems
        for problem in problems:
            assert problem.message
            assert not any(jargon in problem.message for jargon in ("pydantic", "Input should", "function-before"))


def places(value, loc=()):
    """Every place of a document, the inner ones after those that hold them."""
    yield loc
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for step, item in items:
        yield from places(item, (*loc, step))


def mutated(data, document):
    """The document after one random change at one random place: taken away, renamed, doubled or replaced."""
    loc = data.draw(st.sampled_from(list(places(document))[1:]))
    *way, last = loc
    here = document
    for step in way:
        here = here[step]
    match data.draw(st.sampled_from(["delete", "rename", "replace", "wrap"])):
        case "delete":
            del here[last]
        case "rename" if isinstance(here, dict):
            here[data.draw(st.sampled_from([*WORDS, f"{last}s", str(last)[1:], f"{last}_ft"]))] = here.pop(last)
        case "wrap":
            here[last] = [here[last]]
        case _:
            here[last] = data.draw(anything)
    return document


@RELAXED
@given(st.data())
def test_a_changed_document_gives_a_scenario_or_its_mistakes(fakes, document, data):
    document = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        document = mutated(data, document) or {"name": "emptied"}
    outcome(from_dict, document)


@RELAXED
@given(anything)
def test_any_data_gives_a_scenario_or_its_mistakes(fakes, value):
    outcome(from_text, json.dumps(value))
    if isinstance(value, dict):
        outcome(from_dict, value)


@RELAXED
@given(st.data())
def test_a_file_with_changed_letters_gives_a_scenario_or_its_mistakes(fakes, document, data):
    text = json.dumps(document, indent=1)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 12))
        text = text[:start] + data.draw(st.text("[]{},:\n -&*!|\"'1e.x#\t", max_size=4)) + text[start + length :]
    outcome(from_text, text)


@RELAXED
@given(st.lists(st.sampled_from(PATHS), max_size=3), anything)
def test_any_setting_gives_a_scenario_or_its_mistakes(fakes, document, paths, value):
    outcome(from_dict, document, dict.fromkeys(paths, value))
    outcome(from_dict, document, [f"{path}={value}" for path in paths])


@RELAXED
@given(st.dictionaries(st.sampled_from(PATHS), st.lists(anything, max_size=3), max_size=3))
def test_any_sweep_gives_a_scenario_or_its_mistakes(fakes, document, sweep):
    outcome(from_dict, {**document, "sweep": sweep})


@RELAXED
@given(st.lists(st.text(max_size=12), min_size=1, max_size=8), st.binary(max_size=40))
def test_any_table_gives_a_scenario_or_its_mistakes(fakes, document, cells, rubbish):
    for table in ("id,x_m,y_m,z_m\n" + ",".join(cells), "\n".join(cells), rubbish.decode("latin-1")):
        outcome(from_dict, {**document, "tags": [{"csv": "t.csv"}], "files": {"t.csv": table}})
