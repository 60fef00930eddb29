"""What is inside of what: points, and the solid boxes and meshes that hold them. A ray that starts inside a box does not meet it."""

from __future__ import annotations

import numpy as np
from numba import njit

from testbed import frames
from testbed.columns import Array
from testbed.geometry import WORLD, Boxes, Meshes
from testbed.scene import Scene

GRAZING = 1e-9  # m: so near a surface, a point is on it and not inside


def holder(points: Array, boxes: Boxes) -> Array:
    """(P,) index of the first box that holds each point (P, 3), in the frame of the boxes; -1 for none. A surface holds nothing."""
    axes = np.moveaxis(frames.matrix(boxes.quaternion), -1, -2).reshape(-1, 9)
    return _holder(np.asarray(points, dtype=np.float64).reshape(-1, 3), np.concatenate([boxes.center, axes, boxes.half], axis=1))


def mesh_holder(points: Array, meshes: Meshes) -> Array:
    """(P,) index of the first closed mesh that holds each point (P, 3), in the frame of the meshes; -1 for none."""
    points, found = np.asarray(points, dtype=np.float64).reshape(-1, 3), np.full(len(np.reshape(points, (-1, 3))), -1, dtype=np.int64)
    for m in np.flatnonzero(meshes.closed):
        corners = meshes.vertices[meshes.triangles[meshes.mesh == m]]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        some = np.flatnonzero((found < 0) & ((points > low) & (points < high)).all(axis=1))
        found[some[_winding(points[some], corners) != 0]] = m
    return found


def holders(scene: Scene, body: Array, points: Array) -> Array:
    """(P,) the piece of the scene, a box or a closed mesh, that holds each point, -1 for none.

    body : (P,) place in `scene.moving` of the body in whose frame a point is given; it is asked whether that body holds it. -1 for points
           in the world's frame, and all that never moves. What only drives over a point later is not looked at.
    """
    body, points = np.asarray(body), np.asarray(points, dtype=np.float64).reshape(-1, 3)
    found = np.full(len(points), -1, dtype=np.int64)
    for carrier in np.unique(body):
        rows = np.flatnonzero(body == carrier)
        if carrier == WORLD:
            index = np.flatnonzero(~np.isin(scene.boxes.body, scene.moving))
            own = holder(points[rows], scene.static_boxes())
        else:
            index = np.flatnonzero(scene.boxes.body == scene.moving[carrier])
            own = holder(points[rows], scene.boxes.take(index))
        found[rows[own >= 0]] = index[own[own >= 0]]
        if carrier == WORLD and len(scene.meshes):
            rest = rows[found[rows] < 0]
            own = mesh_holder(points[rest], scene.static_meshes())
            found[rest[own >= 0]] = len(scene.boxes) + own[own >= 0]
    return found


@njit(cache=True)
def _holder(points, boxes):
    """boxes (B, 15): centre, its own three directions, half lengths."""
    found = np.full(len(points), -1, dtype=np.int64)
    for i in range(len(points)):
        for k in range(len(boxes)):
            x, y, z = points[i, 0] - boxes[k, 0], points[i, 1] - boxes[k, 1], points[i, 2] - boxes[k, 2]
            if (
                abs(x * boxes[k, 3] + y * boxes[k, 4] + z * boxes[k, 5]) < boxes[k, 12] - GRAZING
                and abs(x * boxes[k, 6] + y * boxes[k, 7] + z * boxes[k, 8]) < boxes[k, 13] - GRAZING
                and abs(x * boxes[k, 9] + y * boxes[k, 10] + z * boxes[k, 11]) < boxes[k, 14] - GRAZING
            ):
                found[i] = k
                break
    return found


@njit(cache=True)
def _winding(points, corners):
    """(P,) how often the surface (T, 3, 3) goes round each point: by the triangles straight above it, down ones against up ones.

    A point just below an edge is taken to lie a little to one side of it, the same side for all triangles at that edge.
    """
    found = np.zeros(len(points), dtype=np.int64)
    for i in range(len(points)):
        for k in range(len(corners)):
            c = corners[k]
            positive, negative, height, area = 0, 0, 0.0, 0.0
            for j in range(3):
                a, b, opposite = c[j], c[(j + 1) % 3], c[(j + 2) % 3]
                ax, ay, bx, by = a[0] - points[i, 0], a[1] - points[i, 1], b[0] - points[i, 0], b[1] - points[i, 1]
                side = ax * by - ay * bx
                height, area = height + side * (opposite[2] - points[i, 2]), area + side
                if side == 0.0:
                    side = ay - by if ay != by else bx - ax
                positive, negative = positive + (side > 0.0), negative + (side < 0.0)
            if (positive == 3 or negative == 3) and area != 0.0 and height / area > 0.0:
                found[i] += 1 if positive == 3 else -1
    return found
