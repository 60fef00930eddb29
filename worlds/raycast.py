"""Every obstacle on a segment, and how much of it: boxes cut by the slab method.

What counts. A box is closed. A segment crosses it when more than `SURFACE` (1e-9 m) of it lies inside, so touching a corner, an
edge or, from outside, a face is no crossing. A segment that changes by less than `SURFACE` along one of the box's axes is
parallel to the faces across that axis, and must lie deeper than `SURFACE` behind them: one that runs within a face crosses
nothing. Where a segment starts or ends inside, the part inside counts, entered at 0 m. A segment no longer than `SURFACE`
crosses nothing. The loss of a crossing is entry_db + per_metre_db * length inside, by the box's material.

How it is fast. Boxes lie packed in blocks (`worlds.boxtree`) whose lanes are tested together, in a loop over slices that the
compiler turns into vector instructions. Near and far faces are picked once a segment, by the signs of its direction. Bounds
round as their boxes do, so that no crossing is lost to them.

A. Williams et al., "An efficient and robust ray-box intersection algorithm", Journal of Graphics Tools 10 (2005).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, uint64
from numba.cpython.unsafe.numbers import trailing_zeros

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Crossings, Obstruction
from testbed.scene import Scene
from worlds.boxtree import WIDTH, Forest, forest

SURFACE = 1e-9  # m: less than this inside a box is touching, not crossing
_PARALLEL = 1e100  # stands for 1 / 0 in the slab test; finite, so that 0 times it is 0


class BoxCaster:
    """Obstacles of a scene by its boxes (`testbed.protocols.Caster`).

    entry_db, per_metre_db : (materials,) dB and dB/m, by the order of `scene.materials`
    """

    def __init__(self, scene: Scene, entry_db: Array, per_metre_db: Array) -> None:
        entry_db, per_metre_db = checked_losses(scene, entry_db, per_metre_db)
        material = scene.boxes.material.astype(np.int64)
        self._entry, self._per_metre = entry_db[material], per_metre_db[material]
        self._standing, self._standing_index = scene.static_boxes(), standing_boxes(scene)
        self._static = forest([self._standing], [self._standing_index])
        own = [np.flatnonzero(scene.boxes.body == body) for body in scene.moving]
        self._moving = forest([scene.boxes.take(index) for index in own], own)
        self._movers = len(own)

    def static(self, start: Array, end: Array) -> Obstruction:
        """Obstruction of segments `start` (N, 3) to `end` (N, 3), m, by all that never moves."""
        start, end = checked_segments(start, end)
        return self._count(self._static, start, end, *_still(len(start)))

    def moving(self, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        """Obstruction by the moving bodies alone: segment i meets them as `poses[instant[i]]`; poses (Q, moving bodies, 7)."""
        start, end = checked_segments(start, end)
        return self._count(self._moving, start, end, *checked_poses(poses, instant, len(start), self._movers))

    def crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        """Every obstacle on every segment, sorted by segment and by where it is entered, then by box."""
        start, end = checked_segments(start, end)
        posed = checked_poses(poses, instant, len(start), self._movers)
        both = (self._static, _still(len(start))), (self._moving, posed)
        counts = [self._count(trees, start, end, *where).count.astype(np.int64) for trees, where in both]
        total = counts[0] + counts[1]
        segment, first = np.repeat(np.arange(len(start)), total), np.cumsum(total) - total
        box, enter, length = np.empty(len(segment), dtype=np.int64), np.empty(len(segment)), np.empty(len(segment))
        for (trees, where), before in zip(both, (0, counts[0]), strict=True):
            _cast(trees, self._entry, self._per_metre, start, end, *where, first + before, box, enter, length)
        order = np.lexsort((box, enter, segment))
        return Crossings(segment=segment, box=box[order], enter=enter[order], length=length[order])

    def _count(self, trees: Forest, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        nowhere = np.zeros(0, dtype=np.int64)
        count, loss = _cast(trees, self._entry, self._per_metre, start, end, poses, instant, nowhere, nowhere, np.zeros(0), np.zeros(0))
        return Obstruction(count=count, loss=loss)

    def inside(self, point: Array) -> Array:
        """(N,) int64: the first box of the scene, of those that never move, that holds each of `point` (N, 3); -1 for none.

        A point within `SURFACE` of a face isn't inside.
        """
        point = np.asarray(point, dtype=np.float64).reshape(-1, 3)
        found = np.full(len(point), -1, dtype=np.int64)
        for i, box in enumerate(self._standing_index):
            center, half = self._standing.center[i], self._standing.half[i]
            near = np.flatnonzero((found < 0) & (np.abs(point - center).max(axis=1, initial=0.0) <= np.linalg.norm(half)))
            depth = half - np.abs(frames.to_local(np.concatenate([center, self._standing.quaternion[i]]), point[near]))
            found[near[(depth > SURFACE).all(axis=1)]] = box
        return found


# ---------------------------------------------------------------- what callers hand over


def standing_boxes(scene: Scene) -> Array:
    """Indices of the scene's boxes that never move, in the order of `scene.static_boxes()`."""
    return np.flatnonzero(~np.isin(scene.boxes.body, scene.moving))


