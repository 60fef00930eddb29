"""Statistics over trials, against scipy and against small tables worked by hand."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from testbed.evaluate import check_claims, chi2_limits, mean_interval, paired, per_trial, score, split, summarise
from testbed.metrics.availability import Availability
from testbed.metrics.position_error import PositionError
from testbed.recording import Recording, Trial
from testbed.scene import Truth
from testbed.types import POSITION, Antennas, Site, Tags, Targets, Track


@dataclass
class Claim:
    subject: str
    metric: str
    statistic: str
    bound: str
    value: float
    line: int = 7

    point: int | None = None

    def concerns(self, point):
        return self.point in (None, point)

    @property
    def text(self):
        return f"{self.subject}.{self.metric}.{self.statistic} {self.bound} {self.value}"


def rows(**by_estimator):
    """Rows of one metric, "error.mean": by estimator a list over trials of lists over targets."""
    out = {"point": [], "trial": [], "estimator": [], "target": [], "error.mean": []}
    for estimator, trials in by_estimator.items():
        for trial, targets in enumerate(trials):
            for target, v in enumerate(targets):
                for name, cell in zip(out, (0, trial, estimator, f"tag{target}", v), strict=True):
                    out[name].append(cell)
    return {name: np.array(column) for name, column in out.items()}


def world(values):
    return {"point": np.zeros(len(values), dtype=int), "trial": np.arange(len(values)), "line_of_sight": np.array(values)}


NO_WORLD = world([])


# ---------------------------------------------------------------- score


def trial_of_two_targets():
    truth = Truth(t=[0.0, 1.0, 2.0], poses=[[[k, 0, 0, 1, 0, 0, 0]] for k in range(3)], bodies=("t1",))
    site = Site(Antennas.empty(), Tags(id=["a", "b"]), np.empty(0))
    targets = Targets(name=["a", "b"], body=["t1", ""])
    recording = Recording(3, 2.0, site, {}, targets, (np.array([0]), np.array([1])))
    pose = np.array([[0, 0, 1.0, 1, 0, 0, 0], [5, 5, 5, 1, 0, 0, 0]])
    return Trial(recording, truth, np.array([0, -1]), pose, {"line_of_sight": 0.5})


def track_at(positions, targets):
    k, b = np.shape(positions)[:2]
    none = np.zeros(b)
    return Track(
        t=np.arange(k),
        mean=positions,
        covariance=np.zeros((k, b, 3, 3)),
        status=np.zeros((k, b)),
        trial=np.full(b, 3),
        target=targets,
        used=none,
        refused=none,
        late=none,
        update_seconds=none,
        components=POSITION,
    )


def test_each_row_is_scored_against_its_own_target_whatever_the_order():
    positions = [[[5, 5, 5], [k, 0, 3.0]] for k in range(3)]
    found = score(track_at(positions, ["b", "a"]), trial_of_two_targets(), {"position_error": PositionError(PositionError.Config())})
    assert found["target"].tolist() == ["b", "a"]
    np.testing.assert_allclose(found["position_error_m.mean"], [0.0, 2.0], atol=1e-12)


def test_a_metric_with_an_id_of_its_own_has_columns_of_its_own():
    metrics = {"position_error": PositionError(PositionError.Config()), "floor": PositionError(PositionError.Config(dims=2))}
    found = score(track_at([[[0, 0, 3.0]]], ["a"]), trial_of_two_targets(), metrics)
    assert (found["position_error_m.mean"][0], found["floor.position_error_m.mean"][0]) == (2.0, 0.0)


def test_a_metric_that_gives_the_wrong_shape_is_named():
    class Wrong(Availability):
        def compute(self, track, truth, trial):
            return {"availability": np.float64(1.0)}

    with pytest.raises(ValueError, match=r"metric w: column availability has shape \(\), wants \(1,\)"):
        score(track_at([[[0, 0, 0]]], ["a"]), trial_of_two_targets(), {"w": Wrong(None)})


def test_two_metrics_cannot_write_one_column():
    class Same(Availability):
        def compute(self, track, truth, trial):
            return {"a.availability": np.ones(1)}

    metrics = {"a": Availability(None), Same.__module__.rpartition(".")[2]: Same(None)}
    with pytest.raises(ValueError, match=r"already a column a\.availability"):
        score(track_at([[[0, 0, 0]]], ["a"]), trial_of_two_targets(), metrics)


# ---------------------------------------------------------------- statistics


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=30))
def test_the_interval_is_the_textbook_one(values):
    found = mean_interval(np.array(values))
    assert found.n == len(values)
    assert found.mean == pytest.approx(np.mean(values), abs=1e-9)
    assert found.se == pytest.approx(stats.sem(values), abs=1e-9)
    if found.se > 1e-6:
        low, high = stats.t.interval(0.95, len(values) - 1, loc=np.mean(values), scale=stats.sem(values))
        assert (found.low, found.high) == (pytest.approx(low, abs=1e-6), pytest.approx(high, abs=1e-6))


@given(st.floats(-1e6, 1e6), st.integers(2, 30))
def test_values_that_are_all_alike_have_no_spread_to_the_last_digit(value, n):
    found = mean_interval(np.full(n, value))
    assert (found.mean, found.se, found.low, found.high, found.n) == (value, 0.0, value, value, n)


def test_one_trial_has_a_mean_and_no_spread_and_none_has_neither():
    one, none = mean_interval(np.array([2.0, np.nan])), mean_interval(np.array([np.nan]))
    assert (one.mean, one.n) == (2.0, 1)
    assert np.isnan([one.se, one.low, one.high, none.mean]).all()
    assert none.n == 0


def test_targets_are_averaged_within_a_trial_so_that_more_targets_are_no_more_trials():
    one = summarise(rows(ekf=[[1.0], [3.0], [5.0]]))[0].statistics["error.mean"]
    hundred = summarise(rows(ekf=[[1.0] * 100, [3.0] * 100, [5.0] * 100]))[0].statistics["error.mean"]
    assert (hundred.mean, hundred.se, hundred.n) == (pytest.approx(one.mean), pytest.approx(one.se), 3)


def test_a_trial_with_few_targets_weighs_as_much_as_one_with_many():
    assert summarise(rows(ekf=[[0.0] * 9, [1.0]]))[0].statistics["error.mean"].mean == 0.5


def test_undefined_rows_make_n_smaller_and_are_counted():
    summary = summarise(rows(ekf=[[1.0, np.nan], [np.nan, np.nan], [3.0, 3.0]]))[0]
    assert summary.document()["error"] == {"mean": 2.0, "se": pytest.approx(1.0), "n": 2, "missing": 3}


@given(st.permutations(range(12)))
def test_per_trial_means_do_not_depend_on_the_order_of_rows(order):
    trial, values = np.repeat([4, 1, 9], 4)[order], np.arange(12.0)[order]
    trials, means = per_trial(trial, values)
    assert trials.tolist() == [1, 4, 9]
    np.testing.assert_array_equal(means, [5.5, 1.5, 9.5])


def test_summaries_keep_the_order_of_estimators_and_sort_points():
    table = rows(ukf=[[1.0]], ekf=[[2.0]])
    both = {k: np.concatenate([v, v]) for k, v in table.items()}
    both["point"] = np.array([1, 1, 0, 0])
    assert [(s.point, s.estimator) for s in summarise(both)] == [(0, "ukf"), (0, "ekf"), (1, "ukf"), (1, "ekf")]


def test_the_document_has_each_statistic_with_its_own_error_and_no_nan():
    table = rows(ekf=[[1.0], [3.0]])
    table |= {"error.p95": np.array([2.0, np.nan]), "availability": np.array([1.0, np.nan])}
    document = summarise(table)[0].document()
    assert document["error"] == {"mean": 2.0, "se": 1.0, "n": 2, "p95": 2.0, "p95_se": None, "p95_n": 1, "missing": 1}
    assert document["availability"] == {"mean": 1.0, "se": None, "n": 1, "missing": 1}
    json.dumps(document, allow_nan=False)


def test_limits_of_nees_are_for_n_trials_and_of_nis_for_all_degrees_of_freedom():
    table = rows(ekf=[[1.0]] * 20)
    one = np.ones(20)
    table |= {"nees.mean": 6 * one, "nees.dof": 6 * one, "nis.mean": one, "nis.dof": 50 * one}
    limits = summarise(table)[0].limits
    np.testing.assert_allclose(limits["nees.mean"], stats.chi2.ppf([0.025, 0.975], 120) / 20)
    np.testing.assert_allclose(limits["nis.mean"], stats.chi2.ppf([0.025, 0.975], 1000) / 1000)


def test_limits_of_something_without_degrees_of_freedom_are_undefined():
    assert np.isnan(chi2_limits(np.nan, 3)).all()
    assert np.isnan(chi2_limits(3.0, 0)).all()


@pytest.mark.parametrize(
    ("column", "parts"),
    [("a.mean", ("a", "mean")), ("a", ("a", "")), ("floor.a.p95", ("floor.a", "p95"))],
)
def test_a_column_splits_into_metric_and_statistic(column, parts):
    assert split(column) == parts


# ---------------------------------------------------------------- paired


def test_pairs_are_trials_and_targets_that_both_have():
    table = rows(ekf=[[5.0, 7.0], [4.0, np.nan], [9.0, 9.0]], ukf=[[4.0, 4.0], [3.0, 1.0], [8.0, np.nan]])
    found = paired(table, 0, "ekf", "ukf", "error.mean")
    assert (found.n, found.mean) == (3, pytest.approx((2.0 + 1.0 + 1.0) / 3))


def test_pairing_removes_what_trials_have_in_common():
    common = np.random.default_rng(1).normal(0, 100, 30)
    table = rows(ekf=[[c + 1.0 + 0.01 * (i % 2)] for i, c in enumerate(common)], ukf=[[c] for c in common])
    found = paired(table, 0, "ekf", "ukf", "error.mean")
    assert found.low > 1.0
    assert found.high < 1.01


def test_pairing_is_antisymmetric():
    table = rows(ekf=[[1.0], [4.0], [2.0]], ukf=[[2.0], [3.0], [5.0]])
    there, back = paired(table, 0, "ekf", "ukf", "error.mean"), paired(table, 0, "ukf", "ekf", "error.mean")
    assert (there.mean, there.low, there.high) == (-back.mean, -back.high, -back.low)


# ---------------------------------------------------------------- claims


def judged(claim, table, stimulus=NO_WORLD):
    return check_claims([claim], table, stimulus, points=[0])[0]


@pytest.mark.parametrize(("bound", "value", "ok"), [("max", 2.0, True), ("max", 1.99, False), ("min", 2.0, True), ("min", 2.01, False)])
def test_a_plain_claim_compares_the_value_itself(bound, value, ok):
    found = judged(Claim("ekf", "error", "mean", bound, value), rows(ekf=[[1.0], [3.0]]))
    assert (found.ok, found.value, found.line, found.note) == (ok, 2.0, 7, "")
    assert found.interval[0] < 2.0 < found.interval[1]


def test_a_paired_claim_compares_the_confidence_limit_on_the_far_side():
    table = rows(ekf=[[2.0], [3.0], [4.0]], ukf=[[1.0], [1.5], [2.5]])
    found = judged(Claim("ekf - ukf", "error", "mean", "min", 0.0), table)
    low, high = stats.t.interval(0.95, 2, loc=4 / 3, scale=stats.sem([1.0, 1.5, 1.5]))
    assert found.ok
    assert found.value == pytest.approx(4 / 3)
    assert found.interval == (pytest.approx(low), pytest.approx(high))
    assert not judged(Claim("ekf - ukf", "error", "mean", "min", 1.0), table).ok  # below the mean, above the lower limit
    assert not judged(Claim("ekf - ukf", "error", "mean", "max", 1.5), table).ok
    assert judged(Claim("ekf - ukf", "error", "mean", "max", 2.1), table).ok


def test_one_trial_proves_no_difference():
    found = judged(Claim("ekf - ukf", "error", "mean", "min", 0.0), rows(ekf=[[9.0]], ukf=[[1.0]]))
    assert not found.ok
    assert "at least two" in found.note


def test_the_world_is_asserted_by_its_mean_over_trials():
    found = judged(Claim("world", "line_of_sight", "", "min", 0.3), rows(ekf=[[1.0]]), world([0.2, 0.6]))
    assert (found.ok, found.value) == (True, pytest.approx(0.4))


def test_a_metric_of_one_column_may_be_claimed_with_or_without_its_mean():
    table = rows(ekf=[[1.0], [3.0]]) | {"availability": np.array([0.5, 1.0])}
    for statistic in ("", "mean"):
        assert judged(Claim("ekf", "availability", statistic, "min", 0.75), table).ok


@pytest.mark.parametrize(
    ("claim", "note"),
    [
        (Claim("ekf", "speed", "mean", "max", 1e9), "there is no 'speed.mean'; there are error.mean"),
        (Claim("ukf", "error", "mean", "max", 1e9), "no trial has rows"),
        (Claim("ekf", "error", "mean", "max", 1e9), "every trial's is undefined"),
        (Claim("ekf - ukf", "error", "mean", "max", 1e9), "no trial has both"),
        (Claim("world", "line_of_sight", "", "max", 1e9), "no trial has rows"),
        (Claim("ekf", "trial", "", "max", 1e9), "there is no 'trial'"),
    ],
)
def test_a_claim_about_nothing_fails_and_says_why(claim, note):
    found = judged(claim, rows(ekf=[[np.nan], [np.nan]]))
    assert not found.ok
    assert note in found.note
    assert found.document()["value"] is None
    json.dumps(found.document(), allow_nan=False)


def test_every_point_of_a_sweep_is_judged_by_itself():
    table = rows(ekf=[[1.0], [5.0]])
    table["point"] = np.array([0, 1])
    found = check_claims([Claim("ekf", "error", "mean", "max", 2.0)], table, NO_WORLD, points=[0, 1])
    assert [(c.point, c.ok) for c in found] == [(0, True), (1, False)]


def test_a_claim_about_one_point_is_judged_there_alone():
    table = rows(ekf=[[1.0], [3.0]])
    found = check_claims([Claim("ekf", "error.mean", "", "min", 0.0, point=0)], table, table, [0, 1])
    assert [c.point for c in found] == [0]


def test_the_share_of_trials_in_which_one_is_above_the_other_counts_ties_half():
    table = rows(ekf=[[1.0], [3.0], [2.0], [5.0]], ukf=[[2.0], [1.0], [2.0], [4.0]])
    found = judged(Claim("ekf > ukf", "error", "mean", "min", 0.6), table)
    assert found.value == pytest.approx((0 + 1 + 0.5 + 1) / 4)
    assert found.ok
    assert not judged(Claim("ekf > ukf", "error", "mean", "min", 0.63), table).ok  # itself, not its confidence limit
    assert judged(Claim("ukf > ekf", "error", "mean", "min", 0.0), table).value == pytest.approx(0.375)


def test_a_share_leaves_out_what_only_one_of_the_two_has():
    table = rows(ekf=[[1.0], [3.0], [np.nan]], ukf=[[2.0], [1.0], [0.0]])
    assert judged(Claim("ekf > ukf", "error", "mean", "min", 0.0), table).value == 0.5
