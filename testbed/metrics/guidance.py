"""How well a person was guided: steps, turns, way, whether the tag was found, and how well the advice pointed at it."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.guided.record import Walk
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Metres
from testbed.recording import Trial
from testbed.types import Track


class Guidance:
    """The figures of Raptopoulos et al. 2019, Section VI, and the guidance cosine, which they lack.

    The cosine is that of the angle between where the guide believed the tag to be after a step and where it was: 1 is perfect, 0 is a
    guess, below 0 leads away. It counts steps further than beyond_m from the tag and after the first after_steps ones. cosine.sum over
    cosine.steps, means of both over trials, is the cosine pooled over all steps. Steps and turns of those who did not find the tag count
    as well. NaN for trials without a guided person.
    """

    class Config(BaseConfig):
        """Which steps the cosine is taken of, and within how many the tag should be found."""

        beyond_m: Annotated[Metres, Field(ge=0)] = 1.0
        after_steps: Annotated[int, Field(ge=0)] = 3
        in_time_steps: Annotated[int, Field(ge=1)] = 26

    on_request: ClassVar[bool] = True
    columns: ClassVar[dict[str, str]] = {
        "steps": "steps taken",
        "turns": "turns taken, those of a search included",
        "distance_m": "way walked, m",
        "stride_m": "way walked a step, m",
        "found": "1 where the tag was found, else 0",
        "in_time": "1 where it was found within in_time_steps steps, else 0",
        "cosine.mean": "mean cosine between the direction advised and the true one, over the steps of a trial",
        "cosine.sum": "sum of the same",
        "cosine.steps": "how many steps it is over",
        "seconds": "from the first listening to the end, s",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,)."""
        n = len(track.trial)
        if trial.walk is None:
            return {name: np.full(n, np.nan) for name in self.columns}
        return {name: np.full(n, value) for name, value in self._figures(trial.walk).items()}

    def _figures(self, walk: Walk) -> dict[str, float]:
        step = walk.kind == "step"
        number = np.cumsum(step)
        counted = step & (number > self._config.after_steps) & (walk.range > self._config.beyond_m) & np.isfinite(walk.aim)
        cosine = np.cos(walk.bearing - walk.aim)[counted]
        return {
            "steps": float(step.sum()),
            "turns": float((walk.kind == "turn").sum()),
            "distance_m": float(walk.length.sum()),
            "stride_m": float(walk.length.sum() / step.sum()) if step.any() else np.nan,
            "found": float(walk.found.any()),
            "in_time": float(walk.found.any() and step.sum() <= self._config.in_time_steps),
            "cosine.mean": float(cosine.mean()) if len(cosine) else np.nan,
            "cosine.sum": float(cosine.sum()),
            "cosine.steps": float(len(cosine)),
            "seconds": float(walk.t[-1]),
        }
