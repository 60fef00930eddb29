"""Values set from outside: --set, the points of a sweep, and a scenario with some of its estimators."""

import itertools
import json

import pytest

from testbed.scenario import ScenarioError, from_dict, from_text, only, override
from testbed.scenario.overrides import resolve


def told(document, sets=()):
    with pytest.raises(ScenarioError) as caught:
        from_dict(document, sets)
    return str(caught.value)


# ---------------------------------------------------------------- --set


def test_a_path_names_items_by_id_kind_or_index(fakes, document):
    s = from_dict(
        document,
        [
            "trials=9",
            "sensors.portal.antennas.count=5",
            "actors.t1.route.speed_mps=3 km/h",
            "estimators.ekf.gate=0.5",
            "estimators.1.gate=.25",
            "tags.bay.per_group=2",
        ],
    )
    assert s.trials == 9
    assert s.sensors[0].config.antennas.count == 5
    assert s.actors[0].route.speed_mps == pytest.approx(3 / 3.6)
    assert [e.config.gate for e in s.estimators] == [0.5, 0.25]
    assert s.tags[1].per_group == 2


def test_values_are_read_as_yaml_and_may_be_whole_sections(fakes, document):
    s = from_dict(
        document, ["prior={position_m: [1, 2, 3]}", "title='7'", "targets=[a, b]", "survey.antenna_yaw_std_deg=2", "expect=", "rays=bullet"]
    )
    assert s.prior.position_m == (1, 2, 3)
    assert (s.title, s.targets, s.survey.antenna_yaw_std_deg, s.expect, s.rays) == ("7", ("a", "b"), 2.0, (), "bullet")


def test_setting_a_value_equals_writing_it(fakes, document):
    written = json.loads(json.dumps(document).replace('"count": 3', '"count": 7'))
    assert from_dict(document, ["sensors.portal.antennas.count=7"]) == from_dict(written)
    assert from_dict(document, {"sensors.portal.antennas.count": 7}).hash == from_dict(written).hash
    assert override(from_dict(document), ["sensors.portal.antennas.count=7"]) == from_dict(written)
    assert from_dict(document).hash != from_dict(written).hash


def test_setting_leaves_the_callers_document_alone(fakes, document):
    before = json.dumps(document)
    from_dict(document, ["sensors.portal.antennas.count=7", "world.gates=5"])
    assert json.dumps(document) == before


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("trials", "--set: 'trials' is not path=value, as in trials=8"),
        ("=3", "--set: '=3' is not path=value"),
        ("trials=1e9", "--set trials: must be at most 1000000, is 1000000000.0"),
        ("trails=3", "--set trails: extra field, did you mean trials?"),
        ("trials=.nan", "--set trials: a finite number is wanted, not .nan"),
        ("trials=[1", "--set trials: a comma or a closing ] is missing"),
        ("trials=!!python/name:os.system", "--set trials: the tag"),
        ("sensors.portl.range_m=3", "--set sensors.portl.range_m: nothing in sensors is named 'portl', did you mean portal?"),
        ("sensors.7.range_m=3", "--set sensors.7.range_m: sensors has no item 7: it has 1, counted from 0"),
        ("sensors.portal.antenas.count=3", "--set sensors.portal.antenas: extra field, did you mean antennas?"),
        ("sensors.portal.antennas.cuont=3", "--set sensors.portal.antennas.cuont: extra field, did you mean count?"),
        ("sensors.portal.range_m.x=3", "--set sensors.portal.range_m.x: sensors.portal.range_m is a single value"),
        ("actors.t1.route.sped_mps=3", "--set actors.t1.route.sped_mps: extra field, did you mean speed_mps?"),
        ("estimators.ekf.kind=uf", "--set estimators.ekf.kind: no estimator named 'uf', did you mean ukf?"),
        ("world..gates=3", "--set world..gates: a path is words with dots between them"),
        ("prior.position_std_m=[1, 2, x]", "--set prior.position_std_m.2: 'x' is not a number in m"),
    ],
)
def test_what_cannot_be_set_is_told_in_the_words_of_the_command(fakes, document, text, sentence):
    document["expect"] = {}
    assert sentence in told(document, [text])