def checked_losses(scene: Scene, entry_db: Array, per_metre_db: Array) -> tuple[Array, Array]:
    """Both as float64. ValueError unless there is one finite number for each material, and every box has size and rotation."""
    losses = np.asarray(entry_db, dtype=np.float64), np.asarray(per_metre_db, dtype=np.float64)
    for name, values in zip(("entry_db", "per_metre_db"), losses, strict=True):
        if values.shape != (len(scene.materials),) or not np.isfinite(values).all():
            raise ValueError(f"{name}: wants one finite number for each of {len(scene.materials)} materials, got shape {values.shape}")
    boxes = scene.boxes
    if not (np.isfinite(boxes.center).all() and np.isfinite(boxes.half).all() and (boxes.half >= 0).all()):
        raise ValueError("a box of the scene has a centre that isn't finite, or half lengths that aren't finite and positive")
    if (np.abs(np.linalg.norm(boxes.quaternion, axis=1) - 1) > 1e-6).any():
        raise ValueError("a box of the scene has a quaternion that isn't of unit length")
    return losses


def checked_segments(start: Array, end: Array) -> tuple[Array, Array]:
    """Both ends as contiguous float64 (N, 3). ValueError for other shapes and for points that aren't finite."""
    a, b = np.ascontiguousarray(start, dtype=np.float64), np.ascontiguousarray(end, dtype=np.float64)
    if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
        raise ValueError(f"segments want two arrays (N, 3), got {a.shape} and {b.shape}")
    if not np.isfinite(a.sum() + b.sum()):  # sums need no memory; only now look for the place
        bad = np.flatnonzero(~np.isfinite(a + b).all(axis=1))
        if len(bad):
            raise ValueError(f"segment {bad[0]} runs from {a[bad[0]]} to {b[bad[0]]}: all coordinates must be finite")
    return a, b


def checked_poses(poses: Array, instant: Array, segments: int, bodies: int) -> tuple[Array, Array]:
    """Poses (Q, bodies, 7) and an index into them for each segment. ValueError for what doesn't fit."""
    if np.asarray(instant).dtype.kind not in "iu" and segments:
        raise ValueError(f"instant: wants integers, got {np.asarray(instant).dtype}")
    p, i = np.ascontiguousarray(poses, dtype=np.float64), np.ascontiguousarray(instant, dtype=np.int64)
    if p.ndim != 3 or p.shape[1:] != (bodies, 7):
        raise ValueError(f"poses: wants shape (instants, {bodies}, 7), got {p.shape}")
    if i.shape != (segments,) or (segments and (i.min() < 0 or i.max() >= len(p))):
        raise ValueError(f"instant: wants {segments} numbers from 0 to {len(p) - 1}, got shape {i.shape}")
    if not np.isfinite(p).all() or (np.abs(np.linalg.norm(p[..., 3:], axis=-1) - 1) > 1e-6).any():
        raise ValueError("poses: wants finite positions and quaternions of unit length")
    return p, i


def _still(segments: int) -> tuple[Array, Array]:
    """Pose and instants of the one body that all standing boxes belong to: the world."""
    return frames.IDENTITY.reshape(1, 1, 7).copy(), np.zeros(segments, dtype=np.int64)


# ---------------------------------------------------------------- kernels
#
# Blocks are addressed by unsigned offsets into flat arrays. An index that could be negative would be wrapped around like
# Python's, and a view of a block would be counted by the garbage collector: either costs more than the arithmetic.

_LANES, _BLOCK = uint64(WIDTH), uint64(6 * WIDTH)
_lowest: Any = trailing_zeros  # place of the lowest bit that is set
_CHUNK = 1024  # segments
_HIGH = uint64(3 * WIDTH)  # from a low face's row to the high one's


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
    enter = max((blocks[x + near_x] - ax) * ix, (blocks[y + near_y] - ay) * iy, (blocks[z + near_z] - az) * iz, 0.0)
    leave = min((blocks[x + far_x] - bx) * ix, (blocks[y + far_y] - by) * iy, (blocks[z + far_z] - bz) * iz, length)
    return enter, leave - enter


@njit(cache=True)
def _rotated(w, i, j, k, x, y, z):
    """The vector (x, y, z) rotated by the unit quaternion (w, i, j, k); with -w for w, rotated back."""
    u, v, t = 2 * (j * z - k * y), 2 * (k * x - i * z), 2 * (i * y - j * x)
    return x + w * u + j * t - k * v, y + w * v + k * u - i * t, z + w * t + i * v - j * u


