"""Particles on the floor for B rows at once: where they begin, how they are weighed and resampled, and what they say."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from estimators.belief import StatusConfig, status_of
from estimators.resampling import effective_number, systematic
from testbed.quantity import Metres, Point2
from testbed.types import POSITION, Array, Estimate, Prior, RowRandom, Site

TRIES = 8  # draws from a prior before a particle is put anywhere in the box


class CloudConfig(StatusConfig):
    """`particles` a row. `margin_m`: particles stay in the box of the site's antennas and so much beyond; nothing holds them without it.

    `box_m`: two corners of the floor that they stay on instead, where the outer walls are known.

    `jitter_m`: how far an heir is put from its ancestor, on each axis, so that copies don't stay copies.
    """

    particles: Annotated[int, Field(ge=10, le=100_000)] = 1000
    margin_m: Annotated[Metres, Field(ge=0, le=1000)] | None = 2.0
    box_m: tuple[Point2, Point2] | None = None
    jitter_m: Annotated[Metres, Field(ge=0, le=10)] = 0.05


class FloorCloud:
    """B clouds of N particles: place (B, N, 2) m, height (B, N) m, and logarithms of weights (B, N).

    Methods add arrays (B, N, ...) of their own to `own`; these go with their particle when it has heirs, put off by a normal draw of the
    standard deviation in `rough`, where there is one.
    """

    def __init__(self, config: CloudConfig, site: Site, random: RowRandom, prior: Prior) -> None:
        self._config, self.random = config, random
        rows, n = prior.rows, config.particles
        self.low, self.high = _box(site, config)
        self.time, self.heard = np.array(prior.t), np.array(prior.t)
        self.log_weight = np.zeros((rows, n))
        self.place = self._begun(prior, n)
        spread = np.sqrt(np.maximum(prior.covariance[:, 2, 2], 0.0))
        self.height = prior.mean[:, 2, None] + spread[:, None] * random.normal(n)
        self.own: dict[str, Array] = {}
        self.rough: dict[str, float] = {}

    def _begun(self, prior: Prior, n: int) -> Array:
        """(B, n, 2): draws from the prior; those that fall outside of the box are drawn again, at last anywhere in it."""
        std = np.sqrt(np.maximum(np.einsum("bii->bi", prior.covariance)[:, :2], 0.0))
        place = np.full((prior.rows, n, 2), np.nan)
        for _ in range(TRIES):
            drawn = prior.mean[:, None, :2] + std[:, None] * self.random.normal(2 * n).reshape(-1, n, 2)
            fits = ((drawn >= self.low) & (drawn <= self.high)).all(axis=2) & np.isnan(place[..., 0])
            place[fits] = drawn[fits]
        anywhere = self.random.uniform(2 * n).reshape(-1, n, 2)
        low, high = np.maximum(self.low, prior.mean[:, None, :2] - 1e3), np.minimum(self.high, prior.mean[:, None, :2] + 1e3)
        return np.where(np.isnan(place), low + anywhere * (high - low), place)

    def moved(self, rows: Array, step: Array) -> None:
        """Particles of the rows (R,) go by `step` (R, N, 2) m, and stay in the box."""
        self.place[rows] = np.clip(self.place[rows] + step, self.low, self.high)

    def weigh(self, rows: Array, log_likelihood: Array) -> Array:
        """Take log-likelihoods (R, N) for the rows, resample those come down to few particles; (R,) log of the mean likelihood."""
        before = self.log_weight[rows]
        total = _log_sum(before)
        self.log_weight[rows] = before + log_likelihood
        after = _log_sum(self.log_weight[rows])
        self.log_weight[rows] -= after[:, None]
        weight = np.exp(self.log_weight[rows])
        poor = rows[effective_number(weight) < self._config.particles / 2]
        if len(poor):
            self._resample(poor)
        self.heard[rows] = self.time[rows]
        return after - total

    def _resample(self, rows: Array) -> None:
        n = self._config.particles
        chosen = systematic(np.exp(self.log_weight[rows]), self.random.uniform(1, rows)[:, 0])
        self.height[rows] = _picked(self.height[rows], chosen)
        for name, array in self.own.items():
            array[rows] = _picked(array[rows], chosen)
            if name in self.rough:
                array[rows] += self.rough[name] * self.random.normal(array[0].size, rows).reshape(len(rows), *array.shape[1:])
        self.place[rows] = _picked(self.place[rows], chosen)
        self.moved(rows, self._config.jitter_m * self.random.normal(2 * n, rows).reshape(-1, n, 2))
        self.log_weight[rows] = -np.log(n)

    def weights(self) -> Array:
        """(B, N), each row of sum 1."""
        weight = np.exp(self.log_weight - self.log_weight.max(axis=1, keepdims=True))
        return weight / weight.sum(axis=1, keepdims=True)

    def points(self) -> Array:
        """(B, N, 3) m."""
        return np.concatenate([self.place, self.height[..., None]], axis=2)

    def estimate(self) -> Estimate:
        """Mean and covariance of each cloud, with the status that the silence gives."""
        weight, points = self.weights(), self.points()
        mean = np.einsum("bn,bni->bi", weight, points)
        apart = points - mean[:, None]
        covariance = np.einsum("bn,bni,bnj->bij", weight, apart, apart)
        covariance = (covariance + covariance.transpose(0, 2, 1)) / 2 + 1e-8 * np.eye(3)
        return Estimate(POSITION, mean, covariance, status_of(self.time - self.heard, self._config))


def student(z: Array, freedom: float) -> Array:
    """Logarithm of Student's t density of the standardised z, without its constant: far out it falls by powers, not as e^-z²."""
    return -(freedom + 1) / 2 * np.log1p(z**2 / freedom)


def _box(site: Site, config: CloudConfig) -> tuple[Array, Array]:
    if config.box_m is not None:
        corners = np.array(config.box_m)
        return corners.min(axis=0), corners.max(axis=0)
    margin = config.margin_m
    fixed = site.antennas.position[site.antennas.carrier == ""][:, :2]
    if margin is None or not len(fixed):
        return np.full(2, -np.inf), np.full(2, np.inf)
    return fixed.min(axis=0) - margin, fixed.max(axis=0) + margin


def _picked(array: Array, chosen: Array) -> Array:
    index = chosen.reshape(*chosen.shape, *(1,) * (array.ndim - 2))
    return np.take_along_axis(array, index, axis=1)


def _log_sum(a: Array) -> Array:
    top = a.max(axis=1)
    return top + np.log(np.exp(a - top[:, None]).sum(axis=1))
