"""Motion along a road network: a random way from edge to edge, driven as a point or as a vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Roads
from testbed.roads import RoadGraph
from testbed.walk import RoadWalk
from worlds.paths import PIVOT_RADIUS, Trip, rounded, timed

NEAREST = 0.5  # m: a way point so near to the start is left out, for a corner needs a leg before it


def wander(graph: RoadGraph, far: float, random: np.random.Generator) -> tuple[Array, float]:
    """A random way of at least `far` m: the edges (n,) int64, and the offset on the first one, m.

    The start is uniform over the directed length; at a node all ways on are equally likely, back is none unless the road ends.
    """
    ends = np.cumsum(graph.length)
    begin = random.uniform(0.0, ends[-1])
    edge = int(np.searchsorted(ends, begin, side="right"))
    offset = begin - (ends[edge] - graph.length[edge])
    edges, covered = [edge], graph.length[edge] - offset
    while covered < far:
        ways = graph.onward[graph.first[edge] : graph.first[edge + 1]]
        edge = int(ways[int(random.uniform(0.0, len(ways)))])
        edges.append(edge)
        covered += graph.length[edge]
    return np.array(edges), float(offset)


@dataclass(frozen=True, eq=False)
class PointTrip:
    """A point that moves along edges (n,) of a network at one speed (m/s) from t = 0, `offset` m into the first one."""

    graph: RoadGraph
    edges: Array
    offset: float
    speed: float

    def pose(self, t: ArrayLike) -> Array:
        """Poses (..., 7) on the floor at times t (...,) s; at a node, on the next edge already."""
        ends = np.cumsum(self.graph.length[self.edges])
        s = np.clip(self.offset + self.speed * np.asarray(t, dtype=np.float64), 0.0, ends[-1])
        i = np.minimum(np.searchsorted(ends, s, side="right"), len(ends) - 1)
        edge = self.edges[i]
        position = self.graph.position(edge, s - (ends[i] - self.graph.length[edge]))
        height = np.zeros((*np.shape(s), 1))
        return np.concatenate([position, height, frames.from_euler(self.graph.direction[edge])], axis=-1)


def check_walk(actor: str, route: Any, motion: str, roads: Roads | None) -> None:
    """ValueError, naming the actor, for a walk where there are no roads, and for a point that is to be driven by the physics engine."""
    if not isinstance(route, RoadWalk):
        return
    if roads is None:
        raise ValueError(f"actor {actor}: a walk wants roads, and this world has none: give it a route, or take a world with roads")
    if motion == "dynamic" and route.corner_radius_m < PIVOT_RADIUS:
        raise ValueError(f"actor {actor}: nothing with wheels turns at once: give its walk a corner_radius_m of {PIVOT_RADIUS:g} or more")


def walk(model: RoadWalk, roads: Roads, duration: float, random: np.random.Generator) -> Trip | PointTrip:
    """A trial's way along the roads for `duration` s: speed and way drawn from `random`, in this order."""
    graph = RoadGraph(roads)
    speed = model.speed_mps * (1 + model.speed_jitter * random.uniform(-1.0, 1.0))
    edges, offset = wander(graph, speed * (duration + 1.0), random)
    if model.corner_radius_m == 0:
        return PointTrip(graph, edges, offset, speed)
    start = graph.position(edges[0], offset)
    nodes = roads.nodes[graph.head[edges]]
    ahead = nodes if np.hypot(*(nodes[0] - start)) > NEAREST else nodes[1:]
    path = rounded(np.concatenate([start[None], ahead]), model.corner_radius_m)
    return timed(path, 0.0, speed, model.acceleration_mps2, model.lateral_acceleration_mps2)
