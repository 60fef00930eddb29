"""The `ukf` again, for one target, on filterpy's UnscentedKalmanFilter: the oracle, and an example of a plain plug-in."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from estimators import kalman
from estimators.belief import status_of
from estimators.ekf_filterpy import judged, read_variance
from estimators.motion import ConstantVelocity
from estimators.rssi_model import LIMITS_DBM, RssiModel
from estimators.ukf import UkfConfig
from testbed.protocols import SingleTarget
from testbed.types import POSITION_VELOCITY, Array, Site, Status


class UkfFilterpy(SingleTarget):
    """Equal to `ukf` to 1e-9 under the same configuration, some hundred times slower.

    filterpy keeps the sigma points of the last prediction; a second read at the same time would be taken through stale ones, so they
    are drawn afresh before each update.
    """

    Config = UkfConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})
    components: ClassVar[tuple[str, ...]] = POSITION_VELOCITY

    def __init__(self, config: UkfConfig, site: Site, rng: np.random.Generator) -> None:
        super().__init__(config, site, rng)
        self._model, self._motion = RssiModel(config, site, "ukf_filterpy"), ConstantVelocity(config)
        self._limit = float(kalman.gate_limits(config.gate, 1)[1])

    def start(self, t: float, mean: Array, covariance: Array) -> None:
        points = MerweScaledSigmaPoints(6, self.config.alpha, self.config.beta, self.config.kappa)
        self._filter = UnscentedKalmanFilter(6, 1, 1.0, hx=self._expected, fx=self._move, points=points)
        self._filter.x, self._filter.P = mean, covariance
        self._time = self._heard = t
        self._last: dict[int, float] = {}

    def predict(self, t: float) -> None:
        self._transition, self._filter.Q = self._motion.matrices(t - self._time)
        self._filter.predict()
        self._time = t

    def update(self, kind: str, data: Any) -> tuple[bool, float, float, int]:
        if not LIMITS_DBM[0] <= data.rssi <= LIMITS_DBM[1]:  # nor is NaN
            return False, math.nan, math.nan, 0
        one, self._link = self._filter, self._model.link(data.antenna, data.tag)
        variance = read_variance(self.config, data.t - self._last.get(data.antenna, -math.inf))
        x, p = one.x, one.P
        one.sigmas_f = one.points_fn.sigma_points(x, p)
        one.update(np.array([data.rssi]), R=variance)
        nis, log_likelihood = judged(one)
        if nis > self._limit or not np.isfinite(one.P).all():
            one.x, one.P = x, p
            return False, log_likelihood, nis, 1
        self._heard = self._last[data.antenna] = data.t
        return True, log_likelihood, nis, 1

    def estimate(self) -> tuple[Array, Array, Status]:
        return self._filter.x, self._filter.P, Status(status_of(np.array(self._time - self._heard), self.config))

    def _expected(self, x: Array) -> Array:
        return np.array([self._link.expected(x)])

    def _move(self, x: Array, dt: float) -> Array:
        return self._transition @ x
