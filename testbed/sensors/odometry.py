"""An odometer: speed and yaw rate of a body, with scale, bias and noise.

Speed is that of the body's origin along its own +x. Left out: slip beyond what a dynamic body really does, and scale that
changes with the load.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed import types
from testbed.columns import Array
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Config, DegreesPerSecond, Hertz, MetresPerSecond, Seconds
from testbed.rng import Counter, stream
from testbed.scene import Scene
from testbed.sensors.carrier import Carried, forward_speed, instants, yaw_rate
from testbed.types import Antennas


class OdometryConfig(Config):
    """speed = (1 + scale) v + bias + noise, yaw rate likewise without scale.

    Scale and biases are drawn once a trial, normal with the spreads given; noise is white, once a sample.
    """

    on: str
    rate_hz: Annotated[Hertz, Field(gt=0, le=1000)] = 10.0
    scale_std: Annotated[float, Field(ge=0, le=1)] = 0.01
    bias_std_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.0
    noise_std_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.02
    yaw_bias_std_dps: Annotated[DegreesPerSecond, Field(ge=0, le=90)] = 0.1
    yaw_noise_std_dps: Annotated[DegreesPerSecond, Field(ge=0, le=90)] = 0.2
    latency_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.0


class Odometry:
    """Samples speed and yaw rate of one body at a fixed rate."""

    Config: ClassVar[type[OdometryConfig]] = OdometryConfig
    produces: ClassVar[frozenset[str]] = frozenset({"odometry"})

    def __init__(self, config: OdometryConfig, id: str, scene: Scene) -> None:
        self._config, self._name, self._carried = config, f"sensors.{id}", Carried.by(scene, config.on)

    def antennas(self) -> Antennas:
        """None."""
        return Antennas.empty()

    def frequencies(self) -> Array:
        """None."""
        return np.empty(0)

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """The whole trial's samples."""
        config, truth = self._config, around.truth
        body, t = truth.index(self._carried.body), instants(around.duration, config.rate_hz)
        constant = stream(around.root, around.trial, f"{self._name}.constants").standard_normal(3)
        noise, sample = Counter(around.root, around.trial, f"{self._name}.noise"), np.arange(len(t))
        speed = (1 + config.scale_std * constant[0]) * forward_speed(truth, body, t) + config.bias_std_mps * constant[1]
        turning = yaw_rate(truth, body, t) + np.deg2rad(config.yaw_bias_std_dps) * constant[2]
        odometry = types.Odometry(
            t=t,
            t_arrival=t + config.latency_s,
            carrier=np.full(len(t), self._carried.target(around)),
            speed=speed + config.noise_std_mps * noise.normal(0, sample),
            yaw_rate=turning + np.deg2rad(config.yaw_noise_std_dps) * noise.normal(1, sample),
        )
        return Sensed({"odometry": odometry})
