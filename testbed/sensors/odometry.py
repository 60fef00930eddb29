"""An odometer: speed and yaw rate of a body, with scale, bias and noise.

Speed is that of the body's origin along its own +x. Left out: slip beyond what a dynamic body really does, and scale that
changes with the load.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed import types
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import DegreesPerSecond, MetresPerSecond
from testbed.rng import Counter, stream
from testbed.sensors.carrier import Carried, CarriedConfig, forward_speed, yaw_rate


class OdometryConfig(CarriedConfig):
    """speed = (1 + scale) v + bias + noise, yaw rate likewise without scale.

    Scale and biases are drawn once a trial, normal with the spreads given; to the bias of the speed comes a draw from
    U(-bias_range_mps, bias_range_mps). Noise is white and normal, once a sample.
    """

    scale_std: Annotated[float, Field(ge=0, le=1)] = 0.01
    bias_std_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.0
    bias_range_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.0
    noise_std_mps: Annotated[MetresPerSecond, Field(ge=0, le=10)] = 0.02
    yaw_bias_std_dps: Annotated[DegreesPerSecond, Field(ge=0, le=90)] = 0.1
    yaw_noise_std_dps: Annotated[DegreesPerSecond, Field(ge=0, le=90)] = 0.2


class Odometry(Carried):
    """Samples speed and yaw rate of one body at a fixed rate."""

    Config: ClassVar[type[OdometryConfig]] = OdometryConfig
    produces: ClassVar[frozenset[str]] = frozenset({"odometry"})

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """The whole trial's samples."""
        config, truth = self._config, around.truth
        body, t, columns = self.samples(around)
        constant = stream(around.root, around.trial, f"{self._name}.constants").standard_normal(3)
        anywhere = stream(around.root, around.trial, f"{self._name}.bias").uniform(-1.0, 1.0)
        noise, sample = Counter(around.root, around.trial, f"{self._name}.noise"), np.arange(len(t))
        bias = config.bias_std_mps * constant[1] + config.bias_range_mps * anywhere
        speed = (1 + config.scale_std * constant[0]) * forward_speed(truth, body, t) + bias
        turning = yaw_rate(truth, body, t) + np.deg2rad(config.yaw_bias_std_dps) * constant[2]
        odometry = types.Odometry(
            **columns,
            speed=speed + config.noise_std_mps * noise.normal(0, sample),
            yaw_rate=turning + np.deg2rad(config.yaw_noise_std_dps) * noise.normal(1, sample),
        )
        return Sensed({"odometry": odometry})
