"""A whole scenario: what a valid one gives, and how each mistake is told, with its place and the mend."""

import copy
import json
import pickle

import pytest

from testbed.scenario import ScenarioError, from_dict, from_text

VALID = """\
name: dock
seed: 1
trials: 2
duration_s: 10
world: {kind: hall}
actors:
  - id: t1
    kind: cart
    motion: kinematic
    route: {waypoints_m: [[0, 0], [1, 0]]}
sensors:
  - {id: portal, kind: portal_reader, range_m: 5}
estimators:
  - {kind: ekf}
"""


def told(text_or_document):
    make = from_dict if isinstance(text_or_document, dict) else lambda text: from_text(text, "dock.yaml")
    with pytest.raises(ScenarioError) as caught:
        make(text_or_document)
    return str(caught.value)


def changed(document, path, value):
    """The document with one value replaced, added, or (None) taken away."""
    document = copy.deepcopy(document)
    *way, last = path
    here = document
    for step in way:
        here = here[step]
    if value is None:
        del here[last]
    else:
        here[last] = value
    return document


def test_a_valid_document_gives_every_part_as_it_was_written(fakes, document):
    s = from_dict(document)
    assert (s.name, s.seed, s.trials, s.duration_s) == ("dock", 20261, 4, 20.0)
    assert (s.world.kind, s.world.config.gates, s.world.loc) == ("hall", 2, ("world",))
    cart, parked = s.actors
    assert (cart.id, cart.motion, cart.config.load, cart.route.speed_mps, cart.loc) == ("t1", "kinematic", 0.3, 1.5, ("actors", 0))
    assert (parked.route, parked.position_m, parked.yaw_deg, parked.moves) == (None, (2.0, 3.0), 0.0, False)
    assert s.sensors[0].config.antennas.count == 3
    assert [e.id for e in s.estimators] == ["ekf", "fast"]
    assert [m.id for m in s.metrics] == ["availability", "position_error"], "all metrics, where none are named"
    assert s.prior.position_std_m == (0.4, 0.4, 0.4)
    assert s.prior.velocity_std_mps == (0.25, 0.25, 0.25)
    assert (s.report_hz, s.hold_s, s.step_hz, s.truth_hz, s.rays) == (10.0, 0.0, 240, 120, "boxes")
    assert s.targets == ("t1*",)
    assert [p.scenario is s for p in s.points()] == [True]


def test_yaml_and_mapping_give_the_same_scenario_and_hash(fakes, document):
    from_yaml = from_text(json.dumps(document, indent=2))
    assert from_yaml == from_dict(document)
    assert from_yaml.hash == from_dict(document).hash
    assert from_dict(from_yaml.document) == from_yaml


def test_the_hash_does_not_depend_on_order_comments_spelling_seed_trials_or_expectations(fakes):
    base = from_text(VALID).hash
    backwards = "\n".join(
        [
            "# a comment",
            "sensors: [{range_m: 500 cm, kind: portal_reader, id: portal}]",
            *VALID.splitlines()[:10],
            "estimators: [{kind: ekf}]",
        ]
    )
    assert from_text(backwards).hash == base
    assert from_text(VALID.replace("seed: 1", "seed: 9").replace("trials: 2", "trials: 9")).hash == base
    assert from_text(VALID + "expect: {ekf: {availability: {min: 0.5}}}\n").hash == base
    assert from_text(VALID + "report_hz: 10\n").hash == base, "a default that is written out"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("duration_s: 10", "duration_s: 11"),
        ("range_m: 5", "range_m: 6"),
        ("[1, 0]", "[1, 1]"),
        ("kind: ekf", "kind: ukf"),
        ("ekf}", "ekf, gate: 0.5}"),
    ],
)
def test_the_hash_depends_on_everything_that_changes_a_result(fakes, old, new):
    assert old in VALID
    assert from_text(VALID.replace(old, new)).hash != from_text(VALID).hash


def test_the_hash_is_the_same_in_every_process(fakes):
    # a set's order depends on the process; the fake sensor has one
    assert from_text(VALID).hash == "45686c863bf63ba0e2ccce502f7ba32ad8c47c537659daf0c943c984f9c19e21"


