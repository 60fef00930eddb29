"""Metrics of map matching: the right road, settle time, lost runs, and the error over time as slices."""

from dataclasses import replace

import numpy as np
import pytest

from testbed.checks import samples
from testbed.metrics.error_curve import SLICES, ErrorCurve
from testbed.metrics.road_segment import RoadSegment
from testbed.metrics.settle_time import SettleTime, first_stretch
from testbed.recording import Trial
from testbed.scene import Truth
from testbed.types import Innovations, Status, Track

T = np.arange(401) / 10  # 40 s


def track(error, status=Status.OK):
    """A row that is `error` (K,) m north of the truth, which stands at (3, 1)."""
    k = len(T)
    mean = np.stack([np.full(k, 3.0), 1.0 + np.broadcast_to(error, k)], axis=1)[:, None]
    return Track(
        t=T, mean=mean, covariance=np.tile(np.eye(2), (k, 1, 1, 1)), status=np.broadcast_to(status, k)[:, None],
        trial=np.zeros(1), target=np.array(["tag0"]), used=[1], refused=[0], late=[0], update_seconds=[0.0],
        components=("x", "y"), innovations=Innovations.empty(),
    )  # fmt: skip


def trial(roads=True):
    recording = samples.only(samples.recording(duration=0.2), 0)
    if not roads:
        recording = replace(recording, site=replace(recording.site, roads=None))
    nobody = Truth(t=np.array([0.0, 1.0]), poses=np.empty((2, 0, 7)))
    return Trial(recording, nobody, np.array([-1]), np.array([[3.0, 1.0, 0, 1, 0, 0, 0]]), {})


TRUTH = np.tile([3.0, 1.0, 0, 0, 0, 0], (len(T), 1, 1))


def value(metric, name, error, status=Status.OK, roads=True, truth=TRUTH, **config):
    return metric(metric.Config(**config)).compute(track(error, status), truth, trial(roads))[name][0]


def test_the_settle_time_is_the_start_of_the_first_ten_seconds_with_a_small_error():
    error = np.where(T < 5, 9.0, 0.5)
    error[(T > 8) & (T < 9)] = 3.0  # a break within the ten seconds
    assert value(SettleTime, "settle_s", error) == pytest.approx(9.0)
    assert value(SettleTime, "lost_runs", error) == 0
    assert value(SettleTime, "settled_in_time", error, limit_s=9.0) == 1
    assert value(SettleTime, "settled_in_time", error, limit_s=8.9) == 0


def test_a_run_that_never_settles_is_lost():
    error = np.where(T % 8 < 1, 5.0, 0.1)
    assert np.isnan(value(SettleTime, "settle_s", error))
    assert value(SettleTime, "lost_runs", error) == 1
    assert value(SettleTime, "settled_in_time", error) == 0
    late = np.where(T < 31, 5.0, 0.1)  # good for the last nine seconds
    assert value(SettleTime, "lost_runs", late) == 1
    assert value(SettleTime, "lost_runs", late, hold_s=9.0) == 0


def test_a_lost_row_does_not_settle():
    status = np.where(T < 20, Status.LOST, Status.OK)
    assert value(SettleTime, "settle_s", 0.1, status) == pytest.approx(20.0)


def test_the_first_stretch():
    good = np.array([True, True, False, True, True, True])
    assert first_stretch(np.arange(6.0), good, 1.0) == 0.0
    assert first_stretch(np.arange(6.0), good, 2.0) == 3.0
    assert first_stretch(np.arange(6.0), good, 3.0) == np.inf
    assert first_stretch(np.empty(0), np.empty(0, dtype=bool), 1.0) == np.inf


def test_what_a_method_says_of_itself_is_judged():
    status = np.where(T < 10, Status.COASTING, Status.OK)
    error = np.where(T < 20, 5.0, 0.1)
    assert value(SettleTime, "tracking.share", error, status) == pytest.approx(301 / 401)
    assert value(SettleTime, "tracking.right", error, status) == pytest.approx(201 / 301)
    assert np.isnan(value(SettleTime, "tracking.right", error, Status.COASTING))


def test_the_segment_is_the_nearest_one():
    # the sample hall's roads are a rectangle, (1, 1) to (5, 4): the truth is on its south side
    error = np.where(T < 10, 2.9, 0.4)
    assert value(RoadSegment, "segment.identified", error) == pytest.approx(301 / 401)
    assert value(RoadSegment, "segment.identified", error, skip_s=10.0) == 1
    assert value(RoadSegment, "segment.identified", 0.0, Status.LOST) == 0
    assert np.isnan(value(RoadSegment, "segment.identified", 0.0, roads=False))


def test_a_vehicle_off_the_network_is_flagged():
    aside = TRUTH.copy()
    aside[T >= 30, :, 1] = -1.0
    assert value(RoadSegment, "segment.off_network", 0.0, truth=aside) == pytest.approx(101 / 401)
    assert value(RoadSegment, "segment.off_network", 0.0, truth=aside, off_m=2.5) == 0


def test_slices_of_the_error_over_time():
    found = ErrorCurve(ErrorCurve.Config()).compute(track(T / 10), TRUTH, trial())
    curve = np.array([found[f"error_curve_m.s{i:02d}"][0] for i in range(SLICES)])
    # slice i ends at (i + 1) s, a whole second being ten reports; the first one has the report at 0 as well
    np.testing.assert_allclose(curve[1:], (np.arange(1, 40) + 0.55) / 10)
    assert curve[0] == pytest.approx(0.05)
    right = np.array([found[f"identified_curve.s{i:02d}"][0] for i in range(SLICES)])
    assert right[:14].min() == 1
    assert right[16:].max() == 0
    assert set(found) == set(ErrorCurve.columns)
    lost = ErrorCurve(ErrorCurve.Config()).compute(track(0.0, Status.LOST), TRUTH, trial(roads=False))
    assert np.isnan(np.concatenate(list(lost.values()))).all()
