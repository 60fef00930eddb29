"""Distance between where a target is and where it was said to be."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import distance
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Seconds
from testbed.recording import Trial
from testbed.types import Track


class PositionError:
    """Mean, median, 95 % point, root mean square and last value of the position error over a row's report times.

    Report times without a finite estimate, or with status LOST, don't count: read it beside `availability`. A row with no such
    time at all is NaN.
    """

    class Config(BaseConfig):
        """dims: 2 on the floor, 3 in space; skip_s: report times before it are left out (while a filter settles)."""

        dims: Literal[2, 3] = 3
        skip_s: Annotated[Seconds, Field(ge=0)] = 0.0

    columns: ClassVar[dict[str, str]] = {
        "position_error_m.mean": "mean distance to the truth, m",
        "position_error_m.p50": "median distance to the truth, m",
        "position_error_m.p95": "95 % point of the distance to the truth, m",
        "position_error_m.rms": "root mean square distance to the truth, m",
        "position_error_m.final": "distance to the truth at the last report time with an estimate, m",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), m."""
        error = distance(track, truth, self._config.dims)[track.t >= self._config.skip_s]
        rows = [_figures(e[np.isfinite(e)]) for e in error.T]
        return dict(zip(self.columns, np.array(rows).reshape(-1, len(self.columns)).T, strict=True))


def _figures(error: Array) -> list[float]:
    if not len(error):
        return [np.nan] * 5
    p50, p95 = np.percentile(error, [50, 95])
    return [error.mean(), p50, p95, np.sqrt((error**2).mean()), error[-1]]
