"""Moving bodies about links: where they are at the links' instants, and which of them come near which link.

Most links have nothing moving near them. A ball round each body says so before any ray is cast, and before a pose is
interpolated exactly: for the balls a straight line between the truth's samples does, widened by what that may be wrong.

Left out: bodies that bend. A person's limbs and a forklift's mast move with the whole.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from testbed import frames
from testbed.columns import Array
from testbed.radio.diffuse import REACH, Stir, weight_of
from testbed.rng import keys_of
from testbed.scene import WORLD, Scene, Truth

SLACK = 0.02  # m: an acceleration of 10 m/s² bends a way of 1/120 s by 0.1 mm; sparser truths may have as much as this
ELSEWHERE = np.array([0.0, 0.0, -1e7, 1.0, 0.0, 0.0, 0.0])  # where a body stands in `Posed.poses` as long as nobody asked for it


class Movers:
    """The moving bodies of a scene, in the order of its `Truth`: a ball round each, in its own frame, and a key by its name."""

    def __init__(self, scene: Scene) -> None:
        balls = [_ball(scene, body) for body in scene.moving]
        self.center = np.array([center for center, _ in balls]).reshape(-1, 3)
        self.radius = np.array([radius for _, radius in balls])
        self.key = keys_of(scene.moving_names)

    def __len__(self) -> int:
        return len(self.radius)

    def at(self, truth: Truth, t: Array) -> Posed:
        """The bodies at times t (N,), one for each link."""
        return Posed(self, truth, t)


class Posed:
    """Moving bodies for N links at Q different instants; `instant` (N,) is which of them is each link's."""

    def __init__(self, movers: Movers, truth: Truth, t: Array) -> None:
        self._movers, self._truth = movers, truth
        self._t, instant = np.unique(t, return_inverse=True)
        self.instant = instant.astype(np.int64).ravel()
        self.poses = np.tile(ELSEWHERE, (len(self._t), len(movers), 1))  # (Q, B, 7), exact where asked for
        self._exact = np.zeros(self.poses.shape[:2], dtype=bool)
        first, last = (truth.t[0], truth.t[-1]) if len(movers) else (0.0, 0.0)
        step = (last - first) / max(len(truth.t) - 1, 1)
        self._center = _centers(truth.poses, self._t, first, step, movers.center)

    def exactly(self, instant: Array, body: Array) -> Array:
        """(M, 7) poses of `body` (M,) at instants (M,), by the truth's own interpolant."""
        key = np.unique(instant * len(self._movers) + body)
        q, b = key // max(len(self._movers), 1), key % max(len(self._movers), 1)
        new = ~self._exact[q, b]
        q, b = q[new], b[new]
        self.poses[q, b] = self._truth.pose(b, self._t[q])
        self._exact[q, b] = True
        return self.poses[instant, body]

    def carried(self, body: Array, pose: Array, links: Array) -> Array:
        """(M, 7) world poses of what sits at `pose` (M, 7) on `body` (M,), -1 for the world, at the instants of `links` (M,)."""
        return self.carried_at(body, pose, self.instant[links])

    def carried_at(self, body: Array, pose: Array, instant: Array) -> Array:
        """(M, 7) world poses of what sits at `pose` (M, 7) on `body` (M,), at instants (M,)."""
        rides = body != WORLD
        if not rides.any():
            return pose
        pose = np.array(pose)
        pose[rides] = frames.compose(self.exactly(instant[rides], body[rides]), pose[rides])
        return pose

    def near(self, links: Array, start: Array, end: Array, margin: Array) -> Array:
        """(M,) bool: whether a body's ball comes within `margin` (M,) m of the lines from `start` to `end` (M, 3), of `links` (M,).

        Such bodies are posed exactly from then on.
        """
        line, body = _near(start, end, self._center, self._movers.radius + SLACK, self.instant[links], margin)
        self.exactly(self.instant[links[line]], body)
        found = np.zeros(len(links), dtype=bool)
        found[line] = True
        return found

    def stir(self, links: Array, start: Array, end: Array, own: Array) -> Stir:
        """The bodies that take part in the diffuse field of `links` (M,); not those that carry an end of one: own (M, 2), or -1."""
        line, body = _about(start, end, self._center, self.instant[links], own, REACH + 2 * SLACK)
        center = frames.to_world(self.exactly(self.instant[links[line]], body), self._movers.center[body])
        there = np.linalg.norm(center - start[line], axis=1) + np.linalg.norm(end[line] - center, axis=1)
        weight = weight_of(there - np.linalg.norm(end[line] - start[line], axis=1))
        return Stir(link=line, key=self._movers.key[body], center=center, weight=weight).take(weight > 0)


