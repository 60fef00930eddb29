"""The Kalman updates over rows: B Gaussians (mean (B, n), covariance (B, n, n)), changed in place for the rows of an event.

What is measured, and how the state moves, is the caller's: he gives innovations and Jacobians (extended filter) or sigma points
and what they predict (unscented filter), each vectorised over entries; a measurement may be a number or a vector, of which NaN
components are left out. Each row is worked on by itself, so a row's numbers don't depend on its company.

A covariance stays symmetric and positive definite: the extended update is Joseph's form (Bucy and Joseph 1968), and what
rounding leaves of either update is made symmetric and, should it not be positive definite, lifted by the smallest tenfold step
of its trace that makes it so. An update that would leave a number that is not finite is not made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal

import numpy as np
from numba import njit
from pydantic import Field
from scipy.stats import chi2

from testbed.types import Array, UpdateInfo

Gate = Annotated[float, Field(gt=0, lt=1)] | Literal["none"]  # probability with which a good measurement passes


@cache
def gate_limits(gate: float | str, components: int) -> Array:
    """(components + 1,): the largest normalised innovation squared let through, by degrees of freedom; infinite for "none"."""
    if gate == "none":
        return np.full(components + 1, np.inf)
    return np.concatenate([[0.0], chi2.ppf(float(gate), np.arange(1, components + 1))])


def extended_update(
    mean: Array, covariance: Array, rows: Array, innovation: Array, jacobian: Array, noise: Array, limits: Array
) -> UpdateInfo:
    """Take one linearised measurement for each of the rows, in place.

    rows (E,) distinct; innovation (E, m) z - h(x), NaN where not measured; jacobian (E, m, n); noise (E, m, m); limits (m + 1,)
    of `gate_limits`. Refused (not used): nothing measured, beyond the gate, or without a finite result.
    """
    out = _Outcome(len(rows))
    _extended(mean, covariance, rows, innovation, jacobian, noise, limits, out.used, out.log_likelihood, out.nis, out.dof)
    return out.info()


def unscented_update(
    mean: Array, covariance: Array, rows: Array, points: Array, innovation: Array, noise: Array, weights: Weights, limits: Array
) -> UpdateInfo:
    """Take one measurement for each of the rows by its sigma points, in place.

    points (E, 2n + 1, n) of `sigma_points`; innovation (E, 2n + 1, m) z - h(point), NaN where not measured; else as `extended_update`.
    Differences, not values, so that a measured angle may wrap. (Wan and van der Merwe 2000, Eqs. 15-18.)
    """
    out = _Outcome(len(rows))
    _unscented(
        mean, covariance, rows, points, innovation, noise, weights.mean, weights.covariance, limits,
        out.used, out.log_likelihood, out.nis, out.dof,
    )  # fmt: skip
    return out.info()


def sigma_points(mean: Array, covariance: Array, rows: Array, weights: Weights) -> Array:
    """(E, 2n + 1, n): the mean, then the mean plus and minus each column of the lower Cholesky factor of spread × covariance."""
    points = np.empty((len(rows), 2 * mean.shape[1] + 1, mean.shape[1]))
    _points(mean, covariance, rows, weights.spread, points)
    return points


@dataclass(frozen=True)
class Weights:
    """Scaled sigma points of an n-dimensional state (van der Merwe 2004): spread n + λ, and the weights for mean and covariance."""

    spread: float
    mean: Array  # (2n + 1,)
    covariance: Array  # (2n + 1,)

    @classmethod
    def merwe(cls, n: int, alpha: float, beta: float, kappa: float) -> Weights:
        """λ = α²(n + κ) - n. ValueError where the points would collapse (n + κ <= 0)."""
        if n + kappa <= 0:
            raise ValueError(f"kappa must be above -{n} for a state of {n} components, it is {kappa:g}")
        spread = alpha**2 * (n + kappa)
        mean = np.full(2 * n + 1, 0.5 / spread)
        mean[0] = (spread - n) / spread
        covariance = mean.copy()
        covariance[0] += 1 - alpha**2 + beta
        return cls(spread, mean, covariance)


class _Outcome:
    def __init__(self, n: int) -> None:
        self.used, self.dof = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.int32)
        self.log_likelihood, self.nis = np.full(n, np.nan), np.full(n, np.nan)

    def info(self) -> UpdateInfo:
        return UpdateInfo(self.used, self.log_likelihood, self.nis, self.dof)


# ---------------------------------------------------------------- kernels: rows one after another, no numpy calls inside


@njit(cache=True, error_model="numpy")
def _cholesky(a, factor, n):
    """Lower factor of the leading n × n block of `a`; False where it is not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            if i == j:
                if not s > 0.0 or not np.isfinite(s):  # NaN is not above 0 either
                    return False
                factor[i, i] = np.sqrt(s)
            else:
                factor[i, j] = s / factor[j, j]
    return True