def test_all_wrong_paths_are_told_at_once(fakes, document):
    assert len(told(document, ["a.b.c", "sensors.x.y=1", "sensors.z.y=1", "trials=1", "trials=2"]).splitlines()) == 2
    assert len(told(document, ["sensors.x.y=1", "sensors.z.y=1"]).splitlines()) == 2


def test_one_text_in_place_of_a_list_is_a_programming_error(fakes, document):
    with pytest.raises(TypeError):
        from_dict(document, "trials=3")


def test_keys_that_hold_dots_are_found_whole():
    document = {"sweep": {"sensors.portal.range_m": [1, 2]}, "files": {"tags.csv": "id"}}
    assert resolve(document, "sweep.sensors.portal.range_m.1")[0] == ("sweep", "sensors.portal.range_m", 1)
    assert resolve(document, "files.tags.csv")[0] == ("files", "tags.csv")


# ---------------------------------------------------------------- the sweep


def test_points_are_all_combinations_in_the_order_of_the_file(fakes, document):
    document["sweep"] = {"world.gates": [1, 2, 3], "sensors.portal.antennas": [{"count": 2}, [{"position_m": [0, 0, 1]}]]}
    s = from_dict(document)
    points = s.points()
    assert [p.index for p in points] == list(range(6))
    assert [(p.set["world.gates"], p.set["sensors.portal.antennas"]) for p in points] == list(
        itertools.product([1, 2, 3], document["sweep"]["sensors.portal.antennas"])
    )
    assert [p.scenario.world.config.gates for p in points] == [1, 1, 2, 2, 3, 3]
    assert points[1].scenario.sensors[0].config.antennas[0].position_m == (0, 0, 1)
    assert len({p.scenario.hash for p in points}) == 6


def test_a_point_is_the_scenario_with_its_values_set_and_no_sweep(fakes, document):
    plain = {k: v for k, v in document.items() if k != "sweep"}
    points = from_dict({**document, "sweep": {"world.gates": [4, 5]}}).points()
    for point, gates in zip(points, (4, 5), strict=True):
        assert point.scenario == from_dict(plain, {"world.gates": gates})
        assert [p.scenario for p in point.scenario.points()] == [point.scenario]
        assert from_dict(point.scenario.document) == point.scenario


def test_a_recorded_document_gives_the_same_points_again(fakes, document):
    document["sweep"] = {"estimators.fast.gate": [0.1, 0.2], "duration_s": [5, 10]}
    s = from_dict(document, ["trials=3"])
    again = from_dict(json.loads(json.dumps(s.document)))
    assert again == s
    assert [p.set for p in again.points()] == [p.set for p in s.points()]
    assert [p.scenario.hash for p in again.points()] == [p.scenario.hash for p in s.points()]


SWEPT = """\
name: dock
seed: 1
trials: 2
duration_s: 10
world: {kind: hall}
sensors:
  - {id: portal, kind: portal_reader}
sweep:
  world.gates: [1, 99]
  sensors.portal.range_m:
    - 5
    - 5 kg
"""


def test_every_wrong_value_of_a_sweep_is_told_once_at_its_own_place(fakes):
    with pytest.raises(ScenarioError) as caught:
        from_text(SWEPT, "dock.yaml")
    assert str(caught.value).splitlines() == [
        "dock.yaml:9:20 sweep.world.gates.1: must be at most 20, is 99",
        "dock.yaml:12:7 sweep.sensors.portal.range_m.1: '5 kg' is not a quantity in m: the units don't fit",
    ]


