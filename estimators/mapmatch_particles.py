"""Particle map matching, as published: speed and heading against the roads' directions, from an unknown start.

K. El Mokhtari, S. Reboul, J.-B. Choquel, B. Amami, M. Benjelloun, "Indoor localization by particle map matching".
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from pydantic import Field

from estimators.resampling import effective_number, systematic
from estimators.roads_cloud import Cloud, RoadCloud
from estimators.roads_filter import RoadFilterConfig
from estimators.roads_map import drive, split
from testbed.quantity import MetresPerSecond
from testbed.types import Array, Prior


class MapmatchParticlesConfig(RoadFilterConfig):
    """kappa is the paper's κ_P. spread_mps: standard deviation of the uniform noise on a particle's speed, new at each step.

    The paper gives neither the noise nor its time step's share of it; 2.0 m/s is fitted to its tables: with the odometer's own 0.6
    the cloud can't diffuse over a bias of 0.5 m/s.
    """

    kappa: Annotated[float, Field(ge=0, le=1e4)] = 1.0
    particles: Annotated[int, Field(ge=2, le=1_000_000)] = 300
    spread_mps: Annotated[MetresPerSecond, Field(ge=0, le=100)] = 2.0


class MapmatchParticles(RoadCloud[Cloud]):
    """Particles on directed edges: moved by the odometer (Eqs. 8-10), weighed by von Mises likelihoods (Eq. 11), their mean projected on
    the nearest road (Eq. 13), resampled when the effective number falls below half of them (Eq. 14).

    With few particles it sometimes settles in a wrong place and has no particle left to come back with (4-13 % of runs): the row then
    says that it seeks, for its directions and the compass disagree, but stays lost.
    """

    Config = MapmatchParticlesConfig
    config: MapmatchParticlesConfig

    def begin(self, prior: Prior) -> None:
        self.cloud = Cloud.empty(prior.rows, self.config.particles)
        self.spread(prior, self.rng.uniform(self.config.particles))

    def move(self, rows: Array, speed: Array, dt: Array) -> None:
        draws = self.rng.uniform(self.config.particles, rows)
        half = np.sqrt(3) * self.config.spread_mps * dt
        _move(self.map, rows, self.cloud.edge, self.cloud.offset, speed * dt, half, draws)

    def renew(self, rows: Array) -> None:
        weight = self.cloud.weight
        poor = rows[effective_number(weight[rows]) < self.config.particles / 2] if len(rows) else rows
        if len(poor):
            self.cloud.inherit(poor, systematic(weight[poor], self.rng.uniform(1, poor)[:, 0]))


@njit(cache=True)
def _move(roads, rows, edge, offset, shift, half, draws):
    for r in range(len(rows)):
        b = rows[r]
        for i in range(edge.shape[1]):
            noise, turns = split(draws[r, i])
            o = max(0.0, offset[b, i] + shift[r] + half[r] * (2.0 * noise - 1.0))
            edge[b, i], offset[b, i] = drive(roads, edge[b, i], o, turns)
