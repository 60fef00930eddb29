"""What sensors that ride on a body share: which body, which target it is, and when they sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.plugins import suggest
from testbed.protocols import Surroundings
from testbed.scene import Scene, Truth
from testbed.units import wrap


@dataclass(frozen=True)
class Carried:
    """A moving body by name, found in the scene when the sensor is made. ValueError where it is not there or never moves."""

    body: str

    @classmethod
    def by(cls, scene: Scene, name: str) -> Carried:
        if name not in scene.moving_names:
            raise ValueError(f"on: no moving body is named {name!r}{suggest(name, list(scene.moving_names))}")
        return cls(name)

    def target(self, around: Surroundings) -> int:
        """Index of the first target on this body, -1 where it carries none (its samples then speak of nobody)."""
        return next((i for i, body in enumerate(around.target_bodies) if body == self.body), -1)


def instants(duration: float, rate: float) -> Array:
    """(K,) s: 0, 1/rate, ... up to `duration`."""
    return np.arange(int(np.floor(duration * rate + 1e-9)) + 1) / rate


def forward_speed(truth: Truth, body: int, t: Array) -> Array:
    """(K,) m/s: speed of a moving body's origin along its own +x."""
    forward = frames.rotate(truth.pose(body, t)[:, 3:], np.array([1.0, 0.0, 0.0]))
    return np.einsum("ki,ki->k", forward, truth.velocity(body, t))


def yaw_rate(truth: Truth, body: int, t: Array) -> Array:
    """(K,) rad/s, by a central difference over 2 ms."""
    h = 1e-3
    return wrap(frames.yaw_of(truth.pose(body, t + h)[:, 3:]) - frames.yaw_of(truth.pose(body, t - h)[:, 3:])) / (2 * h)
