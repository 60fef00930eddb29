"""What stands between two points: for placing cameras, a few thousand sight lines at most."""

from __future__ import annotations

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes


def crossed(start: Array, end: Array, boxes: Boxes) -> Array:
    """(S, N) bool: which of N boxes, in the world frame, each segment from start (S, 3) to end (S, 3) passes through or touches.

    The slab method: in a box's own frame the segment lies within each pair of faces for some share of its way, and crosses the
    box if those three shares have a part in common.
    """
    found = np.zeros((len(start), len(boxes)), dtype=bool)
    if not len(boxes):
        return found
    back = frames.conjugate(boxes.quaternion)
    for i, (a, b) in enumerate(zip(start, end, strict=True)):
        origin, along = frames.rotate(back, a - boxes.center), frames.rotate(back, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-boxes.half - origin) / along, (boxes.half - origin) / along
        level = np.abs(along) < 1e-12  # parallel to these faces: between them all the way, or never
        between = np.abs(origin) <= boxes.half
        enter = np.where(level, np.where(between, -np.inf, np.inf), np.minimum(first, second)).max(axis=1)
        leave = np.where(level, np.where(between, np.inf, -np.inf), np.maximum(first, second)).min(axis=1)
        found[i] = np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)
    return found
