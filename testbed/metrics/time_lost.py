"""How long a target was lost."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import distance
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Metres
from testbed.recording import Trial
from testbed.types import Track


class TimeLost:
    """Time during which a row was LOST, had no finite estimate, or was further from the truth than `lost_above_m`.

    A report time stands for half the way to its neighbours on either side (the trapezoid rule), so a target that is lost all
    the time is lost for as long as the track lasts. NaN for fewer than two report times.
    """

    class Config(BaseConfig):
        """lost_above_m: an estimate further off than this finds nothing; dims as in `position_error`."""

        lost_above_m: Annotated[Metres, Field(gt=0)] = 3.0
        dims: Literal[2, 3] = 3

    columns: ClassVar[dict[str, str]] = {
        "time_lost_s.total": "time lost in all, s",
        "time_lost_s.longest": "longest time lost without a break, s",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), s."""
        if len(track.t) < 2:
            return {name: np.full(len(track.trial), np.nan) for name in self.columns}
        error = distance(track, truth, self._config.dims)
        lost = ~(error <= self._config.lost_above_m)  # NaN, which compares as false, is lost as well
        half = np.diff(track.t) / 2
        share = np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])
        run = np.zeros(lost.shape[1])
        longest = np.zeros(lost.shape[1])
        for now, seconds in zip(lost, share, strict=True):
            run = np.where(now, run + seconds, 0.0)
            longest = np.maximum(longest, run)
        return {"time_lost_s.total": (lost * share[:, None]).sum(axis=0), "time_lost_s.longest": longest}
