"""Exact Bayes on roads, but for the grid: cells along directed edges times values of the odometer's bias."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from estimators.roads_filter import RoadFilter, RoadFilterConfig, prior_weight
from estimators.roads_grid import Cells, move_grid, summarise_grid, weigh_grid, weigh_place_grid
from testbed.quantity import Metres, MetresPerSecond
from testbed.types import Array, Prior, RowRandom, Site


class MapmatchGridConfig(RoadFilterConfig):
    """What a grid filter on roads is told of the odometer, and how fine it is.

    bias_range_mps : the bias is uniform within ± this, in `biases` values at the middles of equal parts
    noise_mps      : standard deviation of a sample's noise, independent from sample to sample
    carried_per_s  : probability, each second, that the vehicle is lifted and put down anywhere
    place          : "segment", the mean on the most probable segment; "mean", that of all, projected on the nearest road
    """

    cell_m: Annotated[Metres, Field(gt=0, le=100)] = 0.5
    biases: Annotated[int, Field(ge=1, le=1000)] = 7
    bias_range_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.5
    noise_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.6
    carried_per_s: Annotated[float, Field(ge=0, le=1)] = 1e-6
    place: Literal["segment", "mean"] = "segment"


class MapmatchGrid(RoadFilter):
    """Point-mass filter (Bucy, Senne 1971) on the directed network: mass moves cell by cell along the edges, splits at nodes evenly over
    the ways on, and is weighed by the von Mises likelihood of the compass.

    It loses no run, for no hypothesis is ever dropped. Vehicles that reverse are not modelled: a belief waits until they come back.
    Cells of edges shorter than a cell stand for more or less than their length, so cells should be finer than the shortest edge.
    """

    Config = MapmatchGridConfig
    config: MapmatchGridConfig
    watches_agreement = False  # the belief itself knows of other places

    def __init__(self, config: MapmatchGridConfig, site: Site, rng: RowRandom) -> None:
        super().__init__(config, site, rng)
        self.cells = Cells.of(self.graph, config.cell_m)
        part = 2 * config.bias_range_mps / config.biases
        self.bias = -config.bias_range_mps + part * (np.arange(config.biases) + 0.5)

    def begin(self, prior: Prior) -> None:
        shape = (prior.rows, len(self.bias))
        weight = np.tile(self.cells.size[self.cells.edge], (prior.rows, 1))
        if self.config.start == "prior":
            place = np.stack([self.cells.x, self.cells.y], axis=1)
            for b in range(prior.rows):
                weight[b] *= prior_weight(prior, np.array([b]), place, self.graph.direction[self.cells.edge])[0]
        weight /= weight.sum(axis=1, keepdims=True) * len(self.bias)
        self.mass = np.repeat(weight[:, None], len(self.bias), axis=1)
        self.remainder, self._waiting = np.zeros(shape), np.zeros(shape)

    def move(self, rows: Array, speed: Array, dt: Array) -> None:
        c = self.config
        move_grid(self.cells, rows, self.mass, self.remainder, self._waiting, self.bias, c.cell_m, speed, dt, c.noise_mps)

    def weigh(self, rows: Array, heading: Array, kappa: Array, since: Array) -> tuple[Array, Array]:
        told, agreement = np.empty(len(rows)), np.empty(len(rows))
        carried = np.minimum(self.config.carried_per_s * since, 1.0)
        weigh_grid(self.cells, self.map, rows, self.mass, heading, kappa, carried, told, agreement)
        return told, agreement

    def weigh_place(self, rows: Array, place: Array, lead: float) -> None:
        std = float(self.config.fix_std_m or np.inf)
        weigh_place_grid(self.cells, self.map, rows, self.mass, self.remainder, place, lead, std, self.config.fix_floor)

    def summary(self, rows: Array) -> tuple[Array, Array, Array]:
        n = len(rows)
        mean, covariance, share = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n)
        by_segment = self.config.place == "segment"
        summarise_grid(self.cells, self.map, rows, self.mass, self.remainder, self.config.near_m, by_segment, mean, covariance, share)
        return mean, covariance, share

    def renew(self, rows: Array) -> None:
        """Nothing: a grid needs no resampling."""

    def particles(self) -> tuple[Array, Array]:
        """The cells' middles (B, C, 3) on the floor with their mass (B, C), remainders included."""
        whole = self.mass.sum(axis=1)
        ahead = np.einsum("bkc,bk->bc", self.mass, self.remainder) / np.maximum(whole, 1e-300)
        place = self.graph.position(np.broadcast_to(self.cells.edge, ahead.shape), self.cells.middle + ahead)
        return np.concatenate([place, np.zeros((*ahead.shape, 1))], axis=2), whole
