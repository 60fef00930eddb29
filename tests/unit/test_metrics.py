"""Metrics against closed forms on hand-made tracks, and against naive loops on random ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from testbed.metrics.availability import Availability
from testbed.metrics.consistency import Consistency, squared_mahalanobis
from testbed.metrics.event_counts import EventCounts
from testbed.metrics.position_error import PositionError
from testbed.metrics.time_lost import TimeLost
from testbed.plugins import names
from testbed.types import POSITION, POSITION_VELOCITY, Innovations, Status, Track

ALL = [Availability, Consistency, EventCounts, PositionError, TimeLost]
NO_INNOVATIONS = Innovations.empty()


def track(mean, t=None, status=None, covariance=None, components=POSITION, innovations=NO_INNOVATIONS, counts=(0, 0, 0)):
    mean = np.asarray(mean, dtype=float)
    k, b, n = mean.shape
    return Track(
        t=np.arange(k) if t is None else t,
        mean=mean,
        covariance=np.broadcast_to(np.eye(n), (k, b, n, n)) if covariance is None else covariance,
        status=np.zeros((k, b)) if status is None else status,
        trial=np.zeros(b),
        target=[f"tag{i}" for i in range(b)],
        used=np.full(b, counts[0]),
        refused=np.full(b, counts[1]),
        late=np.full(b, counts[2]),
        update_seconds=np.zeros(b),
        components=components,
        innovations=innovations,
    )


def along_x(errors):
    """One row whose error is `errors` along x, and a truth of zeros."""
    mean = np.zeros((len(errors), 1, 3))
    mean[:, 0, 0] = errors
    return mean, np.zeros((len(errors), 1, 6))


def computed(metric, a_track, truth, **config):
    return metric(metric.Config(**config)).compute(a_track, truth, None)


def value(metric, a_track, truth, column, **config):
    return computed(metric, a_track, truth, **config)[column][0]


# ---------------------------------------------------------------- position error


def test_error_figures_of_a_known_sequence():
    mean, truth = along_x(np.arange(1.0, 102.0))
    found = computed(PositionError, track(mean), truth)
    assert {k: v[0] for k, v in found.items()} == {
        "position_error_m.mean": 51.0,
        "position_error_m.p50": 51.0,
        "position_error_m.p95": 96.0,
        "position_error_m.rms": pytest.approx(np.sqrt(101 * 102 * 203 / 6 / 101)),
        "position_error_m.final": 101.0,
    }


def test_height_counts_in_space_and_not_on_the_floor():
    mean = np.array([[[3.0, 4.0, 12.0]]])
    truth = np.zeros((1, 1, 6))
    assert value(PositionError, track(mean), truth, "position_error_m.mean", dims=3) == 13.0
    assert value(PositionError, track(mean), truth, "position_error_m.mean", dims=2) == 5.0


def test_components_are_found_by_name_whatever_their_order():
    mean = np.array([[[12.0, 4.0, 3.0, 99.0]]])
    moved = track(mean, components=("z", "y", "x", "bias"))
    truth = np.array([[[0.0, 0.0, 10.0, 0, 0, 0]]])
    assert value(PositionError, moved, truth, "position_error_m.mean") == pytest.approx(np.sqrt(9 + 16 + 4))


def test_a_method_without_height_has_an_error_on_the_floor_only():
    flat = track(np.array([[[3.0, 4.0]]]), components=("x", "y"))
    truth = np.zeros((1, 1, 6))
    assert value(PositionError, flat, truth, "position_error_m.mean", dims=2) == 5.0
    assert np.isnan(value(PositionError, flat, truth, "position_error_m.mean", dims=3))


def test_lost_and_undefined_times_do_not_count_and_the_last_answer_is_final():
    mean, truth = along_x([1.0, 2.0, np.nan, 100.0])
    status = np.array([[Status.OK], [Status.COASTING], [Status.OK], [Status.LOST]])
    found = computed(PositionError, track(mean, status=status), truth)
    assert found["position_error_m.mean"][0] == 1.5
    assert found["position_error_m.final"][0] == 2.0


def test_the_time_before_skip_is_left_out():
    mean, truth = along_x([100.0, 100.0, 1.0, 3.0])
    assert value(PositionError, track(mean), truth, "position_error_m.mean", skip_s=2.0) == 2.0


# ---------------------------------------------------------------- availability, time lost, counts


def test_availability_counts_coasting_but_neither_lost_nor_undefined():
    mean, truth = along_x([0.0, 0.0, np.nan, 0.0])
    status = np.array([[Status.OK], [Status.COASTING], [Status.OK], [Status.LOST]])
    assert value(Availability, track(mean, status=status), truth, "availability") == 0.5


def test_time_lost_by_the_trapezoid_rule():
    mean, truth = along_x([0, 0, 4, 4, 0, np.nan, 0, 0])  # lost at t = 2, 3 and at 5
    found = computed(TimeLost, track(mean, t=[0, 1, 2, 3, 4, 5, 6, 10]), truth)
    assert (found["time_lost_s.total"][0], found["time_lost_s.longest"][0]) == (3.0, 2.0)


def test_a_target_lost_all_the_time_is_lost_for_the_length_of_its_track():
    mean, truth = along_x(np.full(5, np.nan))
    found = computed(TimeLost, track(mean, t=[0.0, 0.5, 3.0, 3.5, 7.0]), truth)
    assert (found["time_lost_s.total"][0], found["time_lost_s.longest"][0]) == (7.0, 7.0)


def test_the_threshold_itself_is_not_lost():
    mean, truth = along_x([3.0, 3.0, np.nextafter(3.0, 4.0)])
    assert value(TimeLost, track(mean), truth, "time_lost_s.total") == 0.5
    assert value(TimeLost, track(mean), truth, "time_lost_s.total", lost_above_m=2.0) == 2.0


def test_a_status_of_lost_is_lost_however_near():
    mean, truth = along_x([0.0, 0.0, 0.0])
    assert value(TimeLost, track(mean, status=[[2], [2], [0]]), truth, "time_lost_s.total") == 1.5


def test_event_counts_are_those_of_the_track():
    mean, truth = along_x([0.0])
    found = computed(EventCounts, track(mean, counts=(7, 2, 1)), truth)
    assert [v[0] for v in found.values()] == [7, 2, 1]


# ---------------------------------------------------------------- consistency


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_squared_mahalanobis_equals_a_solve_whatever_the_units(d, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 3, d, d)) + 2 * np.eye(d)
    units = 10.0 ** rng.integers(-6, 6, d)
    covariance = root @ np.swapaxes(root, -1, -2) * np.outer(units, units)
    error = rng.normal(size=(4, 3, d)) * units
    white, scaled = error / units, covariance / np.outer(units, units)
    expected = np.einsum("...i,...i", white, np.linalg.solve(scaled, white[..., None])[..., 0])
    np.testing.assert_allclose(squared_mahalanobis(error, covariance), expected, rtol=1e-6)


def test_one_bad_covariance_spoils_no_other():
    good = np.diag([1.0, 4.0])
    bad = [np.zeros((2, 2)), np.array([[1, 2], [2, 1.0]]), np.full((2, 2), np.nan), np.ones((2, 2)), np.diag([1.0, -1.0])]
    found = squared_mahalanobis(np.full((6, 2), 2.0), np.array([good, *bad]))
    assert found[0] == 5.0
    assert np.isnan(found[1:]).all()


def test_nees_of_a_known_error():
    mean, truth = along_x([2.0, 0.0, 4.0])
    covariance = np.broadcast_to(np.diag([4.0, 1.0, 1.0]), (3, 1, 3, 3))
    found = computed(Consistency, track(mean, covariance=covariance), truth)
    assert found["nees.mean"][0] == pytest.approx((1 + 0 + 4) / 3)
    assert found["nees.dof"][0] == 3
    assert found["nees.inside_95"][0] == pytest.approx(2 / 3)  # 0 is too good to be true: the interval begins at 0.216
    assert found["nees.times"][0] == 3


def test_velocity_is_judged_with_the_position_unless_told_otherwise():
    mean = np.zeros((1, 1, 6))
    mean[..., 3] = 3.0
    six = track(mean, components=POSITION_VELOCITY)
    truth = np.zeros((1, 1, 6))
    assert (value(Consistency, six, truth, "nees.mean"), value(Consistency, six, truth, "nees.dof")) == (9.0, 6.0)
    assert value(Consistency, six, truth, "nees.mean", components="position") == 0.0


def test_singular_covariances_are_counted_and_left_out():
    mean, truth = along_x([1.0, 1.0])
    covariance = np.stack([np.eye(3), np.diag([1.0, 1.0, 0.0])])[:, None]
    found = computed(Consistency, track(mean, covariance=covariance), truth)
    assert (found["nees.mean"][0], found["nees.times"][0], found["nees.singular"][0]) == (1.0, 1.0, 1.0)


def test_a_row_that_calls_itself_lost_is_not_judged():
    mean, truth = along_x([1.0, 30.0])
    found = computed(Consistency, track(mean, status=[[Status.OK], [Status.LOST]]), truth)
    assert (found["nees.mean"][0], found["nees.times"][0], found["nees.singular"][0]) == (1.0, 1.0, 0.0)


def test_nis_is_pooled_over_degrees_of_freedom_row_by_row():
    said = Innovations(
        row=[0, 0, 0, 1, 0],
        t=np.arange(5),
        nis=[1.0, 2.0, 30.0, 0.5, np.nan],
        dof=[1, 2, 3, 1, 1],
        log_likelihood=np.zeros(5),
    )
    found = computed(Consistency, track(np.zeros((1, 3, 3)), innovations=said), np.zeros((1, 3, 6)))
    np.testing.assert_array_equal(found["nis.mean"], [33.0 / 6.0, 0.5, np.nan])
    np.testing.assert_allclose(found["nis.inside_95"], [2 / 3, 1.0, np.nan])
    np.testing.assert_array_equal(found["nis.updates"], [3, 1, 0])
    np.testing.assert_array_equal(found["nis.dof"], [6, 1, 0])


# ---------------------------------------------------------------- all of them


def test_every_metric_is_registered_and_says_what_its_columns_mean():
    assert set(names("metrics")) >= {"availability", "consistency", "event_counts", "position_error", "time_lost"}
    for metric in ALL:
        assert list(computed(metric, track(np.zeros((3, 2, 3))), np.zeros((3, 2, 6)))) == list(metric.columns)
        assert all(len(text) > 10 for text in metric.columns.values())


@pytest.mark.parametrize("metric", ALL)
def test_a_row_that_never_gets_an_estimate_is_undefined_and_does_not_disturb_the_others(metric):
    rng = np.random.default_rng(5)
    mean, truth = rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3, 6))
    status = np.zeros((6, 3))
    alone = computed(metric, track(mean), truth)
    mean[:, 1], status[:, 1] = np.nan, Status.LOST
    covariance = np.broadcast_to(np.eye(3), (6, 3, 3, 3)).copy()
    covariance[:, 1] = np.nan
    found = computed(metric, track(mean, status=status, covariance=covariance), truth)
    for name, column in found.items():
        np.testing.assert_array_equal(column[[0, 2]], alone[name][[0, 2]])
    if metric in (PositionError, Consistency):
        assert np.isnan(found[next(iter(found))][1])


@pytest.mark.parametrize("metric", ALL)
@pytest.mark.parametrize("shape", [(0, 2), (1, 2), (3, 0)])
def test_no_report_times_and_no_rows_are_survived(metric, shape):
    for name, column in computed(metric, track(np.zeros((*shape, 3))), np.zeros((*shape, 6))).items():
        assert column.shape == (shape[1],), name


@pytest.mark.parametrize("metric", ALL)
def test_rows_are_independent_of_their_company(metric):
    rng = np.random.default_rng(8)
    whole = track(rng.normal(size=(9, 4, 3)), status=rng.integers(0, 3, (9, 4)))
    truth = rng.normal(size=(9, 4, 6))
    together = computed(metric, whole, truth)
    for i in range(4):
        for name, column in computed(metric, whole.take(np.array([i])), truth[:, [i]]).items():
            np.testing.assert_allclose(column[0], together[name][i], rtol=1e-12)


@pytest.mark.parametrize(
    ("metric", "config"),
    [(PositionError, {"dims": 4}), (PositionError, {"skip_s": -1}), (TimeLost, {"lost_above_m": 0}), (Availability, {"x": 1})],
)
def test_senseless_configurations_are_refused(metric, config):
    with pytest.raises(ValidationError):
        metric.Config(**config)
