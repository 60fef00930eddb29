"""Ways through a road network: its segments as directed edges, what follows each, and the nearest place on it.

A leaf: numpy only. Worlds drive along it, estimators believe on it, metrics judge by it; none of that is in here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array
from testbed.geometry import Roads

NOWHERE = -1  # an edge, or a segment, that is not there
SHORTEST = 1e-6  # m: a segment below it has no direction


class RoadGraph:
    """A road network with directions. E edges: all segments forward, then those that are not one-way backward, in their order.

    segment (E,) int64; tail, head (E,) int64 nodes; start (E, 2) m, unit (E, 2), length (E,) m; direction (E,) rad in (-π, π], the
    heading of whoever drives along; back (E,) int64, the same segment the other way, NOWHERE where it is one-way.
    The ways on from edge e are `onward[first[e] : first[e + 1]]`: all that leave its head but `back`, and `back` alone at a dead end.
    ValueError for a network without segments, for what `check_roads` refuses, and for a place that can be entered and not left, named.
    """

    def __init__(self, roads: Roads) -> None:
        check_roads(roads)
        if not len(roads.segments):
            raise ValueError("roads: a network of at least one segment is wanted, this one has none")
        two_way = np.flatnonzero(~roads.one_way)
        forward = np.asarray(roads.segments, dtype=np.int64)
        self.roads = roads
        self.segment = np.concatenate([np.arange(len(forward)), two_way])
        self.tail, self.head = np.concatenate([forward, forward[two_way, ::-1]]).T
        self.back = np.full(len(self.segment), NOWHERE)
        reverse = len(forward) + np.arange(len(two_way))
        self.back[two_way], self.back[reverse] = reverse, two_way
        self.start = roads.nodes[self.tail]
        along = roads.nodes[self.head] - self.start
        self.length = np.hypot(*along.T)
        self.unit = along / self.length[:, None]
        self.direction = np.arctan2(self.unit[:, 1], self.unit[:, 0])
        self.direction[self.direction == -np.pi] = np.pi  # due west is π, whatever the sign of the zero beside it
        self.first, self.onward = self._ways_on()

    def _ways_on(self) -> tuple[Array, Array]:
        by_tail = [np.flatnonzero(self.tail == node) for node in range(len(self.roads.nodes))]
        ways = []
        for edge, head in enumerate(self.head):
            found = by_tail[head][by_tail[head] != self.back[edge]]
            if not len(found) and self.back[edge] == NOWHERE:
                x, y = self.roads.nodes[head]
                raise ValueError(f"roads: node {head} at ({x:g}, {y:g}) can be entered by segment {self.segment[edge]} and not left again")
            ways.append(found if len(found) else self.back[[edge]])
        return np.cumsum([0] + [len(w) for w in ways]), np.concatenate(ways)

    @property
    def edges(self) -> int:
        """E."""
        return len(self.segment)

    def position(self, edge: ArrayLike, offset: ArrayLike) -> Array:
        """(..., 2) m: the place `offset` (...,) m along the edges `edge` (...,)."""
        edge = np.asarray(edge)
        return self.start[edge] + np.asarray(offset, dtype=np.float64)[..., None] * self.unit[edge]

    def project(self, position: ArrayLike) -> tuple[Array, Array, Array]:
        """The nearest place on the network to each position (..., 2) m: segment (...,), place (..., 2) m, distance (...,) m.

        The segment of lower index on a tie; NOWHERE, NaN and NaN for a position that is not finite.
        """
        return project(self.roads, position)


def project(roads: Roads, position: ArrayLike) -> tuple[Array, Array, Array]:
    """`RoadGraph.project` for a network as it is; it may be empty, everything is then NOWHERE."""
    p = np.asarray(position, dtype=np.float64)
    distance, place = np.full(p.shape[:-1], np.inf), np.full(p.shape, np.nan)
    segment = np.full(p.shape[:-1], NOWHERE, dtype=np.int32)
    for i, (a, b) in enumerate(roads.nodes[roads.segments]):
        along = b - a
        share = np.clip((p - a) @ along / max(along @ along, 1e-300), 0.0, 1.0)
        foot = a + share[..., None] * along
        apart = np.hypot(*np.moveaxis(p - foot, -1, 0))
        closer = apart < distance
        distance, segment = np.where(closer, apart, distance), np.where(closer, i, segment).astype(np.int32)
        place = np.where(closer[..., None], foot, place)
    return segment, place, np.where(segment == NOWHERE, np.nan, distance)


def nearest_segment(roads: Roads | None, position: ArrayLike) -> Array:
    """(...,) int32: the segment nearest to each position (..., 2) m, NOWHERE without roads. The lower index on a tie."""
    if roads is None:
        return np.full(np.shape(position)[:-1], NOWHERE, dtype=np.int32)
    return project(roads, position)[0]


def check_roads(roads: Roads) -> None:
    """ValueError, naming the place, for what vehicles can't drive on.

    That is a segment that ends at no node, has no length or is there twice (two one-way segments that run against each other are
    not), and a part that hangs together with nothing else.
    """
    _ends_are_nodes(roads)
    _segments_are_distinct(roads)
    _hangs_together(roads)


def _ends_are_nodes(roads: Roads) -> None:
    wrong = np.flatnonzero(~np.isfinite(roads.nodes).all(axis=1))
    if len(wrong):
        raise ValueError(f"roads: node {wrong[0]} is at {_place(roads.nodes[wrong[0]])}: a finite place is wanted")
    wrong = np.flatnonzero(((roads.segments < 0) | (roads.segments >= len(roads.nodes))).any(axis=1))
    if len(wrong):
        i = wrong[0]
        raise ValueError(f"roads: segment {i} joins nodes {roads.segments[i].tolist()}, there are nodes 0 to {len(roads.nodes) - 1}")
    ends = roads.nodes[roads.segments]
    short = np.flatnonzero(np.hypot(*(ends[:, 1] - ends[:, 0]).T) < SHORTEST)
    if len(short):
        i, (a, b) = short[0], roads.segments[short[0]]
        raise ValueError(f"roads: segment {i} from node {a} to node {b} at {_place(ends[i, 0])} has no length: leave it out")


def _segments_are_distinct(roads: Roads) -> None:
    taken: dict[tuple[int, int], int] = {}
    for i, ((a, b), one_way) in enumerate(zip(roads.segments.tolist(), roads.one_way.tolist(), strict=True)):
        for way in ((a, b),) if one_way else ((a, b), (b, a)):
            if way in taken:
                where = f"between {_place(roads.nodes[a])} and {_place(roads.nodes[b])}"
                raise ValueError(f"roads: segment {i} {where} is there already, as segment {taken[way]}: leave one of them out")
            taken[way] = i


def _hangs_together(roads: Roads) -> None:
    part = np.arange(len(roads.nodes))
    for _ in range(len(roads.nodes)):
        lower = part.copy()
        np.minimum.at(lower, roads.segments.ravel(), part[roads.segments[:, ::-1].ravel()])
        lower = lower[lower]  # halves the way to the lowest node each time
        if np.array_equal(lower, part):
            break
        part = lower
    apart = np.flatnonzero(part != part[0]) if len(part) else part
    if len(apart):
        i = apart[0]
        raise ValueError(
            f"roads: no way leads from node 0 at {_place(roads.nodes[0])} to node {i} at {_place(roads.nodes[i])}: join the parts"
        )


def _place(point: Array) -> str:
    return f"({point[0]:g}, {point[1]:g})"
