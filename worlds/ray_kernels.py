"""The compiled loops of `worlds.raycast`: segments against packed boxes (`worlds.boxtree`).

Segments are taken in batches, and a batch through all levels of blocks one level at a time: first all its tests, then what follows
from them. Going down with one segment after the other, the processor would guess at each block what the last test will say,
and often be wrong: that takes 1.3 times as long.

Blocks are addressed by unsigned offsets into flat arrays. An index that could be negative would be wrapped around like Python's,
and a view of a block would be counted by the memory manager: either costs more than the arithmetic. All memory comes from the
caller, for the compiler takes longer over an allocation than over a loop.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit, uint64
from numba.cpython.unsafe.numbers import trailing_zeros

from testbed.columns import Array

WIDTH = 16  # lanes a block: four vector registers of four doubles. Here and not in boxtree: compiled code is kept until this file changes
SURFACE = 1e-9  # m: less than this inside a box is touching, not crossing
GROUP = 32  # bodies whose nearness is kept in one number
BATCH = 256  # segments at most: what they need stays in the cache
_PAIRS, _PASSES = 65_536, 4_096  # a batch is smaller where it could come to more than this
_PARALLEL = 1e100  # stands for 1 / 0 in the slab test; finite, so that 0 times it is 0
_LANES, _BLOCK = uint64(WIDTH), uint64(6 * WIDTH)
_HIGH = uint64(3 * WIDTH)  # from a low face's row to the high one's
_lowest: Any = trailing_zeros  # place of the lowest bit that is set


class Workspace(NamedTuple):
    """Memory that a cast works in. A pass is one segment near one body, in the body's frame; a pair is a pass and a block."""

    centre: Array  # (Q * 3 * lanes,) m: x, then y, then z of the centre of each body's ball in the world, for each instant
    near: Array  # (batch, groups of bodies) int64: the bodies whose ball a segment meets, as bits
    segment: Array  # (passes,) int64
    number: Array  # (passes, 16): three axes of `_axis` without offsets, length, both ends
    offset: Array  # (passes, 6) uint64: the offsets of `_axis`
    who: Array  # (2, pairs) int64: passes, now and of the next level
    what: Array  # (2, pairs) int64: blocks, likewise
    bits: Array  # (pairs,) int64: lanes that are crossed


class Result(NamedTuple):
    """What a cast finds. Crossings of segment i go to place first[i] and on; none are listed where `first` is empty."""

    counts: Array  # (N,) int32, 0 before
    losses: Array  # (N,) dB, 0 before
    first: Array  # (N,) or (0,) int64
    box: Array  # (crossings,) int64
    enter: Array  # (crossings,) m
    length: Array  # (crossings,) m


