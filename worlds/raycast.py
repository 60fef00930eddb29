"""Every obstacle on a segment, and how much of it: boxes cut by the slab method, and meshes (`worlds.mesh_rays`).

What counts. A box is closed. A segment crosses it when more than `SURFACE` (1e-9 m) of it lies inside, so touching a corner, an
edge or, from outside, a face is no crossing. A segment that changes by less than `SURFACE` along one of the box's axes is
parallel to the faces across that axis, and must lie deeper than `SURFACE` behind them: one that runs within a face crosses
nothing. Where a segment starts or ends inside, the part inside counts, entered at 0 m. A segment no longer than `SURFACE`
crosses nothing. The loss of a crossing is entry_db + per_metre_db * length inside, by the box's material.

How it is fast. Boxes lie packed in blocks (`worlds.boxtree`) whose lanes are tested together, in a loop of constant length that
the compiler turns into vector instructions (`worlds.ray_kernels`). Near and far faces are picked once a segment, by the signs of
its direction. Bounds round as their boxes do, so that no crossing is lost to them.

A. Williams et al., "An efficient and robust ray-box intersection algorithm", Journal of Graphics Tools 10 (2005).
"""

from __future__ import annotations

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Crossings, Obstruction
from testbed.scene import Scene
from worlds.boxtree import Forest, forest
from worlds.mesh_rays import MeshRays
from worlds.ray_kernels import SURFACE, Result, cast, place_balls, workspace


class BoxCaster:
    """Obstacles of a scene by its boxes and meshes (`testbed.protocols.Caster`).

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
        of = scene.meshes.material.astype(np.int64)
        self._meshes = MeshRays(scene.static_meshes(), entry_db[of], per_metre_db[of], len(scene.boxes)) if len(of) else None

    def static(self, start: Array, end: Array) -> Obstruction:
        """Obstruction of segments `start` (N, 3) to `end` (N, 3), m, by all that never moves."""
        start, end = checked_segments(start, end)
        found = self._count(self._static, start, end, *_still(len(start)))
        if self._meshes is None:
            return found
        more = self._meshes.obstruction(start, end)
        return Obstruction(count=found.count + more.count, loss=found.loss + more.loss)

    def moving(self, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        """Obstruction by the moving bodies alone: segment i meets them as `poses[instant[i]]`; poses (Q, moving bodies, 7)."""
        start, end = checked_segments(start, end)
        return self._count(self._moving, start, end, *checked_poses(poses, instant, len(start), self._movers))

    def crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        """Every obstacle on every segment, sorted by segment and by where it is entered, then by piece."""
        start, end = checked_segments(start, end)
        posed = checked_poses(poses, instant, len(start), self._movers)
        both = (self._static, _still(len(start))), (self._moving, posed)
        counts = [self._count(trees, start, end, *where).count.astype(np.int64) for trees, where in both]
        total = counts[0] + counts[1]
        segment, first = np.repeat(np.arange(len(start)), total), np.cumsum(total) - total
        box, enter, length = np.empty(len(segment), dtype=np.int64), np.empty(len(segment)), np.empty(len(segment))
        for (trees, where), before in zip(both, (0, counts[0]), strict=True):
            self._cast(trees, start, end, *where, first + before, box, enter, length)
        order = np.lexsort((box, enter, segment))
        found = Crossings(segment=segment, box=box[order], enter=enter[order], length=length[order])
        if self._meshes is None:
            return found
        found = Crossings.concatenate([found, self._meshes.crossings(start, end)])
        return found.take(np.lexsort((found.box, found.enter, found.segment)))

    def _count(self, trees: Forest, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        nothing = np.zeros(0, dtype=np.int64)
        found = self._cast(trees, start, end, poses, instant, nothing, nothing, np.zeros(0), np.zeros(0))
        return Obstruction(count=found.counts, loss=found.losses)

    def _cast(self, trees: Forest, start: Array, end: Array, poses: Array, instant: Array, *listing: Array) -> Result:
        work = workspace(len(poses), poses.shape[1], len(trees.ball), len(trees.frame))
        place_balls(trees.ball, poses, work.centre)
        result = Result(np.zeros(len(start), dtype=np.int32), np.zeros(len(start)), *listing)
        cast(trees, self._entry, self._per_metre, start, end, poses, instant, work, result)
        return result

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
