"""The rows' random numbers in one pass: what `testbed.rng.RowRandom` draws, bit for bit as `mix` and `uniform_of` there give it."""

from __future__ import annotations

import numpy as np
from numba import njit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@njit(cache=True)
def _mixed(z):
    z = (z ^ (z >> _30)) * _MIX1
    z = (z ^ (z >> _27)) * _MIX2
    return z ^ (z >> _31)


@njit(cache=True)
def row_uniforms(seed, first, n):
    """(B, n) float64 in (0, 1): the draws `first` (B,), `first` + 1, ... of rows with these seeds (B,), both uint64."""
    rows = len(seed)
    found = np.empty((rows, n))
    for b in range(rows):
        for k in range(n):
            word = _mixed(first[b] + np.uint64(k) + _GOLDEN)
            state = _mixed((seed[b] + _GOLDEN) ^ word)
            found[b, k] = (np.float64(_mixed(state + _GOLDEN) >> _11) + 0.5) * 2.0**-53
    return found
