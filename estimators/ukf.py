"""An unscented Kalman filter on received power, for all rows at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from estimators import kalman
from estimators.filtering import FilterConfig, PowerFilter, diagonal, stacked
from estimators.measurements import Piece
from testbed.types import Array, RowRandom, Site, UpdateInfo


class UkfConfig(FilterConfig):
    """The section of a `ukf`: where its sigma points lie (α, β, κ), and the rest as for an `ekf`."""

    alpha: Annotated[float, Field(ge=1e-3, le=2)] = 0.3
    beta: Annotated[float, Field(ge=0, le=10)] = 2.0
    kappa: Annotated[float, Field(gt=-6, le=100)] = 0.0


class Ukf(PowerFilter):
    """State (x, y, z, vx, vy, vz), constant velocity; every read (or snapshot of reads) is taken through 13 sigma points.

    The motion is linear, so it is predicted in closed form, which is what the points would give; they are drawn afresh from the present
    belief for each read, two reads at one time included. The default α keeps the points within the doubt: with α = 1 they lie at √6
    standard deviations, often behind the antenna, where the pattern tells another story. α = 1, β = κ = 0 has no negative weight.
    Breaks as the `ekf` does where a belief has several modes, and drifts away from the antennas where doubt is wide.
    """

    Config = UkfConfig

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        super().__init__(config, site, rng)
        self._weights = kalman.Weights.merwe(self._motion.n, config.alpha, config.beta, config.kappa)

    def _correct(self, row: Array, pieces: Sequence[Piece]) -> UpdateInfo:
        belief = self._belief
        points = kalman.sigma_points(belief.mean, belief.covariance, row, self._weights)
        apart = [piece.z[:, None] - piece.expected(points) for piece in pieces]
        innovation = np.ascontiguousarray(apart[0] if len(apart) == 1 else np.concatenate(apart, axis=-1))
        limits = kalman.gate_limits(self._config.gate, innovation.shape[2])
        noise = diagonal(stacked([piece.variance for piece in pieces]))
        return kalman.unscented_update(belief.mean, belief.covariance, row, points, innovation, noise, self._weights, limits)
