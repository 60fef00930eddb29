"""Quantiles of χ² and Student's t from scipy.special: scipy.stats has them too, and takes half of every worker's start to import."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, stdtrit

from testbed.columns import Array


def chi2_quantile(probability: ArrayLike, dof: ArrayLike) -> Array:
    """Where χ² of `dof` degrees of freedom stays below with the given probability: 2 P⁻¹(dof / 2, probability)."""
    return 2.0 * gammaincinv(np.asarray(dof, dtype=np.float64) / 2.0, np.asarray(probability, dtype=np.float64))


def student_quantile(probability: ArrayLike, dof: ArrayLike) -> Array:
    """Where Student's t of `dof` degrees of freedom stays below with the given probability."""
    return stdtrit(np.asarray(dof, dtype=np.float64), np.asarray(probability, dtype=np.float64))
