"""Geometry and motion as plain data: what stands where, what it is made of, and where the moving bodies were.

`Scene` is made once by a world and read by physics, ray caster, plan and importers alike; nobody reads geometry back
from the physics engine. `Truth` is what motion leaves behind: poses over time, and the interpolant that everyone uses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array, Columns, column
from testbed.geometry import WORLD, Boxes, Meshes, Mounts, Roads, Zones

__all__ = ["WORLD", "Body", "Boxes", "Meshes", "Mounts", "Roads", "Scene", "Truth", "Zones"]


@dataclass(frozen=True, eq=False)
class Body:
    """One thing of the scene: its name, what it is ("rack", "trolley"), its pose at rest, and whether it ever moves."""

    name: str
    kind: str
    pose: Array  # (7,) m and (w, x, y, z), world frame
    moving: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A hall: bodies, the boxes and meshes they are made of, materials by name, mounts, zones, roads, and the extent of the floor.

    Moving bodies must have distinct names, as must all others; `moving` lists their indices, which is the order of bodies
    in `Truth`. They are made of boxes alone. A piece is a box or a mesh: those of the boxes' numbers, then the meshes.
    """

    bodies: tuple[Body, ...]
    boxes: Boxes
    materials: tuple[str, ...]
    bounds: Array  # (2, 3) m: lowest and highest corner of the hall
    mounts: Mounts = field(default_factory=Mounts.empty)
    zones: Zones = field(default_factory=Zones.empty)
    roads: Roads | None = None
    meshes: Meshes = field(default_factory=Meshes.empty)

    @property
    def piece_body(self) -> Array:
        """(boxes + meshes,) the body of each piece."""
        return np.concatenate([self.boxes.body, self.meshes.body])

    @property
    def piece_material(self) -> Array:
        """(boxes + meshes,) the material of each piece."""
        return np.concatenate([self.boxes.material, self.meshes.material])

    @property
    def moving(self) -> Array:
        """(moving bodies,) indices into `bodies`, ascending."""
        return np.array([i for i, b in enumerate(self.bodies) if b.moving], dtype=np.int64)

    @property
    def moving_names(self) -> tuple[str, ...]:
        """Names of the moving bodies, in the order of `Truth`."""
        return tuple(b.name for b in self.bodies if b.moving)

    def rest_poses(self) -> Array:
        """(bodies, 7): every body's pose at rest."""
        return np.array([b.pose for b in self.bodies]).reshape(-1, 7)

    def static_boxes(self) -> Boxes:
        """Boxes of all bodies that never move, in the world frame; `body` still indexes `bodies`."""
        is_moving = np.array([*(b.moving for b in self.bodies), False])  # the last one is the world's, for index -1
        boxes = self.boxes.take(~is_moving[self.boxes.body])
        pose = np.concatenate([self.rest_poses(), [frames.IDENTITY]])[boxes.body]
        return boxes.with_(center=frames.to_world(pose, boxes.center), quaternion=frames.multiply(pose[:, 3:], boxes.quaternion))

    def static_meshes(self) -> Meshes:
        """All meshes, in the world frame; `body` still indexes `bodies`."""
        if not len(self.meshes):
            return self.meshes
        pose = np.concatenate([self.rest_poses(), [frames.IDENTITY]])[self.meshes.body][self.meshes.owner()]
        return self.meshes.with_(vertices=frames.to_world(pose, self.meshes.vertices))


UNKNOWN = -2  # a zone of `Truth`: nobody knows where the body was then, its pose only joins what is known before and after


