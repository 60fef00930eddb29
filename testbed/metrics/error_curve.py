"""The error over time as a few numbers a row, so that it can be averaged over trials without their tracks."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from testbed.columns import Array
from testbed.metrics.road_segment import identified
from testbed.metrics.track_error import distance
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import Track

SLICES = 40  # equal parts of the track's time
ERROR, RIGHT = "error_curve_m", "identified_curve"


class ErrorCurve:
    """Mean error, and share of times with the right road segment, in each of 40 equal parts of a track.

    Report times without an estimate don't count for the error; a slice without any is NaN. Without roads the shares are NaN.
    """

    on_request: ClassVar[bool] = True  # many columns: scenarios name it

    class Config(BaseConfig):
        """dims: 2 on the floor, 3 in space."""

        dims: Literal[2, 3] = 2

    columns: ClassVar[dict[str, str]] = {
        **{f"{ERROR}.s{i:02d}": f"mean error in part {i + 1} of {SLICES} of the time, m" for i in range(SLICES)},
        **{f"{RIGHT}.s{i:02d}": f"share with the right segment in part {i + 1} of {SLICES} of the time" for i in range(SLICES)},
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,)."""
        error = distance(track, truth, self._config.dims)
        right = identified(track, truth, trial).astype(np.float64)
        if trial.recording.site.roads is None:
            right = np.full_like(right, np.nan)
        last = track.t[-1] if len(track.t) and track.t[-1] > 0 else 1.0
        part = np.clip(np.ceil(SLICES * track.t / last - 1e-9).astype(int) - 1, 0, SLICES - 1)  # a slice ends with its last time
        found: dict[str, Array] = {}
        for name, values in ((ERROR, error), (RIGHT, right)):
            for i in range(SLICES):
                found[f"{name}.s{i:02d}"] = _means(values[part == i])
        return found


def _means(values: Array) -> Array:
    """Means over the first axis of what is there, NaN where nothing is."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    return np.divide(np.where(there, values, 0.0).sum(axis=0), count, out=np.full(values.shape[1], np.nan), where=count > 0)
