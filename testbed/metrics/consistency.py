"""Whether an estimator is as sure of itself as it should be: NEES and NIS.

Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from testbed.columns import Array
from testbed.metrics.track_error import difference, known_components, usable
from testbed.quantiles import chi2_quantile
from testbed.quantity import Config as BaseConfig
from testbed.recording import Trial
from testbed.types import POSITION, Innovations, Track


class Consistency:
    """Normalised error of the state (NEES, at report times) and of the innovations (NIS, at updates).

    NEES is e' P⁻¹ e over the components that the truth knows; for an honest filter its mean is `nees.dof`. NIS comes from the
    method itself and is given per degree of freedom: 1 for an honest filter. Above: too sure; below: too modest. Times with a
    covariance that is not positive definite have no NEES and are counted in `nees.singular`.
    """

    class Config(BaseConfig):
        """components: judge the position alone, or all that the truth knows (position and velocity)."""

        components: Literal["position", "all"] = "all"

    columns: ClassVar[dict[str, str]] = {
        "nees.mean": "mean NEES over the report times; nees.dof for an honest filter",
        "nees.inside_95": "share of report times with NEES in its two-sided 95 % χ² interval; 0.95 for an honest filter",
        "nees.dof": "degrees of freedom of NEES: how many components are judged",
        "nees.times": "report times with a NEES",
        "nees.singular": "report times whose covariance is not positive definite",
        "nis.mean": "sum of NIS over sum of degrees of freedom; 1 for an honest filter",
        "nis.inside_95": "share of updates with NIS in its two-sided 95 % χ² interval; 0.95 for an honest filter",
        "nis.updates": "updates with a NIS",
        "nis.dof": "sum of their degrees of freedom",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,)."""
        names = known_components(track)
        if self._config.components == "position":
            names = [name for name in names if name in POSITION]
        found = {**_nees(track, truth, names), **_nis(track.innovations, len(track.trial))}
        return {name: found[name] for name in self.columns}


def _nees(track: Track, truth: Array, names: list[str]) -> dict[str, Array]:
    places = [track.components.index(name) for name in names]
    covariance = track.covariance[..., places, :][..., places]
    stands = usable(track)
    with np.errstate(invalid="ignore"):  # unusable rows may hold anything
        nees = np.where(stands, squared_mahalanobis(difference(track, truth, names), covariance), np.nan)
    there = np.isfinite(nees) & (len(names) > 0)
    low, high = chi2_quantile([0.025, 0.975], len(names)) if names else (np.nan, np.nan)
    inside = there & (nees >= low) & (nees <= high)
    times = there.sum(axis=0)
    return {
        "nees.mean": _ratio(np.where(there, nees, 0.0).sum(axis=0), times),
        "nees.inside_95": _ratio(inside.sum(axis=0), times),
        "nees.dof": np.where(times > 0, float(len(names)), np.nan),
        "nees.times": times.astype(np.float64),
        "nees.singular": (stands & ~there).sum(axis=0).astype(np.float64),
    }


def _nis(innovations: Innovations, rows: int) -> dict[str, Array]:
    said = innovations.take(np.isfinite(innovations.nis) & (innovations.dof > 0))
    kinds, place = np.unique(said.dof, return_inverse=True)
    low, high = chi2_quantile(0.025, kinds)[place], chi2_quantile(0.975, kinds)[place]
    inside = (said.nis >= low) & (said.nis <= high)

    def total(weights: Array) -> Array:
        return np.bincount(said.row, weights=weights, minlength=rows)

    updates, dof = total(np.ones(len(said))), total(said.dof)
    return {
        "nis.mean": _ratio(total(said.nis), dof),
        "nis.inside_95": _ratio(total(inside), updates),
        "nis.updates": updates,
        "nis.dof": dof,
    }


def _ratio(part: Array, whole: Array) -> Array:
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


def squared_mahalanobis(error: Array, covariance: Array) -> Array:
    """e' P⁻¹ e for errors (..., d) and covariances (..., d, d): (...,), NaN where P is not positive definite.

    By a Cholesky factorisation of the correlations (so that metres and metres per second weigh alike), written out over the
    leading axes: numpy's own stops at the first matrix that has none. A component of which less than 1e-12 of its variance
    is left, given those before it, counts as singular.
    """
    d = error.shape[-1]
    # component by component, each one contiguous array over all leading axes; a NaN (of a variance that is not positive, of a
    # correlation beyond 1) goes through to the total
    p = np.ascontiguousarray(np.moveaxis(covariance, (-2, -1), (0, 1)))
    scale = [np.sqrt(np.where(p[j, j] > 0, p[j, j], np.nan)) for j in range(d)]
    white = [error[..., j] / scale[j] for j in range(d)]
    factor: list[list[Array]] = [[] for _ in range(d)]  # lower triangle, row by row
    total = np.zeros(error.shape[:-1])
    for j in range(d):
        for k in range(j):
            left = p[j, k] / (scale[j] * scale[k])
            for m in range(k):
                left = left - factor[j][m] * factor[k][m]
            factor[j].append(left / factor[k][k])
        left = np.ones_like(total)
        for k in range(j):
            left = left - factor[j][k] * factor[j][k]
            white[j] = white[j] - factor[j][k] * white[k]
        factor[j].append(np.sqrt(np.where(left > 1e-12, left, np.nan)))
        white[j] = white[j] / factor[j][j]
        total = total + white[j] * white[j]
    return total