@dataclass(frozen=True, eq=False)
class Truth(Columns):
    """Poses of the moving bodies over time: (x, y, z, qw, qx, qy, qz) in the world frame.

    `pose(body, t)` interpolates and is *the* truth, for sensors and metrics alike. segment and zone are indices into the
    scene's roads and zones at each time, -1 for none; zone is UNKNOWN where a recorded truth does not say where the body was.
    """

    t: Array = column("float64", ("K",), "s, evenly spaced")
    poses: Array = column("float64", ("K", "bodies", 7), "m and (w, x, y, z)")
    bodies: tuple[str, ...] = ()
    segment: Array = column("int32", ("K", "bodies"), default=-1)
    zone: Array = column("int16", ("K", "bodies"), default=-1)

    def __post_init__(self) -> None:
        super().__post_init__()
        poses = np.array(self.poses)
        if len(poses) > 1:  # q and -q are one rotation: choose signs so that neighbours can be interpolated
            dots = np.einsum("kbi,kbi->kb", poses[1:, :, 3:], poses[:-1, :, 3:])
            poses[1:, :, 3:] *= np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)[..., None]
        poses.flags.writeable = False
        object.__setattr__(self, "poses", poses)

    def index(self, body: str) -> int:
        """Place of a body in `poses`. KeyError, naming the body, where it does not move."""
        try:
            return self.bodies.index(body)
        except ValueError:
            raise KeyError(f"no moving body {body!r}; there are {', '.join(self.bodies) or 'none'}") from None

    def pose(self, body: ArrayLike, t: ArrayLike) -> Array:
        """Poses (..., 7) of the moving bodies `body` (index, ...) at times `t` (...), broadcast together.

        Cubic Hermite (Catmull-Rom) in position and in the sign-aligned quaternion, renormalised: continuous in velocity and yaw rate.
        Held still before the first and after the last time.
        """
        value, _ = self._hermite(body, t)
        value[..., 3:] = frames.normalise(value[..., 3:])
        return value

    def known(self, body: int, t: Array) -> Array:
        """(K,) bool: whether it is known where the moving body was at times t (K,) s: at the samples before and after each."""
        lost = self.zone[:, body] == UNKNOWN
        if not lost.any():
            return np.ones(len(t), dtype=bool)
        after = np.clip(np.searchsorted(self.t, t - 1e-9), 0, len(self.t) - 1)
        before = np.clip(np.searchsorted(self.t, t + 1e-9, side="right") - 1, 0, len(self.t) - 1)
        return ~(lost[before] | lost[after])

    def velocity(self, body: ArrayLike, t: ArrayLike) -> Array:
        """Velocities (..., 3), m/s in the world frame, of the moving bodies at times `t`: the derivative of `pose`."""
        return self._hermite(body, t)[1][..., :3]

    def _hermite(self, body: ArrayLike, t: ArrayLike) -> tuple[Array, Array]:
        body, t = np.broadcast_arrays(np.asarray(body, dtype=np.int64), np.asarray(t, dtype=np.float64))
        if len(self.t) == 1:
            still = self.poses[0][body]
            return still.copy(), np.zeros_like(still)
        step = (self.t[-1] - self.t[0]) / (len(self.t) - 1)
        place = np.clip((t - self.t[0]) / step, 0.0, len(self.t) - 1)
        k = np.minimum(place.astype(np.int64), len(self.t) - 2)
        s = (place - k)[..., None]
        last = len(self.t) - 1
        p0, p1 = self.poses[k, body], self.poses[k + 1, body]
        before, after = self.poses[np.maximum(k - 1, 0), body], self.poses[np.minimum(k + 2, last), body]
        # one-sided differences at the two ends, central ones inside
        m0 = (p1 - before) / np.where(k > 0, 2.0, 1.0)[..., None]
        m1 = (after - p0) / np.where(k + 1 < last, 2.0, 1.0)[..., None]
        d = p1 - p0
        c2, c3 = 3 * d - 2 * m0 - m1, m0 + m1 - 2 * d
        value = p0 + s * (m0 + s * (c2 + s * c3))
        rate = (m0 + s * (2 * c2 + s * 3 * c3)) / step
        return value, np.where(((t >= self.t[0]) & (t <= self.t[-1]))[..., None], rate, 0.0)

    def resampled(self, every: int) -> Self:
        """Every n-th instant: a smaller truth for storage."""
        return self.with_(t=self.t[::every], poses=self.poses[::every], segment=self.segment[::every], zone=self.zone[::every])
