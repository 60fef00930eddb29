"""The `ukf` again, for one target, on filterpy's UnscentedKalmanFilter: the oracle, and an example of a plain plug-in."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from estimators.filterpy_twin import FilterpyTwin, Level
from estimators.ukf import UkfConfig
from testbed.types import Array


class UkfFilterpy(FilterpyTwin):
    """Equal to `ukf` to 1e-9 under the same configuration, some hundred times slower.

    filterpy keeps the sigma points of the last prediction; a second read at the same time would be taken through stale ones, so they
    are drawn afresh before each update.
    """

    Config = UkfConfig

    def _made(self) -> Any:
        points = MerweScaledSigmaPoints(6, self.config.alpha, self.config.beta, self.config.kappa)
        return UnscentedKalmanFilter(6, 1, 1.0, hx=self._seen, fx=self._moved, points=points)

    def _move(self, transition: Array, noise: Array) -> None:
        self._transition, self._filter.Q = transition, noise
        self._filter.predict()

    def _take(self, z: Array, levels: list[Level], variance: list[float]) -> None:
        one, self._levels_now = self._filter, levels
        one.sigmas_f = one.points_fn.sigma_points(one.x, one.P)
        one.update(z, R=np.diag(variance))

    def _seen(self, x: Array) -> Array:
        return np.array([self._expected(level, x) for level in self._levels_now])

    def _moved(self, x: Array, dt: float) -> Array:
        return self._transition @ x
