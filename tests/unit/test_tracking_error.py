"""Both scores of a track, and those of one that speaks of the past."""

import numpy as np
import pytest

from testbed.metrics.tracking_error import TrackingError
from testbed.types import Track


class OnALine:
    """A trial whose one target moves along x at 1 m/s."""

    class recording:
        class targets:
            name = np.array(["a"])

    def target_states(self, t):
        return np.stack([t, 0 * t, 0 * t, 1 + 0 * t, 0 * t, 0 * t], axis=1)[:, None]


def track(x, components=("x", "y"), status=None):
    k, n = len(x), len(components)
    mean = np.zeros((k, 1, n))
    mean[:, 0, 0] = x
    return Track(
        t=np.arange(k, dtype=float), mean=mean, covariance=np.tile(np.eye(n), (k, 1, 1, 1)),
        status=np.zeros((k, 1)) if status is None else np.array(status)[:, None], trial=[0], target=["a"], used=[1], refused=[0],
        late=[0], update_seconds=[0.0], components=components,
    )  # fmt: skip


def scores(shown, **config):
    truth = OnALine().target_states(shown.t)
    found = TrackingError(TrackingError.Config(**config)).compute(shown, truth, OnALine())
    return [float(found[name][0]) for name in ("tracking_error_m", "tracking_error_m2")]


def test_mean_and_mean_square():
    assert scores(track([1.0, 1.0, 5.0, 3.0])) == pytest.approx([(1 + 0 + 3 + 0) / 4, (1 + 0 + 9 + 0) / 4])
    assert scores(track([1.0, 1.0, 5.0, 3.0]), skip_s=2) == pytest.approx([1.5, 4.5])


def test_a_report_of_the_past_is_held_against_the_past():
    shown = track([9.0, 9.0, 0.0, 1.0, 2.5])
    assert scores(shown, lag_s=2) == pytest.approx([0.5 / 3, 0.25 / 3])


def test_lost_reports_and_methods_without_a_place_say_nothing():
    assert scores(track([1.0, 7.0], status=[0, 2])) == pytest.approx([1.0, 1.0])
    assert np.isnan(scores(track([1.0], status=[2]))).all()
    assert np.isnan(scores(track([1.0], components=("heading",)))).all()
