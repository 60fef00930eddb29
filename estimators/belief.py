"""The Gaussian beliefs of B rows over time, which every Kalman filter here keeps: present time, mean, covariance, and status."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from estimators.motion import ConstantVelocity
from testbed.quantity import Config, Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Prior, Status


class StatusConfig(Config):
    """After how long without a used read a row says that it is coasting, and that it is lost. It takes reads all the same."""

    coast_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 1.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 10.0


def status_of(silent: Array, config: StatusConfig) -> Array:
    """(B,) int8 from the seconds since the last used read."""
    coasting = np.where(silent > config.coast_s, Status.COASTING, Status.OK)
    return np.where(silent > config.lost_s, Status.LOST, coasting).astype(np.int8)


class Belief:
    """B Gaussians over the state of a motion model. Updates change `mean` and `covariance` in place, for some rows.

    ValueError where the prior does not speak of position and velocity.
    """

    def __init__(self, prior: Prior, motion: ConstantVelocity, config: StatusConfig) -> None:
        if prior.components != POSITION_VELOCITY:
            raise ValueError(f"a prior over position and velocity is wanted, this one is over {', '.join(prior.components)}")
        self.mean, self.covariance = np.array(prior.mean), np.array(prior.covariance)
        self._motion, self._config = motion, config
        self._time, self._heard = np.array(prior.t), np.array(prior.t)

    def predict(self, t: Array) -> None:
        """Bring every row to t (B,) s; rows that are there already stay as they are, bit for bit."""
        self._motion.advance(self.mean, self.covariance, np.maximum(t - self._time, 0.0))
        self._time = np.array(t)

    def heard(self, rows: Array, used: Array) -> None:
        """The rows for which `used` holds took something at their present time."""
        rows = rows[used]
        self._heard[rows] = self._time[rows]

    def estimate(self) -> Estimate:
        """Copies of what is believed now, with the status that the silence gives."""
        return Estimate(POSITION_VELOCITY, self.mean.copy(), self.covariance.copy(), status_of(self._time - self._heard, self._config))
