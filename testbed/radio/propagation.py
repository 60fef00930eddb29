"""One complex channel per link, and what follows from it: power at the tag, power at the reader, phase.

For a path of length d at carrier f, one way (Friis, "A note on a simple transmission formula", Proc. IRE 34, 1946):

    h = (λ / 4πd) · √(G_a(θ) · G_t(α) · χ) · 10^(-A/20) · exp(-j 2π f d / c)

with χ the share that the tag takes of the wave's polarisation (`testbed.radio.coupling`) and A the loss in obstacles, dB. All gains
are inside h, so the round trip is |h|⁴ and its phase 2·arg h: forward margin, RSSI and phase come from one number and can't
disagree. This is the direct path; other paths add to h.

Left out: the near field (within some wavelengths a patch and a dipole couple in other ways than Friis says, and nearer than `NEAREST` the
level is held), the phase of the antennas' own patterns, and readers with one antenna to send and another to listen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array
from testbed.units import SPEED_OF_LIGHT, wrap_positive

NEAREST = 0.05  # m: nearer than λ/2π the far field does not exist and Friis would give gain for nothing
POLARISATION_DB = float(-10 * np.log10(0.5))  # a circular wave on a linear tag: one half


def direct_path(distance: ArrayLike, frequency: ArrayLike, gain_db: ArrayLike, loss_db: ArrayLike) -> Array:
    """Complex one-way gain of the direct path, broadcast over its arguments.

    distance m (below `NEAREST` the amplitude stays what it is there), frequency Hz, gain_db = antenna (with pattern) + tag
    + polarisation in dB, loss_db >= 0 in obstacles.
    """
    d, f = np.asarray(distance, dtype=np.float64), np.asarray(frequency, dtype=np.float64)
    amplitude = SPEED_OF_LIGHT / f / (4 * np.pi * np.maximum(d, NEAREST))
    decibels = np.asarray(gain_db, dtype=np.float64) - np.asarray(loss_db, dtype=np.float64)
    return amplitude * 10 ** (decibels / 20) * np.exp(-2j * np.pi * f * d / SPEED_OF_LIGHT)


def power_at_tag(h: Array, transmit_dbm: ArrayLike) -> Array:
    """dBm: P_tx · |h|²."""
    return np.asarray(transmit_dbm) + 20 * np.log10(np.abs(h))


def power_at_reader(h: Array, transmit_dbm: ArrayLike, modulation_loss_db: float) -> Array:
    """dBm: P_tx · |h|⁴ · L_mod (monostatic: the same way back)."""
    return np.asarray(transmit_dbm) + 40 * np.log10(np.abs(h)) - modulation_loss_db


def phase_of(h: Array, offset: ArrayLike = 0.0) -> Array:
    """rad in [0, 2π): 2·arg h + offset, which for the direct path alone is wrap(-4π f d / c + offset)."""
    return wrap_positive(2 * np.angle(h) + np.asarray(offset))
