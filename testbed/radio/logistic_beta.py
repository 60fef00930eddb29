"""Detection counts from the published model: a logistic mean over distance and angle, a Beta spread, and dead zones.

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering" (Eqs. 2-7):

    m(d, θ) = 1 / (1 + exp(-4.9433 + 0.8370 d + 0.0552 |θ|))                d in m, θ in degrees off boresight
    v(d, θ) = 0.05 (1 - ((d - 5.5)/4)² - (θ/60)²)                           >= 0, 0 beyond 10 m, at most 0.6 m(1 - m)
    λ ~ Beta with mean m and variance v (λ = m where v is 0),  n ~ Binomial(N, λ),  n = 0 where the count is dead
    P(dead) = 1 - (1 - g)(1 - r),  r ~ Beta(0.9, 17.1)

The values of v are assumed: the paper holds none. g in [0, 1] is how much of the way geometry closes (one less the soft line of
sight); r is what is left over, redrawn per `scope`. The paper is g = 0 and scope "count". This source of counts stands for
itself: obstacles that set g don't lower m as well, and nothing of the link budget enters. So left out are power, carrier, the
antenna's pattern and polarisation, the tag's model and how it hangs, and other tags that want the reader's time.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.special import betaincinv

from testbed.columns import Array
from testbed.quantity import Config
from testbed.rng import Counter

LOGIT = (-4.9433, 0.8370, 0.0552)  # constant, per metre, per degree
WIDEST, MIDDLE, HALF_RANGE, HALF_ANGLE, FARTHEST = 0.05, 5.5, 4.0, 60.0, 10.0
SHARE = 0.6  # of m(1 - m), which no variance reaches
NEVER = 30.0  # m: on boresight a query is answered there once in 600 million

Scope = Literal["count", "round", "antenna", "run"]


class DeadZoneConfig(Config):
    """The residual dead zone r ~ Beta(alpha, beta), and how long a draw of it holds.

    count: for one antenna, round and tag; round: for one antenna and round, whoever answers; antenna: for one antenna, all the
    time; run: for all. Whether a count is dead is drawn for each count in any case.
    """

    alpha: Annotated[float, Field(gt=0, le=1e4)] = 0.9
    beta: Annotated[float, Field(gt=0, le=1e4)] = 17.1
    scope: Scope = "count"


def mean(distance: ArrayLike, angle: ArrayLike) -> Array:
    """m for distances (m) and angles off boresight (rad), broadcast."""
    a, b, c = LOGIT
    return 1 / (1 + np.exp(a + b * np.asarray(distance, dtype=np.float64) + c * np.abs(np.rad2deg(angle))))


def variance(distance: ArrayLike, angle: ArrayLike) -> Array:
    """v for distances (m) and angles off boresight (rad), broadcast."""
    d, degrees = np.broadcast_arrays(np.asarray(distance, dtype=np.float64), np.rad2deg(angle))
    raw = WIDEST * (1 - ((d - MIDDLE) / HALF_RANGE) ** 2 - (degrees / HALF_ANGLE) ** 2)
    m = mean(distance, angle)
    return np.where(d > FARTHEST, 0.0, np.clip(raw, 0.0, SHARE * m * (1 - m)))


def beta_of(mean: ArrayLike, variance: ArrayLike) -> tuple[Array, Array]:
    """(α, β) of the Beta distribution with that mean and variance; infinite where the variance is 0."""
    m, v = np.asarray(mean, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    with np.errstate(divide="ignore"):
        strength = m * (1 - m) / v - 1
    return m * strength, (1 - m) * strength


def counts(mean: Array, variance: Array, queries: int, draws: Counter, keys: tuple[Array, ...]) -> Array:
    """(N,) int64 counts of N blocks of `queries` queries each, dead zones aside. `keys` are integers that identify each block."""
    probability, spread = np.array(mean), np.flatnonzero(variance > 0)
    u = draws.uniform(np.int64(0), *(k[spread] for k in keys))
    probability[spread] = betaincinv(*beta_of(mean[spread], variance[spread]), u)
    return sum((draws.uniform(np.int64(1), *keys, np.int64(q)) < probability for q in range(queries)), np.zeros(len(mean), dtype=np.int64))


def alive(distance: Array, angle: Array, queries: int, draws: Counter, keys: tuple[Array, ...]) -> Array:
    """(N,) int64 counts of N blocks over distances (m) and angles (rad), dead zones aside. Farther off than NEVER nobody answers."""
    n, near = np.zeros(len(distance), dtype=np.int64), np.flatnonzero(distance < NEVER)
    d, a = distance[near], angle[near]
    n[near] = counts(mean(d, a), variance(d, a), queries, draws, tuple(k[near] for k in keys))
    return n


def residual(config: DeadZoneConfig, draws: Counter, antenna: Array, round: Array, tag: Array) -> Array:
    """(N,) r for counts of antennas, rounds and tags by their keys (N,), shared as far as the scope goes."""
    shared = {"count": (antenna, round, tag), "round": (antenna, round), "antenna": (antenna,), "run": ()}[config.scope]
    u = np.broadcast_to(draws.uniform(np.int64(2), *shared), np.shape(tag))
    return betaincinv(config.alpha, config.beta, u)


def blocks(
    distance: Array,
    angle: Array,
    geometric: ArrayLike,
    queries: int,
    config: DeadZoneConfig,
    draws: Counter,
    keys: tuple[Array, Array, Array],
) -> Array:
    """(N,) int64: how often tags are read in N blocks of `queries` queries; keys are those of antennas, rounds and tags (N,) each."""
    n = alive(distance, angle, queries, draws, keys)
    return np.where(dead(geometric, residual(config, draws, *keys), draws, keys), 0, n)


def dead(geometric: ArrayLike, residual: Array, draws: Counter, keys: tuple[Array, ...]) -> Array:
    """(N,) bool: dead with probability 1 - (1 - g)(1 - r), a draw for each count."""
    alive = (1 - np.asarray(geometric, dtype=np.float64)) * (1 - residual)
    return draws.uniform(np.int64(3), *keys) >= alive