@njit(cache=True, error_model="numpy")
def _positive(a, work, n):
    """Whether the leading n × n block of `a` is positive definite beyond what rounding can undo: each pivot of its elimination is
    more than 1e-14 of its diagonal."""
    for i in range(n):
        for j in range(i + 1):
            work[i, j] = a[i, j]
    for k in range(n):
        if not work[k, k] > 1e-14 * a[k, k] or not np.isfinite(work[k, k]):  # NaN is not above anything
            return False
        inverse = 1.0 / work[k, k]
        for i in range(k + 1, n):
            share = work[i, k] * inverse
            for j in range(k + 1, i + 1):
                work[i, j] -= share * work[j, k]
    return True


@njit(cache=True, error_model="numpy")
def _lift(a, work, n):
    """Raise the diagonal of `a` by as little as makes it positive definite; False where nothing helps."""
    if _positive(a, work, n):
        return True
    trace = 0.0
    for i in range(n):
        trace += abs(a[i, i])
    step, lifted = 1e-15 * trace, 0.0
    for _ in range(16):
        for i in range(n):
            a[i, i] += step - lifted
        lifted = step
        if _positive(a, work, n):
            return True
        step *= 10.0
    return False


@njit(cache=True, error_model="numpy")
def _commit(mean, covariance, row, x, p, work, n):
    """Write a row's new mean and covariance if they are finite and the covariance is, or can be made, positive definite."""
    for i in range(n):
        if not np.isfinite(x[i]):
            return False
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
    if not _lift(p, work, n):
        return False
    for i in range(n):  # not by slices: an assignment of arrays takes numba seconds to compile
        mean[row, i] = x[i]
        for j in range(n):
            covariance[row, i, j] = p[i, j]
    return True


@njit(cache=True, error_model="numpy")
def _judge(s, y, m, factor, limit):
    """Whiten y (in place) by the Cholesky factor of s: (passes, nis, log-likelihood)."""
    if not _cholesky(s, factor, m):
        return False, np.nan, np.nan
    nis, log_det = 0.0, 0.0
    for i in range(m):
        v = y[i]
        for k in range(i):
            v -= factor[i, k] * y[k]
        y[i] = v / factor[i, i]
        nis += y[i] * y[i]
        log_det += 2.0 * np.log(factor[i, i])
    return nis <= limit, nis, -0.5 * (nis + log_det + m * np.log(2.0 * np.pi))


@njit(cache=True, error_model="numpy")
def _whiten_rows(c, m, n, factor):
    """c L⁻ᵀ in place: each row of c (n, m) divided by the factor from the right."""
    for a in range(n):
        for i in range(m):
            v = c[a, i]
            for k in range(i):
                v -= factor[i, k] * c[a, k]
            c[a, i] = v / factor[i, i]


@njit(cache=True, error_model="numpy")
def _extended(mean, covariance, rows, innovation, jacobian, noise, limits, used, log_likelihood, nis, dof):
    n, most = mean.shape[1], innovation.shape[1]
    x, p, work = np.empty(n), np.empty((n, n)), np.empty((n, n))
    h, y, r, w, k = np.empty((most, n)), np.empty(most), np.empty((most, most)), np.empty(n), np.empty(n)
    for e in range(len(rows)):
        m = _independent(innovation[e], jacobian[e], noise[e], h, y, r)
        if m == 0:
            continue
        dof[e], row = m, rows[e]
        for i in range(n):
            x[i] = 0.0  # the correction so far: the innovations are of the prediction
            for j in range(n):
                p[i, j] = covariance[row, i, j]
        squared, log_det = 0.0, 0.0
        for i in range(m):
            s, v = _scalar_update(x, p, h[i], y[i], r[i, i], w, k)
            squared += v * v / s
            log_det += np.log(s)
        nis[e], log_likelihood[e] = squared, -0.5 * (squared + log_det + m * np.log(2.0 * np.pi))
        if squared <= limits[m]:
            for i in range(n):
                x[i] += mean[row, i]
            used[e] = _commit(mean, covariance, row, x, p, work, n)


