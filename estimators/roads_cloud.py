"""A belief on roads as particles: where they begin, how they are weighed, and what they say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from estimators.resampling import systematic
from estimators.roads_filter import RoadFilter, prior_weight
from estimators.roads_map import summarise_cloud, weigh_cloud, weigh_place
from testbed.types import Array, Prior

FINER = 20  # places tried for each particle, where a prior says which are likely


@dataclass
class Cloud:
    """Up to N particles of B rows: edge, offset along it (m), weight (sums to one), and how many of the N there are in each row."""

    edge: Array
    offset: Array
    weight: Array
    count: Array

    @classmethod
    def empty(cls, rows: int, n: int) -> Cloud:
        """N particles a row at the start of edge 0, of equal weight."""
        return cls(np.zeros((rows, n), dtype=np.int64), np.zeros((rows, n)), np.full((rows, n), 1 / n), np.full(rows, n, dtype=np.int64))

    def inherit(self, rows: Array, chosen: Array) -> None:
        """The particles of some rows (R,) are replaced by those `chosen` (R, n) among them, with equal weights; -1 for none."""
        n = chosen.shape[1]
        for column in self.columns():
            column[rows, :n] = np.take_along_axis(column[rows], np.maximum(chosen, 0), axis=1)
        self.count[rows] = (chosen >= 0).sum(axis=1)
        self.weight[rows] = (np.arange(self.weight.shape[1]) < self.count[rows, None]) / self.count[rows, None]

    def columns(self) -> tuple[Array, ...]:
        """What is each particle's own, its weight aside: arrays (B, N)."""
        return self.edge, self.offset


AnyCloud = TypeVar("AnyCloud", bound=Cloud)


class RoadCloud(RoadFilter, Generic[AnyCloud]):
    """A filter on roads whose belief is a cloud of particles."""

    cloud: AnyCloud
    by_segment = False  # whether the place is the mean on the most probable segment, instead of the mean of all

    def spread(self, prior: Prior, coins: Array) -> None:
        """Set the particles out: evenly along all segments, in a direction by coins (B, N) in (0, 1), or about the prior."""
        cloud, graph = self.cloud, self.graph
        rows, n = cloud.edge.shape
        if self.config.start == "network":
            edge, cloud.offset[:] = even_spacing(graph.length[: len(graph.roads.segments)], n)
            turned = (coins >= 0.5) & (graph.back[edge] >= 0)
            cloud.edge[:] = np.where(turned, graph.back[edge], edge)
            cloud.offset[:] = np.where(turned, graph.length[edge] - cloud.offset, cloud.offset)
            return
        edge, offset = even_spacing(graph.length, FINER * n)
        for b in range(rows):
            weight = prior_weight(prior, np.array([b]), graph.position(edge, offset), graph.direction[edge])
            chosen = systematic(weight, coins[b, :1], n)[0]
            cloud.edge[b], cloud.offset[b] = edge[chosen], offset[chosen]

    def weigh(self, rows: Array, heading: Array, kappa: Array, since: Array) -> tuple[Array, Array]:
        told, agreement = np.empty(len(rows)), np.empty(len(rows))
        weigh_cloud(self.map, rows, self.cloud.edge, self.cloud.weight, self.cloud.count, heading, kappa, told, agreement)
        return told, agreement

    def weigh_place(self, rows: Array, place: Array, lead: float) -> None:
        c, std = self.cloud, float(self.config.fix_std_m or np.inf)
        weigh_place(self.map, rows, c.edge, c.offset, c.weight, c.count, place, lead, std, self.config.fix_floor)

    def summary(self, rows: Array) -> tuple[Array, Array, Array]:
        c, n = self.cloud, len(rows)
        mean, covariance, share = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n)
        summarise_cloud(self.map, rows, c.edge, c.offset, c.weight, c.count, self.config.near_m, self.by_segment, mean, covariance, share)
        return mean, covariance, share

    def particles(self) -> tuple[Array, Array]:
        """Positions (B, N, 3) on the floor, and weights (B, N); the places of a row that has fewer have weight 0."""
        place = self.graph.position(self.cloud.edge, self.cloud.offset)
        there = np.arange(place.shape[1]) < self.cloud.count[:, None]
        return np.concatenate([place, np.zeros((*place.shape[:2], 1))], axis=2), np.where(there, self.cloud.weight, 0.0)


def even_spacing(length: Array, n: int) -> tuple[Array, Array]:
    """(n,) index and (n,) offset of n places, evenly along pieces of `length` (P,) m laid end to end: at (i + ½) of the whole / n."""
    ends = np.cumsum(length)
    at = (np.arange(n) + 0.5) * ends[-1] / n
    piece = np.minimum(np.searchsorted(ends, at, side="right"), len(length) - 1)
    return piece, np.clip(at - (ends[piece] - length[piece]), 0.0, length[piece])
