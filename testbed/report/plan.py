"""A hall from above: footprints of what stands and of what moves. Plain geometry; nothing is drawn here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from testbed.scene import Scene

OVERHEAD = 1.9  # m: what begins higher up is walked under
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Footprint:
    """A body from above, in the world frame: its boxes' outlines (each (n, 2) m), those overhead apart, and the outline of all."""

    name: str
    kind: str
    solid: tuple[Array, ...]
    overhead: tuple[Array, ...]
    outline: Array


def standing(scene: Scene) -> list[Footprint]:
    """Every body that never moves. Boxes of one outline, such as a rack's levels, are given once; of meshes what faces down."""
    boxes, meshes = scene.static_boxes(), scene.static_meshes()
    triangles, of = meshes.corners(), meshes.body[meshes.mesh]
    facing = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    under = np.where(meshes.closed[meshes.mesh], -facing[:, 2], np.abs(facing[:, 2])) > 1e-9  # what one walks under, or can't walk through
    triangles, of = triangles[under], of[under]
    found = []
    for index, body in enumerate(scene.bodies):
        own = np.flatnonzero(boxes.body == index)
        if body.moving or not len(own) + (of == index).sum():
            continue
        shapes = [*_corners(boxes.take(own)), *triangles[of == index]]
        high = np.array([shape[:, 2].min() >= OVERHEAD for shape in shapes])
        solid, overhead = (_distinct([hull(shapes[i][:, :2]) for i in np.flatnonzero(mask)]) for mask in (~high, high))
        found.append(Footprint(body.name, body.kind, solid, overhead, hull(np.concatenate(shapes)[:, :2])))
    return found


def outlines(scene: Scene) -> list[Array]:
    """The outline (n, 2) m of each moving body in its own frame, in the order of `scene.moving`; (0, 2) for one without boxes."""
    found = []
    for index in scene.moving:
        own = scene.boxes.take(scene.boxes.body == index)
        found.append(hull(_corners(own)[:, :, :2].reshape(-1, 2)) if len(own) else np.zeros((0, 2)))
    return found


def placed(outline: Array, pose: Array) -> Array:
    """An outline (n, 2) in the frame of a body at `pose` (7,), in the world's."""
    yaw = frames.yaw_of(pose[3:])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return outline @ turn + pose[:2]


def ellipse(covariance: Array, mean: Array, squared: float = 5.991464547107979, points: int = 40) -> Array:
    """(points, 2) m: the outline within which lies 95 % of a normal distribution (χ² with two degrees of freedom < `squared`)."""
    a, b, angle = axes(covariance, squared)
    turn = np.linspace(0.0, 2 * np.pi, points, endpoint=False)
    x, y = a * np.cos(turn), b * np.sin(turn)
    return mean + np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=1)


def axes(covariance: Array, squared: float = 5.991464547107979) -> tuple[Array, Array, Array]:
    """Half axes (...,) m, the longer first, and the angle (...,) rad of the longer one from +x, of covariances (..., 2, 2) m².

    NaN where a covariance is not finite or not positive semi-definite: there is no ellipse then.
    """
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    with np.errstate(invalid="ignore", over="ignore"):
        middle, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        small = middle - apart
        small = np.where(small >= -1e-9 * middle, np.maximum(small, 0.0), np.nan)
        return np.sqrt(squared * (middle + apart) + 0 * small), np.sqrt(squared * small), np.arctan2(2 * xy, xx - yy) / 2


def hull(points: Array) -> Array:
    """The convex hull (n, 2) of points (m, 2), counter-clockwise: Andrew's monotone chain (1979)."""
    ordered = np.unique(np.round(points, 6), axis=0)
    if len(ordered) < 3:
        return ordered
    chains = []
    for direction in (ordered, ordered[::-1]):
        chain: list[Array] = []
        for p in direction:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 1e-12:
                chain.pop()
            chain.append(p)
        chains.append(chain[:-1])
    return np.array([*chains[0], *chains[1]])


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _corners(boxes: Boxes) -> Array:
    """(N, 8, 3) m: the corners of boxes in the frame that they are given in."""
    return boxes.center[:, None] + frames.rotate(boxes.quaternion[:, None], boxes.half[:, None] * _CORNERS)


def _distinct(polygons: list[Array]) -> tuple[Array, ...]:
    return tuple({(p.shape, p.tobytes()): p for p in polygons}.values())
