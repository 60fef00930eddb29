"""Rotations and poses. Quaternions are (w, x, y, z) everywhere in the testbed; a pose is (x, y, z, qw, qx, qy, qz).

Right-handed world frame, z up; yaw counter-clockwise from +x. An antenna looks along its own +x. All functions broadcast
over leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def normalise(q: ArrayLike) -> Array:
    """Quaternions (..., 4) scaled to unit length."""
    q = np.asarray(q, dtype=np.float64)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Hamilton product a b of quaternions (..., 4): first rotate by b, then by a."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> Array:
    """The inverse rotation of unit quaternions (..., 4)."""
    return np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Vectors (..., 3) rotated by unit quaternions (..., 4)."""
    q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
    u = q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + q[..., :1] * t + np.cross(u, t)


def from_euler(yaw: ArrayLike, pitch: ArrayLike = 0.0, roll: ArrayLike = 0.0) -> Array:
    """Quaternions (..., 4) of R = Rz(yaw) Ry(pitch) Rx(roll), rad. A positive pitch turns +x downwards."""
    y, p, r = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) / 2 for a in (yaw, pitch, roll)))
    cy, sy, cp, sp, cr, sr = np.cos(y), np.sin(y), np.cos(p), np.sin(p), np.cos(r), np.sin(r)
    return np.stack(
        [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy],
        axis=-1,
    )


def yaw_of(q: ArrayLike) -> Array:
    """Heading (...,) of the body's +x axis in the horizontal plane, rad in (-π, π]."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def looking_at(position: ArrayLike, target: ArrayLike) -> Array:
    """Quaternions (..., 4) that turn +x from `position` (..., 3) towards `target` (..., 3), without roll."""
    d = np.asarray(target, dtype=np.float64) - np.asarray(position, dtype=np.float64)
    return from_euler(np.arctan2(d[..., 1], d[..., 0]), -np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1])))


def matrix(q: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4); columns are the rotated axes."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def compose(outer: ArrayLike, inner: ArrayLike) -> Array:
    """Poses (..., 7): `inner`, given in the frame of `outer`, expressed in the frame `outer` itself is given in."""
    o, i = np.asarray(outer, dtype=np.float64), np.asarray(inner, dtype=np.float64)
    position = o[..., :3] + rotate(o[..., 3:], i[..., :3])
    quaternion = multiply(o[..., 3:], i[..., 3:])
    shape = np.broadcast_shapes(position.shape[:-1], quaternion.shape[:-1])
    return np.concatenate([np.broadcast_to(position, (*shape, 3)), np.broadcast_to(quaternion, (*shape, 4))], axis=-1)


def to_local(pose: ArrayLike, point: ArrayLike) -> Array:
    """World points (..., 3) expressed in the frames `pose` (..., 7)."""
    p = np.asarray(pose, dtype=np.float64)
    return rotate(conjugate(p[..., 3:]), np.asarray(point, dtype=np.float64) - p[..., :3])


def to_world(pose: ArrayLike, point: ArrayLike) -> Array:
    """Points (..., 3) of the frames `pose` (..., 7) expressed in the world."""
    p = np.asarray(pose, dtype=np.float64)
    return p[..., :3] + rotate(p[..., 3:], point)
