"""What counts a method expects of an antenna that asked a tag N times: a Beta-binomial with a dead zone, exact and as a table.

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", Eqs. 3, 4 and 7:

    P(n | d, θ) = (1 - s) C(N, n) B(n + α, N - n + β) / B(α, β) + s [n = 0],       s = 1 - (1 - g)(1 - E λ)

with mean m = 1 / (1 + exp(a1 + a2 d + a3 θ)) and variance σ² = c1 + c2 d + c3 d² + c4 θ + c5 θ², d in m and θ in degrees off boresight.
Where σ² is clipped to 0 the count is Binomial(N, m). The c are assumed (the paper holds none). g, what a map says of shelves in the
way, is the estimator's own business and 0 in the paper. The counts of the testbed come from other code (`testbed.radio.logistic_beta`).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Annotated, Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from pydantic import Field, model_validator
from scipy.special import gammaln

from testbed.quantity import Config, Metres
from testbed.types import Array

FAR = 26.0  # m, where tables end: beyond it log P is straight in d, and is taken to be
LINES_D, LINES_THETA = 521, 361  # of tables: 0.05 m and 0.5 degrees apart, so that 1.5 m, 9.5 m and 60 degrees are among them
MOST_QUERIES = 100  # a table of more would be over 80 MB


class DetectionModelConfig(Config):
    """Parameters of the observation model. Defaults: the paper's a and dead zone; the c that stand in the testbed's specification.

    farthest_m: beyond it the variance is 0. largest_share: of m (1 - m), which the variance of a Beta distribution has to stay below.
    """

    logit: tuple[float, Annotated[float, Field(gt=0)], Annotated[float, Field(ge=0)]] = (-4.9433, 0.8370, 0.0552)
    variance: tuple[float, float, float, float, float] = (-0.04453125, 0.034375, -0.003125, 0.0, -0.05 / 3600)
    farthest_m: Annotated[Metres, Field(ge=0, le=1e3)] = 10.0
    largest_share: Annotated[float, Field(gt=0, lt=1)] = 0.6
    dead_alpha: Annotated[float, Field(ge=0, le=1e6)] = 0.9
    dead_beta: Annotated[float, Field(gt=0, le=1e6)] = 17.1

    @model_validator(mode="after")
    def _told_apart(self) -> DetectionModelConfig:
        if self.dead > 0.999:
            raise ValueError(f"a dead zone of mean {self.dead:g} leaves nothing to be read: dead_beta {self.dead_beta:g} is too small")
        return self

    @property
    def dead(self) -> float:
        """E λ, the share of blocks that are dead whatever the distance."""
        return self.dead_alpha / (self.dead_alpha + self.dead_beta)


class DetectionModel:
    """The observation model of one configuration. Angles here are in degrees, as in the paper."""

    def __init__(self, config: DetectionModelConfig) -> None:
        self.config, self.dead = config, config.dead
        self._document = config.model_dump_json(include=set(DetectionModelConfig.model_fields))

    def mean(self, distance: ArrayLike, degrees: ArrayLike) -> Array:
        """E p (Eq. 3), broadcast."""
        a1, a2, a3 = self.config.logit
        return 1 / (1 + np.exp(a1 + a2 * np.asarray(distance, dtype=np.float64) + a3 * np.abs(degrees)))

    def spread(self, distance: ArrayLike, degrees: ArrayLike) -> Array:
        """Var p (Eq. 4), clipped to what a Beta distribution can have."""
        c1, c2, c3, c4, c5 = self.config.variance
        d, angle = np.broadcast_arrays(np.asarray(distance, dtype=np.float64), np.abs(degrees))
        m = self.mean(d, angle)
        raw = c1 + d * (c2 + d * c3) + angle * (c4 + angle * c5)
        return np.where(d > self.config.farthest_m, 0.0, np.clip(raw, 0.0, self.config.largest_share * m * (1 - m)))

    def log_alive(self, n: ArrayLike, queries: ArrayLike, distance: ArrayLike, degrees: ArrayLike) -> Array:
        """log of the Beta-binomial alone, no dead zone: the exact path.

        With e = 1 / (α + β) it is C(N, n) Π(m + k e) Π(1 - m + k e) / Π(1 + k e), over k below n, N - n and N: unlike a difference of
        log-Beta functions it keeps its digits as the variance, and e, go to 0, where it is the binomial distribution.
        """
        n, q, d, angle = np.broadcast_arrays(np.asarray(n, dtype=np.float64), queries, distance, degrees)
        m, v = self.mean(d, angle), self.spread(d, angle)
        e = v / (m * (1 - m) - v)
        log = gammaln(q + 1.0) - gammaln(n + 1) - gammaln(q - n + 1)
        for k in range(int(np.max(q, initial=0))):
            log = log + np.where(k < n, np.log(m + k * e), 0.0) + np.where(k < q - n, np.log1p(-m + k * e), 0.0)
            log = log - np.where(k < q, np.log1p(k * e), 0.0)
        return log

    def log_mass(self, n: ArrayLike, queries: ArrayLike, distance: ArrayLike, degrees: ArrayLike, shut: ArrayLike = 0.0) -> Array:
        """log P(n) of Eq. 7, with geometry closing a share `shut` besides the residual dead zone. Broadcast."""
        alive = (1 - self.dead) * (1 - np.asarray(shut, dtype=np.float64))
        log = self.log_alive(n, queries, distance, degrees)
        with np.errstate(divide="ignore"):
            read = log + np.log(alive)
            silent = np.log(alive * np.exp(log) + (1 - alive))
        return np.where(np.asarray(n) == 0, silent, read)

    def table(self, queries: int) -> Array:
        """(queries + 1, LINES_D, LINES_THETA) float32: log P(n) over d in [0, FAR] and θ in [0, 180] degrees."""
        return _table(self._document, queries)


@cache
def _table(document: str, queries: int) -> Any:
    if not 1 <= queries <= MOST_QUERIES:
        raise ValueError(f"blocks of {queries} queries: tables are made for 1 to {MOST_QUERIES}")
    config = DetectionModelConfig.model_validate_json(document)
    d, angle = np.linspace(0.0, FAR, LINES_D)[:, None], np.linspace(0.0, 180.0, LINES_THETA)
    model = DetectionModel(config)
    return np.stack([model.log_mass(n, queries, d, angle) for n in range(queries + 1)]).astype(np.float32)


@njit(cache=True, error_model="numpy")
def degrees_off(cosine):
    """Angle in degrees of a cosine in [-1, 1], to 4e-6 degrees: Abramowitz and Stegun 4.4.46, at a third of arccos's time."""
    x = abs(cosine)
    x = min(x, 1.0)
    p = -0.0012624911
    p = p * x + 0.0066700901
    p = p * x - 0.0170881256
    p = p * x + 0.0308918810
    p = p * x - 0.0501743046
    p = p * x + 0.0889789874
    p = p * x - 0.2145988016
    p = p * x + 1.5707963050
    angle = math.sqrt(1.0 - x) * p * 57.29577951308232
    return angle if cosine >= 0.0 else 180.0 - angle


@njit(cache=True, error_model="numpy")
def look_up(plane, distance, degrees):
    """A plane (LINES_D, LINES_THETA) of a table between its lines; straight on beyond FAR."""
    x = distance * ((LINES_D - 1) / FAR)
    y = degrees * ((LINES_THETA - 1) / 180.0)
    i = min(int(x), LINES_D - 2)
    j = min(int(y), LINES_THETA - 2)
    u = x - i
    v = y - j
    low = plane[i, j] + v * (plane[i, j + 1] - plane[i, j])
    high = plane[i + 1, j] + v * (plane[i + 1, j + 1] - plane[i + 1, j])
    return low + u * (high - low)


@njit(cache=True)
def looked_up(plane, distance, degrees):
    """`look_up` over arrays (N,)."""
    found = np.empty(len(distance))
    for k in range(len(distance)):
        found[k] = look_up(plane, distance[k], degrees[k])
    return found
