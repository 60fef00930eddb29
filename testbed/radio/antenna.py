"""Directivity of an antenna: cos^n about its own +x, down to a floor behind it; or a table over the angle off boresight.

A patch's main lobe is described well by cos^n: half the power at half the beam width off boresight settles n. A table
is interpolated in dB, straight between whole degrees. Both are the same all round the boresight: the difference of E- and
H-plane, and side lobes that point one way, are left out. So is how the pattern changes over the band (data sheets of patches give one
for all of it), and what the wall or post behind the antenna does to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array

DEGREES = np.arange(181.0)  # where a table is kept: 0, 1, ..., 180° off boresight; a beam under 10° is none of an RFID antenna's
HALF_POWER = 10 * np.log10(0.5)  # dB


def exponent(beamwidth: ArrayLike) -> Array:
    """n for which cos^n of half the half-power beam width (full angle, rad, below π) is one half."""
    return np.log(0.5) / np.log(np.cos(np.asarray(beamwidth, dtype=np.float64) / 2))


def tabulated(angle: ArrayLike, gain: ArrayLike, beyond: float | None = None) -> Array:
    """(181,) dB at whole degrees from a table: `angle` (K,) degrees off boresight, `gain` (K,) dB relative to boresight.

    Between the rows it is interpolated in dB; `beyond` holds past the last one. ValueError, in one sentence, for a table that does
    not begin at 0° with 0 dB, exceeds that anywhere, is not ascending, or ends before 180° without `beyond`.
    """
    angle, gain = np.asarray(angle, dtype=np.float64), np.asarray(gain, dtype=np.float64)
    if angle.shape != gain.shape or angle.ndim != 1:
        raise ValueError(f"angle_deg and gain_db go together, and there are {angle.size} angles and {gain.size} gains")
    if len(angle) < 2:
        raise ValueError("a pattern wants two angles at least, 0 among them")
    if not np.isfinite([angle, gain]).all():
        raise ValueError("a pattern's angles and gains must be finite numbers")
    fall = np.flatnonzero(np.diff(angle) <= 0)
    if len(fall):
        raise ValueError(f"angle_deg must ascend, and {angle[fall[0] + 1]:g} follows {angle[fall[0]]:g}")
    if angle[0] != 0 or angle[-1] > 180:
        raise ValueError(f"angle_deg is the angle off boresight, from 0 to 180, and this one goes from {angle[0]:g} to {angle[-1]:g}")
    if gain[0] != 0:
        raise ValueError(f"gain_db is relative to boresight: 0 at 0°, not {gain[0]:g} (what boresight has is gain_dbi)")
    above = np.flatnonzero(gain > 0)
    if len(above):
        at = f"{angle[above[0]]:g}°"
        raise ValueError(
            f"gain_db is greatest on boresight, 0 dB, and {gain[above[0]]:g} dB at {at} is more: turn the antenna to where it is"
        )
    if angle[-1] < 180 and beyond is None:
        raise ValueError(f"the table ends at {angle[-1]:g}°: go on to 180, or say with beyond_db what holds behind that")
    if beyond is None:
        return np.interp(DEGREES, angle, gain)
    if angle[-1] == 180:
        raise ValueError("beyond_db is for a table that ends before 180°")
    if not beyond <= 0:
        raise ValueError(f"beyond_db must be 0 or less, is {beyond:g}")
    return np.interp(DEGREES, angle, gain) * (angle[-1] >= DEGREES) + beyond * (angle[-1] < DEGREES)


def half_power_width(pattern: Array) -> float:
    """Half-power beam width (full angle, rad, at most 2π) of a table (181,): twice where it first falls by half."""
    below = np.flatnonzero(pattern < HALF_POWER)
    if not len(below):
        return 2 * np.pi
    k = int(below[0])
    share = (pattern[k - 1] - HALF_POWER) / (pattern[k - 1] - pattern[k])
    return float(2 * np.deg2rad(DEGREES[k - 1] + share))


def off_boresight(quaternion: Array, towards: Array) -> tuple[Array, Array]:
    """Cosine of the angle between each antenna's +x (quaternions (..., 4)) and vectors `towards` (..., 3), and their lengths."""
    distance = np.linalg.norm(towards, axis=-1)
    axis = frames.rotate(quaternion, np.array([1.0, 0.0, 0.0]))
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("...i,...i->...", axis, towards) / distance
    return np.where(distance > 0, np.clip(cosine, -1.0, 1.0), 1.0), distance  # beyond 1 by rounding alone
