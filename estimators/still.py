"""How a thing is believed to stand still: a position that hardly moves, and a velocity of which only its smallness is known."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed.quantity import Config, MetresPerSecond
from testbed.types import Array


class StillConfig(Config):
    """`still_speed_std_mps`: velocities of what stands are within it. `still_wander_m2ps`: variance that a second adds to a position."""

    still_speed_std_mps: Annotated[MetresPerSecond, Field(gt=0, le=10)] = 0.02
    still_wander_m2ps: Annotated[float, Field(ge=0, le=10)] = 1e-4


class Still:
    """A motion model beside `ConstantVelocity`: whatever the velocity was, after any time it is 0 but for its deviation."""

    n = 6

    def __init__(self, config: StillConfig) -> None:
        self._variance, self._wander = config.still_speed_std_mps**2, config.still_wander_m2ps

    def advance(self, mean: Array, covariance: Array, dt: Array) -> None:
        """In place, each row over its own dt (B,) >= 0 s; rows with dt 0 are left alone, bit for bit."""
        gone = dt > 0
        axes = np.arange(3)
        mean[gone, 3:] = 0.0
        moved = covariance[gone]
        moved[:, 3:], moved[:, :, 3:] = 0.0, 0.0
        moved[:, axes + 3, axes + 3] = self._variance
        moved[:, axes, axes] += (self._wander * dt[gone])[:, None]
        covariance[gone] = moved
