"""An unscented Kalman filter on received power, for all rows at once."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators import kalman
from estimators.belief import Belief, StatusConfig
from estimators.motion import ConstantVelocity, MotionConfig
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel, measured
from testbed.types import Array, Estimate, Event, Prior, Reads, RowRandom, Site, UpdateInfo


class UkfConfig(RssiConfig, MotionConfig, StatusConfig):
    """The section of a `ukf`: where its sigma points lie (α, β, κ), and the rest as for an `ekf`."""

    alpha: Annotated[float, Field(ge=1e-3, le=2)] = 0.3
    beta: Annotated[float, Field(ge=0, le=10)] = 2.0
    kappa: Annotated[float, Field(gt=-6, le=100)] = 0.0
    gate: kalman.Gate = 0.999


class Ukf:
    """State (x, y, z, vx, vy, vz), constant velocity; every read is one scalar measurement, taken through 13 sigma points.

    The motion is linear, so it is predicted in closed form, which is what the points would give; they are drawn afresh from the present
    belief for each read, two reads at one time included. The default α keeps the points within the doubt: with α = 1 they lie at √6
    standard deviations, often behind the antenna, where the pattern tells another story. α = 1, β = κ = 0 has no negative weight.
    Breaks as the `ekf` does where a belief has several modes, and drifts away from the antennas where doubt is wide.
    """

    Config = UkfConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: UkfConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._antennas = config, len(site.antennas)
        self._model, self._motion = RssiModel(config, site, "ukf"), ConstantVelocity(config)
        self._weights = kalman.Weights.merwe(self._motion.n, config.alpha, config.beta, config.kappa)
        self._limits = kalman.gate_limits(config.gate, 1)

    def start(self, prior: Prior) -> None:
        self._belief = Belief(prior, self._motion, self._config)
        self._variance = ReadVariance(self._config, prior.rows, self._antennas)
        self.predict(prior.t)
        self.update(Event("reads", np.empty(0, dtype=np.int64), Reads.empty()))  # kernels are compiled here, not in the first update

    def predict(self, t: Array) -> None:
        self._belief.predict(t)

    def update(self, event: Event) -> UpdateInfo:
        row, reads, belief = event.row, event.data, self._belief
        points = kalman.sigma_points(belief.mean, belief.covariance, row, self._weights)
        innovation = (measured(reads.rssi)[:, None] - self._model.expected(points[..., :3], reads.antenna, reads.tag))[..., None]
        noise = self._variance.of(row, reads.antenna, reads.t)[:, None, None]
        info = kalman.unscented_update(belief.mean, belief.covariance, row, points, innovation, noise, self._weights, self._limits)
        belief.heard(row, info.used)
        self._variance.took(row[info.used], reads.antenna[info.used], reads.t[info.used])
        return info

    def estimate(self) -> Estimate:
        return self._belief.estimate()
