"""Whether a detector at a gate is as often right as it says: what it claimed and what came true, by how sure it was."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from testbed.columns import Array
from testbed.metrics.gate_events import GateEventsConfig, true_events
from testbed.recording import Trial
from testbed.types import Track

EDGES = (0.0, 0.7, 0.85, 0.95, 0.985, 0.995, 1.0)  # of the probability that was claimed
BINS = len(EDGES) - 1


class GateCalibration:
    """In each bin of claimed probability: how many in and out were announced or hinted at, their mean claim, and the share that was so.

    A claim is so where the tag's event is of its kind, whenever it was made. The chance of being right at the moment when the odds first
    reach a level is the probability then, if the model is true, so hints at rising odds test all of the scale. With few hints in the
    detector's configuration there is little to see.
    """

    on_request: ClassVar[bool] = True  # says nothing without gates: scenarios name it
    Config = GateEventsConfig

    columns: ClassVar[dict[str, str]] = {
        f"calibration.{what}{i}": f"{text} from {EDGES[i]:g} to {EDGES[i + 1]:g}"
        for i in range(BINS)
        for what, text in (("n", "claims of a probability"), ("claimed", "mean claim"), ("so", "share come true of claims"))
    }

    def __init__(self, config: GateEventsConfig) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,); claimed and so are NaN where a row made no such claim."""
        said = track.decisions.take(np.isin(track.decisions.what, ("in", "out", "in?", "out?")))
        events = np.array([event for event, _ in true_events(track, trial, self._config.inward_deg, self._config.opening_m)])
        so = np.char.rstrip(said.what, "?") == events[said.row] if len(said) else np.zeros(0, dtype=bool)
        place = np.clip(np.searchsorted(EDGES, said.probability, side="right") - 1, 0, BINS - 1)
        found: dict[str, Array] = {}
        rows = len(track.target)
        for i in range(BINS):
            row = said.row[place == i]
            n = np.bincount(row, minlength=rows).astype(np.float64)
            found[f"calibration.n{i}"] = n
            for name, values in (("claimed", said.probability), ("so", so)):
                total = np.bincount(row, weights=np.asarray(values[place == i], dtype=np.float64), minlength=rows)
                found[f"calibration.{name}{i}"] = np.divide(total, n, out=np.full(rows, np.nan), where=n > 0)
        return found