def test_a_scenario_travels_to_another_process(fakes, document):
    s = from_dict({**document, "sweep": {"trials": [1, 2]}})
    copy_ = pickle.loads(pickle.dumps(s))
    assert copy_ == s
    assert copy_.hash == s.hash
    assert len(copy_.points()) == 2
    error = ScenarioError([copy_.problem(("world",), "x").problems[0]])
    assert str(pickle.loads(pickle.dumps(error))) == str(error) == "<dict> world: x"


def test_a_key_with_nothing_after_it_is_not_given(fakes):
    assert from_text(VALID + "sweep:\ntags:\nmetrics:\n").hash == from_text(VALID).hash


# ---------------------------------------------------------------- all mistakes at once, each at its place


def test_every_mistake_of_a_file_is_told_at_once_in_the_order_of_the_file(fakes):
    text = VALID.replace("seed: 1", "seed: -1").replace("kind: hall}", "kind: hal}").replace("speed_mps", "x")
    text = text.replace("range_m: 5", "rate_hz: 3").replace("{kind: ekf}", "{kind: ekf, gat: 0.9}") + "durations_s: 3\n"
    assert told(text).splitlines() == [
        "dock.yaml:2:7 seed: must be at least 0, is -1",
        "dock.yaml:5:15 world.kind: no world named 'hal', did you mean hall?",
        "dock.yaml:12:39 sensors.0.rate_hz: extra field, did you mean read_rate_hz?",
        "dock.yaml:14:17 estimators.0.gat: extra field, did you mean gate?",
        "dock.yaml:15:1 durations_s: extra field, did you mean duration_s?",
    ]


def test_faults_of_the_yaml_and_of_the_scenario_are_told_together(fakes):
    text = VALID.replace("duration_s: 10", "duration_s: .inf").replace("range_m: 5", "range_m: 5, range_m: -6") + "trials: !x 3\nsedd: 1\n"
    assert told(text.replace("hall", "hal")).splitlines() == [
        "dock.yaml:4:13: a finite number is wanted, not .inf",
        "dock.yaml:5:15 world.kind: no world named 'hal', did you mean hall?",
        "dock.yaml:12:51: the key 'range_m' stands here a second time, first in line 12",
        "dock.yaml:15:1: the key 'trials' stands here a second time, first in line 3",
        "dock.yaml:15:9: the tag '!x' is not allowed: a scenario is plain data and can't name code",
        "dock.yaml:16:1 sedd: extra field, did you mean seed?",
    ]


def test_an_id_used_twice_is_told_though_the_section_is_wrong_otherwise(fakes, document):
    document |= {"estimators": [{"kind": "ekf", "gate": 9}, {"id": "ekf", "kind": "ufk"}], "expect": {}}
    assert told(document).splitlines() == [
        "<dict> estimators.0.gate: must be less than 1, is 9",
        "<dict> estimators.1.kind: no estimator named 'ufk', did you mean ukf?",
        "<dict> estimators.1.id: the id 'ekf' is used twice in estimators, first as item 0",
    ]


def test_a_missing_field_is_placed_at_what_should_hold_it(fakes):
    assert told("name: x\n").splitlines() == [f"dock.yaml:1:1 {name}: missing" for name in ("seed", "trials", "duration_s", "world")]
    assert told(VALID.replace("kind: cart", "load: 0.1")) == "dock.yaml:7:5 actors.0: missing: kind, one of cart"
    assert told(VALID.replace("kind: hall", "gates: 1")) == "dock.yaml:5:8 world: missing: kind, one of hall"


