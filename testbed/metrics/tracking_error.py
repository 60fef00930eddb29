"""The two scores of tracking studies side by side: mean distance, which some papers call RMSE, and the mean square behind the true one."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import usable
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Seconds
from testbed.recording import Trial
from testbed.types import POSITION, Track


class TrackingError:
    """Mean and mean square of the distance on the floor between what was said at t and where the target was `lag_s` before t.

    The root of `tracking_error_m2`, averaged over trials, is the RMSE over all of them; the average of the trials' own root mean squares
    would be smaller. Report times without a finite estimate or with status LOST don't count; a row with no other is NaN.
    """

    class Config(BaseConfig):
        """dims: 2 on the floor, 3 in space. Reports before skip_s, or of a time before the start, are left out."""

        dims: Literal[2, 3] = 2
        skip_s: Annotated[Seconds, Field(ge=0)] = 0.0
        lag_s: Annotated[Seconds, Field(ge=0)] = 0.0

    columns: ClassVar[dict[str, str]] = {
        "tracking_error_m": "mean distance to where the target was, m",
        "tracking_error_m2": "mean square distance to where the target was, m²; the root of its mean is the RMSE",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), m and m²."""
        c, axes = self._config, POSITION[: self._config.dims]
        if not set(axes) <= set(track.components):
            return dict.fromkeys(self.columns, np.full(len(track.trial), np.nan))
        if c.lag_s > 0:
            names = [str(name) for name in trial.recording.targets.name]
            places = [names.index(str(name)) for name in track.target]
            truth = trial.target_states(np.maximum(track.t - c.lag_s, 0.0))[:, places]
        mine = [track.components.index(name) for name in axes]
        square = ((track.mean[..., mine] - truth[..., : c.dims]) ** 2).sum(axis=-1)
        counts = usable(track) & ((track.t >= max(c.skip_s, c.lag_s) - 1e-9)[:, None])
        many = counts.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            means = [np.where(counts, values, 0.0).sum(axis=0) / many for values in (np.sqrt(square), square)]
        return dict(zip(self.columns, means, strict=True))
