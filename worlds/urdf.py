"""URDF text from plain data: how boxes, wheels and joints reach PyBullet.

Every function returns text; put together by `robot`. Lengths in m, angles in rad, masses in kg. Quaternions are (w, x, y, z).
A model that is only looked at by rays or stands still needs one `compound`; a vehicle is some `link`s and `joint`s.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes


def robot(name: str, parts: Sequence[str]) -> str:
    """A whole model from its links and joints; the first link is the base, whose frame is the body's frame."""
    return "\n".join([f"<robot name={quoteattr(name)}>", *parts, "</robot>"]) + "\n"


def compound(name: str, boxes: Boxes) -> str:
    """A model of one massless link that holds all `boxes` (N >= 1) in its frame: what stands still."""
    if not len(boxes):
        raise ValueError(f"{name}: a compound needs at least one box")
    return robot(name, [link("base", box_shapes(boxes))])


def link(
    name: str, shapes: Sequence[str], mass: float = 0.0, inertia: ArrayLike = (0.0, 0.0, 0.0), com: ArrayLike = (0.0, 0.0, 0.0)
) -> str:
    """A rigid part: collision `shapes` in its frame, mass, centre of mass, and the principal moments of inertia about it (kg m²).

    The inertial element is written for massless parts too: PyBullet gives 1 kg to a part without, and prints a warning.
    """
    ixx, iyy, izz = (_number(v) for v in np.asarray(inertia, dtype=np.float64))
    inertial = (
        f'<inertial><origin xyz="{_numbers(com)}"/><mass value="{_number(mass)}"/>'
        f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial>'
    )
    return "\n".join([f"<link name={quoteattr(name)}>", inertial, *shapes, "</link>"])


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    pose: ArrayLike = frames.IDENTITY,
    axis: ArrayLike = (0.0, 0.0, 1.0),
    limit: tuple[float, float] | None = None,
) -> str:
    """Joins `child`, whose frame stands at `pose` (7,) in the parent's frame, to `parent`.

    kind is URDF's: "fixed", "continuous" (a wheel), "revolute" or "prismatic", which want `limit` = (lower, upper) in rad or m.
    """
    if kind in ("revolute", "prismatic") and limit is None:
        raise ValueError(f"joint {name}: a {kind} joint needs limits")
    # effort and velocity are required by the format; the forces that count are given to the motors
    bounds = f'<limit lower="{_number(limit[0])}" upper="{_number(limit[1])}" effort="1e9" velocity="1e9"/>' if limit else ""
    return (
        f"<joint name={quoteattr(name)} type={quoteattr(kind)}><parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>"
        f'{_origin(pose)}<axis xyz="{_numbers(axis)}"/>{bounds}</joint>'
    )


def box_shapes(boxes: Boxes) -> list[str]:
    """One collision element for each of the N boxes; each becomes one line of the model.

    The alternative, PyBullet's createCollisionShapeArray, silently keeps 16 shapes; a URDF link has no such limit.
    """
    poses = np.concatenate([boxes.center, boxes.quaternion], axis=1)
    return [_collision(pose, f'<box size="{_numbers(2 * half)}"/>') for pose, half in zip(poses, boxes.half, strict=True)]


def sphere_shape(center: ArrayLike, radius: float) -> str:
    """A sphere. Use it for wheels too: a cylinder rattles by millimetres as its facets touch the floor in turn."""
    return _collision(np.concatenate([np.asarray(center, dtype=np.float64), frames.IDENTITY[3:]]), f'<sphere radius="{_number(radius)}"/>')


def cylinder_shape(pose: ArrayLike, radius: float, length: float) -> str:
    """A cylinder around the z axis of `pose` (7,)."""
    return _collision(pose, f'<cylinder radius="{_number(radius)}" length="{_number(length)}"/>')


def box_inertia(mass: float, size: ArrayLike) -> Array:
    """(3,) kg m²: principal moments of a homogeneous box with edges `size` (3,)."""
    x, y, z = np.asarray(size, dtype=np.float64) ** 2
    return mass / 12.0 * np.array([y + z, x + z, x + y])


def sphere_inertia(mass: float, radius: float) -> Array:
    """(3,) kg m²: moments of a homogeneous sphere."""
    return np.full(3, 0.4 * mass * radius**2)


def rpy(quaternion: ArrayLike) -> Array:
    """(3,) roll, pitch, yaw of a unit quaternion, R = Rz(yaw) Ry(pitch) Rx(roll): URDF's convention.

    At a pitch of ±90° only yaw - (±roll) is defined; roll is 0 there.
    """
    r = frames.matrix(frames.normalise(quaternion))
    level = np.hypot(r[0, 0], r[1, 0])
    pitch = np.arctan2(-r[2, 0], level)
    if level < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-r[0, 1], r[1, 1])])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _collision(pose: ArrayLike, geometry: str) -> str:
    return f"<collision>{_origin(pose)}<geometry>{geometry}</geometry></collision>"


def _origin(pose: ArrayLike) -> str:
    pose = np.asarray(pose, dtype=np.float64)
    return f'<origin xyz="{_numbers(pose[:3])}" rpy="{_numbers(rpy(pose[3:]))}"/>'


def _numbers(values: ArrayLike) -> str:
    return " ".join(_number(v) for v in np.asarray(values, dtype=np.float64))


def _number(value: float) -> str:
    """The shortest text that reads back as the same double. ValueError for what a file can't hold."""
    if not np.isfinite(value):
        raise ValueError(f"{value} can't stand in a URDF: all numbers must be finite")
    return repr(float(value))
