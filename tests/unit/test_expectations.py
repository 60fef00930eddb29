import math
import pickle

import pytest
from small_scenario import EXPECT, SMALL

import testbed
from testbed import batch
from testbed.evaluate import ClaimResult
from testbed.expectations import TrialsCrashed, Verdict, claimed, crashed, label
from testbed.scenario import Claim, ScenarioError, from_text
from testbed.worker import Failure

NAN = math.nan


def verdict(claim, value, interval=(NAN, NAN), note="", swept=None, path="dock.yaml"):
    ok = claim.holds(value)
    return Verdict(0, claim.text, claim.line, value, interval, ok, note, claim=claim, path=path, set=swept or {})


P95 = Claim("ukf", "position_error_m", "p95", "max", 0.8, 31)
PAIRED = Claim("ekf - ukf", "position_error_m", "mean", "min", 0.0, 7)


@pytest.mark.parametrize(
    ("judged", "sentence"),
    [
        (verdict(P95, 0.93, (0.88, 0.97)), "ukf.position_error_m.p95: got 0.93, want <= 0.80 (95 % interval 0.88-0.97)"),
        (verdict(P95, 0.93), "ukf.position_error_m.p95: got 0.93, want <= 0.80"),
        (verdict(P95, 0.80004, (0.7, 0.9)), "ukf.position_error_m.p95: got 0.80004, want <= 0.80000 (95 % interval 0.70000-0.90000)"),
        (verdict(P95, 0.8), "ukf.position_error_m.p95: got 0.80, want <= 0.80"),
        (verdict(P95, 0.8 + 1e-15), "ukf.position_error_m.p95: got 0.8, want <= 0.8"),
        (verdict(P95, 1e300), "ukf.position_error_m.p95: got 1e+300, want <= 0.8"),
        (verdict(P95, 1.0, swept={"a": 2, "b.c": [1, 2]}), "ukf.position_error_m.p95 at a=2, b.c=[1,2]: got 1.00, want <= 0.80"),
        (verdict(P95, NAN, note="no value: no trial has rows"), "ukf.position_error_m.p95: got no value (no trial has rows), want <= 0.80"),
    ],
)  # fmt: skip
def test_a_verdict_reads_as_place_figure_value_bound_and_interval(judged, sentence):
    assert str(judged) == f"dock.yaml:31: {sentence}"


def test_a_difference_says_which_of_its_limits_has_to_keep_the_bound():
    found = verdict(PAIRED, 0.05, (-0.001, 0.11))
    assert str(found) == (
        "dock.yaml:7: (ekf - ukf).position_error_m.mean: got 0.050, want lower limit >= 0.000 (95 % interval -0.001 to 0.110)"
    )
    at_most = Claim("ekf - ukf", "availability", "", "max", 0.125)
    assert str(verdict(at_most, 0.1, (0.05, 0.15))) == (
        "dock.yaml: (ekf - ukf).availability: got 0.100, want upper limit <= 0.125 (95 % interval 0.050-0.150)"
    )


def test_a_difference_without_a_limit_says_why():
    found = verdict(PAIRED, 0.05, note="one trial has no confidence limit: run at least two")
    assert str(found).endswith("got 0.05, want lower limit >= 0.00; one trial has no confidence limit: run at least two")


def test_a_label_is_one_short_line_whatever_is_swept():
    assert label({"seed": 1, "world.kind": "dock_gate"}) == "seed=1, world.kind=dock_gate"
    long = label({"sensors.0.antennas": [{"position_m": [i, 0, 2]} for i in range(40)], "title": "two\nlines"})
    assert "\n" not in long
    assert len(long) < 100


def test_a_crash_is_counted_by_trials_and_its_first_traceback_is_told():
    scenario = from_text(SMALL, "dock.yaml", {"sweep": {"duration_s": [1, 2]}})
    failures = [
        Failure(1, 0, "", "simulate", "ValueError: later", "the later traceback"),
        Failure(0, 1, "centroid", "estimate", "ValueError: first", "the first traceback\n"),
        Failure(0, 1, "slow", "estimate", "ValueError: too", "another"),
    ]
    assert crashed(scenario, failures) == (
        "dock.yaml: 2 of 4 trials crashed; the first, trial 1 at duration_s=1, centroid in estimate: ValueError: first\nthe first traceback"
    )


def test_check_scenario_gives_every_claim_with_its_value(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(SMALL + EXPECT)
    found = testbed.check_scenario(path)
    assert [(v.text, v.ok, v.line) for v in found] == [
        ("centroid.position_error_m.mean <= 9", True, 21),
        ("centroid.position_error_m.p95 <= 0.01", False, 22),
        ("centroid.availability >= 0.5", True, 23),
        ("world.line_of_sight >= 0", True, 24),
    ]
    assert all(isinstance(v, ClaimResult) and v.interval[0] <= v.value <= v.interval[1] for v in found)
    assert str(found[1]).startswith(f"{path}:22: centroid.position_error_m.p95: got ")
    assert [ClaimResult(**{n: getattr(v, n) for n in ClaimResult.__dataclass_fields__}) for v in found] == list(testbed.run(path).claims)


def test_check_scenario_takes_trials_and_seed_and_keeps_claims_with_their_points():
    scenario = from_text(SMALL + EXPECT, sets={"sweep": {"duration_s": [1, 2]}})
    found = testbed.check_scenario(scenario, trials=1, seed=8)
    assert [(v.claim, v.set) for v in found] == [(claim, point.set) for claim, point in claimed(scenario)]
    assert [v.set["duration_s"] for v in found[:4]] == [1, 2, 1, 2]
    assert [v.point for v in found[:4]] == [0, 1, 0, 1]
    same = testbed.run(scenario, trials=1, seed=8).claims
    assert [v.value for v in found] == [c.value for c in same]
    assert all(math.isnan(v.interval[0]) for v in found)  # of one trial


def test_check_scenario_refuses_what_the_command_refuses():
    with pytest.raises(ScenarioError, match="did you mean trials"):
        testbed.check_scenario({"name": "x", "trails": 3, "duration_s": 1, "world": {"kind": "open_floor"}})


def test_check_scenario_raises_where_trials_crash_instead_of_judging_the_rest(monkeypatch):
    from estimators.centroid import Centroid

    def update(self, event):
        raise ArithmeticError("no such luck")

    monkeypatch.setattr(Centroid, "update", update)
    with pytest.raises(TrialsCrashed, match=r"2 of 2 trials crashed; the first, trial 0, centroid in estimate: ArithmeticError") as caught:
        testbed.check_scenario(from_text(SMALL + EXPECT))
    assert "raise ArithmeticError" in str(caught.value)
    assert {f.trial for f in caught.value.failures} == {0, 1}


def test_verdicts_travel_between_processes():
    found = verdict(P95, 0.93, (0.88, 0.97), swept={"trials": 2})
    assert str(pickle.loads(pickle.dumps(found))) == str(found)


def test_nothing_is_written_by_check_scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outs = []
    run = batch.run
    monkeypatch.setattr(batch, "run", lambda *a, **k: outs.append(k.get("out")) or run(*a, **k))
    testbed.check_scenario(from_text(SMALL + EXPECT), trials=1)
    assert outs == [None]
    assert not list(tmp_path.iterdir())
