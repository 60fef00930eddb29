"""The ends of links between antennas and tags: what each is mounted on, and where that is at a time.

A mount is rigid: cables that pull and tags that flap are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.scene import WORLD, Truth


@dataclass(frozen=True)
class Ends:
    """One side of the links, N antennas or tags: moving body of each (-1 for the world) and pose (N, 7) in its frame."""

    body: Array
    pose: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", np.asarray(self.pose, dtype=np.float64))  # whole numbers would be carried as whole numbers

    def at(self, truth: Truth, index: Array, t: Array) -> Array:
        """World poses (..., 7) of the ends `index` (...) at times t (...)."""
        index, t = np.broadcast_arrays(index, t)
        pose = np.array(self.pose[index])
        rides = self.body[index] != WORLD
        if rides.any():
            carrier = truth.pose(self.body[index[rides]], t[rides])
            pose[rides] = frames.compose(carrier, pose[rides])
        return pose
