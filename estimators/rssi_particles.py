"""A particle filter on received power: any start, several hypotheses at once, reads that stray far.

N. J. Gordon, D. J. Salmond, A. F. M. Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE Proceedings F 140
(1993); the motion is Singer's without acceleration: velocity forgets itself over `memory_s` (Ornstein-Uhlenbeck).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators.floor_cloud import CloudConfig, FloorCloud, student
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel, measured
from testbed.quantity import Decibels, MetresPerSecond, Seconds
from testbed.types import Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo


class RssiParticlesConfig(CloudConfig, RssiConfig):
    """`speed_std_mps`: of the speed in the plane, forgotten over `memory_s`. `freedom`: of Student's t, by which reads stray.

    Levels come from the antennas' measured references where the site has them, else from the link budget (`estimators.rssi_model`).
    """

    speed_std_mps: Annotated[MetresPerSecond, Field(gt=0, le=100)] = 0.8
    memory_s: Annotated[Seconds, Field(gt=0, le=1000)] = 4.0
    freedom: Annotated[float, Field(ge=1, le=1000)] = 10.0
    sigma_db: Annotated[Decibels, Field(gt=0, le=40)] = 6.0


class RssiParticles:
    """Place and velocity on the floor by N particles a row; the height of each stays as drawn from the prior.

    Reads that follow faster than `correlation_s` count for less, by a power of their likelihood. Breaks where walls or bodies make a
    level differ from the law by much more than σ for longer than the filter waits.
    """

    Config = RssiParticlesConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: RssiParticlesConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._site, self._random = config, site, rng
        self._model = RssiModel(config, site, "rssi_particles")

    def start(self, prior: Prior) -> None:
        n = self._config.particles
        self._cloud = FloorCloud(self._config, self._site, self._random, prior)
        self._variance = ReadVariance(self._config, prior.rows, len(self._site.antennas))
        self._cloud.own["velocity"] = self._config.speed_std_mps / np.sqrt(2) * self._random.normal(2 * n).reshape(-1, n, 2)

    def predict(self, t: Array) -> None:
        cloud, config, n = self._cloud, self._config, self._config.particles
        rows = np.flatnonzero(t > cloud.time)
        if not len(rows):
            return
        dt = (t - cloud.time)[rows, None, None]
        kept = np.exp(-dt / config.memory_s)
        velocity = cloud.own["velocity"]
        noise = self._random.normal(2 * n, rows).reshape(-1, n, 2) * config.speed_std_mps / np.sqrt(2)
        before = velocity[rows]
        velocity[rows] = before * kept + noise * np.sqrt(1 - kept**2)
        cloud.moved(rows, (before + velocity[rows]) / 2 * dt)
        cloud.time = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        reads, config = event.data, self._config
        rssi = measured(reads.rssi)
        used = np.isfinite(rssi)
        rows = event.row[used]
        if not len(rows):
            return UpdateInfo(used)
        reads, rssi = reads.take(used), rssi[used]
        expected = self._model.expected(self._cloud.points()[rows], reads.antenna, reads.tag)
        weight = config.sigma_db**2 / self._variance.of(rows, reads.antenna, reads.t)
        told = student((rssi[:, None] - expected) / config.sigma_db, config.freedom) * np.minimum(weight, 1.0)[:, None]
        log_likelihood = np.full(len(event), np.nan)
        log_likelihood[used] = self._cloud.weigh(rows, told)
        self._variance.took(rows, reads.antenna, reads.t)
        return UpdateInfo(used, log_likelihood)

    def estimate(self) -> Estimate:
        return self._cloud.estimate()

    def particles(self) -> tuple[Array, Array]:
        """(B, N, 3) m and weights (B, N)."""
        return self._cloud.points(), self._cloud.weights()
