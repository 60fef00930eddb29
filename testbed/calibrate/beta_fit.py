"""The logistic-beta model of detections, fitted to blocks of counts by maximum likelihood.

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", Eqs. 3, 4 and 7: a count of N
queries is Beta-binomial with mean m = 1/(1 + exp(a1 + a2 d + a3 θ)) and variance of p c1 + c2 d + c3 d² + c4 θ + c5 θ², clipped, and 0
in a share `dead` of the blocks. The paper fits mean and variance apart; here that is where the search starts, and the likelihood of
all counts decides. Blocks of one place count as independent, which they are not where fades stay: estimates are right on average, and
what is held out is judged by whole runs (`testbed.calibrate.logistic_beta`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import betaln, expit, gammaln

from testbed.calibrate import CalibrationError
from testbed.calibrate.counts import Blocks
from testbed.columns import Array

LEAST, LARGEST = 1e-4, 0.95  # of m (1 - m): the variance's limits. Below the first, no count of 100 queries tells it from 0
FAR, WIDE = 10.0, 90.0  # m and degrees: the search is over d/FAR and θ/WIDE, so that its steps are alike
NEAR, NARROW = 0.02, 0.5  # m and degrees: places that are no farther apart count as one, so that equal counts there are taken at once
MOST_DEAD = 0.9
DRAWN = 1e-3  # per block, by which c is drawn to what squared residuals say: it decides only where the variance is at its limits


@dataclass(frozen=True)
class Fit:
    """logit: a1, a2 (1/m), a3 (1/degree); variance: c1 ... c5; dead: share of blocks that are 0 whatever the distance.

    farthest_m: the farthest that was measured; what the variance is beyond nobody knows. log_likelihood: of what it was fitted to.
    """

    logit: tuple[float, float, float]
    variance: tuple[float, float, float, float, float]
    dead: float
    farthest_m: float
    log_likelihood: float

    def mean(self, distance: Array, degrees: Array) -> Array:
        """E p, broadcast."""
        a1, a2, a3 = self.logit
        return expit(-(a1 + a2 * np.asarray(distance) + a3 * np.asarray(degrees)))

    def spread(self, distance: Array, degrees: Array) -> Array:
        """Var p, broadcast, within its limits."""
        c1, c2, c3, c4, c5 = self.variance
        m = self.mean(distance, degrees)
        raw = c1 + c2 * distance + c3 * distance**2 + c4 * degrees + c5 * degrees**2
        return np.clip(raw, LEAST * m * (1 - m), LARGEST * m * (1 - m))

    def log_mass(self, blocks: Blocks) -> Array:
        """(N,) log P(n) of each block."""
        m, v = self.mean(blocks.distance, blocks.degrees), self.spread(blocks.distance, blocks.degrees)
        return _log_mass(m, v, self.dead, blocks.n, blocks.queries)


def fit(blocks: Blocks, directional: bool = True) -> Fit:
    """The most likely model; without `directional` one of distance alone (a3 = c4 = c5 = 0), as before the paper.

    CalibrationError where the blocks can't tell: all at one distance (or, for the angle, all at one angle), or all read, or none.
    """
    _enough(blocks, directional)
    place = [np.round(blocks.distance / NEAR) * NEAR, np.round(blocks.degrees / NARROW) * NARROW]
    rows, times = np.unique(np.stack([*place, blocks.n, blocks.queries], axis=1), axis=0, return_counts=True)
    u, w, n, queries = rows[:, 0] / FAR, rows[:, 1] / WIDE * directional, rows[:, 2], rows[:, 3]
    basis = np.stack([np.ones(len(u)), u, u * u, w, w * w], axis=1)

    starts = _starts(u, w, basis, n / queries, queries, times)

    def cost(x: Array) -> float:
        m, v = _moments(x, u, w, basis)
        return -float(times @ _log_mass(m, v, x[8], n, queries)) / times.sum() + DRAWN * float(np.sum((x[3:8] - starts[0][3:8]) ** 2))

    free = (None, None) if directional else (0.0, 0.0)
    slope = (0.0, None) if directional else (0.0, 0.0)
    bounds = [(None, None), (0.01, None), slope, (None, None), (None, None), (None, None), free, free, (0.0, MOST_DEAD)]
    found = min((minimize(cost, x, method="L-BFGS-B", bounds=bounds) for x in starts), key=lambda one: float(one.fun))
    b, k = found.x[:3], found.x[3:8]
    made = Fit(
        logit=(float(b[0]), float(b[1] / FAR), float(b[2] / WIDE)),
        variance=(float(k[0]), float(k[1] / FAR), float(k[2] / FAR**2), float(k[3] / WIDE), float(k[4] / WIDE**2)),
        dead=float(found.x[8]),
        farthest_m=float(blocks.distance.max()),
        log_likelihood=0.0,
    )
    return replace(made, log_likelihood=float(made.log_mass(blocks).sum()))


def _enough(blocks: Blocks, directional: bool) -> None:
    if len(blocks) < 20:
        raise CalibrationError(f"{len(blocks)} blocks of counts are too few to fit nine numbers to: 20 are the least")
    if np.ptp(blocks.distance) < 0.5:
        raise CalibrationError(f"all counts are of {blocks.distance[0]:.2f} m: distances at least half a metre apart are wanted")
    if directional and np.ptp(blocks.degrees) < 5:
        raise CalibrationError(f"all counts are {blocks.degrees[0]:.0f}° off boresight: angles at least 5° apart are wanted")
    for value, what in ((0, "nothing was ever read"), (blocks.queries, "every query was answered")):
        if (blocks.n == value).all():
            raise CalibrationError(f"{what}: measure where the probability of detection lies between 0 and 1")


def _moments(x: Array, u: Array, w: Array, basis: Array) -> tuple[Array, Array]:
    m = np.clip(expit(-(x[0] + x[1] * u + x[2] * w)), 1e-12, 1 - 1e-12)
    return m, np.clip(basis @ x[3:8], LEAST * m * (1 - m), LARGEST * m * (1 - m))


def _log_mass(m: Array, v: Array, dead: float, n: Array, queries: Array) -> Array:
    m = np.clip(m, 1e-12, 1 - 1e-12)
    strength = m * (1 - m) / v - 1
    alpha, beta = m * strength, (1 - m) * strength
    log = gammaln(queries + 1) - gammaln(n + 1) - gammaln(queries - n + 1) + betaln(n + alpha, queries - n + beta) - betaln(alpha, beta)
    return np.where(n == 0, np.logaddexp(np.log(max(dead, 1e-300)), np.log1p(-dead) + log), np.log1p(-dead) + log)


def _starts(u: Array, w: Array, basis: Array, share: Array, queries: Array, times: Array) -> list[Array]:
    """Where the search begins: the mean by logistic regression; the variance fitted to squared residuals, or the same everywhere."""

    def cross(b: Array) -> float:
        z = b[0] + b[1] * u + b[2] * w
        return float(times @ (np.logaddexp(0, z) * share + np.logaddexp(0, -z) * (1 - share))) / times.sum()

    b = minimize(cross, [-4.0, 6.0, 2.0], method="L-BFGS-B", bounds=[(None, None), (0.01, None), (0.0, None)]).x
    m = expit(-(b[0] + b[1] * u + b[2] * w))
    surplus = (share - m) ** 2 - m * (1 - m) / queries
    fitted = np.linalg.lstsq(basis * np.sqrt(times)[:, None], surplus * np.sqrt(times), rcond=None)[0]  # 0 where w is 0 everywhere
    level = max(float(times @ surplus) / times.sum(), 1e-3)
    return [np.concatenate([b, k, [0.02]]) for k in (fitted, np.array([level, 0.0, 0.0, 0.0, 0.0]))]
