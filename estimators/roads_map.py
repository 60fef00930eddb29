"""A road network as plain arrays, for kernels: how things move along it, and what a cloud of weights on it says."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from testbed.roads import RoadGraph
from testbed.types import Array
from testbed.units import wrap

TURNED_ROUND = np.deg2rad(170)  # beyond it a turn is no corner


class RoadMap(NamedTuple):
    """The arrays of a `testbed.roads.RoadGraph`: E directed edges, S segments.

    start, unit (E, 2), length (E,), cosine, sine (E,) of the direction, segment (E,), first (E + 1,) and onward as there;
    foot (S, 2) where a segment begins, along (S, 2) from there to its end.
    """

    start: Array
    unit: Array
    length: Array
    segment: Array
    first: Array
    onward: Array
    foot: Array
    along: Array

    @classmethod
    def of(cls, graph: RoadGraph) -> RoadMap:
        """The arrays of a graph, contiguous."""
        ends = graph.roads.nodes[graph.roads.segments]
        parts = (graph.start, graph.unit, graph.length, graph.segment, graph.first, graph.onward, ends[:, 0], ends[:, 1] - ends[:, 0])
        return cls(*(np.ascontiguousarray(p) for p in parts))


def rounding_saves(graph: RoadGraph, radius: float) -> float:
    """The share of the roads' length that a vehicle saves by rounding its corners with `radius` m, from the map alone.

    A fillet between legs that turn by δ is shorter than the corner by r (2 tan(δ/2) - δ): 0.43 r for a right angle. The mean over all
    turns, each edge driven as often as any other (so it is with two-way roads and even turns), over the mean length of an edge. Where a
    leg is too short for it the fillet takes half of the leg; whoever turns round saves nothing.
    """
    edge = np.repeat(np.arange(graph.edges), np.diff(graph.first))
    ways = np.diff(graph.first)[edge]
    turn = np.abs(wrap(graph.direction[graph.onward] - graph.direction[edge]))
    half = np.tan(np.minimum(turn, TURNED_ROUND) / 2)
    fits = np.minimum(graph.length[edge], graph.length[graph.onward]) / 2
    fillet = np.minimum(radius, fits / np.maximum(half, 1e-12))
    saved = np.where(turn < TURNED_ROUND, fillet * (2 * half - turn), 0.0)
    return float((saved / ways).sum() / graph.length.sum())


@njit(cache=True)
def split(uniform):
    """Two numbers in [0, 1), as good as independent, from one of 53 bits: its leading 24 bits, and the rest."""
    scaled = uniform * 16777216.0  # 2^24
    whole = np.floor(scaled)
    return (whole + 0.5) / 16777216.0, scaled - whole


@njit(cache=True)
def drive(roads, edge, offset, turns):
    """(edge, offset) once what exceeds an edge's length is carried on, at each node to a way on at random.

    `turns` is in [0, 1); each choice among n ways uses up log2 n of its bits, what is left of it is uniform again.
    """
    while offset > roads.length[edge]:
        offset -= roads.length[edge]
        ways = roads.first[edge + 1] - roads.first[edge]
        scaled = turns * ways
        chosen = min(int(scaled), ways - 1)
        turns = scaled - chosen
        edge = roads.onward[roads.first[edge] + chosen]
    return edge, offset


@njit(cache=True)
def nearest(roads, x, y):
    """(segment, x, y): the nearest place of the network, by a clamped projection on every segment; the lower index on a tie."""
    best, at, px, py = np.inf, 0, x, y
    for s in range(len(roads.foot)):
        dx, dy = roads.along[s, 0], roads.along[s, 1]
        share = ((x - roads.foot[s, 0]) * dx + (y - roads.foot[s, 1]) * dy) / (dx * dx + dy * dy)
        share = min(max(share, 0.0), 1.0)
        qx, qy = roads.foot[s, 0] + share * dx, roads.foot[s, 1] + share * dy
        apart = (x - qx) ** 2 + (y - qy) ** 2
        if apart < best:
            best, at, px, py = apart, s, qx, qy
    return at, px, py


@njit(cache=True)
def heading_factors(roads, heading, kappa, cosine, factor):
    """Fills, for every edge, the cosine between heading and direction, and exp(κ (cos - 1)): the von Mises likelihood over its maximum."""
    c, s = np.cos(heading), np.sin(heading)
    for e in range(len(roads.length)):
        cosine[e] = c * roads.unit[e, 0] + s * roads.unit[e, 1]
        factor[e] = np.exp(kappa * (cosine[e] - 1.0))


@njit(cache=True)
def weigh_cloud(roads, rows, edge, weight, count, heading, kappa, log_likelihood, agreement):
    """Multiply the weights of some rows by the likelihood of their headings (R,), and normalise them.

    log_likelihood (R,) is of the heading over its greatest value, agreement (R,) the mean cosine before it counted. Where all weights
    vanish they are equal again.
    """
    cosine, factor = np.empty(len(roads.length)), np.empty(len(roads.length))
    for r in range(len(rows)):
        b = rows[r]
        heading_factors(roads, heading[r], kappa[r], cosine, factor)
        total, agreed = 0.0, 0.0
        for i in range(count[b]):
            e = edge[b, i]
            agreed += weight[b, i] * cosine[e]
            weight[b, i] *= factor[e]
            total += weight[b, i]
        normalise(weight[b], count[b], total)
        log_likelihood[r] = np.log(max(total, 1e-300))
        agreement[r] = agreed


@njit(cache=True)
def normalise(weight, count, total):
    """Weights of sum one; equal ones where there is nothing left of them."""
    if total > 0.0 and total < np.inf:
        for i in range(count):
            weight[i] /= total
    else:
        for i in range(count):
            weight[i] = 1.0 / count


@njit(cache=True)
def weigh_place(roads, rows, edge, offset, weight, count, place, lead, std, floor):
    """Multiply weights by the likelihood that something at `place` (R, 2) is near: floor + exp(-½ (d / std)²).

    d is from the point `lead` m ahead of each particle.
    """
    for r in range(len(rows)):
        b, total = rows[r], 0.0
        for i in range(count[b]):
            e = edge[b, i]
            o = offset[b, i] + lead
            dx = roads.start[e, 0] + o * roads.unit[e, 0] - place[r, 0]
            dy = roads.start[e, 1] + o * roads.unit[e, 1] - place[r, 1]
            weight[b, i] *= floor + np.exp(-0.5 * (dx * dx + dy * dy) / (std * std))
            total += weight[b, i]
        normalise(weight[b], count[b], total)


@njit(cache=True)
def summarise_cloud(roads, rows, edge, offset, weight, count, near, by_segment, mean, covariance, share):
    """What the clouds of some rows say, into mean (R, 2), covariance (R, 2, 2) about it, and the share of weight within `near` m of it.

    The place is the weighted mean of all, or (`by_segment`) of those on the most probable segment, projected on the network.
    """
    mass = np.empty(len(roads.foot))
    for r in range(len(rows)):
        b = rows[r]
        x = y = whole = 0.0
        chosen = -1
        if by_segment:
            mass[:] = 0.0
            for i in range(count[b]):
                mass[roads.segment[edge[b, i]]] += weight[b, i]
            chosen = np.argmax(mass)
        for i in range(count[b]):
            e, w = edge[b, i], weight[b, i]
            if chosen < 0 or roads.segment[e] == chosen:
                x += w * (roads.start[e, 0] + offset[b, i] * roads.unit[e, 0])
                y += w * (roads.start[e, 1] + offset[b, i] * roads.unit[e, 1])
                whole += w
        _, px, py = nearest(roads, x / whole, y / whole)
        xx = xy = yy = close = 0.0
        for i in range(count[b]):
            e, w = edge[b, i], weight[b, i]
            dx = roads.start[e, 0] + offset[b, i] * roads.unit[e, 0] - px
            dy = roads.start[e, 1] + offset[b, i] * roads.unit[e, 1] - py
            xx += w * dx * dx
            xy += w * dx * dy
            yy += w * dy * dy
            if dx * dx + dy * dy <= near * near:
                close += w
        mean[r, 0], mean[r, 1], share[r] = px, py, close
        covariance[r, 0, 0], covariance[r, 0, 1], covariance[r, 1, 0], covariance[r, 1, 1] = xx, xy, xy, yy