MISTAKES = [
    (["seed"], 2.5, "seed: a whole number is wanted, not 2.5"),
    (["seed"], True, "seed: a number is wanted, not true"),
    (["seed"], "one", "seed: a whole number is wanted, not 'one'"),
    (["seed"], 2**63, "seed: must be less than 9223372036854775808, is 9223372036854775808"),
    (["trials"], 10**9, "trials: must be at most 1000000, is 1000000000"),
    (["trials"], 0, "trials: must be at least 1, is 0"),
    (["duration_s"], 1e9, "duration_s: must be at most 86400"),
    (["duration_s"], "20 m", "duration_s: '20 m' is not a quantity in s: the units don't fit"),
    (["duration_s"], "long", "duration_s: 'long' is not a number in s"),
    (["duration_s"], False, "duration_s: a number is wanted, not false"),
    (["name"], 7, "name: a text is wanted, not 7: put it in quotes"),
    (["name"], "two words", "name: 'two words' can't be a name: letters, digits, _ and - are, beginning with a letter"),
    (["title"], "x" * 300, "title: must have at most 200 characters, has 300"),
    (["rays"], "boxs", "rays: 'boxs' is none of boxes, bullet, did you mean boxes?"),
    (["truth_hz"], 77, "truth_hz: must divide step_hz, and 77 does not divide 240"),
    (["sensors"], {"kind": "portal_reader"}, "sensors: a list is wanted, not a mapping"),
    (["world"], "hall", "world: a mapping (key: value) is wanted, not 'hall'"),
    (["estimators", 0], "ekf", "estimators.0: a mapping with a kind is wanted, as in {kind: ekf}, not 'ekf'"),
    (["estimators", 0, "kind"], 5, "estimators.0.kind: a name is wanted, not 5"),
    (["estimators", 0, "kind"], "efk", "estimators.0.kind: no estimator named 'efk', did you mean ekf?"),
    (["estimators", 0, "id"], "9x", "estimators.0.id: '9x' can't be an id"),
    (["estimators", 0, "id"], "fast", "estimators.1.id: the id 'fast' is used twice in estimators, first as item 0"),
    (["estimators", 0, "id"], "world", "estimators.0.id: 'world' can't be an estimator's id"),
    (["estimators", 0, "gate"], 2, "estimators.0.gate: must be less than 1, is 2"),
    (["estimators", 0, "accelerations_mps2"], 2, "estimators.0.accelerations_mps2: extra field, did you mean acceleration_mps2?"),
    (["estimators", 0], {"kind": "best", "particles": 2, "keep": 3}, "estimators.0: keep must be at most particles, 3 of 2 can't be kept"),
    (["estimators", 0], {"kind": "best"}, "estimators.0.particles: missing"),
    (["sensors", 0, "range_ft"], 20, "sensors.0.range_ft: extra field: it is wanted in metres, as range_m"),
    (["sensors", 0, "range"], 20, "sensors.0.range: extra field: it is wanted in metres, as range_m"),
    (["sensors", 0, "power_mw"], 20, "sensors.0.power_mw: extra field: it is wanted in decibel-milliwatts, as power_dbm"),
    (["sensors", 0, "power_dbm"], "29 dBi", "sensors.0.power_dbm: '29 dBi' is not a number in dBm"),
    (["sensors", 0, "range_m"], "3 kg", "sensors.0.range_m: '3 kg' is not a quantity in m: the units don't fit"),
    (["sensors", 0, "antennas", "cuont"], 2, "sensors.0.antennas.cuont: extra field, did you mean count?"),
    (["sensors", 0, "antennas", "count"], 0, "sensors.0.antennas.count: must be at least 1, is 0"),
    (["sensors", 0, "antennas"], [{"position_m": [0, 0]}], "sensors.0.antennas.0.position_m.2: missing"),
    (["sensors", 0, "antennas"], [{"position_m": [0, 0, "up"]}], "sensors.0.antennas.0.position_m.2: 'up' is not a number in m"),
    (["sensors", 0, "antennas"], 4, "sensors.0.antennas: a mapping (key: value) or a list is wanted, not 4"),
    (["world", "floor"], {"shape": "ruff"}, "world.floor: 'ruff' is none of 'smooth', 'rough'"),
    (["world", "floor"], {"shape": "rough", "width_m": 1}, "world.floor.width_m: extra field"),
    (["world", "floor"], {}, "world.floor: shape is missing: it says what this is"),
    (["world", "gates"], True, "world.gates: a number is wanted, not true"),
    (["actors", 0, "motion"], "rolling", "actors.0.motion: 'rolling' is none of dynamic, kinematic, parked, guided"),
    (["actors", 0, "motion"], None, "actors.0.motion: missing"),
    (["actors", 0, "route"], None, "actors.0: motion kinematic needs a route"),
    (["actors", 0, "rout"], {}, "actors.0.rout: extra field, did you mean route?"),
    (["actors", 0, "laod"], 0.1, "actors.0.laod: extra field, did you mean load?"),
    (["actors", 0, "position_m"], [0, 0], "actors.0: position_m is for parked actors"),
    (["actors", 0, "route", "waypoints_m"], [[0, 0]], "actors.0.route.waypoints_m: needs at least 2 items, has 1"),
    (["actors", 0, "route", "waypoints_m"], [[0, 0], [0, 0]], "actors.0.route: way points 0 and 1 are the same place"),
    (["actors", 0, "route", "speed_kmh"], 5, "actors.0.route.speed_kmh: extra field: it is wanted in metres per second, as speed_mps"),
    (["actors", 1, "route"], {"waypoints_m": [[0, 0], [1, 1]]}, "actors.1: a parked actor has no route"),
    (["actors", 1, "position_m"], None, "actors.1: a parked actor needs position_m"),
    (["actors", 1, "id"], "t1", "actors.1.id: the id 't1' is used twice in actors, first as item 0"),
    (["actors", 1, "pushed"], "perhaps", "actors.1.pushed: true or false is wanted, not 'perhaps'"),
    (["prior", "position_std_m"], [1, 2], "prior.position_std_m.2: missing"),
    (["prior", "position_std_m"], 0, "prior.position_std_m"),
    (["prior", "position_std_m"], True, "prior.position_std_m: a number is wanted, not true"),
    (["survey"], {"antenna_yaw_std_rad": 1}, "survey.antenna_yaw_std_rad: extra field: it is wanted in degrees, as antenna_yaw_std_deg"),
    (["metrics"], [{"kind": "availability"}] * 2, "metrics.1.id: the id 'availability' is used twice in metrics"),
    (["targets"], "t1", "targets: a list is wanted, not 't1': put it in brackets, [t1]"),
    (["hold_s"], float("inf"), "hold_s: a finite number is wanted, not inf"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "sentence"), MISTAKES, ids=lambda v: ".".join(map(str, v)) if isinstance(v, list) else None)
