"""An extended Kalman filter on received power, for all rows at once."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from estimators import kalman
from estimators.belief import Belief, StatusConfig
from estimators.motion import ConstantVelocity, MotionConfig
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel
from testbed.types import Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo


class EkfConfig(RssiConfig, MotionConfig, StatusConfig):
    """The section of an `ekf`. gate: none, second_order: false, correlation_s: 0 is the plain textbook filter."""

    gate: kalman.Gate = 0.999
    second_order: bool = True


class Ekf:
    """State (x, y, z, vx, vy, vz), constant velocity; every read is one scalar measurement, linearised at the present mean.

    RSSI bends sharply near an antenna, where a straight line through it promises far more than a read can tell. `second_order` adds to
    the prediction and to the noise what the curvature makes of the present doubt, ½ tr(H'' P) and ½ tr(H'' P H'' P) (Jazwinski 1970,
    ch. 9): as long as the doubt is wide against the distance a read counts for little. Breaks all the same when the belief has several
    modes (two antennas leave two places), or when an obstacle dims one antenna for long; the gate lets pass what dims it for a read.
    """

    Config = EkfConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: EkfConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._antennas = config, len(site.antennas)
        self._model, self._motion = RssiModel(config, site, "ekf"), ConstantVelocity(config)
        self._limits = kalman.gate_limits(config.gate, 1)

    def start(self, prior: Prior) -> None:
        self._belief = Belief(prior, self._motion, self._config)
        self._variance = ReadVariance(self._config, prior.rows, self._antennas)

    def predict(self, t: Array) -> None:
        self._belief.predict(t)

    def update(self, event: Event) -> UpdateInfo:
        row, reads, belief = event.row, event.data, self._belief
        position = belief.mean[row, :3]
        expected, gradient = self._model.linearised(position, reads.antenna, reads.tag)
        variance = self._variance.of(row, reads.antenna, reads.t)
        if self._config.second_order:
            bias, extra = second_order(self._model.curvature(position, reads.antenna, reads.tag), belief.covariance[row, :3, :3])
            expected, variance = expected + bias, variance + extra
        jacobian = np.zeros((len(row), 1, 6))
        jacobian[:, 0, :3] = gradient
        innovation = (reads.rssi - expected)[:, None]
        info = kalman.extended_update(belief.mean, belief.covariance, row, innovation, jacobian, variance[:, None, None], self._limits)
        belief.heard(row, info.used)
        self._variance.took(row[info.used], reads.antenna[info.used], reads.t[info.used])
        return info

    def estimate(self) -> Estimate:
        return self._belief.estimate()


def second_order(hessian: Array, covariance: Array) -> tuple[Array, Array]:
    """What curvature adds to a prediction and to its variance: ½ tr(H'' P) and ½ tr((H'' P)²), (E,) each, from (E, k, k) both."""
    product = hessian @ covariance
    return np.einsum("eii->e", product) / 2, np.einsum("eij,eji->e", product, product) / 2