def _ball(scene: Scene, body: int) -> tuple[Array, float]:
    boxes = scene.boxes.take(scene.boxes.body == body)
    if not len(boxes):
        return np.zeros(3), 0.0
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    corners = (boxes.center[:, None] + frames.rotate(boxes.quaternion[:, None], signs * boxes.half[:, None])).reshape(-1, 3)
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return center, float(np.linalg.norm(corners - center, axis=1).max())


@njit(cache=True)
def _centers(poses, t, first, step, local):
    """(Q, B, 3): each body's `local` point at times t, on straight lines between the samples of `poses` (K, B, 7)."""
    found = np.empty((len(t), len(local), 3))
    for q in range(len(t)):
        place = (t[q] - first) / step if step > 0.0 else 0.0
        place = min(max(place, 0.0), len(poses) - 1.0)
        k = min(int(place), max(len(poses) - 2, 0))
        s, after = place - k, min(k + 1, len(poses) - 1)
        for b in range(len(local)):
            p = poses[k, b] + s * (poses[after, b] - poses[k, b])
            w, i, j, l = p[3], p[4], p[5], p[6]  # noqa: E741
            x, y, z = local[b]
            u, v, r = 2 * (j * z - l * y), 2 * (l * x - i * z), 2 * (i * y - j * x)
            found[q, b, 0] = p[0] + x + w * u + j * r - l * v
            found[q, b, 1] = p[1] + y + w * v + l * u - i * r
            found[q, b, 2] = p[2] + z + w * r + i * v - j * u
    return found


@njit(cache=True)
def _near(start, end, center, radius, instant, margin):
    """Pairs (line, body) whose ball comes within the line's margin of it."""
    pairs = [(0, 0) for _ in range(0)]
    for i in range(len(start)):
        dx, dy, dz = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        for b in range(len(radius)):
            c = center[instant[i], b]
            x, y, z = c[0] - start[i, 0], c[1] - start[i, 1], c[2] - start[i, 2]
            along = (x * dx + y * dy + z * dz) / squared if squared > 0.0 else 0.0
            along = min(max(along, 0.0), 1.0)
            x, y, z = x - along * dx, y - along * dy, z - along * dz
            reach = radius[b] + margin[i]
            if x * x + y * y + z * z < reach * reach:
                pairs.append((i, b))
    return _columns(pairs)


@njit(cache=True)
def _about(start, end, center, instant, own, reach):
    """Pairs (line, body) with a way over the body's centre that is less than `reach` longer; bodies in `own` left out."""
    pairs = [(0, 0) for _ in range(0)]
    for i in range(len(start)):
        a, b = start[i], end[i]
        straight = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
        for k in range(center.shape[1]):
            c = center[instant[i], k]
            there = np.sqrt((c[0] - a[0]) ** 2 + (c[1] - a[1]) ** 2 + (c[2] - a[2]) ** 2)
            if there > straight + reach or k == own[i, 0] or k == own[i, 1]:
                continue
            if there + np.sqrt((b[0] - c[0]) ** 2 + (b[1] - c[1]) ** 2 + (b[2] - c[2]) ** 2) - straight < reach:
                pairs.append((i, k))
    return _columns(pairs)


@njit(cache=True)
def _columns(pairs):
    first, second = np.empty(len(pairs), dtype=np.int64), np.empty(len(pairs), dtype=np.int64)
    for j in range(len(pairs)):
        first[j], second[j] = pairs[j]
    return first, second
