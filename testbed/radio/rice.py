"""What can be said of |h| without drawing a fade: h = mean + spread · D is Rician where D is complex, Gaussian and of unit power.

    P(|h|² >= x) = Q₁(√(2|mean|²/spread²), √(2x/spread²))            J. I. Marcum, IRE Trans. Inf. Theory 6 (1960): his Q function
    E[ln |h|²] = ln |mean|² + E₁(|mean|²/spread²)                    ln spread² - γ where the mean is 0

The second is the mean logarithm of a non-central χ² variable with two degrees of freedom (A. Lapidoth, S. M. Moser, IEEE Trans. Inf.
Theory 49 (2003), Lemma 10.1). The diffuse field of the channel is a sum of P = 24 waves, Gaussian but for 1/P in its fourth moment;
by the next term of its series, -1/(2P) (x²/2 - x) exp(-x) where the mean is 0, that moves a probability by 0.005 at the most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import exp1
from scipy.stats import ncx2

from testbed.columns import Array

DECIBELS = 10 / np.log(10)
SETTLED = 1e-14  # of the mean's power: a spread of less, or none, leaves nothing to chance
FAINT = 1e-9  # of the spread's power: a mean of less is none


def exceeding(mean: ArrayLike, spread: ArrayLike, least: ArrayLike) -> Array:
    """P(|h|² >= least), broadcast, for the complex (or absolute) mean, the spread >= 0 and a power `least` > 0."""
    power, diffuse, least = np.broadcast_arrays(np.abs(mean) ** 2, np.square(spread), np.asarray(least, dtype=np.float64))
    settled = diffuse <= SETTLED * power
    by_chance = np.where(settled, 1.0, diffuse)
    return np.where(settled, power >= least, ncx2.sf(2 * least / by_chance, 2, np.where(settled, 0.0, 2 * power / by_chance)))


def mean_db(mean: ArrayLike, spread: ArrayLike) -> Array:
    """Mean of 10 log10 |h|² over D, dB, broadcast: what levels in dB average to. -inf where mean and spread are both 0."""
    power, diffuse = np.broadcast_arrays(np.abs(mean) ** 2, np.square(spread))
    settled, alone = diffuse <= SETTLED * power, power < FAINT * diffuse
    ratio = np.where(settled | alone, 1.0, power) / np.where(settled, 1.0, diffuse)
    with np.errstate(divide="ignore"):
        found = np.where(alone, np.log(diffuse) - np.euler_gamma, np.log(power) + np.where(settled, 0.0, exp1(ratio)))
    return DECIBELS * found
