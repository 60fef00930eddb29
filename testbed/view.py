"""A camera, and the picture that it takes: the geometry that renders and everything drawn over them share.

A leaf: numpy only. The matrices are OpenGL's: the eye looks along its own -z with +y up, clip space is [-1, 1] in all three axes.
Pixel coordinates are (u, v) in px, u to the right, v downwards; whole numbers are the middles of pixels, so (0, 0) is the middle of
the one at the top left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array

NOTHING = -1  # body of a pixel that shows the floor or the background
MAX_SIDE = 4096  # px


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera at `position` that looks at `target` (both (3,) m, world frame), upright.

    field_of_view : rad, the full angle over the picture's height
    near, far     : m along the optical axis; nothing nearer or farther is seen

    ValueError for a camera that can't look: at its own place, with no angle, with no pixels.
    """

    name: str
    position: Array
    target: Array
    field_of_view: float = np.pi / 4
    width: int = 640
    height: int = 480
    near: float = 0.1
    far: float = 200.0

    def __post_init__(self) -> None:
        for field in ("position", "target"):
            point = np.array(getattr(self, field), dtype=np.float64)
            if point.shape != (3,) or not np.isfinite(point).all():
                raise ValueError(f"camera {self.name}: its {field} must be three finite numbers, got {getattr(self, field)}")
            point.flags.writeable = False
            object.__setattr__(self, field, point)
        if np.linalg.norm(self.target - self.position) < 1e-6:
            raise ValueError(f"camera {self.name}: it stands where it looks, at {self.position.tolist()}")
        if not 0 < self.field_of_view < np.pi:
            raise ValueError(f"camera {self.name}: its field of view must lie between 0 and π, got {self.field_of_view} rad")
        if not (8 <= self.width <= MAX_SIDE and 8 <= self.height <= MAX_SIDE):
            raise ValueError(f"camera {self.name}: each side must have 8 to {MAX_SIDE} px, got {self.width} x {self.height}")
        if not 0 < self.near < self.far < np.inf:
            raise ValueError(f"camera {self.name}: 0 < near < far is wanted, got {self.near} m and {self.far} m")

    @cached_property
    def axes(self) -> Array:
        """(3, 3), rows: the directions in the world of the picture's right, of its top, and of the optical axis backwards."""
        back = self.position - self.target
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        if np.linalg.norm(right) < 1e-9:  # straight down or up: north is at the top
            right = np.array([1.0, 0.0, 0.0])
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def view_matrix(self) -> Array:
        """(4, 4): from the world to the eye, column vectors."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.axes
        matrix[:3, 3] = -self.axes @ self.position
        return matrix

    def projection_matrix(self) -> Array:
        """(4, 4): from the eye to clip space, column vectors; the fourth component is the depth."""
        near, far = self.near, self.far
        f = 1.0 / np.tan(self.field_of_view / 2)
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = f * self.height / self.width, f
        matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
        matrix[3, 2] = -1.0
        return matrix

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """Where points (..., 3) m appear: pixels (..., 2) and depth (...) m along the optical axis.

        Pixels are NaN for points that are nearer than `near`, most of them behind the camera.
        """
        p = np.asarray(points, dtype=np.float64)
        clip = np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1) @ self._clip.T
        depth = clip[..., 3]
        w = np.where(depth >= self.near, depth, np.nan)
        u = (clip[..., 0] / w + 1) * self.width / 2 - 0.5
        v = (1 - clip[..., 1] / w) * self.height / 2 - 0.5
        return np.stack([u, v], axis=-1), depth

    @cached_property
    def _clip(self) -> Array:
        return self.projection_matrix() @ self.view_matrix()

    def rays(self) -> Array:
        """(height, width, 3): what each pixel's middle sees lies at `position + depth * ray`, m."""
        right, top, back = self.axes
        x, y = self._slopes(np.arange(self.width)[None, :, None], np.arange(self.height)[:, None, None])
        return x * right + (y * top - back)

    def directions(self, pixels: ArrayLike) -> Array:
        """(..., 3): the same for any pixels (..., 2); one metre along the optical axis each."""
        uv = np.asarray(pixels, dtype=np.float64)
        x, y = self._slopes(uv[..., 0], uv[..., 1])
        return np.stack([x, y, -np.ones_like(x)], axis=-1) @ self.axes

    def _slopes(self, u: Array, v: Array) -> tuple[Array, Array]:
        """How far to the right and to the top pixels see, each m of depth."""
        tall = np.tan(self.field_of_view / 2)
        return (2 * (u + 0.5) / self.width - 1) * tall * self.width / self.height, (1 - 2 * (v + 0.5) / self.height) * tall


@dataclass(frozen=True, eq=False)
class Image:
    """A render. H x W are the camera's height and width.

    rgb   : (H, W, 3) uint8
    depth : (H, W) float64, m along the optical axis at each pixel's middle, inf where nothing is seen
    body  : (H, W) int32, index into the scene's bodies, NOTHING for the floor and the background
    """

    camera: Camera
    rgb: Array
    depth: Array
    body: Array
