"""How well a guide followed the phase over steps: how often it lost count of the wraps, and whether it knew."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from testbed.columns import Array
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import Track
from testbed.units import SPEED_OF_LIGHT


class PhaseSteps:
    """A step slips where the change of phase that a guide found is off by more than half the reader's period, or is none at all.

    True is 4π/λ times the change of range on the floor, at the mean of the site's carriers. NaN for trials without a guided person.
    """

    class Config(BaseConfig):
        """wraps_at: the reader's period."""

        wraps_at: Literal["pi", "2pi"] = "2pi"

    on_request: ClassVar[bool] = True
    columns: ClassVar[dict[str, str]] = {
        "slips": "share of steps that slipped",
        "slips_trusted": "share of steps that slipped and were trusted all the same",
        "trusted": "share of steps that were trusted",
        "phase_error_rad": "root mean square error of the change over steps that did not slip, rad",
    }

    def __init__(self, config: Config) -> None:
        self._half = np.pi / 2 if config.wraps_at == "pi" else np.pi

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,)."""
        n, walk = len(track.trial), trial.walk
        if walk is None or not (walk.kind == "step").any() or not len(trial.recording.site.frequencies):
            return {name: np.full(n, np.nan) for name in self.columns}
        step = walk.kind == "step"
        wavenumber = 4 * np.pi * float(np.mean(trial.recording.site.frequencies)) / SPEED_OF_LIGHT
        error = np.abs(walk.followed - wavenumber * np.diff(walk.range, prepend=np.nan))[step]
        slipped, trusted = ~(error < self._half), walk.trusted[step]
        kept = error[~slipped]
        found = [slipped.mean(), (slipped & trusted).mean(), trusted.mean(), np.sqrt((kept**2).mean()) if len(kept) else np.nan]
        return {name: np.full(n, value) for name, value in zip(self.columns, found, strict=True)}
