"""What sensors that ride on a body share: which body, which target it is, and when they sample."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from testbed import frames
from testbed.columns import Array
from testbed.plugins import suggest
from testbed.protocols import Surroundings
from testbed.quantity import Config, Hertz, Seconds
from testbed.scene import Scene, Truth
from testbed.types import Antennas
from testbed.units import wrap


class CarriedConfig(Config):
    """Which body carries it, how often it samples, and how late its samples arrive."""

    on: str
    rate_hz: Annotated[Hertz, Field(gt=0, le=1000)] = 10.0
    latency_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.0


class Carried:
    """Base of a sensor without a radio that rides on a moving body. ValueError where the body is not there or never moves."""

    def __init__(self, config: Any, id: str, scene: Scene) -> None:
        if config.on not in scene.moving_names:
            raise ValueError(f"on: no moving body is named {config.on!r}{suggest(config.on, list(scene.moving_names))}")
        self._config, self._name = config, f"sensors.{id}"

    def antennas(self) -> Antennas:
        """None."""
        return Antennas.empty()

    def frequencies(self) -> Array:
        """None."""
        return np.empty(0)

    def samples(self, around: Surroundings) -> tuple[int, Array, dict[str, Array]]:
        """The body's index in the truth, the instants (K,) s, and the columns that every such stream begins with.

        The carrier is the first target on the body, -1 where it carries none: the samples then speak of nobody.
        """
        config = self._config
        t = instants(around.duration, config.rate_hz)
        target = next((i for i, body in enumerate(around.target_bodies) if body == config.on), -1)
        columns = {"t": t, "t_arrival": t + config.latency_s, "carrier": np.full(len(t), target)}
        return around.truth.index(config.on), t, columns


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
