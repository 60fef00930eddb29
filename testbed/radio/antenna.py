"""Directivity of an antenna: cos^n about its own +x, down to a floor behind it.

A patch's main lobe is described well by cos^n; side lobes and the difference of E- and H-plane are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array


def exponent(beamwidth: ArrayLike) -> Array:
    """n for which cos^n of half the half-power beam width (full angle, rad, below π) is one half."""
    return np.log(0.5) / np.log(np.cos(np.asarray(beamwidth, dtype=np.float64) / 2))


def pattern_db(cosine: ArrayLike, n: ArrayLike, front_to_back: ArrayLike) -> Array:
    """Gain relative to boresight, dB, for the cosine of the angle off boresight; never below -front_to_back (dB)."""
    cosine = np.asarray(cosine, dtype=np.float64)
    with np.errstate(divide="ignore"):
        lobe = 10.0 * np.asarray(n) * np.log10(np.maximum(cosine, 0.0))
    return np.maximum(lobe, -np.asarray(front_to_back, dtype=np.float64))


def off_boresight(quaternion: Array, towards: Array) -> tuple[Array, Array]:
    """Cosine of the angle between each antenna's +x (quaternions (..., 4)) and vectors `towards` (..., 3), and their lengths."""
    distance = np.linalg.norm(towards, axis=-1)
    axis = frames.rotate(quaternion, np.array([1.0, 0.0, 0.0]))
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("...i,...i->...", axis, towards) / distance
    return np.where(distance > 0, np.clip(cosine, -1.0, 1.0), 1.0), distance
