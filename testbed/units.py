"""Decibels and the wrap of angles: the few conversions that every part needs, each written once.

Inside the testbed all quantities are SI and radians; names at the edges carry their unit as a suffix (`range_m`,
`power_dbm`). Levels in dB relative to a milliwatt are "dBm"; gains relative to an isotropic radiator are "dBi".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array

SPEED_OF_LIGHT = 299_792_458.0  # m/s, exact by definition of the metre (BIPM, SI brochure, 9th edition)


def wrap(angle: ArrayLike) -> Array:
    """`angle` in rad, brought into (-π, π]; shape kept."""
    a = np.asarray(angle, dtype=np.float64)
    return np.pi - np.mod(np.pi - a, 2 * np.pi)


def wrap_positive(angle: ArrayLike) -> Array:
    """`angle` in rad, brought into [0, 2π); shape kept. What a reader reports."""
    a = np.mod(np.asarray(angle, dtype=np.float64), 2 * np.pi)
    return np.where(a >= 2 * np.pi, 0.0, a)  # mod of a tiny negative number rounds up to 2π itself


def db(ratio: ArrayLike) -> Array:
    """Power ratio to dB: 10 log10(ratio); -inf for 0."""
    with np.errstate(divide="ignore"):
        return 10.0 * np.log10(np.asarray(ratio, dtype=np.float64))


def from_db(level: ArrayLike) -> Array:
    """dB to power ratio: 10^(level / 10)."""
    return np.power(10.0, np.asarray(level, dtype=np.float64) / 10.0)
