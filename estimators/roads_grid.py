"""A belief on roads as a grid: cells along directed edges, times values of the odometer's bias.

Mass moves by whole cells, each bias by its own; what is less than a cell waits in a remainder. So nothing is smeared by interpolation,
and the odometer's noise alone widens the belief.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from estimators.roads_map import heading_factors, nearest
from testbed.roads import RoadGraph
from testbed.types import Array

MOST_SPREAD = 0.48  # cells² that one shift widens by, at most: 2 q (1 - q) has no more than 1/2


class Cells(NamedTuple):
    """C cells on E edges: edge e has those from first[e] to first[e + 1], each size[e] m long.

    edge (C,), middle (C,) m along its edge, x, y (C,) m. back_first (E + 1,), back (n,) and back_share (n,): the edges that lead
    into edge e, and the share of what comes out of each that takes e.
    """

    first: Array
    size: Array
    edge: Array
    middle: Array
    x: Array
    y: Array
    back_first: Array
    back: Array
    back_share: Array

    @classmethod
    def of(cls, graph: RoadGraph, cell: float) -> Cells:
        """Cells of about `cell` m: as many on each edge as fit best, at least one."""
        count = np.maximum(1, np.round(graph.length / cell).astype(np.int64))
        first = np.concatenate([[0], np.cumsum(count)])
        size = graph.length / count
        edge = np.repeat(np.arange(graph.edges), count)
        middle = (np.arange(first[-1]) - first[edge] + 0.5) * size[edge]
        place = graph.position(edge, middle)
        ways = np.diff(graph.first)
        origin, share = np.repeat(np.arange(graph.edges), ways), np.repeat(1.0 / ways, ways)
        order = np.argsort(graph.onward, kind="stable")
        back_first = np.concatenate([[0], np.cumsum(np.bincount(graph.onward, minlength=graph.edges))])
        x, y = np.ascontiguousarray(place[:, 0]), np.ascontiguousarray(place[:, 1])
        return cls(first, size, edge, middle, x, y, back_first, origin[order], share[order])


@njit(cache=True)
def shift(cells, mass, share, inflow):
    """mass (C,) = (1 - share) of it where it is, and `share` of it one cell further, in place; inflow (E,) is room to work in."""
    edges = len(cells.size)
    for e in range(edges):
        come = 0.0
        for k in range(cells.back_first[e], cells.back_first[e + 1]):
            come += cells.back_share[k] * mass[cells.first[cells.back[k] + 1] - 1]
        inflow[e] = come
    stay = 1.0 - share
    for e in range(edges):
        a = cells.first[e]
        for c in range(cells.first[e + 1] - 1, a, -1):
            mass[c] = stay * mass[c] + share * mass[c - 1]
        mass[a] = stay * mass[a] + share * inflow[e]


@njit(cache=True)
def move_grid(cells, rows, mass, remainder, waiting, bias, cell, speed, dt, noise):
    """Bring mass (B, K, C) of some rows (R,) on by (speed - bias) dt, and widen it by (noise dt)² a step.

    remainder (B, K) m: how far the mass of a bias is ahead of its cells. waiting (B, K) cells²: variance that a later shift will bring in,
    as the kernel (stay, one, two cells) = (q, 1 - q) * (1 - q, q), of mean one cell and variance 2 q (1 - q).
    """
    inflow = np.empty(len(cells.size))
    for r in range(len(rows)):
        b = rows[r]
        spread = (noise * dt[r] / cell) ** 2
        for k in range(len(bias)):
            remainder[b, k] += (speed[r] - bias[k]) * dt[r]
            waiting[b, k] += spread
            while remainder[b, k] > 0.5 * cell:
                remainder[b, k] -= cell
                now = min(waiting[b, k], MOST_SPREAD)
                waiting[b, k] -= now
                q = 0.5 * (1.0 - np.sqrt(1.0 - 2.0 * now))
                shift(cells, mass[b, k], 1.0 - q, inflow)
                if q > 0.0:
                    shift(cells, mass[b, k], q, inflow)


@njit(cache=True)
def weigh_grid(cells, roads, rows, mass, heading, kappa, everywhere, log_likelihood, agreement):
    """Bayes' rule for headings (R,): mass (B, K, C) of some rows times their likelihood, of sum one.

    `everywhere` (R,) of the mass is first spread evenly: the vehicle may have been carried there. log_likelihood (R,) over its greatest,
    agreement (R,) the mean cosine before it counted.
    """
    biases, edges = mass.shape[1], len(cells.size)
    cosine, factor = np.empty(edges), np.empty(edges)
    for r in range(len(rows)):
        b = rows[r]
        heading_factors(roads, heading[r], kappa[r], cosine, factor)
        even, keep = everywhere[r] / (biases * mass.shape[2]), 1.0 - everywhere[r]
        total, agreed = 0.0, 0.0
        for k in range(biases):
            for e in range(edges):
                part = 0.0
                for c in range(cells.first[e], cells.first[e + 1]):
                    mass[b, k, c] = (keep * mass[b, k, c] + even) * factor[e]
                    part += mass[b, k, c]
                total += part
                agreed += part * cosine[e] / factor[e] if factor[e] > 0.0 else 0.0
        scale(mass[b], total)
        log_likelihood[r] = np.log(max(total, 1e-300))
        agreement[r] = agreed


@njit(cache=True)
def scale(mass, total):
    """Mass (K, C) of sum one; even mass where nothing is left."""
    if total > 0.0:
        mass /= total
    else:
        mass[:] = 1.0 / mass.size


@njit(cache=True)
def weigh_place_grid(cells, roads, rows, mass, remainder, place, lead, std, floor):
    """Bayes' rule for a fix: something `lead` m ahead is near `place` (R, 2): floor + exp(-½ (d / std)²)."""
    for r in range(len(rows)):
        b, total = rows[r], 0.0
        for k in range(mass.shape[1]):
            ahead = remainder[b, k] + lead
            for c in range(mass.shape[2]):
                e = cells.edge[c]
                dx = cells.x[c] + ahead * roads.unit[e, 0] - place[r, 0]
                dy = cells.y[c] + ahead * roads.unit[e, 1] - place[r, 1]
                mass[b, k, c] *= floor + np.exp(-0.5 * (dx * dx + dy * dy) / (std * std))
                total += mass[b, k, c]
        scale(mass[b], total)


