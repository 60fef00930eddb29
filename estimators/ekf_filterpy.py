"""The `ekf` again, for one target, on filterpy's ExtendedKalmanFilter: the oracle, and an example of a plain plug-in."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimators import kalman
from estimators.belief import status_of
from estimators.ekf import EkfConfig, curvature_noise
from estimators.motion import ConstantVelocity
from estimators.rssi_model import LIMITS_DBM, RssiModel
from testbed.protocols import SingleTarget
from testbed.types import POSITION_VELOCITY, Array, Site, Status


class EkfFilterpy(SingleTarget):
    """Equal to `ekf` to 1e-9 under the same configuration, some hundred times slower.

    predict and update are called apart: filterpy's `predict_update` linearises at the state before the prediction.
    """

    Config = EkfConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})
    components: ClassVar[tuple[str, ...]] = POSITION_VELOCITY

    def __init__(self, config: EkfConfig, site: Site, rng: np.random.Generator) -> None:
        super().__init__(config, site, rng)
        self._model, self._motion = RssiModel(config, site, "ekf_filterpy"), ConstantVelocity(config)
        self._limit = float(kalman.gate_limits(config.gate, 1)[1])

    def start(self, t: float, mean: Array, covariance: Array) -> None:
        self._filter = ExtendedKalmanFilter(dim_x=6, dim_z=1)
        self._filter.x, self._filter.P = mean, covariance
        self._time = self._heard = t
        self._last: dict[int, float] = {}

    def predict(self, t: float) -> None:
        self._filter.F, self._filter.Q = self._motion.matrices(t - self._time)
        self._filter.predict()
        self._time = t

    def update(self, kind: str, data: Any) -> tuple[bool, float, float, int]:
        if not LIMITS_DBM[0] <= data.rssi <= LIMITS_DBM[1]:  # nor is NaN
            return False, math.nan, math.nan, 0
        one, link = self._filter, self._model.link(data.antenna, data.tag)
        variance = read_variance(self.config, data.t - self._last.get(data.antenna, -math.inf))
        if self.config.curvature_noise:
            *_, hessian = self._model.quadratic(one.x[None, :3], np.array([data.antenna]), np.array([data.tag]))
            variance += float(curvature_noise(hessian, one.P[None, :3, :3])[0])
        x, p = one.x, one.P
        one.update(
            np.array([data.rssi]),
            HJacobian=lambda x: np.array([[*link.gradient(x), 0.0, 0.0, 0.0]]),
            Hx=lambda x: np.array([link.expected(x)]),
            R=variance,
        )
        nis, log_likelihood = judged(one)
        if nis > self._limit or not np.isfinite(one.P).all():
            one.x, one.P = x, p
            return False, log_likelihood, nis, 1
        self._heard = self._last[data.antenna] = data.t
        return True, log_likelihood, nis, 1

    def estimate(self) -> tuple[Array, Array, Status]:
        return self._filter.x, self._filter.P, Status(status_of(np.array(self._time - self._heard), self.config))


def read_variance(config: Any, apart: float) -> float:
    """dB²: as `ReadVariance` for one read, `apart` s after the last one that its antenna gave."""
    tau = config.correlation_s
    return config.sigma_db**2 / (math.tanh(max(apart, 1e-4 * tau) / (2 * tau)) if tau else 1.0)


def judged(one: Any) -> tuple[float, float]:
    """NIS and log-likelihood of filterpy's last scalar update."""
    s = float(one.S[0, 0])
    nis = float(one.y[0]) ** 2 / s
    return nis, -0.5 * (nis + math.log(2 * math.pi * s))
