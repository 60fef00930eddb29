"""An extended Kalman filter on received power, for all rows at once."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from estimators import kalman
from estimators.belief import Belief, StatusConfig
from estimators.motion import ConstantVelocity, MotionConfig
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel, measured
from testbed.types import Array, Estimate, Event, Prior, Reads, RowRandom, Site, UpdateInfo


class EkfConfig(RssiConfig, MotionConfig, StatusConfig):
    """The section of an `ekf`. With gate: none, curvature_noise: false and correlation_s: 0 it is the plain textbook filter."""

    gate: kalman.Gate = 0.999
    curvature_noise: bool = True


class Ekf:
    """State (x, y, z, vx, vy, vz), constant velocity; every read is one scalar measurement, linearised at the present mean.

    RSSI bends sharply near an antenna, where a straight line through it promises far more than a read can tell. `curvature_noise` adds
    to the noise what the curvature makes of the present doubt, ½ tr((H'' P)²), the second-order term of Jazwinski 1970, ch. 9: as long
    as the doubt is wide against the distance, a read counts for little. The term's twin, ½ tr(H'' P) added to the prediction, is left
    out: with such doubt it is off by tens of dB, where the logarithm is far from its parabola, and drives the mean away.
    Breaks all the same when the belief has several modes (two antennas leave two places), or when an obstacle dims an antenna for
    long; the gate lets pass what dims it for a read or two.
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
        self.predict(prior.t)
        self.update(Event("reads", np.empty(0, dtype=np.int64), Reads.empty()))  # kernels are compiled here, not in the first update

    def predict(self, t: Array) -> None:
        self._belief.predict(t)

    def update(self, event: Event) -> UpdateInfo:
        row, reads, belief = event.row, event.data, self._belief
        position = belief.mean[row, :3]
        variance = self._variance.of(row, reads.antenna, reads.t)
        if self._config.curvature_noise:
            expected, gradient, hessian = self._model.quadratic(position, reads.antenna, reads.tag)
            variance = variance + curvature_noise(hessian, belief.covariance[row, :3, :3])
        else:
            expected, gradient = self._model.linearised(position, reads.antenna, reads.tag)
        jacobian = np.zeros((len(row), 1, 6))
        jacobian[:, 0, :3] = gradient
        innovation = (measured(reads.rssi) - expected)[:, None]
        info = kalman.extended_update(belief.mean, belief.covariance, row, innovation, jacobian, variance[:, None, None], self._limits)
        belief.heard(row, info.used)
        self._variance.took(row[info.used], reads.antenna[info.used], reads.t[info.used])
        return info

    def estimate(self) -> Estimate:
        return self._belief.estimate()


def curvature_noise(hessian: Array, covariance: Array) -> Array:
    """(E,) ½ tr((H'' P)²): the variance that a parabola adds to the straight line through it, from (E, k, k) both."""
    product = hessian @ covariance
    return np.einsum("eij,eji->e", product, product) / 2
