"""Scores at a gate: what is true, what counts as right, exact limits, precision at any prevalence, and how it is drawn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from gate_recordings import antennas, walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta

from testbed.evaluate import summarise
from testbed.gate_figures import GateFigures, Share, gate_figures, has_gates
from testbed.metrics.gate_calibration import GateCalibration
from testbed.metrics.gate_events import ANSWERS, EVENTS, GateEvents, answered, true_events
from testbed.report.figures_gates import calibrated, gates, summed
from testbed.types import Decisions, Track

WAYS = {
    "in": walk((-4, 0), (4, 0)),
    "out": walk((4, 0.5), (-4, 0)),
    "pass": walk((2.5, -4), (2.5, 4)),
    "uturn": walk((-4, 0), (-1.5, 0), (-4, 0)),
    "through and back": walk((-4, 0), (1, 0), (-4, 0)),
    "round the wall": walk((-4, 0), (-4, 2.5), (4, 2.5), (4, 0), speed=2.0),
    "stands": walk((1, 2), (1, 2)),
    "stirs": walk((1, 2), (1.1, 2.1), (1, 2)),
}
DURATION = 12.0


def trial(ways=WAYS, duration=DURATION):
    names = list(ways)

    def states(t):
        places = np.stack([way(t) for way in ways.values()], axis=1)
        return np.concatenate([places, np.zeros_like(places)], axis=2)

    recording = SimpleNamespace(duration=duration, site=SimpleNamespace(antennas=antennas()), targets=SimpleNamespace(name=np.array(names)))
    return SimpleNamespace(recording=recording, target_states=states)


def track(said, names=tuple(WAYS)):
    """said: (target, t, what, probability), in order of time."""
    n, zero = len(names), np.zeros(len(names), dtype=np.int64)
    row, t, what, p = (list(column) for column in zip(*[(names.index(a), *rest) for a, *rest in said], strict=True)) if said else [[]] * 4
    mean, covariance = np.zeros((1, n, 3)), np.zeros((1, n, 3, 3))
    return Track(
        np.zeros(1), mean, covariance, np.zeros((1, n)), zero, names, zero, zero, zero, np.zeros(n), components=("x", "y", "z"),
        decisions=Decisions(row, t, what, p),
    )  # fmt: skip


def scored(said, **config):
    columns = GateEvents(GateEvents.Config(**config)).compute(track(said), np.empty(0), trial())
    return {name: dict(zip(WAYS, values.tolist(), strict=True)) for name, values in columns.items()}


# ---------------------------------------------------------------- one trial


def test_what_was_done_is_read_off_the_way():
    found = dict(zip(WAYS, true_events(track([]), trial(), 0.0, 2.8), strict=True))
    assert {name: event for name, (event, _) in found.items()} == {
        "in": "in", "out": "out", "pass": "pass", "uturn": "uturn", "through and back": "uturn", "round the wall": "pass", "stands": "stat",
        "stirs": "stat",
    }  # fmt: skip
    assert found["in"][1] == pytest.approx(4.0, abs=1e-6)
    assert np.isnan(found["pass"][1])


def test_an_inward_direction_turned_round_swaps_the_truth_as_well():
    found = [event for event, _ in true_events(track([]), trial(), 180.0, 2.8)]
    assert found[:2] == ["out", "in"]


@pytest.mark.parametrize(
    ("what", "answer"),
    [
        ([], "none"), (["in"], "in"), (["in", "pass"], "in"), (["in", "out"], "several"), (["in", "in"], "several"),
        (["pass", "uturn"], "uturn"), (["in?"], "none"), (["out?", "pass"], "pass"),
    ],
)  # fmt: skip
def test_one_answer_for_one_event(what, answer):
    assert answered(np.array(what, dtype=np.str_)) == answer


def test_each_event_has_its_score():
    found = scored(
        [("in", 5.25, "in", 0.995), ("out", 6, "in", 0.99), ("pass", 3, "out", 0.99), ("stands", 5, "in", 0.99), ("uturn", 9, "uturn", 1)]
    )
    assert found["gate.in_recall"]["in"] == 1
    assert found["gate.latency_s"]["in"] == pytest.approx(1.25, abs=1e-6)
    assert found["gate.out_recall"]["out"] == 0
    assert (found["gate.swapped"]["in"], found["gate.swapped"]["out"]) == (0, 1)
    assert (found["gate.in_precision"]["in"], found["gate.in_precision"]["out"], found["gate.in_precision"]["stands"]) == (1, 0, 0)
    assert (found["gate.moved_by_others"]["pass"], found["gate.moved_by_others"]["uturn"]) == (1, 0)
    assert found["gate_answers.uturn_uturn"]["uturn"] == 1
    assert np.isnan(found["gate.in_recall"]["out"])
    assert np.isnan(found["gate.latency_s"]["out"])
    assert np.isnan(found["gate.false_windows"]["in"])


def test_standing_tags_are_judged_in_windows():
    found = scored(
        [("stands", 1, "in", 1.0), ("stands", 1.5, "out", 1.0), ("stands", 11, "in", 1.0), ("stirs", 5, "pass", 1.0)], window_s=5
    )
    assert found["gate.windows"]["stands"] == 2  # the two seconds that are left over count for nothing
    assert found["gate.false_windows"]["stands"] == 0.5
    assert found["gate.false_moves_per_h"]["stands"] == pytest.approx(2 / (10 / 3600))
    assert found["gate_answers.stat_several"]["stands"] == 0.5
    assert found["gate.said_in"]["stands"] == 1
    assert found["gate.false_windows"]["stirs"] == 0
    assert found["gate_answers.stat_pass"]["stirs"] == 0.5


def test_claims_are_sorted_by_how_sure_they_were():
    said = [
        ("in", 3, "in?", 0.75),
        ("in", 5, "in", 0.992),
        ("stands", 2, "out?", 0.6),
        ("stands", 3, "out?", 0.75),
        ("uturn", 3, "pass", 0.99),
    ]
    found = GateCalibration(GateCalibration.Config()).compute(track(said), np.empty(0), trial())
    row = list(WAYS).index
    assert found["calibration.n0"][row("stands")] == 1
    assert found["calibration.so0"][row("stands")] == 0
    assert found["calibration.claimed1"][row("in")] == 0.75
    assert found["calibration.so1"][row("in")] == 1
    assert found["calibration.so4"][row("in")] == 1
    assert sum(found[f"calibration.n{i}"][row("uturn")] for i in range(6)) == 0  # passes and turns are no claims of a move
    none = GateCalibration(GateCalibration.Config()).compute(track([]), np.empty(0), trial())
    assert np.isnan(none["calibration.so0"]).all()


# ---------------------------------------------------------------- all trials


def table(trials=3):
    """The rows of `trials` trials in which all goes well but one standing tag of the last, and the hints of one."""
    parts = []
    for number in range(trials):
        said = [("in", 5.0, "in?", 0.8), ("in", 5.5, "in", 0.99), ("out", 6.0, "out", 0.999)]
        said += [("stands", 3.0, "out", 0.99)] if number == trials - 1 else []
        own = track(said)
        columns = GateEvents(GateEvents.Config(window_s=4)).compute(own, np.empty(0), trial())
        columns |= GateCalibration(GateCalibration.Config()).compute(own, np.empty(0), trial())
        keys = {"point": 0, "trial": number, "estimator": "detector", "target": np.array(list(WAYS))}
        parts.append({name: np.broadcast_to(value, len(WAYS)) for name, value in keys.items()} | columns)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_events_are_counted_over_all_trials():
    found = gate_figures(table(3), 0, "detector")
    assert found.events("in") == found.events("out") == 3
    assert found.events("stat") == 3 * 2 * 3  # two tags, three windows of 4 s in 12 s
    assert found.recall("in") == Share(3, 3)
    assert found.precision("out") == Share(3, 4)
    assert found.false_windows == Share(1, 18)
    assert found.prevalence() == 3.0
    assert found.parked_hours == pytest.approx(3 * 2 * 12 / 3600)
    assert found.false_moves_per_hour == pytest.approx(1 / (72 / 3600))
    np.testing.assert_allclose(found.latency[:3], [1.5, 1.5, 1.5], atol=1e-6)
    assert found.trials == 3


@given(n=st.integers(1, 5000), share=st.floats(0, 1))
@settings(max_examples=80, deadline=None)
def test_limits_are_exact(n, share):
    k = round(share * n)
    found = Share(k, n)
    assert found.low == pytest.approx(beta.ppf(0.025, k, n - k + 1) if k else 0.0, abs=1e-9)
    assert found.high == pytest.approx(beta.ppf(0.975, k + 1, n - k) if k < n else 1.0, abs=1e-9)
    assert found.low <= found.value <= found.high


def test_none_seen_in_n_may_be_3_7_in_n():
    assert Share(0, 3700).high == pytest.approx(3.69 / 3700, rel=0.01)
    assert np.isnan(Share(0, 0).value)
    assert np.isnan(Share(0, 0).low)


def figures(rows, said=None):
    counts = np.zeros((len(EVENTS), len(ANSWERS)), dtype=int)
    for event, answers in rows.items():
        for answer, n in answers.items():
            counts[EVENTS.index(event), ANSWERS.index(answer)] = n
    return GateFigures(counts, said or {"in": 0, "out": 0}, 10.0, 0.0, np.array([1.0, 2.0]), 5)


def test_precision_is_that_of_the_prevalence_asked_for():
    found = figures({"in": {"in": 90, "none": 10}, "out": {"out": 100}, "pass": {"in": 1, "pass": 99}, "stat": {"in": 2, "none": 998}})
    # of one IN, OUT and PASS and 100 windows: 0.9 right against 0 + 0.01 + 100 × 0.002 wrong
    assert found.precision_at("in", 100.0)[0] == pytest.approx(0.9 / (0.9 + 0.01 + 0.2))
    assert found.precision_at("in", 0.0)[0] == pytest.approx(0.9 / 0.91)
    assert found.precision_at("out", 100.0)[0] == 1.0
    for parked in (1.0, 20.0, 100.0):
        mean, worst = found.precision_at("in", parked)
        assert worst < mean
    assert found.precision_at("in", 100.0)[1] < found.precision_at("in", 20.0)[1]


def test_a_run_that_announced_nothing_has_no_precision():
    found = figures({"in": {"none": 10}, "stat": {"none": 10}})
    assert np.isnan(found.precision_at("in", 20.0)[0])
    assert np.isnan(found.precision("in").value)
    assert "recall 0.000" in summed(found)


# ---------------------------------------------------------------- drawn


@pytest.fixture(scope="module")
def study():
    rows = table(3) | {"seed": np.zeros(24), "kind": np.full(24, "gate_detector")}
    return SimpleNamespace(rows=rows, summaries=summarise(rows), estimators=("detector",), label=lambda point: "")


def test_the_figures_say_what_was_counted(study):
    drawn = {one.name: one for one in gates(study)}
    assert set(drawn) == {"gate-answers", "gate-prevalence", "gate-calibration"}
    assert "1 of 18 windows" in drawn["gate-answers"].caption
    assert "in recall 1.000" in drawn["gate-answers"].caption
    assert "at 100:1" in drawn["gate-answers"].caption
    assert all("<svg" in one.svg for one in drawn.values())


def test_the_calibration_is_pooled_over_trials(study):
    claimed, shares = calibrated(study, 0, "detector")
    np.testing.assert_allclose(claimed, [0.8, 0.99, 0.999])  # hints of 0.8; decisions of 0.99 and of 0.999
    assert shares == [Share(3, 3), Share(3, 4), Share(3, 3)]


def test_other_runs_have_no_such_figures(study):
    assert gates(SimpleNamespace(rows={"trial": np.zeros(1)}, summaries=(), estimators=())) == []
    assert not has_gates({"trial": np.zeros(1)})
