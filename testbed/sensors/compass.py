"""A compass: the yaw of a body, with a bias, an error that wanders, one that belongs to the place, and noise.

The wandering error is an Ornstein-Uhlenbeck process (stationary, exponential correlation). What steel does to a compass is in
`testbed.sensors.steel`.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from scipy.signal import lfilter
from scipy.special import i0e

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Degrees, Metres, Seconds
from testbed.rng import Counter, stream
from testbed.scene import Scene
from testbed.sensors.carrier import Carried, CarriedConfig
from testbed.sensors.steel import distance_to, random_angle, standing_steel
from testbed.types import Heading
from testbed.units import wrap


class CompassConfig(CarriedConfig):
    """heading = yaw + bias + wandering error + error by steel + noise, wrapped into (-π, π]. The bias is drawn once a trial.

    noise_kappa : the noise of a sample is von Mises with this concentration, instead of normal with `noise_std_deg`
    steel       : steel_std_deg is the standard deviation, over places and trials, of the error beside steel; it falls off with the
    distance d to the nearest as exp(-½ (d / steel_reach_m)²), and is one for places much nearer to each other than steel_length_m
    """

    bias_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 2.0
    noise_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 1.0
    noise_kappa: Annotated[float, Field(ge=0, le=1e6)] | None = None
    wander_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 0.0
    wander_time_s: Annotated[Seconds, Field(gt=0, le=3600)] = 5.0
    steel_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 0.0
    steel_reach_m: Annotated[Metres, Field(gt=0, le=100)] = 2.0
    steel_length_m: Annotated[Metres, Field(gt=0, le=1000)] = 5.0


class Compass(Carried):
    """Samples the yaw of one body at a fixed rate."""

    Config: ClassVar[type[CompassConfig]] = CompassConfig
    produces: ClassVar[frozenset[str]] = frozenset({"heading"})

    def __init__(self, config: CompassConfig, id: str, scene: Scene) -> None:
        super().__init__(config, id, scene)
        self._steel = standing_steel(scene) if config.steel_std_deg else np.empty((0, 4))

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """The whole trial's samples."""
        config = self._config
        body, t, columns = self.samples(around)
        bias = config.bias_std_deg * stream(around.root, around.trial, f"{self._name}.bias").standard_normal()
        noise, sample = Counter(around.root, around.trial, f"{self._name}.noise"), np.arange(len(t))
        pose = around.truth.pose(body, t)
        error = np.deg2rad(bias + self._wander(noise.normal(1, sample)) + self._by_steel(around, pose[:, :2]))
        if config.noise_kappa is None:
            error = error + np.deg2rad(config.noise_std_deg) * noise.normal(0, sample)
        else:
            error = error + von_mises(noise.uniform(0, sample), config.noise_kappa)
        heading = wrap(frames.yaw_of(pose[:, 3:]) + error)
        return Sensed({"heading": Heading(**columns, heading=heading)})

    def _wander(self, drive: Array) -> Array:
        """(K,) deg: the stationary Ornstein-Uhlenbeck process driven by standard normals (K,), exact at the sample times."""
        keep = np.exp(-1 / (self._config.rate_hz * self._config.wander_time_s))
        scaled = drive * np.sqrt(1 - keep**2)
        scaled[0] = drive[0]  # starts in the stationary state
        return self._config.wander_std_deg * np.asarray(lfilter([1.0], [1.0, -keep], scaled))

    def _by_steel(self, around: Surroundings, position: Array) -> Array | float:
        """(K,) deg at positions (K, 2) m."""
        config = self._config
        if not config.steel_std_deg:
            return 0.0
        near = np.exp(-0.5 * (distance_to(self._steel, position) / config.steel_reach_m) ** 2)
        random = stream(around.root, around.trial, f"{self._name}.steel")
        return config.steel_std_deg * near * random_angle(position, config.steel_length_m, random)


POINTS = 20_001  # of the table: its error is below 1e-4 rad up to κ = 1e4


def von_mises(uniform: Array, kappa: float) -> Array:
    """Angles (K,) in [-π, π] about 0 from uniforms (K,): the inverse of the von Mises distribution's integral, by table.

    By inversion, so that a draw stays a function of its own index (rejection takes a random number of draws).
    """
    angle, share = _integral(float(kappa))
    return np.interp(uniform, share, angle)


@cache
def _integral(kappa: float) -> tuple[Array, Array]:
    width = min(np.pi, 12.0 / np.sqrt(max(kappa, 1e-12)))  # the rest of the circle holds less than 1e-30
    angle = np.linspace(-width, width, POINTS)
    density = np.exp(kappa * (np.cos(angle) - 1)) / (2 * np.pi * i0e(kappa))
    share = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return angle, share / share[-1]
