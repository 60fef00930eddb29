"""A PyBullet client that is only looked at: coloured meshes without collision shapes, and PyBullet's software renderer.

`ER_TINY_RENDERER` needs neither a display nor OpenGL. Like `worlds.bullet`, on which it stands, this file keeps the engine's ways
to itself: what comes out are plain arrays with depths in metres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes
from testbed.view import Camera
from worlds.bullet import Client, Handle

TRIANGLES_PER_MESH = 4000
BOXES_PER_MESH = 500  # 24 corners each: far from the engine's limits on a mesh
LIGHT = np.array([0.35, -0.45, 0.82])  # towards the light, world frame: every visible side of a box gets a brightness of its own
AMBIENT, DIFFUSE = 0.72, 0.34  # a face turned to the light has its own colour, one turned away three quarters of it


class Window(NamedTuple):
    """A part of a picture, px."""

    left: int
    top: int
    width: int
    height: int


class VisualClient(Client):
    """Bodies that can be seen but not touched. Made, placed and closed like those of its base."""

    def show(self, boxes: Boxes, name: str, colour: ArrayLike, pose: ArrayLike = frames.IDENTITY) -> list[Handle]:
        """Boxes in the frame `pose` (7,), in one colour (3,) of [0, 1]: a few meshes, for many separate boxes render slowly."""
        parts = [mesh(boxes.take(slice(i, i + BOXES_PER_MESH))) for i in range(0, len(boxes), BOXES_PER_MESH)]
        return [self._shown(part, name, colour, pose) for part in parts]

    def show_mesh(self, meshes: Meshes, name: str, colour: ArrayLike, pose: ArrayLike = frames.IDENTITY) -> list[Handle]:
        """The triangles of meshes in the frame `pose` (7,), in one colour (3,), each flat."""
        corners = meshes.corners()
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        flat, corners = (normal / np.maximum(length, 1e-300))[length[:, 0] > 0], corners[length[:, 0] > 0]
        handles = []
        for i in range(0, len(corners), TRIANGLES_PER_MESH):
            some = corners[i : i + TRIANGLES_PER_MESH].reshape(-1, 3)
            handles.append(
                self._shown((some, np.repeat(flat[i : i + TRIANGLES_PER_MESH], 3, axis=0), np.arange(len(some))), name, colour, pose)
            )
        return handles

    def _shown(self, part: tuple[Array, Array, Array], name: str, colour: ArrayLike, pose: ArrayLike) -> Handle:
        corners, normals, triangles = part
        shape = self._p.createVisualShape(
            self._p.GEOM_MESH,
            vertices=corners.tolist(),
            normals=normals.tolist(),
            indices=triangles.tolist(),
            rgbaColor=[*np.asarray(colour, dtype=np.float64).tolist(), 1.0],
            physicsClientId=self._id,
        )
        if shape < 0:
            raise RuntimeError(f"PyBullet made no mesh of {name}")
        handle = self._handle(self._p.createMultiBody(0, -1, shape, physicsClientId=self._id), name)
        self.place(handle, pose)
        return handle

    def picture(self, camera: Camera, window: Window | None = None) -> tuple[Array, Array, Array]:
        """What the camera sees: (H, W, 3) uint8, depth (H, W) float32 in m along the optical axis, PyBullet's body numbers (H, W) int32.

        Depth is inf and the number -1 where nothing is seen. `window` is the part of the picture that is wanted, H x W are then its.
        No shadows: the engine's own are cast by a light of fixed reach.
        """
        window = window or Window(0, 0, camera.width, camera.height)
        width, height = window.width, window.height
        _, _, rgba, buffer, number = self._p.getCameraImage(
            width,
            height,
            viewMatrix=_columns(camera.view_matrix()),
            projectionMatrix=_columns(_framing(camera, window) @ camera.projection_matrix()),
            lightDirection=(LIGHT / np.linalg.norm(LIGHT)).tolist(),
            lightColor=[1.0, 1.0, 1.0],
            lightAmbientCoeff=AMBIENT,
            lightDiffuseCoeff=DIFFUSE,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._p.ER_TINY_RENDERER,
            physicsClientId=self._id,
        )
        # a PyBullet that was built without numpy gives tuples
        colours = np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)[..., :3]
        found = np.asarray(number, dtype=np.int32).reshape(height, width)
        share = np.asarray(buffer, dtype=np.float32).reshape(height, width).astype(np.float64)
        near, far = camera.near, camera.far
        depth = np.where(found >= 0, far * near / (far - (far - near) * share), np.inf)
        return colours, depth.astype(np.float32), found


def mesh(boxes: Boxes) -> tuple[Array, Array, Array]:
    """Corners (24 N, 3), their normals (24 N, 3) and triangles (36 N,) int64 of N boxes, in the frame the boxes are given in.

    Four corners a side, since each side has a normal of its own; counter-clockwise as seen from outside.
    """
    sides, turns = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal, along = np.zeros(3), np.zeros(3)
            normal[axis], along[(axis + 1) % 3] = sign, 1.0
            across = np.cross(normal, along)
            sides += [normal + a * along + b * across for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            turns += [normal] * 4
    q = boxes.quaternion[:, None]
    corners = boxes.center[:, None] + frames.rotate(q, np.array(sides) * boxes.half[:, None])
    normals = frames.rotate(q, np.broadcast_to(np.array(turns), corners.shape))
    one = (np.array([0, 1, 2, 0, 2, 3]) + 4 * np.arange(6)[:, None]).ravel()
    triangles = (one + 24 * np.arange(len(boxes))[:, None]).ravel()
    return corners.reshape(-1, 3), normals.reshape(-1, 3), triangles


def _framing(camera: Camera, window: Window) -> Array:
    """(4, 4) in clip space: the window becomes the whole picture.

    TinyRenderer samples pixel (u, v) half a pixel left of and below its middle: the picture is pushed there.
    """
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1] = camera.width / window.width, camera.height / window.height
    matrix[0, 3] = (camera.width - 2 * window.left - 1) / window.width - 1
    matrix[1, 3] = 1 - (camera.height - 2 * window.top + 1) / window.height
    return matrix


def _columns(matrix: Array) -> list[Any]:
    return matrix.T.ravel().tolist()