@pytest.mark.parametrize(
    ("sweep", "sentence"),
    [
        ({"world.gates": 3}, "sweep.world.gates: a list of values is wanted, as in [2, 3, 4]"),
        ({"world.gates": []}, "sweep.world.gates: a list of values is wanted"),
        ({"world.gate": [1, 2]}, "sweep.world.gate.0: extra field, did you mean gates?"),
        ({"wrld.gates": [1, 2]}, "sweep.wrld: extra field, did you mean world?"),
        ({"sensors.portl.range_m": [1]}, "sweep.sensors.portl.range_m: nothing in sensors is named 'portl', did you mean portal?"),
        ({"estimators.ekf.kind": ["ukf", "efk"]}, "sweep.estimators.ekf.kind.1: no estimator named 'efk', did you mean ekf?"),
        ({"world": [{"kind": "hall", "gates": -1}]}, "sweep.world.0.gates: must be at least 0, is -1"),
        ({"sweep.x": [1]}, "sweep.sweep.x: sweep can't be swept over"),
        ({"actors.0.load": [0.1], "actors.t1.load": [0.2]}, "sweep.actors.t1.load: sets the same value as actors.0.load"),
        ({"actors.0": [{}], "actors.t1.load": [0.2]}, "sweep.actors.t1.load: sets the same value as actors.0"),
        ({"trials": list(range(1, 102)), "seed": list(range(100))}, "sweep: 10,100 points, at most 10,000 are run"),
        ([1, 2], "sweep: a mapping (key: value) is wanted, not a list"),
    ],
)
def test_a_wrong_sweep_is_told_in_a_sentence(fakes, document, sweep, sentence):
    document["expect"] = {}
    assert f"<dict> {sentence}" in told({**document, "sweep": sweep})


def test_mistakes_of_values_that_only_clash_together_are_found(fakes, document):
    document["estimators"] = [{"kind": "best", "particles": 5}]
    document["expect"] = {}
    document["sweep"] = {"estimators.best.particles": [2, 5], "estimators.best.keep": [1, 4]}
    assert told(document) == "<dict> estimators.0: keep must be at most particles, 4 of 2 can't be kept"


def test_a_sweep_is_checked_even_where_the_scenario_itself_is_wrong(fakes, document):
    document |= {"trials": 0, "sweep": {"world.gates": [1, 99]}, "expect": {}}
    assert told(document).splitlines() == [
        "<dict> trials: must be at least 1, is 0",
        "<dict> sweep.world.gates.1: must be at most 20, is 99",
    ]


def test_set_and_sweep_of_one_value_are_not_mixed_up(fakes, document):
    document["sweep"] = {"world.gates": [1, 2]}
    assert "--set world.gates: the sweep sets this as well: set sweep.world.gates" in told(document, ["world.gates=3"])
    assert [p.set for p in from_dict(document, ["sweep.world.gates=[4]"]).points()] == [{"world.gates": 4}]
    assert [p.set for p in from_dict(document, ["sweep={}"]).points()] == [{}]


def test_parts_that_a_sweep_does_not_touch_are_shared_by_its_points(fakes, document):
    document["sweep"] = {"seed": list(range(50))}
    points = from_dict(document).points()
    assert len({id(p.scenario.sensors[0]) for p in points}) == 1, "a sweep of thousands is checked in the time of its changes"


# ---------------------------------------------------------------- some of the estimators


def test_only_some_estimators_with_the_claims_that_are_about_them(fakes, document):
    document["sweep"] = {"world.gates": [1, 2]}
    s = from_dict(document)
    fast = only(s, ["fast"])
    assert [e.id for e in fast.estimators] == ["fast"]
    assert {c.subject for c in fast.expect} == {"fast", "world"}
    assert [[e.id for e in p.scenario.estimators] for p in fast.points()] == [["fast"], ["fast"]]
    assert from_dict(fast.document) == fast
    assert only(s, ["ekf", "fast"]) == s
    assert [e.id for e in s.estimators] == ["ekf", "fast"]


def test_only_an_estimator_that_is_there(fakes, document):
    with pytest.raises(ScenarioError, match="no estimator has the id 'fst', did you mean fast"):
        only(from_dict(document), ["fst"])
    document["sweep"] = {"estimators.ekf.gate": [0.1, 0.2]}
    with pytest.raises(ScenarioError, match="the sweep varies an estimator that is left out"):
        only(from_dict(document), ["fast"])
