"""How often an estimator had an answer at all."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from testbed.columns import Array
from testbed.metrics.track_error import usable
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import Track


class Availability:
    """Share of a row's report times with a finite estimate and the status OK or COASTING; NaN for a track without times."""

    class Config(BaseConfig):
        """Nothing to choose."""

    columns: ClassVar[dict[str, str]] = {"availability": "share of report times with an estimate, 0 to 1"}

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Column (B,), from 0 to 1."""
        if not len(track.t):
            return {"availability": np.full(len(track.trial), np.nan)}
        return {"availability": usable(track).mean(axis=0)}