def test_each_mistake_is_told_in_a_plain_sentence_at_its_place(fakes, document, path, value, sentence):
    document["expect"] = {}
    message = told(changed(document, path, value))
    assert f"<dict> {sentence}" in message, message
    for jargon in ("pydantic", "Input", "validation", "dict_type", "function-", "http", "Value error"):
        assert jargon not in message


def test_each_mistake_is_told_once(fakes, document):
    document["expect"] = {}
    for path, value, _ in MISTAKES:
        lines = told(changed(document, path, value)).splitlines()
        assert len(lines) == 1, lines


def test_a_plug_in_that_cannot_be_imported_is_told_at_its_kind(fakes, document):
    fakes["estimators"]["broken"] = "broken"
    document["estimators"].append({"kind": "broken"})
    assert told(document) == "<dict> estimators.2.kind: estimator 'broken' can't be imported"


def test_an_error_inside_a_plug_in_keeps_its_traceback(fakes, document):
    class Wrong:
        class Config:
            @staticmethod
            def model_validate(data, context):
                raise ZeroDivisionError

    fakes["estimators"]["wrong"] = Wrong
    document["estimators"].append({"kind": "wrong"})
    with pytest.raises(ZeroDivisionError):
        from_dict(document)


@pytest.mark.parametrize("text", ["- a\n", "just text\n", "7\n"])
def test_a_file_that_is_no_mapping_is_refused(fakes, text):
    assert told(text).startswith("dock.yaml:1:1: a scenario is a mapping that begins with a name")


def test_limits_that_concern_two_fields_name_both(fakes, document):
    assert "duration_s: 864,000,000 instants of truth (duration_s × truth_hz)" in told(
        {**document, "duration_s": 86_400, "step_hz": 10_000, "truth_hz": 10_000}
    )
    assert "duration_s: 2,000,000 reports (duration_s × report_hz)" in told({**document, "duration_s": 2_000, "report_hz": 1000})
    assert "sweep: 20,000,000 runs (trials × points × estimators)" in told(
        {**document, "trials": 10**6, "sweep": {"seed": list(range(10))}}
    )


def test_a_later_stage_can_place_its_own_complaint(fakes):
    s = from_text(VALID, "dock.yaml")
    assert str(s.problem(s.sensors[0].loc, "no rack is named so")) == "dock.yaml:12:5 sensors.0: no rack is named so"
    assert str(s.problem((*s.actors[0].loc, "route", "waypoints_m", 1), "inside a rack")).startswith(
        "dock.yaml:10:35 actors.0.route.waypoints_m.1: "
    )


def test_a_metric_under_an_id_of_its_own_has_columns_of_its_own(fakes, document):
    document["metrics"] = [{"kind": "position_error"}, {"id": "flat", "kind": "position_error", "dims": 2}]
    document["expect"] = {"ekf": {"flat.position_error_m": {"mean": {"max": 1}}}}
    assert from_dict(document).expect[0].column == "flat.position_error_m.mean"
