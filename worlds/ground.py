"""The floor of a render as seen from straight above: its tiles, its zones, and the soft shadows of what stands on it.

TinyRenderer's own shadows come from a light of fixed reach and break off in a hall; these are exact for boxes: the shadow of a
convex body on a plane is the convex hull of its corners' shadows.
"""

from __future__ import annotations

import cv2
import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Zones
from worlds.paint import FLOOR
from worlds.stage import LIGHT

MARGIN = 0.6  # m of floor beyond the hall
CELLS = 2048  # along the longer side, at most
FINEST = 0.02  # m a cell
TILE = 1.0  # m
DARKNESS, SOFTNESS = 0.34, 0.05  # of a full shadow; m
_SHIFT = 4  # binary digits of cell fractions in OpenCV's polygons

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def corners(boxes: Boxes) -> Array:
    """(N, 8, 3) m: the corners of N boxes, in the frame the boxes are given in."""
    return boxes.center[:, None] + frames.rotate(boxes.quaternion[:, None], CORNERS * boxes.half[:, None])


class Ground:
    """The floor over `bounds` (2, 3) m and a little beyond, as a picture with x to the right and y upwards."""

    def __init__(self, bounds: Array, zones: Zones) -> None:
        self.low, high = bounds[0, :2] - MARGIN, bounds[1, :2] + MARGIN
        self.cell = max(FINEST, float((high - self.low).max()) / CELLS)
        self.size = np.ceil((high - self.low) / self.cell).astype(int)  # columns, rows
        self.plain = self._tiles(zones)

    def cells(self, xy: Array) -> Array:
        """(..., 2): column and row of floor points (..., 2) m, whole numbers at the middles of cells; row 0 lies in the south."""
        return (xy - self.low) / self.cell - 0.5

    def _tiles(self, zones: Zones) -> Array:
        """(rows, columns, 3) uint8: the floor without shadows, faint lines every TILE m and round the zones."""
        columns, rows = self.size
        image = np.full((rows, columns, 3), FLOOR, dtype=np.uint8)
        for axis in (0, 1):
            first = np.ceil(self.low[axis] / TILE) * TILE
            for at in np.arange(first, self.low[axis] + self.size[axis] * self.cell, TILE):
                ends = np.array([self.low, self.low + self.size * self.cell])
                ends[:, axis] = at
                self._line(image, ends, 0.03, 0.955)
        for x0, y0, x1, y1 in zones.bounds:
            ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
            for i in range(4):
                self._line(image, ring[i : i + 2], 0.06, 0.87)
        return image

    def _line(self, image: Array, ends: Array, width: float, brightness: float) -> None:
        a, b = (tuple(round(float(v)) for v in self.cells(p) * 2**_SHIFT) for p in ends)
        cv2.line(image, a, b, [round(c * brightness) for c in FLOOR], max(1, round(width / self.cell)), cv2.LINE_AA, _SHIFT)

    def shadow(self, boxes: Boxes, triangles: Array | None = None) -> Array:
        """(rows, columns) float32 in [0, 1]: how much light boxes and triangles (T, 3, 3), in the world frame, keep from each cell."""
        columns, rows = self.size
        mask = np.zeros((rows, columns), dtype=np.uint8)
        for points in (corners(boxes), np.zeros((0, 3, 3)) if triangles is None else triangles):
            fallen = points[..., :2] - LIGHT[:2] / LIGHT[2] * np.maximum(points[..., 2:], 0.0)
            for outline in np.round(self.cells(fallen) * 2**_SHIFT).astype(np.int32):
                cv2.fillConvexPoly(mask, cv2.convexHull(outline), 255, cv2.LINE_AA, _SHIFT)
        return cv2.GaussianBlur(mask, (0, 0), SOFTNESS / self.cell).astype(np.float32) / 255

    def shaded(self, shadow: Array) -> Array:
        """(rows, columns, 3) uint8: the floor under a shadow (rows, columns)."""
        return (self.plain * (1 - DARKNESS * shadow[..., None])).astype(np.uint8)
