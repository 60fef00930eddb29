"""What worlds from files share: names, kinds and materials by pattern, mounts on the sides of things, and how large the hall is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes, Mounts
from testbed.scene import Body, Scene
from worlds.importers.files import FARTHEST, WorldFileError
from worlds.parts import MATERIALS, STAND_OFF, Builder, Part

EVERY = 1.5  # m from mount to mount along a side
LOWEST = 3.0  # m: a hall is at least so high
MOST_BODIES = 5_000
MOST_PIECES = 50_000  # boxes and meshes
MOST_SIDES = 60  # mounts along one side


def chosen(patterns: Mapping[str, str], name: str, otherwise: str) -> str:
    """The value of the first pattern that fits a name."""
    return next((value for pattern, value in patterns.items() if fnmatchcase(name, pattern)), otherwise)


def material(patterns: Mapping[str, str], name: str, otherwise: str) -> int:
    """The index in MATERIALS of the first pattern that fits a name."""
    return MATERIALS.index(chosen(patterns, name, otherwise))


def check_materials(names: Sequence[str]) -> None:
    """ValueError for a material that nobody knows."""
    stranger = next((n for n in names if n not in MATERIALS), None)
    if stranger is not None:
        raise ValueError(f"nobody knows the material {stranger!r}; there are {', '.join(MATERIALS)}")


def many(count: int, one: str, more: str) -> str:
    """A number with its noun."""
    return f"{count} {one if count == 1 else more}"


def plain_names(given: Sequence[str]) -> list[str]:
    """Names of bodies: of letters, digits, _, - and . alone, and a number behind the second of one name."""
    found: list[str] = []
    for name in given:
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", name)[:80] or "thing"
        more = 2
        unique = plain
        while unique in found:
            unique, more = f"{plain}_{more}", more + 1
        found.append(unique)
    return found


def with_sides(name: str, kind: str, pose: Array, boxes: Boxes, meshes: Meshes) -> Part:
    """A part with tag mounts round what it fills: front.1, ... (+x), left (+y), back (-x), right (-y) every EVERY m half way up, and top.

    They lie STAND_OFF outside the cuboid round the body, along its own axes: a little off a surface that is set back.
    """
    low, high = extent(boxes, meshes)
    middle, half, built = (low + high) / 2, (high - low) / 2, Builder()
    for side, axis, sign, yaw in (("front", 0, 1, 0.0), ("left", 1, 1, np.pi / 2), ("back", 0, -1, np.pi), ("right", 1, -1, -np.pi / 2)):
        across = 1 - axis
        many = int(np.clip(np.round(2 * half[across] / EVERY), 1, MOST_SIDES))
        for i in range(many):
            at = middle.copy()
            at[axis] += sign * (half[axis] + STAND_OFF)
            at[across] += half[across] * (2 * (i + 0.5) / many - 1)
            built.mount(f"{side}.{i + 1}", at, yaw, group=side)
    built.mount("top", (middle[0], middle[1], high[2] + STAND_OFF), pitch=-np.pi / 2)
    return Part(name, kind, pose, boxes, built.mounts(), meshes)


def without_sides(name: str, kind: str, pose: Array, boxes: Boxes) -> Part:
    """A part of boxes that nothing is hung on."""
    return Part(name, kind, pose, boxes, Mounts.empty())


def extent(boxes: Boxes, meshes: Meshes) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) m of boxes and meshes, in their frame."""
    reach = np.einsum("nij,nj->ni", np.abs(frames.matrix(boxes.quaternion)), boxes.half)
    points = np.concatenate([boxes.center - reach, boxes.center + reach, meshes.vertices])
    return points.min(axis=0), points.max(axis=0)


def room(parts: Sequence[Part], name: str) -> Array:
    """(2, 3) m: the floor under all parts, and what is above it. WorldFileError for a hall that is none."""
    if len(parts) > MOST_BODIES or sum(len(p.boxes) + len(p.meshes) for p in parts) > MOST_PIECES:
        raise WorldFileError(f"{name}: more than {MOST_BODIES:,} bodies or {MOST_PIECES:,} boxes and meshes")
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in parts:
        bodies = (Body("", "", part.pose),)
        own = Scene(bodies, part.boxes.with_(body=np.zeros(len(part.boxes))), MATERIALS, np.zeros((2, 3)), meshes=part.meshes)
        a, b = extent(own.static_boxes(), own.static_meshes())
        low, high = np.minimum(low, a), np.maximum(high, b)
    if not (np.abs([low, high]) <= FARTHEST).all():
        raise WorldFileError(f"{name}: it reaches farther than {FARTHEST / 1000:g} km: look at its scale")
    if high[2] <= 0:
        raise WorldFileError(f"{name}: nothing of it is above the floor")
    return np.array([[low[0], low[1], 0.0], [high[0], high[1], max(high[2], LOWEST)]])
