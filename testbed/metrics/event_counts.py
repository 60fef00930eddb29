"""What became of the events on their way into an estimator."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from testbed.columns import Array
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import Track


class EventCounts:
    """Events taken, refused by the method (a gate, a NaN), and dropped because they came too late."""

    class Config(BaseConfig):
        """Nothing to choose."""

    columns: ClassVar[dict[str, str]] = {
        "events.used": "events that the estimator took",
        "events.refused": "events that the estimator would not use",
        "events.late": "events dropped because the row had passed their time",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), counts."""
        counts = (track.used, track.refused, track.late)
        return {name: np.asarray(count, dtype=np.float64) for name, count in zip(self.columns, counts, strict=True)}
