"""A compass: the yaw of a body, with a bias, an error that wanders, and noise.

The wandering error is an Ornstein-Uhlenbeck process (stationary, exponential correlation). Left out: the disturbance by steel at a
given place; it wanders in time, not in space.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from scipy.signal import lfilter

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Degrees, Seconds
from testbed.rng import Counter, stream
from testbed.sensors.carrier import Carried, CarriedConfig
from testbed.types import Heading
from testbed.units import wrap


class CompassConfig(CarriedConfig):
    """heading = yaw + bias + wandering error + noise, wrapped into (-π, π]. The bias is drawn once a trial."""

    bias_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 2.0
    noise_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 1.0
    wander_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 0.0
    wander_time_s: Annotated[Seconds, Field(gt=0, le=3600)] = 5.0


class Compass(Carried):
    """Samples the yaw of one body at a fixed rate."""

    Config: ClassVar[type[CompassConfig]] = CompassConfig
    produces: ClassVar[frozenset[str]] = frozenset({"heading"})

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """The whole trial's samples."""
        config = self._config
        body, t, columns = self.samples(around)
        bias = config.bias_std_deg * stream(around.root, around.trial, f"{self._name}.bias").standard_normal()
        noise, sample = Counter(around.root, around.trial, f"{self._name}.noise"), np.arange(len(t))
        error = bias + config.noise_std_deg * noise.normal(0, sample) + self._wander(noise.normal(1, sample))
        heading = wrap(frames.yaw_of(around.truth.pose(body, t)[:, 3:]) + np.deg2rad(error))
        return Sensed({"heading": Heading(**columns, heading=heading)})

    def _wander(self, drive: Array) -> Array:
        """(K,) deg: the stationary Ornstein-Uhlenbeck process driven by standard normals (K,), exact at the sample times."""
        keep = np.exp(-1 / (self._config.rate_hz * self._config.wander_time_s))
        scaled = drive * np.sqrt(1 - keep**2)
        scaled[0] = drive[0]  # starts in the stationary state
        return self._config.wander_std_deg * np.asarray(lfilter([1.0], [1.0, -keep], scaled))