@njit(cache=True)
def _near(centre, radius_squared, start, end, instant, near):
    """Writes into `near` (N, groups of 32 bodies) the bodies whose ball each segment meets, as bits.

    A pass of its own: so small a loop stays in registers.
    """
    lanes = len(radius_squared)
    for i in range(len(start)):
        origin = start[i, 0], start[i, 1], start[i, 2]
        way = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
        for group in range(near.shape[1]):
            near[i, group] = _meets(centre, radius_squared, instant[i] * 3 * lanes, lanes, 32 * group, origin, way)


@njit(cache=True)
def _centres(ball, poses, lanes):
    """(Q * 3 * lanes,): x, then y, then z of the centre of each body's ball in the world, for each instant."""
    centre = np.zeros(poses.shape[0] * 3 * lanes)
    for q in range(poses.shape[0]):
        for m in range(poses.shape[1]):
            p, at = poses[q, m], q * 3 * lanes + m
            x, y, z = _rotated(p[3], p[4], p[5], p[6], ball[m, 0], ball[m, 1], ball[m, 2])
            centre[at], centre[at + lanes], centre[at + 2 * lanes] = p[0] + x, p[1] + y, p[2] + z
    return centre


@njit(cache=True)
def _meets(centre, radius_squared, first, lanes, body, origin, way):
    """Which of up to 32 bodies from `body` on have a ball that the segment meets, as bits."""
    (ox, oy, oz), (dx, dy, dz) = origin, way
    x, y, z = uint64(first + body), uint64(first + lanes + body), uint64(first + 2 * lanes + body)
    squared = dx * dx + dy * dy + dz * dz
    bits = 0
    for lane in range(min(32, lanes - body)):
        j = uint64(lane)
        a, b, c = centre[x + j] - ox, centre[y + j] - oy, centre[z + j] - oz
        along, beyond = a * dx + b * dy + c * dz, a * a + b * b + c * c - radius_squared[uint64(body) + j]
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


@njit(cache=True)
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


@njit(cache=True)
def _cast(trees, entry, per_metre, start, end, poses, instant, first, box, enter, inside):
    """Count and loss of each segment; where `first` isn't empty, also every crossing, from place first[i] on."""
    count, loss = np.zeros(len(start), dtype=np.int32), np.zeros(len(start))
    leaves = np.empty(len(trees.frame), dtype=np.int64)
    lanes = (len(trees.ball) + 7) // 8 * 8  # whole vector registers; nothing meets the ball of a body that isn't
    radius_squared = np.full(lanes, -1.0)
    radius_squared[: len(trees.ball)] = trees.ball[:, 3]
    centre = _centres(trees.ball, poses, lanes)
    near = np.zeros((_CHUNK, (lanes + 31) // 32), dtype=np.int64)
    for i in range(len(start)):
        if i % _CHUNK == 0:
            some = slice(i, i + _CHUNK)
            _near(centre, radius_squared, start[some], end[some], instant[some], near)
        q, found, total = uint64(instant[i]), 0, 0.0
        for group in range(near.shape[1]):
            bodies = near[uint64(i % _CHUNK), uint64(group)]
            while bodies:
                body = 32 * group + _lowest(bodies)
                bodies &= bodies - 1
                p = poses[q, uint64(body)]
                ox, oy, oz, ex, ey, ez = start[i, 0], start[i, 1], start[i, 2], end[i, 0], end[i, 1], end[i, 2]
                length = np.sqrt((ex - ox) ** 2 + (ey - oy) ** 2 + (ez - oz) ** 2)
                if length <= SURFACE:
                    break
                a = _rotated(-p[3], p[4], p[5], p[6], ox - p[0], oy - p[1], oz - p[2])
                b = _rotated(-p[3], p[4], p[5], p[6], ex - p[0], ey - p[1], ez - p[2])
                ray = (_axis(a[0], b[0], length), _axis(a[1], b[1], length), _axis(a[2], b[2], length))
                for leaf in leaves[: _leaves(trees, body, ray, length, leaves)]:
                    own = _leaf_ray(trees.rotation, trees.frame[uint64(leaf)], ray, a, b, length)
                    bits = _crossed(trees.leaf, leaf, own, length)
                    while bits:
                        lane = _lowest(bits)
                        bits &= bits - 1
                        which = uint64(trees.box_of[uint64(leaf), uint64(lane)])
                        at, through = _interval(trees.leaf, leaf, lane, own, length)
                        total += entry[which] + per_metre[which] * through
                        if len(first):
                            k = uint64(first[uint64(i)] + found)
                            box[k], enter[k], inside[k] = which, at, through
                        found += 1
        count[i], loss[i] = found, total
    return count, loss
