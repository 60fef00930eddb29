"""Particle map matching that knows of the odometer's bias, and keeps as many particles as its belief needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit
from pydantic import Field

from estimators.resampling import effective_number, kld_size, systematic, systematic_sizes
from estimators.roads_cloud import Cloud, RoadCloud
from estimators.roads_filter import RoadFilterConfig
from estimators.roads_map import drive, split
from testbed.quantity import Metres, MetresPerSecond
from testbed.types import Array, Prior


class MapmatchParticlesBiasConfig(RoadFilterConfig):
    """What the particle filter with a bias is told of the odometer, and how many particles it may have.

    bias_range_mps : the bias is uniform within ± this at the start; bias_walk_mps is added to it (uniform, of this standard deviation) each
    time particles are resampled, for those left would else share a handful of values
    kld_epsilon, kld_confidence, bin_m, bin_mps : the cloud stays within this Kullback-Leibler distance of its belief over cells of road
    times bias, with this probability (Fox 2003); between particles_min and particles_max
    reseed_share : of the particles of a doubted belief, so many are put anywhere when it is resampled
    """

    particles_min: Annotated[int, Field(ge=2, le=1_000_000)] = 1000
    particles_max: Annotated[int, Field(ge=2, le=1_000_000)] = 4000
    bias_range_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.5
    bias_walk_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.02
    noise_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.6
    kld_epsilon: Annotated[float, Field(gt=0, le=10)] = 0.05
    kld_confidence: Annotated[float, Field(gt=0, lt=1)] = 0.99
    bin_m: Annotated[Metres, Field(gt=0, le=100)] = 0.5
    bin_mps: Annotated[MetresPerSecond, Field(gt=0, le=10)] = 0.1
    reseed_share: Annotated[float, Field(ge=0, le=1)] = 0.2


DRAWS = 256  # random numbers come in multiples of it


@dataclass
class BiasedCloud(Cloud):
    """A cloud whose particles have a bias (B, N) m/s of the odometer each."""

    bias: Array

    def columns(self) -> tuple[Array, ...]:
        return self.edge, self.offset, self.bias


class MapmatchParticlesBias(RoadCloud[BiasedCloud]):
    """Particles (edge, offset, bias), moved by u - b with the odometer's own noise, weighed by the compass as in `mapmatch_particles`.

    Matched to the sensors as it is, it needs many particles until it has settled: with the paper's 300 it is worse than the paper's
    own filter, whose wide noise keeps alive what this one would drop.
    """

    Config = MapmatchParticlesBiasConfig
    config: MapmatchParticlesBiasConfig
    by_segment = True

    def begin(self, prior: Prior) -> None:
        n, rows = self.config.particles_max, prior.rows
        empty = Cloud.empty(rows, n)
        bias = self.config.bias_range_mps * (2 * self.rng.uniform(n) - 1)
        self.cloud = BiasedCloud(empty.edge, empty.offset, empty.weight, empty.count, bias)
        self.spread(prior, self.rng.uniform(n))
        cells = np.ceil(self.graph.length / self.config.bin_m).astype(np.int64)
        self._first = np.concatenate([[0], np.cumsum(cells)])

    def move(self, rows: Array, speed: Array, dt: Array) -> None:
        c, half = self.cloud, np.sqrt(3) * self.config.noise_mps
        wanted = -(-c.count[rows] // DRAWS) * DRAWS  # of each row its own: a row's draws must not depend on the others' sizes
        for n in np.unique(wanted):
            some = wanted == n
            draws = self.rng.uniform(int(n), rows[some])
            _move(self.map, rows[some], c.edge, c.offset, c.bias, c.count, speed[some], dt[some], half, draws)

    def renew(self, rows: Array) -> None:
        c = self.cloud
        poor = rows[effective_number(c.weight[rows]) < c.count[rows] / 2] if len(rows) else rows
        if not len(poor):
            return
        n = c.edge.shape[1]
        comb = self.rng.uniform(1, poor)[:, 0]
        sizes = self._sizes(poor, comb)
        c.inherit(poor, systematic_sizes(c.weight[poor], comb, sizes))
        c.bias[poor] += np.sqrt(3) * self.config.bias_walk_mps * (2 * self.rng.uniform(n, poor) - 1)
        self._reseed(poor)

    def _sizes(self, rows: Array, comb: Array) -> Array:
        """(R,) how many particles the beliefs of some rows need, by the cells that a full sample of each fills."""
        c, config = self.cloud, self.config
        sample = systematic(c.weight[rows], comb)
        filled = _filled(rows, sample, c.edge, c.offset, c.bias, self._first, config.bin_m, config.bin_mps)
        return np.clip(kld_size(filled, config.kld_epsilon, config.kld_confidence), config.particles_min, config.particles_max)

    def _reseed(self, rows: Array) -> None:
        """Put a share of a doubted belief's particles anywhere."""
        doubted = rows[self.doubted(rows)]
        if not len(doubted) or not self.config.reseed_share:
            return
        c, n = self.cloud, self.cloud.edge.shape[1]
        who, where, bias = (self.rng.uniform(n, doubted) for _ in range(3))
        ends = np.cumsum(self.graph.length)
        at = where * ends[-1]
        edge = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
        again = who < self.config.reseed_share
        c.edge[doubted] = np.where(again, edge, c.edge[doubted])
        c.offset[doubted] = np.where(again, at - (ends[edge] - self.graph.length[edge]), c.offset[doubted])
        c.bias[doubted] = np.where(again, self.config.bias_range_mps * (2 * bias - 1), c.bias[doubted])


@njit(cache=True)
def _move(roads, rows, edge, offset, bias, count, speed, dt, half, draws):
    for r in range(len(rows)):
        b = rows[r]
        for i in range(count[b]):
            noise, turns = split(draws[r, i])
            o = max(0.0, offset[b, i] + (speed[r] - bias[b, i] + half * (2.0 * noise - 1.0)) * dt[r])
            edge[b, i], offset[b, i] = drive(roads, edge[b, i], o, turns)


@njit(cache=True)
def _filled(rows, sample, edge, offset, bias, first, bin_m, bin_mps):
    """(R,) how many cells of road times bias the sampled particles of some rows lie in."""
    found = np.empty(len(rows), dtype=np.int64)
    keys = np.empty(sample.shape[1], dtype=np.int64)
    for r in range(len(rows)):
        b = rows[r]
        for i in range(sample.shape[1]):
            p = sample[r, i]
            keys[i] = (first[edge[b, p]] + int(offset[b, p] / bin_m)) * 4096 + int(np.floor(bias[b, p] / bin_mps)) + 2048
        keys.sort()
        found[r] = 1 + (keys[1:] != keys[:-1]).sum()
    return found
