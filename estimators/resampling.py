"""Resampling of weighted particles, for B rows at once, and how many particles a belief needs.

Nothing here draws random numbers: callers hand in uniforms from their own `RowRandom`, so a row's choice depends on its own
draws alone.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.special import ndtri

from testbed.types import Array


def systematic(weight: Array, uniform: Array, size: int | None = None) -> Array:
    """(B, size) int64, ascending: which of N particles each of `size` equal heirs descends from (N heirs where left out).

    weight  : (B, N), not negative, of any sum above 0
    uniform : (B,) in [0, 1), one draw a row: it shifts a comb of `size` evenly spaced points along the cumulated weights

    A particle of share w gets floor(size w) or ceil(size w) heirs (Kitagawa 1996, "Monte Carlo filter and smoother", J. Comput.
    Graph. Stat. 5). ValueError for a row whose weights are negative, NaN or all zero, naming it.
    """
    weight = _checked(weight)
    if np.shape(uniform) != (len(weight),):
        raise ValueError(f"systematic resampling wants one uniform a row, shape ({len(weight)},), not {np.shape(uniform)}")
    n = weight.shape[1] if size is None else size
    return _comb(weight, np.ascontiguousarray(uniform, dtype=np.float64), np.full(len(weight), n, dtype=np.int64), n)


def systematic_sizes(weight: Array, uniform: Array, sizes: Array) -> Array:
    """`systematic` with a number of heirs for each row: (B, max(sizes)) int64, -1 beyond a row's own `sizes` (B,)."""
    weight, sizes = _checked(weight), np.asarray(sizes, dtype=np.int64)
    return _comb(weight, np.ascontiguousarray(uniform, dtype=np.float64), sizes, int(sizes.max(initial=0)))


def multinomial(weight: Array, uniform: Array) -> Array:
    """(B, M) int64, ascending: independent choices by weight (B, N), one for each of the uniforms (B, M) in [0, 1).

    Of higher variance than `systematic`, but its heirs are independent, which some theory and some tests want.
    """
    return _search(_checked(weight), np.sort(np.asarray(uniform, dtype=np.float64), axis=1))


def effective_number(weight: Array) -> Array:
    """(B,): 1 / Σ w² of normalised weights (B, N), between 1 and N (Kong, Liu, Wong 1994)."""
    weight = _checked(weight)
    return weight.sum(axis=1) ** 2 / (weight**2).sum(axis=1)


def kld_size(bins: Array, epsilon: float, confidence: float) -> Array:
    """(B,) int64: how many particles keep a belief that fills `bins` (B,) cells within `epsilon` of itself.

    The Kullback-Leibler distance between the sampled and the true distribution over the cells stays below `epsilon` with
    probability `confidence`: Fox 2003, "Adapting the sample size in particle filters through KLD-sampling", Eq. 7 (the Wilson-Hilferty
    approximation of χ²). One for a single cell, which any particle fills.
    """
    if not (epsilon > 0 and 0 < confidence < 1):
        raise ValueError(f"a distance above 0 and a probability within (0, 1) are wanted, not {epsilon:g} and {confidence:g}")
    free = np.maximum(np.asarray(bins, dtype=np.float64) - 1, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 2 / (9 * free)
        size = free / (2 * epsilon) * (1 - share + np.sqrt(share) * ndtri(confidence)) ** 3
    return np.where(free > 0, np.ceil(np.nan_to_num(size)), 1).astype(np.int64)


def _checked(weight: Array) -> Array:
    weight = np.ascontiguousarray(weight, dtype=np.float64)
    if weight.ndim != 2:
        raise ValueError(f"weights of shape (rows, particles) are wanted, not {weight.shape}")
    if not weight.size:
        return weight
    total = weight.sum(axis=1)
    wrong = np.flatnonzero(~((total > 0) & np.isfinite(total)) | (weight.min(axis=1) < 0))
    if len(wrong):
        raise ValueError(f"row {wrong[0]}: weights must not be negative and must have a finite sum above 0, theirs is {total[wrong[0]]:g}")
    return weight


@njit(cache=True)
def _comb(weight, uniform, sizes, width):
    rows, n = weight.shape
    chosen = np.full((rows, width), -1, dtype=np.int64)
    for b in range(rows):
        total = 0.0
        for i in range(n):
            total += weight[b, i]
        step, last = total / max(sizes[b], 1), n - 1
        while last > 0 and weight[b, last] == 0.0:  # rounding may leave the comb's last point beyond the sum: never on a dead one
            last -= 1
        i, reached = 0, weight[b, 0]
        for k in range(sizes[b]):
            point = (k + uniform[b]) * step
            while i < last and point >= reached:
                i += 1
                reached += weight[b, i]
            chosen[b, k] = i
    return chosen


@njit(cache=True)
def _search(weight, points):
    rows, n = weight.shape
    chosen = np.empty(points.shape, dtype=np.int64)
    for b in range(rows):
        total = 0.0
        for i in range(n):
            total += weight[b, i]
        last = n - 1
        while last > 0 and weight[b, last] == 0.0:
            last -= 1
        i, reached = 0, weight[b, 0]
        for k in range(points.shape[1]):
            while i < last and points[b, k] * total >= reached:
                i += 1
                reached += weight[b, i]
            chosen[b, k] = i
    return chosen
