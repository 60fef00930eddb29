"""How a target is believed to move between its measurements."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numba import njit
from pydantic import Field

from testbed.quantity import Config
from testbed.types import Array


class MotionConfig(Config):
    """Constant velocity with noise in the acceleration.

    white_acceleration: continuous white noise of spectral density `acceleration_density_m2ps3`. The belief after 1 s is the same whether
    it was reached in one step or in a hundred. piecewise_acceleration: an acceleration of standard deviation `acceleration_std_mps2`,
    constant between events and new at each: many textbooks' choice, but the more events a second, the smaller its effect.
    """

    process_noise: Literal["white_acceleration", "piecewise_acceleration"] = "white_acceleration"
    acceleration_density_m2ps3: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    acceleration_std_mps2: Annotated[float, Field(ge=0, le=1e3)] = 0.4


class ConstantVelocity:
    """Positions and velocities of `targets` points in `axes` dimensions, stacked as [p v] target after target.

    State (n,) with n = 2 · axes · targets: for one target in space (x, y, z, vx, vy, vz).
    """

    def __init__(self, config: MotionConfig, axes: int = 3, targets: int = 1) -> None:
        first = 2 * axes * np.repeat(np.arange(targets), axes) + np.tile(np.arange(axes), targets)
        self.position, self.velocity = first, first + axes
        self.n = 2 * axes * targets
        self._white = config.process_noise == "white_acceleration"
        self._intensity = config.acceleration_density_m2ps3 if self._white else config.acceleration_std_mps2**2

    def noise(self, dt: Array) -> tuple[Array, Array, Array]:
        """Variances added over dt (...,) s to position, between position and velocity, and to velocity, the same on each axis."""
        q = self._intensity
        if self._white:
            return q * dt**3 / 3, q * dt**2 / 2, q * dt
        return q * dt**4 / 4, q * dt**3 / 2, q * dt**2

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """Transition F (n, n) and noise Q (n, n) over one interval, as filters for one target want them."""
        transition, q = np.eye(self.n), np.zeros((self.n, self.n))
        transition[self.position, self.velocity] = dt
        pp, pv, vv = self.noise(np.asarray(dt))
        q[self.position, self.position], q[self.velocity, self.velocity] = pp, vv
        q[self.position, self.velocity] = q[self.velocity, self.position] = pv
        return transition, q

    def advance(self, mean: Array, covariance: Array, dt: Array) -> None:
        """x = F x and P = F P Fᵀ + Q in place, each row over its own dt (B,) >= 0 s; rows with dt 0 are left alone, bit for bit."""
        _advance(mean, covariance, dt, self.position, self.velocity, *self.noise(dt))


@njit(cache=True, error_model="numpy")
def _advance(mean, covariance, dt, position, velocity, pp, pv, vv):
    n = mean.shape[1]
    for b in range(len(dt)):
        h = dt[b]
        if h == 0.0:
            continue
        x, p = mean[b], covariance[b]
        for k in range(len(position)):  # F adds h times the velocity's row to the position's, then the same with columns
            i, j = position[k], velocity[k]
            x[i] += h * x[j]
            for c in range(n):
                p[i, c] += h * p[j, c]
        for k in range(len(position)):
            i, j = position[k], velocity[k]
            for r in range(n):
                p[r, i] += h * p[r, j]
        for k in range(len(position)):
            i, j = position[k], velocity[k]
            p[i, i] += pp[b]
            p[i, j] += pv[b]
            p[j, i] += pv[b]
            p[j, j] += vv[b]
        for i in range(n):
            for j in range(i):
                p[i, j] = p[j, i]