def workspace(instants: int, bodies: int, lanes: int, leaves: int) -> Workspace:
    """Memory for a cast past some bodies with so many leaves in all, whose balls fill `lanes`."""
    batch = max(1, min(BATCH, _PAIRS // max(leaves, 1), _PASSES // max(bodies, 1)))
    passes, pairs = batch * bodies, batch * leaves
    return Workspace(
        centre=np.zeros(instants * 3 * lanes),
        near=np.empty((batch, -(-lanes // GROUP)), dtype=np.int64),
        segment=np.empty(passes, dtype=np.int64),
        number=np.empty((passes, 16)),
        offset=np.empty((passes, 6), dtype=np.uint64),
        who=np.empty((2, pairs), dtype=np.int64),
        what=np.empty((2, pairs), dtype=np.int64),
        bits=np.empty(pairs, dtype=np.int64),
    )


@njit(cache=True)
def _axis(start, end, length):
    """Along one axis: origins for near and far faces, metres of segment per metre of axis, offsets of near and far faces."""
    way = end - start
    if abs(way) < SURFACE:
        return start - SURFACE, start + SURFACE, _PARALLEL, uint64(0), _HIGH
    if way > 0.0:
        return start, start, length / way, uint64(0), _HIGH
    return start, start, length / way, _HIGH, uint64(0)


@njit(cache=True)
def _crossed(blocks, block, ray, length):
    """Which lanes of a block the segment crosses, as bits."""
    (ax, bx, ix, near_x, far_x), (ay, by, iy, near_y, far_y), (az, bz, iz, near_z, far_z) = ray
    x = uint64(block) * _BLOCK
    y, z = x + _LANES, x + _LANES + _LANES
    bits = 0
    for lane in range(WIDTH):
        j = uint64(lane)
        a, b, c = (blocks[x + near_x + j] - ax) * ix, (blocks[y + near_y + j] - ay) * iy, (blocks[z + near_z + j] - az) * iz
        enter = a if a > b else b
        enter = enter if enter > c else c
        enter = enter if enter > 0.0 else 0.0
        a, b, c = (blocks[x + far_x + j] - bx) * ix, (blocks[y + far_y + j] - by) * iy, (blocks[z + far_z + j] - bz) * iz
        leave = a if a < b else b
        leave = leave if leave < c else c
        leave = leave if leave < length else length
        bits |= (1 << lane) if leave - enter > SURFACE else 0
    return bits


@njit(cache=True)
def _interval(blocks, block, lane, ray, length):
    """Where the segment enters one lane of a block, and how much lies inside: the arithmetic of `_crossed`."""
    (ax, bx, ix, near_x, far_x), (ay, by, iy, near_y, far_y), (az, bz, iz, near_z, far_z) = ray
    x = uint64(block) * _BLOCK + uint64(lane)
    y, z = x + _LANES, x + _LANES + _LANES
    a, b, c = (blocks[x + near_x] - ax) * ix, (blocks[y + near_y] - ay) * iy, (blocks[z + near_z] - az) * iz
    enter = a if a > b else b
    enter = enter if enter > c else c
    enter = enter if enter > 0.0 else 0.0
    a, b, c = (blocks[x + far_x] - bx) * ix, (blocks[y + far_y] - by) * iy, (blocks[z + far_z] - bz) * iz
    leave = a if a < b else b
    leave = leave if leave < c else c
    return enter, (leave if leave < length else length) - enter


@njit(cache=True)
def _rotated(w, i, j, k, x, y, z):
    """The vector (x, y, z) rotated by the unit quaternion (w, i, j, k); with -w for w, rotated back."""
    u, v, t = 2 * (j * z - k * y), 2 * (k * x - i * z), 2 * (i * y - j * x)
    return x + w * u + j * t - k * v, y + w * v + k * u - i * t, z + w * t + i * v - j * u


@njit(cache=True)
def place_balls(ball, poses, centre):
    """Fills `Workspace.centre` for poses (Q, bodies, 7)."""
    lanes = len(ball)
    for q in range(poses.shape[0]):
        for m in range(poses.shape[1]):
            p, at = poses[q, m], q * 3 * lanes + m
            x, y, z = _rotated(p[3], p[4], p[5], p[6], ball[m, 0], ball[m, 1], ball[m, 2])
            centre[at], centre[at + lanes], centre[at + 2 * lanes] = p[0] + x, p[1] + y, p[2] + z


@njit(cache=True)
def _find_near(reach, start, end, instant, begin, work):
    """Fills `Workspace.near` for the batch of segments from `begin` on."""
    lanes = len(reach)
    for i in range(begin, min(begin + len(work.near), len(start))):
        origin = start[i, 0], start[i, 1], start[i, 2]
        way = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
        for group in range(work.near.shape[1]):
            work.near[i - begin, group] = _meets(work.centre, reach, instant[i] * 3 * lanes, GROUP * group, origin, way)


@njit(cache=True, inline="always")
def _meets(centre, reach, first, body, origin, way):
    """Which of a group of bodies, from `body` on, have a ball that the segment meets, as bits."""
    (ox, oy, oz), (dx, dy, dz), lanes = origin, way, len(reach)
    x, y, z = uint64(first + body), uint64(first + lanes + body), uint64(first + 2 * lanes + body)
    squared = dx * dx + dy * dy + dz * dz
    bits = 0
    for lane in range(min(GROUP, lanes - body)):
        j = uint64(lane)
        a, b, c = centre[x + j] - ox, centre[y + j] - oy, centre[z + j] - oz
        along, beyond = a * dx + b * dy + c * dz, a * a + b * b + c * c - reach[uint64(body) + j]
        nearest = along if along > 0.0 else 0.0  # times the segment's length: where on it the centre is nearest
        nearest = nearest if nearest < squared else squared
        bits |= (1 << lane) if beyond * squared <= nearest * (along + along - nearest) else 0
    return bits


@njit(cache=True)
def _begin_passes(trees, start, end, poses, instant, begin, work):
    """Fills in the passes of a batch and pairs them with the top blocks of their bodies; returns how many pairs there are."""
    passes, pairs = 0, 0
    for index in range(min(len(work.near), len(start) - begin)):
        i = uint64(begin + index)
        q = uint64(instant[i])
        for group in range(work.near.shape[1]):
            bodies = work.near[uint64(index), uint64(group)]
            while bodies:
                body = GROUP * group + _lowest(bodies)
                bodies &= bodies - 1
                ox, oy, oz, ex, ey, ez = start[i, 0], start[i, 1], start[i, 2], end[i, 0], end[i, 1], end[i, 2]
                length = sqrt((ex - ox) ** 2 + (ey - oy) ** 2 + (ez - oz) ** 2)
                if length > SURFACE:
                    p = poses[q, uint64(body)]
                    a = _rotated(-p[3], p[4], p[5], p[6], ox - p[0], oy - p[1], oz - p[2])
                    b = _rotated(-p[3], p[4], p[5], p[6], ex - p[0], ey - p[1], ez - p[2])
                    _write_pass(work, uint64(passes), i, a, b, length)
                    for top in range(trees.first_top[body], trees.first_top[body + 1]):
                        work.who[0, uint64(pairs)], work.what[0, uint64(pairs)] = passes, top
                        pairs += 1
                    passes += 1
    return pairs


@njit(cache=True, inline="always")
def _write_pass(work, k, segment, a, b, length):
    """Keeps pass k: the segment from a to b in the body's frame."""
    number, offset = work.number, work.offset
    work.segment[k] = segment
    number[k, 0], number[k, 1], number[k, 2], offset[k, 0], offset[k, 1] = _axis(a[0], b[0], length)
    number[k, 3], number[k, 4], number[k, 5], offset[k, 2], offset[k, 3] = _axis(a[1], b[1], length)
    number[k, 6], number[k, 7], number[k, 8], offset[k, 4], offset[k, 5] = _axis(a[2], b[2], length)
    number[k, 9] = length
    number[k, 10], number[k, 11], number[k, 12] = a
    number[k, 13], number[k, 14], number[k, 15] = b


@njit(cache=True)
def _ray(number, offset, k):
    """The axes of pass k, in its body's frame."""
    return (
        (number[k, 0], number[k, 1], number[k, 2], offset[k, 0], offset[k, 1]),
        (number[k, 3], number[k, 4], number[k, 5], offset[k, 2], offset[k, 3]),
        (number[k, 6], number[k, 7], number[k, 8], offset[k, 4], offset[k, 5]),
    )


@njit(cache=True)
def _turned_ray(number, k, rotation, frame):
    """The axes of pass k in a leaf's own frame, whose axes are the columns of `rotation[frame]`."""
    r, n = rotation[frame], number[k]
    return (
        _axis(r[0, 0] * n[10] + r[1, 0] * n[11] + r[2, 0] * n[12], r[0, 0] * n[13] + r[1, 0] * n[14] + r[2, 0] * n[15], n[9]),
        _axis(r[0, 1] * n[10] + r[1, 1] * n[11] + r[2, 1] * n[12], r[0, 1] * n[13] + r[1, 1] * n[14] + r[2, 1] * n[15], n[9]),
        _axis(r[0, 2] * n[10] + r[1, 2] * n[11] + r[2, 2] * n[12], r[0, 2] * n[13] + r[1, 2] * n[14] + r[2, 2] * n[15], n[9]),
    )


@njit(cache=True)
def _descend(blocks, member, work, now, pairs):
    """Tests all pairs and pairs their passes with the members behind the lanes that they cross; returns how many there are."""
    number, offset, bits = work.number, work.offset, work.bits
    who, what, next_who, next_what = work.who[now], work.what[now], work.who[1 - now], work.what[1 - now]
    for pair in range(pairs):
        k = uint64(who[pair])
        bits[pair] = _crossed(blocks, what[pair], _ray(number, offset, k), number[k, 9])
    found = 0
    for pair in range(pairs):
        crossed = bits[pair]
        while crossed:
            next_who[uint64(found)] = who[pair]
            next_what[uint64(found)] = member[uint64(what[pair]), uint64(_lowest(crossed))]
            crossed &= crossed - 1
            found += 1
    return found


@njit(cache=True)
def _finish(trees, entry, per_metre, work, pairs, result):
    """Tests all pairs with leaves and adds the boxes that are crossed to the result."""
    number, offset, bits, frame = work.number, work.offset, work.bits, trees.frame
    who, what = work.who[0], work.what[0]
    for pair in range(pairs):
        k, leaf = uint64(who[pair]), uint64(what[pair])
        ray = _ray(number, offset, k) if frame[leaf] == 0 else _turned_ray(number, k, trees.rotation, frame[leaf])
        bits[pair] = _crossed(trees.leaf, leaf, ray, number[k, 9])
    for pair in range(pairs):
        crossed = bits[pair]
        while crossed:
            k, leaf, lane = uint64(who[pair]), uint64(what[pair]), uint64(_lowest(crossed))
            crossed &= crossed - 1
            ray = _ray(number, offset, k) if frame[leaf] == 0 else _turned_ray(number, k, trees.rotation, frame[leaf])
            enter, inside = _interval(trees.leaf, leaf, lane, ray, number[k, 9])
            i, box = uint64(work.segment[k]), uint64(trees.box_of[leaf, lane])
            if len(result.first):
                to = uint64(result.first[i] + result.counts[i])
                result.box[to], result.enter[to], result.length[to] = box, enter, inside
            result.counts[i] += 1
            result.losses[i] += entry[box] + per_metre[box] * inside


@njit(cache=True)
def cast(trees, entry, per_metre, start, end, poses, instant, work, result):
    """Count and loss of every segment, and if `result.first` isn't empty every crossing, in no order.

    What is found doesn't depend on the batches: a segment's boxes are added in one order always.
    """
    for begin in range(0, len(start), len(work.near)):
        _find_near(trees.reach, start, end, instant, begin, work)
        pairs = _begin_passes(trees, start, end, poses, instant, begin, work)
        pairs = _descend(trees.top, trees.middle_of, work, 0, pairs)
        pairs = _descend(trees.middle, trees.leaf_of, work, 1, pairs)
        _finish(trees, entry, per_metre, work, pairs, result)