@njit(cache=True)
def summarise_grid(cells, roads, rows, mass, remainder, near, by_segment, mean, covariance, share):
    """What the beliefs of some rows say: as `estimators.roads_map.summarise_cloud`, remainders included."""
    n, biases = mass.shape[2], mass.shape[1]
    segments = np.empty(len(roads.foot))
    whole, ahead = np.empty(n), np.empty(n)
    for r in range(len(rows)):
        b = rows[r]
        whole[:] = 0.0
        ahead[:] = 0.0
        for k in range(biases):  # over biases first: places then cost one pass over the cells
            for c in range(n):
                whole[c] += mass[b, k, c]
                ahead[c] += mass[b, k, c] * remainder[b, k]
        chosen = -1
        if by_segment:
            segments[:] = 0.0
            for c in range(n):
                segments[roads.segment[cells.edge[c]]] += whole[c]
            chosen = np.argmax(segments)
        x = y = total = 0.0
        for c in range(n):
            e = cells.edge[c]
            if chosen < 0 or roads.segment[e] == chosen:
                x += whole[c] * cells.x[c] + ahead[c] * roads.unit[e, 0]
                y += whole[c] * cells.y[c] + ahead[c] * roads.unit[e, 1]
                total += whole[c]
        _, px, py = nearest(roads, x / total, y / total)
        xx = xy = yy = close = 0.0
        for c in range(n):
            w = whole[c]
            if w == 0.0:
                continue
            e, on = cells.edge[c], ahead[c] / w
            dx = cells.x[c] + on * roads.unit[e, 0] - px
            dy = cells.y[c] + on * roads.unit[e, 1] - py
            xx += w * dx * dx
            xy += w * dx * dy
            yy += w * dy * dy
            if dx * dx + dy * dy <= near * near:
                close += w
        mean[r, 0], mean[r, 1], share[r] = px, py, close
        covariance[r, 0, 0], covariance[r, 0, 1], covariance[r, 1, 0], covariance[r, 1, 1] = xx, xy, xy, yy