@njit(cache=True, error_model="numpy")
def _independent(innovation, jacobian, noise, h, y, r):
    """The measured components as m ones of independent noise, r = L D Lᵀ with unit L: h = L⁻¹ H, y = L⁻¹ z, and D on r's diagonal."""
    m = 0
    for j in range(len(innovation)):
        if not np.isfinite(innovation[j]):
            continue
        y[m] = innovation[j]
        for a in range(h.shape[1]):
            h[m, a] = jacobian[j, a]
        before = 0
        for i in range(j):
            if np.isfinite(innovation[i]):
                r[m, before] = noise[j, i]
                before += 1
        r[m, m] = noise[j, j]
        for i in range(m):  # r[m, i] becomes L D of this row, then is taken out of h and y
            for k in range(i):
                r[m, i] -= r[m, k] / r[k, k] * r[i, k]
        for i in range(m):
            share = r[m, i] / r[i, i]
            r[m, m] -= share * r[m, i]
            y[m] -= share * y[i]
            for a in range(h.shape[1]):
                h[m, a] -= share * h[i, a]
        m += 1
    return m


@njit(cache=True, error_model="numpy")
def _scalar_update(x, p, h, y, r, w, k):
    """Joseph's form for one number, p = (I - k hᵀ) p (I - k hᵀ)ᵀ + r k kᵀ by two changes of rank one; returns s and the innovation."""
    n = len(x)
    s, v = r, y
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += p[i, j] * h[j]
        w[i] = total
        s += h[i] * total
        v -= h[i] * x[i]
    for i in range(n):
        k[i] = w[i] / s
        x[i] += k[i] * v
        for j in range(n):
            p[i, j] -= k[i] * w[j]
    for i in range(n):
        total = -r * k[i]
        for j in range(n):
            total += p[i, j] * h[j]
        w[i] = total
    for i in range(n):
        for j in range(n):
            p[i, j] -= w[i] * k[j]
    return s, v


@njit(cache=True, error_model="numpy")
def _points(mean, covariance, rows, spread, points):
    n = mean.shape[1]
    scaled, factor = np.empty((n, n)), np.empty((n, n))
    for e in range(len(rows)):
        row = rows[e]
        for i in range(n):
            for j in range(n):
                scaled[i, j] = spread * covariance[row, i, j]
        proper = _cholesky(scaled, factor, n)
        if not proper and _lift(scaled, factor, n):  # a prior may be certain of something
            proper = _cholesky(scaled, factor, n)
        for i in range(n):
            points[e, 0, i] = mean[row, i]
            for k in range(n):
                step = 0.0 if k > i else factor[i, k] if proper else np.nan  # a read through NaN is refused
                points[e, 1 + k, i] = mean[row, i] + step
                points[e, 1 + n + k, i] = mean[row, i] - step


@njit(cache=True, error_model="numpy")
def _unscented(mean, covariance, rows, points, innovation, noise, weight_m, weight_c, limits, used, log_likelihood, nis, dof):
    n, count, most = mean.shape[1], points.shape[1], innovation.shape[2]
    x, p, work = np.empty(n), np.empty((n, n)), np.empty((n, n))
    gain, s, factor = np.empty((n, most)), np.empty((most, most)), np.empty((most, most))
    y, d, seen = np.empty(most), np.empty((count, most)), np.empty(most, np.int64)
    for e in range(len(rows)):
        m = _spread(innovation[e], weight_m, y, d, seen)
        if m == 0:
            continue
        dof[e], row = m, rows[e]
        for i in range(m):
            for j in range(m):
                total = noise[e, seen[i], seen[j]]
                for k in range(count):
                    total += weight_c[k] * d[k, i] * d[k, j]
                s[i, j] = total
        passes, nis[e], log_likelihood[e] = _judge(s, y, m, factor, limits[m])
        if not passes:
            continue
        for a in range(n):
            for i in range(m):
                total = 0.0
                for k in range(count):
                    total += weight_c[k] * (points[e, k, a] - mean[row, a]) * d[k, i]
                gain[a, i] = total
        _whiten_rows(gain, m, n, factor)  # now K L, with S = L Lᵀ
        for a in range(n):
            total = mean[row, a]
            for i in range(m):
                total += gain[a, i] * y[i]
            x[a] = total
            for c in range(n):
                total = covariance[row, a, c]
                for i in range(m):
                    total -= gain[a, i] * gain[c, i]
                p[a, c] = total
        used[e] = _commit(mean, covariance, row, x, p, work, n)


@njit(cache=True, error_model="numpy")
def _spread(innovation, weight_m, y, d, seen):
    """Mean innovation y and each point's deviation d of what it predicts, of the measured components; how many there are."""
    m = 0
    for j in range(innovation.shape[1]):
        middle = 0.0
        for k in range(len(innovation)):
            middle += weight_m[k] * innovation[k, j]
        if np.isfinite(middle):
            seen[m], y[m] = j, middle
            for k in range(len(innovation)):
                d[k, m] = middle - innovation[k, j]
            m += 1
    return m
