"""What an edge costs a radio wave: knife-edge diffraction, and the geometry that it depends on.

An edge is described by one number ν, its place in units of Fresnel zones (ITU-R P.526, "Propagation by diffraction", section
on the single knife-edge obstacle): with Δ the metres by which the way over the edge is longer than the straight one,

    ν = ± 2 √(Δ / λ),      + where the edge stands in the straight line, - where it stays clear of it

which for small heights is h √(2/λ (1/d1 + 1/d2)). Left out: the edge's thickness and material, its roundness, the shift of
phase (that of the longer way is kept, the -45° of a dark edge is not), and everything of a second edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fresnel

from testbed.columns import Array

CLEAR = -0.78  # ν below which the approximation of J is nought, and is taken to be (P.526)
FIRST_ZONE = 0.6  # of the first Fresnel zone's radius: with so much clear the path counts as free (P.526)
CLEAR_OF_ZONE = FIRST_ZONE * np.sqrt(2.0)  # the same as |ν|: the first zone's edge has Δ = λ/2, |ν| = √2


def knife_edge(nu: ArrayLike) -> Array:
    """J(ν), dB lost over one knife edge: the approximation of ITU-R P.526, nought below ν = -0.78. Shape kept."""
    v = np.maximum(np.asarray(nu, dtype=np.float64), CLEAR) - 0.1
    loss = 6.9 + 20 * np.log10(np.sqrt(v * v + 1) + v)
    return np.where(np.asarray(nu) > CLEAR, np.maximum(loss, 0.0), 0.0)


def knife_edge_exact(nu: ArrayLike) -> Array:
    """J(ν) by the Fresnel integrals C and S: -20 log10 of |(1 - C - S) + j (C - S)| / 2. Slightly negative where the edge helps."""
    s, c = fresnel(np.asarray(nu, dtype=np.float64))
    return -20 * np.log10(np.hypot(1 - c - s, c - s) / 2)


def loss_to_nu(loss: ArrayLike) -> Array:
    """ν for which `knife_edge` is `loss` dB: its inverse where the loss is above nought, and `CLEAR` elsewhere."""
    x = 10 ** ((np.asarray(loss, dtype=np.float64) - 6.9) / 20)
    with np.errstate(divide="ignore"):
        v = (x - 1 / x) / 2 + 0.1
    return np.maximum(v, CLEAR)


def nu_of_detour(detour: ArrayLike, wavelength: ArrayLike) -> Array:
    """ν >= 0 of a way that is `detour` metres longer than the straight one."""
    return 2 * np.sqrt(np.maximum(detour, 0.0) / np.asarray(wavelength, dtype=np.float64))


def detour_of_nu(nu: ArrayLike, wavelength: ArrayLike) -> Array:
    """Metres by which a way at |ν| is longer than the straight one: ν² λ / 4."""
    return np.square(np.asarray(nu, dtype=np.float64)) * np.asarray(wavelength, dtype=np.float64) / 4


def nu_of_edge(height: ArrayLike, before: ArrayLike, behind: ArrayLike, wavelength: ArrayLike) -> Array:
    """ν of an edge `height` m above the straight line (negative: below it), at `before` and `behind` m from the two ends along it."""
    h, a, b = (np.asarray(x, dtype=np.float64) for x in (height, before, behind))
    detour = h * h / (np.hypot(a, h) + a) + h * h / (np.hypot(b, h) + b)  # hypot(a, h) - a, without cancellation
    return np.copysign(nu_of_detour(detour, wavelength), h)


def clearance(nu: ArrayLike, along: ArrayLike, distance: ArrayLike, wavelength: ArrayLike) -> Array:
    """Metres off the straight line, `along` m from its start, at which a way through there has that |ν|.

    The ellipse with its foci at the two ends, `distance` m apart: exact, where √(λ d1 d2 / d) times |ν|/√2 is its middle part only.
    """
    d = np.asarray(distance, dtype=np.float64)
    detour = detour_of_nu(nu, wavelength)
    semi_major = (d + detour) / 2
    off_middle = (np.asarray(along, dtype=np.float64) - d / 2) / semi_major
    return np.sqrt(detour * (2 * d + detour)) / 2 * np.sqrt(np.maximum(1 - off_middle * off_middle, 0.0))
