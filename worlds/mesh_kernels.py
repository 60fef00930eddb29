"""The compiled loops of `worlds.mesh_rays`: segments against triangles that lie in trees of bounds.

Whether a line meets a triangle is decided by the three edges as the line sees them, end on. Two triangles that share an edge work out the
same number for it, of opposite sign, so that no line slips between them; where it is nought the line is moved aside by as little as can
be, first one way and then the other, which again is the same for both.

S. Woop, C. Benthin, I. Wald, "Watertight ray/triangle intersection", Journal of Computer Graphics Techniques 2 (2013), for the
projection; H. Edelsbrunner, E. P. Mücke, "Simulation of simplicity", ACM Transactions on Graphics 9 (1990), for the ties.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit, uint64

from testbed.columns import Array

SURFACE = 1e-9  # m: less than this inside is touching, as in `worlds.ray_kernels`
LEAF = 4  # triangles in a leaf
DEPTH = 128  # nodes that wait while a tree is gone down; halving can't come to more than twice its height
_PARALLEL = 1e100  # stands for 1 / 0
_PAD = 1e-6  # m: bounds are wider by this, which covers rounding


class Trees(NamedTuple):
    """A tree of bounds for each mesh, and one over all meshes, in one list of nodes."""

    bounds: Array  # (nodes, 6) m: low x, y, z, high x, y, z
    first: Array  # (nodes,) int64: the first child, the other follows it; in a leaf the first thing in it
    size: Array  # (nodes,) int64: things in the leaf, 0 for a node with children
    corners: Array  # (T, 3, 3) m: the triangles in the order of the leaves
    root: Array  # (M,) int64: the node that each mesh begins with
    mesh: Array  # (M,) int64: which mesh each thing in the tree over all is
    top: int  # the node that the tree over all begins with
    closed: Array  # (M,) bool


@njit(cache=True)
def build(low, high, leaf, first_node, first_thing):
    """A tree over n >= 1 things with bounds (n, 3): node bounds, first, count, and the order in which the things lie in the leaves."""
    n = len(low)
    bounds, first, count = np.empty((2 * n, 6)), np.zeros(2 * n, dtype=np.int64), np.zeros(2 * n, dtype=np.int64)
    order, begin, end, nodes = np.arange(n), np.zeros(2 * n, dtype=np.int64), np.zeros(2 * n, dtype=np.int64), 1
    end[0] = n
    node = 0
    while node < nodes:  # nodes are made in the order in which they are looked at
        own = order[begin[node] : end[node]]
        for axis in range(3):
            bounds[node, axis], bounds[node, 3 + axis] = low[own, axis].min() - _PAD, high[own, axis].max() + _PAD
        if len(own) <= leaf:
            first[node], count[node] = first_thing + begin[node], len(own)
        else:
            widest, spread = 0, -1.0
            for axis in range(3):
                middle = low[own, axis] + high[own, axis]
                if middle.max() - middle.min() > spread:
                    widest, spread = axis, middle.max() - middle.min()
            sorted_ = own[np.argsort(low[own, widest] + high[own, widest], kind="mergesort")]
            order[begin[node] : end[node]] = sorted_
            half = begin[node] + len(own) // 2
            first[node] = first_node + nodes
            begin[nodes], end[nodes], begin[nodes + 1], end[nodes + 1] = begin[node], half, half, end[node]
            nodes += 2
        node += 1
    return bounds[:nodes], first[:nodes], count[:nodes], order


@njit(cache=True)
def _inverse(way):
    """1 / way, but finite where there is no way, so that 0 times it is 0."""
    return 1.0 / way if abs(way) > 1e-15 else _PARALLEL


@njit(cache=True)
def _near(bounds, node, line, begin, end):
    """Whether the line from `begin` to `end` m meets the bounds of a node. `line`: origin, and metres along it a metre of each axis."""
    (x, y, z), (ix, iy, iz) = line
    a, b = (bounds[node, 0] - x) * ix, (bounds[node, 3] - x) * ix
    begin, end = max(begin, min(a, b)), min(end, max(a, b))
    a, b = (bounds[node, 1] - y) * iy, (bounds[node, 4] - y) * iy
    begin, end = max(begin, min(a, b)), min(end, max(a, b))
    a, b = (bounds[node, 2] - z) * iz, (bounds[node, 5] - z) * iz
    return max(begin, min(a, b)) <= min(end, max(a, b))


@njit(cache=True)
def _holds(bounds, node, point):
    """Whether a point lies in the bounds of a node."""
    x, y, z = point
    low = bounds[node, 0] <= x and bounds[node, 1] <= y and bounds[node, 2] <= z
    return low and x <= bounds[node, 3] and y <= bounds[node, 4] and z <= bounds[node, 5]


@njit(cache=True)
def _projection(way):
    """Axes x, y, z with z the one that the line runs along most, and how much x and y change along it, a metre of z; `way` along z."""
    z = 0
    for axis in range(1, 3):
        if abs(way[axis]) > abs(way[z]):
            z = axis
    x, y = (z + 1) % 3, (z + 2) % 3
    if way[z] < 0.0:  # keeps the turn of the corners
        x, y = y, x
    return uint64(x), uint64(y), uint64(z), way[x] / way[z], way[y] / way[z], way[z]


@njit(cache=True)
def _edge(ax, ay, bx, by):
    """The edge from a to b as seen along the line at the origin: its number, and the sign of that, never nought for two distinct points."""
    turn = ax * by - ay * bx
    if turn != 0.0:
        return turn, 1 if turn > 0.0 else -1
    aside = ay - by if ay != by else bx - ax
    return turn, 1 if aside > 0.0 else -1 if aside < 0.0 else 0


@njit(cache=True)
def _met(c, k, origin, axes):
    """(+1 where the line goes in through the triangle c[k], -1 out, 0 where it misses; how far along it is, m)."""
    x, y, z, sx, sy, along = axes
    az, bz, cz = c[k, 0, z] - origin[z], c[k, 1, z] - origin[z], c[k, 2, z] - origin[z]
    ax, ay = c[k, 0, x] - origin[x] - sx * az, c[k, 0, y] - origin[y] - sy * az
    bx, by = c[k, 1, x] - origin[x] - sx * bz, c[k, 1, y] - origin[y] - sy * bz
    w, sign_w = _edge(ax, ay, bx, by)
    cx, cy = c[k, 2, x] - origin[x] - sx * cz, c[k, 2, y] - origin[y] - sy * cz
    u, sign_u = _edge(bx, by, cx, cy)
    if sign_u != sign_w or sign_u == 0:
        return 0, 0.0
    v, sign_v = _edge(cx, cy, ax, ay)
    total = u + v + w
    if sign_u != sign_v or total == 0.0:
        return 0, 0.0
    # one that is counter-clockwise along the line is seen from behind: there the line goes out
    return -sign_u, (u * az + v * bz + w * cz) / total / along


@njit(cache=True)
def _meets(trees, mesh, line, axes, begin, end, at, side, stack):
    """All places up to `end` where the line meets a mesh, in order along it: how many; and `at` and `side`, longer if need be."""
    met, waiting = 0, 1
    stack[0] = trees.root[mesh]
    while waiting:
        waiting -= 1
        node = uint64(stack[uint64(waiting)])
        if not _near(trees.bounds, node, line, begin, end):
            continue
        first = uint64(trees.first[node])
        if trees.size[node] == 0:
            stack[uint64(waiting)], stack[uint64(waiting + 1)] = first, first + uint64(1)
            waiting += 2
            continue
        for i in range(trees.size[node]):
            sign, far = _met(trees.corners, first + uint64(i), line[0], axes)
            if sign == 0 or far > end or far < begin:
                continue
            if met == len(at):
                at, side = np.concatenate((at, at)), np.concatenate((side, side))
            place = met
            while place and at[place - 1] > far:
                at[place], side[place] = at[place - 1], side[place - 1]
                place -= 1
            at[place], side[place] = far, sign
            met += 1
    return met, at, side


@njit(cache=True)
def _inside(met, at, side, length, piece):
    """Fills `piece` (n, 2) with where the line is inside of a closed mesh, from and to in m on the segment; returns how many.

    `side` adds up to how often the surface goes round: not nought is inside, so that shells that overlap are one, and one that is
    turned inside out in another one is a hole.
    """
    found, round_, begin, k = 0, 0, 0.0, 0
    while k <= met:
        far = at[k] if k < met else inf
        before = round_
        round_ = round_ + side[k] if k < met else 0
        if before == 0 and round_ != 0:
            begin = far
        elif before != 0 and round_ == 0:
            a, b = max(begin, 0.0), min(far, length)
            if found and a - piece[found - 1, 1] < SURFACE and b > piece[found - 1, 1]:
                piece[found - 1, 1] = b
            elif b - a > SURFACE:
                piece[found, 0], piece[found, 1] = a, b
                found += 1
        k += 1
    return found


@njit(cache=True)
def cast(trees, entry, per_metre, start, end, counts, losses, first, mesh, enter, inside):
    """Count and loss of every segment, and where `first` isn't empty every crossing, from place first[i] on, mesh by mesh.

    counts (N,) int32 and losses (N,) dB are added to; mesh, enter (m), inside (m) are written.
    """
    at, side, waiting = np.empty(64), np.empty(64, dtype=np.int64), np.empty(DEPTH, dtype=np.int64)
    piece, stack = np.empty((64, 2)), np.empty(DEPTH, dtype=np.int64)
    for i in range(len(start)):
        origin = start[i, 0], start[i, 1], start[i, 2]
        x, y, z = end[i, 0] - origin[0], end[i, 1] - origin[1], end[i, 2] - origin[2]
        length = sqrt(x * x + y * y + z * z)
        if length <= SURFACE:
            continue
        way = x / length, y / length, z / length
        line, axes = (origin, (_inverse(way[0]), _inverse(way[1]), _inverse(way[2]))), _projection(way)
        waiting[0], left = trees.top, 1
        while left:
            left -= 1
            node = waiting[left]
            if not _near(trees.bounds, node, line, 0.0, length):
                continue
            if trees.size[node] == 0:
                waiting[left], waiting[left + 1] = trees.first[node], trees.first[node] + 1
                left += 2
                continue
            for thing in range(trees.first[node], trees.first[node] + trees.size[node]):
                m = trees.mesh[thing]
                closed = trees.closed[m]
                # a line is inside where it has gone in more often than out: if it may start there it is followed from before the segment
                begin = -inf if closed and _holds(trees.bounds, trees.root[m], origin) else 0.0
                met, at, side = _meets(trees, m, line, axes, begin, length, at, side, stack)
                if len(piece) < len(at):
                    piece = np.empty((len(at), 2))
                if closed:
                    found = _inside(met, at, side, length, piece)
                else:
                    found = (met + 1) // 2
                    for k in range(found):
                        piece[k, 0], piece[k, 1] = at[2 * k], at[2 * k]
                for k in range(found):
                    if len(first):
                        to = first[i] + counts[i]
                        mesh[to], enter[to], inside[to] = m, piece[k, 0], piece[k, 1] - piece[k, 0]
                    counts[i] += 1
                    losses[i] += entry[m] + per_metre[m] * (piece[k, 1] - piece[k, 0])
