"""The `ekf` again, for one target, on filterpy's ExtendedKalmanFilter: the oracle, and an example of a plain plug-in."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimators.ekf import EkfConfig
from estimators.filterpy_twin import FilterpyTwin, Level
from estimators.measurements import curvature_noise
from testbed.types import Array


class EkfFilterpy(FilterpyTwin):
    """Equal to `ekf` to 1e-9 under the same configuration, some hundred times slower.

    predict and update are called apart: filterpy's `predict_update` linearises at the state before the prediction.
    """

    Config = EkfConfig

    def _made(self) -> Any:
        return ExtendedKalmanFilter(dim_x=6, dim_z=1)

    def _move(self, transition: Array, noise: Array) -> None:
        self._filter.F, self._filter.Q = transition, noise
        self._filter.predict()

    def _take(self, z: Array, levels: list[Level], variance: list[float]) -> None:
        one = self._filter
        if self.config.curvature_noise:
            variance = [v + self._bend(level, one.x, one.P) for v, level in zip(variance, levels, strict=True)]
        one.update(
            z,
            HJacobian=lambda x: np.array([[*self._gradient(level, x), 0.0, 0.0, 0.0] for level in levels]),
            Hx=lambda x: np.array([self._expected(level, x) for level in levels]),
            R=np.diag(variance),
        )

    def _bend(self, level: Level, x: Array, p: Array) -> float:
        """What the curvature of a level makes of the present doubt."""
        if self._in_metres:
            away = x[:3] - np.array(self._model.link(level.antenna, level.tag).origin)
            d = float(np.linalg.norm(away))
            hessian = (np.eye(3) - np.outer(away, away) / d**2) / d
        else:
            *_, hessian = self._model.quadratic(x[None, :3], np.array([level.antenna]), np.array([level.tag]))
            hessian = hessian[0]
        return float(curvature_noise(hessian[None], p[None, :3, :3])[0])
