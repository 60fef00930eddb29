"""Where racks can stand beside roads: parallel to them, clear of all of them, and of each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.geometry import Roads
from testbed.roads import project

SAMPLES = 0.25  # m: how finely a rack's footprint is looked at
APART = 0.1  # m between racks, at least


@dataclass(frozen=True, eq=False)
class Stand:
    """A rack's place: the middle of its footprint (2,) m, the yaw of its row of bays, and how many bays."""

    center: Array
    yaw: float
    bays: int


def stands(roads: Roads, clear: float, depth: float, pitch: float, upright: float, inside: Array) -> list[Stand]:
    """Racks of `depth` m on both sides of each segment, `clear` m from its line, right side first, as many bays as there is room for.

    pitch : m from bay to bay, with an upright of `upright` m at either end of a rack. inside : (2, 2) m, lowest and highest corner
    of where racks may stand. A bay stands where its whole footprint is `clear` of every road and touches no earlier rack; the racks
    face the road.
    """
    found: list[Stand] = []
    taken: list[Array] = []
    for a, b in roads.nodes[roads.segments]:
        length = float(np.hypot(*(b - a)))
        along = (b - a) / length
        for side in (-1.0, 1.0):
            across = side * np.array([-along[1], along[0]])
            middle = a + (clear + depth / 2) * across
            yaw = float(np.arctan2(along[1], along[0])) + (np.pi if side < 0 else 0.0)  # a rack's front is at its own -y
            slots = int((length - upright) / pitch)
            first = (length - slots * pitch) / 2  # the row stands in the middle of its road
            free = [
                _is_free(
                    roads, _footprint(middle + (first + (i + 0.5) * pitch) * along, along, pitch + upright, depth), clear, inside, taken
                )
                for i in range(slots)
            ]
            for begin, bays in _runs(free):
                center = middle + (first + (begin + bays / 2) * pitch) * along
                found.append(Stand(center, yaw, bays))
                taken.append(_footprint(center, along, bays * pitch + upright + 2 * APART, depth + 2 * APART))
    return found


def _footprint(center: Array, along: Array, length: float, depth: float) -> Array:
    """(n, 2) m: points of a rectangle, no more than SAMPLES apart, its corners among them."""
    x = np.linspace(-length / 2, length / 2, max(2, int(np.ceil(length / SAMPLES)) + 1))
    y = np.linspace(-depth / 2, depth / 2, max(2, int(np.ceil(depth / SAMPLES)) + 1))
    u, v = (g.ravel() for g in np.meshgrid(x, y))
    return center + u[:, None] * along + v[:, None] * np.array([-along[1], along[0]])


def _is_free(roads: Roads, points: Array, clear: float, inside: Array, taken: list[Array]) -> bool:
    if (points < inside[0]).any() or (points > inside[1]).any():
        return False
    if project(roads, points)[2].min() < clear - 1e-9:
        return False
    return all(np.hypot(*(points[:, None] - other).T).min() > SAMPLES for other in taken if _near(points, other))


def _near(points: Array, other: Array) -> bool:
    """Whether two clouds' bounding boxes come within SAMPLES of each other."""
    return bool(((points.min(axis=0) - SAMPLES < other.max(axis=0)) & (other.min(axis=0) - SAMPLES < points.max(axis=0))).all())


def _runs(free: list[bool]) -> Iterator[tuple[int, int]]:
    """(first, length) of each unbroken run of free slots."""
    begin = None
    for i, yes in enumerate([*free, False]):
        if yes and begin is None:
            begin = i
        elif not yes and begin is not None:
            yield begin, i - begin
            begin = None
