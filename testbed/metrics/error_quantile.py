"""One quantile of the position error."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import distance
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import Track


class ErrorQuantile:
    """The error that a share of the report times stays below, of those with an estimate and a truth."""

    on_request: ClassVar[bool] = True  # position_error has the usual ones

    class Config(BaseConfig):
        """dims: 2 on the floor, 3 in space."""

        quantile: Annotated[float, Field(gt=0, lt=1)] = 0.9
        dims: Literal[2, 3] = 3

    columns: ClassVar[dict[str, str]] = {"error_quantile_m": "quantile of the distance to the truth, m"}

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), m."""
        error = distance(track, truth, self._config.dims)
        rows = [e[np.isfinite(e)] for e in error.T]
        return {"error_quantile_m": np.array([np.quantile(e, self._config.quantile) if len(e) else np.nan for e in rows])}
