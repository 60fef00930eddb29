"""Obstacles on segments by PyBullet's own rays: the slow reference for `worlds.raycast`, chosen by `rays: bullet`.

Every box is a body of its own, so that a hit tells which box it is. All hits of a ray forward are entries, all hits of the same
ray backward are exits; a box is crossed between the two. What counts as a crossing is said in `worlds.raycast`; the one
difference is a segment that runs within a face, for which PyBullet's answer is a matter of rounding.

Three ways of PyBullet are met here. A ray doesn't hit a shape that it starts in: rays are cast from before the segment to behind
it, by more than the largest box, and cut to the segment afterwards. A ray finds a convex shape by steps, up to a tolerance in
*units*: in metres it misses corners of a millimetre and is off by centimetres where it comes in flat; in millimetres the steps may
not suffice, and it misses whole boxes. These worlds are built in centimetres, where 40,000 crossings of turned boxes showed no
miss and no length more than 0.04 mm off. And the first hit hides others that begin at the same place: all hits are asked for, by
number.
"""

from __future__ import annotations

import weakref

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from testbed.protocols import Crossings, Obstruction
from testbed.scene import Scene
from worlds.bullet import Client
from worlds.raycast import SURFACE, checked_losses, checked_poses, checked_segments, standing_boxes

UNITS_PER_METRE = 100.0


class BulletCaster:
    """Obstacles of a scene by PyBullet's rays (`testbed.protocols.Caster`). PybulletMissing where there is no PyBullet.

    entry_db, per_metre_db : (materials,) dB and dB/m, by the order of `scene.materials`
    """

    def __init__(self, scene: Scene, entry_db: Array, per_metre_db: Array) -> None:
        entry_db, per_metre_db = checked_losses(scene, entry_db, per_metre_db)
        material = scene.boxes.material.astype(np.int64)
        self._entry, self._per_metre = entry_db[material], per_metre_db[material]
        self._static = _Cloud(scene.static_boxes(), standing_boxes(scene))
        moving = np.flatnonzero(np.isin(scene.boxes.body, scene.moving))
        self._carrier = np.searchsorted(scene.moving, scene.boxes.body[moving])
        self._boxes = scene.boxes.take(moving)
        self._moving, self._movers = _Cloud(self._boxes, moving), len(scene.moving)

    def static(self, start: Array, end: Array) -> Obstruction:
        """Obstruction of segments `start` (N, 3) to `end` (N, 3), m, by all that never moves."""
        start, end = checked_segments(start, end)
        return self._obstruction(self._static.crossings(start, end), len(start))

    def moving(self, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        """Obstruction by the moving bodies alone: segment i meets them as `poses[instant[i]]`; poses (Q, moving bodies, 7)."""
        start, end = checked_segments(start, end)
        found = self._moving_crossings(start, end, *checked_poses(poses, instant, len(start), self._movers))
        return self._obstruction(found, len(start))

    def crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        """Every obstacle on every segment, sorted by segment and by where it is entered, then by box."""
        start, end = checked_segments(start, end)
        moving = self._moving_crossings(start, end, *checked_poses(poses, instant, len(start), self._movers))
        found = Crossings.concatenate([self._static.crossings(start, end), moving])
        return found.take(np.lexsort((found.box, found.enter, found.segment)))

    def _moving_crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        parts = [Crossings.empty()]
        for q in np.unique(instant):
            self._moving.place(frames.compose(poses[q][self._carrier], _poses(self._boxes)))
            some = np.flatnonzero(instant == q)
            found = self._moving.crossings(start[some], end[some])
            parts.append(found.with_(segment=some[found.segment]))
        return Crossings.concatenate(parts)

    def _obstruction(self, found: Crossings, segments: int) -> Obstruction:
        loss = self._entry[found.box] + self._per_metre[found.box] * found.length
        return Obstruction(
            count=np.bincount(found.segment, minlength=segments), loss=np.bincount(found.segment, weights=loss, minlength=segments)
        )


class _Cloud:
    """Boxes as bodies of a client of their own, which goes when the cloud does. index : where they are in the scene."""

    def __init__(self, boxes: Boxes, index: ArrayLike) -> None:
        self._client = Client()
        weakref.finalize(self, self._client.close)
        solid = np.flatnonzero((boxes.half > 0).all(axis=1))  # nothing lies inside one without thickness
        half, poses = boxes.half[solid] * UNITS_PER_METRE, _scaled(_poses(boxes)[solid])
        self._solid, self._index = solid, np.asarray(index, dtype=np.int64)[solid]
        self._handles = [self._client.load_box(h, p, f"box {i}") for h, p, i in zip(half, poses, self._index, strict=True)]
        self._number = np.zeros(max((h.uid for h in self._handles), default=-1) + 1, dtype=np.int64)
        self._number[[h.uid for h in self._handles]] = np.arange(len(self._handles))
        self._beyond = 2 * np.linalg.norm(boxes.half, axis=1).max(initial=0.0) + 0.001  # m

    def place(self, poses: Array) -> None:
        """Move the boxes to world poses (boxes, 7)."""
        for handle, pose in zip(self._handles, _scaled(poses[self._solid]), strict=True):
            self._client.place(handle, pose)
        self._client.refresh()

    def crossings(self, start: Array, end: Array) -> Crossings:
        """Every box on the segments `start` (N, 3) to `end` (N, 3), m, in no order."""
        length = np.linalg.norm(end - start, axis=1)
        cast = np.flatnonzero(length > SURFACE)
        if not (len(cast) and len(self._handles)):
            return Crossings.empty()
        more = self._beyond * (end[cast] - start[cast]) / length[cast, None]
        a, b = (start[cast] - more) * UNITS_PER_METRE, (end[cast] + more) * UNITS_PER_METRE
        (entered, forward), (left, backward) = self._all_hits(a, b), self._all_hits(b, a)
        both, i, j = np.intersect1d(entered, left, assume_unique=True, return_indices=True)  # one way alone: it was touched
        ray, box = np.divmod(both, len(self._handles))
        whole = length[cast[ray]] + 2 * self._beyond
        enter = np.maximum(forward[i] * whole - self._beyond, 0.0)
        leave = np.minimum(length[cast[ray]] + self._beyond - backward[j] * whole, length[cast[ray]])
        crossed = leave - enter > SURFACE
        found = Crossings(segment=cast[ray], box=self._index[box], enter=enter, length=leave - enter)
        return found.take(crossed)

    def _all_hits(self, start: Array, end: Array) -> tuple[Array, Array]:
        """(hits,) int64 ray * boxes + box, and the fraction of the way, of everything that the rays hit."""
        rays, keys, fractions, number = np.arange(len(start)), [], [], 0
        while len(rays):
            hits = self._client.hits(start[rays], end[rays], number)
            got = hits.body >= 0
            rays, number = rays[got], number + 1
            keys.append(rays * len(self._handles) + self._number[hits.body[got]])
            fractions.append(hits.fraction[got])
        return np.concatenate(keys), np.concatenate(fractions)


def _poses(boxes: Boxes) -> Array:
    return np.concatenate([boxes.center, boxes.quaternion], axis=1)


def _scaled(poses: Array) -> Array:
    return poses * np.array([UNITS_PER_METRE] * 3 + [1.0] * 4)
