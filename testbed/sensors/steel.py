"""How steel that stands about turns a compass: an error that belongs to the place, so a vehicle meets it again when it comes back.

A stand-in for the field of racks and their goods, which nobody surveys: a smooth random angle over the floor, as strong as steel is
near. Left out: that iron on the vehicle itself turns the needle by an angle that goes with the heading.
"""

from __future__ import annotations

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.scene import Scene

WAVES = 48  # plane waves that the random angle is made of: its correlation is then Gaussian within a few per cent
STEEL = "steel"
HIGHEST = 2.5  # m: what hangs above it is too far from a compass


def standing_steel(scene: Scene) -> Array:
    """(n, 4) m: x, y and half edges along them of the boxes of steel that stand, as seen from above; turned ones by their bounds."""
    boxes = scene.static_boxes()
    kinds = [i for i, name in enumerate(scene.materials) if name == STEEL]
    chosen = boxes.take(np.isin(boxes.material, kinds) & (boxes.center[:, 2] - boxes.half[:, 2] < HIGHEST))
    reach = (np.abs(frames.matrix(chosen.quaternion)) @ chosen.half[..., None])[..., 0]
    return np.unique(np.round(np.concatenate([chosen.center[:, :2], reach[:, :2]], axis=1), 3), axis=0)


def distance_to(steel: Array, position: Array, chunk: int = 512) -> Array:
    """(K,) m: from each position (K, 2) to the nearest of the rectangles `steel` (n, 4); inf where there is none."""
    nearest = np.full(len(position), np.inf)
    for first in range(0, len(steel), chunk):
        part = steel[first : first + chunk]
        beyond = np.maximum(np.abs(position[:, None] - part[:, :2]) - part[:, 2:], 0.0)
        nearest = np.minimum(nearest, np.hypot(beyond[..., 0], beyond[..., 1]).min(axis=1))
    return nearest


def random_angle(position: Array, length: float, random: np.random.Generator) -> Array:
    """(K,): a random field of unit variance at positions (K, 2) m, with correlation exp(-r² / (2 length²)) over r m.

    A sum of plane waves of random direction and phase: Shinozuka and Deodatis 1991, "Simulation of stochastic processes by
    spectral representation", Appl. Mech. Rev. 44.
    """
    wave = random.standard_normal((WAVES, 2)) / length
    phase = random.uniform(0.0, 2 * np.pi, WAVES)
    return np.sqrt(2 / WAVES) * np.cos(position @ wave.T + phase).sum(axis=1)
