"""What the surveyed racks of a site mean for detections: how far they close the way to each antenna, and where no tag can be."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from pydantic import Field

from testbed import frames
from testbed.geometry import Boxes
from testbed.quantity import Config, Metres
from testbed.types import Array, Site

LEVEL = 0.25  # m: heights of tags are told apart by so much
ROOM = (0.05, 2.0)  # m above the floor: what stands there is in a vehicle's way
MOST = 0.98  # of a way that is closed: no survey is so good that a read from behind a rack proves it wrong


class RackMapConfig(Config):
    """cell_m: of the maps. reach_m: ways longer than this count as open, for nothing is heard over them anyway.

    through: the share of a wave that a box of the survey lets pass; it does not say what the boxes hold.
    """

    cell_m: Annotated[Metres, Field(ge=0.1, le=5)] = 0.5
    reach_m: Annotated[Metres, Field(gt=0, le=200)] = 18.0
    through: Annotated[float, Field(ge=0, le=1)] = 0.2


class RackMap:
    """Maps over the floor from the site's obstacles, for tags at `height` (B,) m.

    closed (H, A, nx, ny) float32: share g of the way from each antenna that is closed at each grid point; solid (H, nx, ny) bool: where a
    rack stands; level (B,) which height is each row's. Grid points are `cell` m apart from `origin` (2,).
    """

    def __init__(self, config: RackMapConfig, site: Site, height: Array) -> None:
        antennas, boxes = site.antennas.position, site.obstacles
        rotation = _rotation(boxes)
        extent = np.einsum("nij,nj->ni", np.abs(rotation), boxes.half)
        corners = np.concatenate([antennas[:, :2], (boxes.center - extent)[:, :2], (boxes.center + extent)[:, :2]])
        self.cell, self.origin = config.cell_m, corners.min(axis=0) - 1.0
        nx, ny = (int(n) + 2 for n in (corners.max(axis=0) + 1.0 - self.origin) / self.cell)
        levels, self.level = np.unique(np.round(np.nan_to_num(height) / LEVEL).astype(np.int64), return_inverse=True)
        self.closed = np.zeros((len(levels), len(antennas), nx, ny), dtype=np.float32)
        in_room = (boxes.center[:, 2] - extent[:, 2] < ROOM[1]) & (boxes.center[:, 2] + extent[:, 2] > ROOM[0])
        self.solid = np.zeros((nx, ny), dtype=np.bool_)
        _stand(self.solid, self.origin, self.cell, boxes.center[in_room], rotation[in_room], boxes.half[in_room])
        for h, level in enumerate(levels):
            _close(
                self.closed[h], self.origin, self.cell, level * LEVEL, config.reach_m, config.through,
                antennas, boxes.center, rotation, boxes.half, extent,
            )  # fmt: skip
        np.minimum(self.closed, MOST, out=self.closed)


def _rotation(boxes: Boxes) -> Array:
    """(N, 3, 3): from the world into each box's frame."""
    return np.stack([frames.rotate(frames.conjugate(boxes.quaternion), axis) for axis in np.eye(3)], axis=2).reshape(-1, 3, 3)


@njit(cache=True, error_model="numpy")
def _stand(solid, origin, cell, center, rotation, half):
    """A grid point is solid where it lies in the footprint of a box (taken upright)."""
    for i in range(solid.shape[0]):
        for j in range(solid.shape[1]):
            x, y = origin[0] + i * cell, origin[1] + j * cell
            for k in range(len(center)):
                dx, dy = x - center[k, 0], y - center[k, 1]
                r = rotation[k]
                if abs(r[0, 0] * dx + r[0, 1] * dy) <= half[k, 0] and abs(r[1, 0] * dx + r[1, 1] * dy) <= half[k, 1]:
                    solid[i, j] = True
                    break


@njit(cache=True, error_model="numpy")
def _close(closed, origin, cell, height, reach, through, antennas, center, rotation, half, extent):
    for a in range(len(antennas)):
        ax, ay, az = antennas[a]
        near = np.empty(len(center), dtype=np.int64)
        beside, radius = np.empty((len(center), 2)), np.empty(len(center))
        many = 0
        for k in range(len(center)):  # boxes that some way from this antenna may meet
            apart = max(abs(center[k, 0] - ax) - extent[k, 0], abs(center[k, 1] - ay) - extent[k, 1])
            low, high = min(az, height), max(az, height)
            if apart < reach and center[k, 2] + extent[k, 2] > low and center[k, 2] - extent[k, 2] < high:
                near[many] = k
                beside[many, 0], beside[many, 1] = center[k, 0] - ax, center[k, 1] - ay
                radius[many] = extent[k, 0] ** 2 + extent[k, 1] ** 2
                many += 1
        for i in range(closed.shape[1]):
            for j in range(closed.shape[2]):
                x, y = origin[0] + i * cell, origin[1] + j * cell
                dx, dy = x - ax, y - ay
                length = dx * dx + dy * dy
                if length > reach * reach:
                    continue
                open_ = 1.0
                for n in range(many):
                    if open_ < 1e-3:
                        break
                    aside = dx * beside[n, 1] - dy * beside[n, 0]
                    if aside * aside > radius[n] * length:
                        continue
                    k = near[n]
                    if _meets(ax, ay, az, x, y, height, center[k], rotation[k], half[k]):
                        open_ *= through
                closed[a, i, j] = 1.0 - open_


@njit(cache=True, error_model="numpy")
def _meets(ax, ay, az, x, y, z, center, rotation, half):
    """Whether the straight way between two points meets a box: the slab test, in the box's own frame."""
    enter, leave = 0.0, 1.0
    for axis in range(3):
        r = rotation[axis]
        start = r[0] * (ax - center[0]) + r[1] * (ay - center[1]) + r[2] * (az - center[2])
        along = r[0] * (x - ax) + r[1] * (y - ay) + r[2] * (z - az)
        if abs(along) < 1e-12:
            if abs(start) > half[axis]:
                return False
            continue
        first, second = (-half[axis] - start) / along, (half[axis] - start) / along
        enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
        if enter > leave:
            return False
    return True
