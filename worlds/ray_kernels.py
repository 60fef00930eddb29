"""The compiled loops of `worlds.raycast`: segments against packed boxes (`worlds.boxtree`).

Blocks are addressed by unsigned offsets into flat arrays. An index that could be negative would be wrapped around like Python's,
and a view of a block would be counted by the memory manager: either costs more than the arithmetic. So does a call that hands
over eighty words of arrays: what runs once a segment is inlined. All memory comes from the caller, for the compiler takes longer
over an allocation than over a loop.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

from numba import njit, uint64
from numba.cpython.unsafe.numbers import trailing_zeros

from testbed.columns import Array

WIDTH = 16  # lanes a block: four vector registers of four doubles. Here and not in boxtree: compiled code is kept until this file changes
SURFACE = 1e-9  # m: less than this inside a box is touching, not crossing
CHUNK = 1024  # segments whose near bodies are looked for together
GROUP = 32  # bodies whose nearness is kept in one number
_PARALLEL = 1e100  # stands for 1 / 0 in the slab test; finite, so that 0 times it is 0
_LANES, _BLOCK = uint64(WIDTH), uint64(6 * WIDTH)
_HIGH = uint64(3 * WIDTH)  # from a low face's row to the high one's
_lowest: Any = trailing_zeros  # place of the lowest bit that is set


class Workspace(NamedTuple):
    """Memory that a cast works in."""

    centre: Array  # (Q * 3 * lanes,) m: x, then y, then z of the centre of each body's ball in the world, for each instant
    near: Array  # (CHUNK, groups of bodies) int64: the bodies whose ball a segment meets, as bits
    leaves: Array  # (leaves,) int64: those that a segment crosses


class Result(NamedTuple):
    """What a cast finds. Crossings of segment i go to place first[i] and on; none are listed where `first` is empty."""

    counts: Array  # (N,) int32
    losses: Array  # (N,) dB
    first: Array  # (N,) or (0,) int64
    box: Array  # (crossings,) int64
    enter: Array  # (crossings,) m
    length: Array  # (crossings,) m


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
    """Fills `Workspace.near` for the chunk of segments from `begin` on. A pass of its own: so small a loop stays in registers."""
    lanes = len(reach)
    for i in range(begin, min(begin + CHUNK, len(start))):
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
def _leaf_ray(rotation, frame, ray, a, b, length):
    """The ray in a leaf's frame, whose axes are the columns of `rotation[frame]`; frame 0 is the body's own."""
    if frame == 0:
        return ray
    r = rotation[frame]
    return (
        _axis(r[0, 0] * a[0] + r[1, 0] * a[1] + r[2, 0] * a[2], r[0, 0] * b[0] + r[1, 0] * b[1] + r[2, 0] * b[2], length),
        _axis(r[0, 1] * a[0] + r[1, 1] * a[1] + r[2, 1] * a[2], r[0, 1] * b[0] + r[1, 1] * b[1] + r[2, 1] * b[2], length),
        _axis(r[0, 2] * a[0] + r[1, 2] * a[1] + r[2, 2] * a[2], r[0, 2] * b[0] + r[1, 2] * b[1] + r[2, 2] * b[2], length),
    )


@njit(cache=True, inline="always")
def _leaves(trees, body, ray, length, leaves):
    """Writes the leaves of a body that the ray may cross boxes of into `leaves`; returns how many."""
    tops, middles, middle_of, leaf_of = trees.top, trees.middle, trees.middle_of, trees.leaf_of
    found = 0
    for top in range(trees.first_top[body], trees.first_top[body + 1]):
        bits = _crossed(tops, top, ray, length)
        while bits:
            middle = middle_of[uint64(top), uint64(_lowest(bits))]
            bits &= bits - 1
            middle_bits = _crossed(middles, middle, ray, length)
            while middle_bits:
                leaves[uint64(found)] = leaf_of[uint64(middle), uint64(_lowest(middle_bits))]
                middle_bits &= middle_bits - 1
                found += 1
    return found


@njit(cache=True, inline="always")
def _cast_body(trees, body, a, b, length, entry, per_metre, i, found, loss, work, result):
    """Adds what one body has on segment i, from a to b in the body's frame, to the result; returns the crossings found so far."""
    ray = (_axis(a[0], b[0], length), _axis(a[1], b[1], length), _axis(a[2], b[2], length))
    for k in range(_leaves(trees, body, ray, length, work.leaves)):
        leaf = work.leaves[uint64(k)]
        own = _leaf_ray(trees.rotation, trees.frame[uint64(leaf)], ray, a, b, length)
        bits = _crossed(trees.leaf, leaf, own, length)
        while bits:
            lane = _lowest(bits)
            bits &= bits - 1
            box = uint64(trees.box_of[uint64(leaf), uint64(lane)])
            enter, inside = _interval(trees.leaf, leaf, lane, own, length)
            loss += entry[box] + per_metre[box] * inside
            if len(result.first):
                to = uint64(result.first[i] + found)
                result.box[to], result.enter[to], result.length[to] = box, enter, inside
            found += 1
    return found, loss


@njit(cache=True)
def cast(trees, entry, per_metre, start, end, poses, instant, work, result):
    """Count and loss of every segment, and if `result.first` isn't empty every crossing, in no order. `result.losses` must begin at 0."""
    for index in range(len(start)):
        i = uint64(index)
        if index % CHUNK == 0:
            _find_near(trees.reach, start, end, instant, index, work)
        found, loss, q = 0, 0.0, uint64(instant[i])
        for group in range(work.near.shape[1]):
            bodies = work.near[uint64(index % CHUNK), uint64(group)]
            while bodies:
                body = GROUP * group + _lowest(bodies)
                bodies &= bodies - 1
                ox, oy, oz, ex, ey, ez = start[i, 0], start[i, 1], start[i, 2], end[i, 0], end[i, 1], end[i, 2]
                length = sqrt((ex - ox) ** 2 + (ey - oy) ** 2 + (ez - oz) ** 2)
                if length > SURFACE:
                    p = poses[q, uint64(body)]
                    a = _rotated(-p[3], p[4], p[5], p[6], ox - p[0], oy - p[1], oz - p[2])
                    b = _rotated(-p[3], p[4], p[5], p[6], ex - p[0], ey - p[1], ez - p[2])
                    found, loss = _cast_body(trees, body, a, b, length, entry, per_metre, i, found, loss, work, result)
        result.counts[i], result.losses[i] = found, loss
