"""What received power an estimator expects: a two-way link budget from the site as surveyed.

    rssi = P_tx + 2 (G(θ) - χ) + 2 (G_tag - o) - L_mod + 40 log10(λ / 4π 1 m) - 10 n log10(d / 1 m)

with the antenna's conducted power and gain, polarisation loss χ, tag gain, modulation loss and path-loss exponent n (4 = free space
there and back: Friis twice). G(θ) is a cos^p pattern through the half-power beam width, over a floor: G_max (f + (1 - f) cos^p θ).
Which way a tag is turned nobody knows; o is what a dipole's pattern takes in the mean over all directions, in dB. It knows nothing of
obstacles and reflections: they, and how far a tag's turn is from the mean (7 dB there and back), are left to `sigma_db`.

Two guards against the singularity at the antenna: d² is taken as |r|² + near², so h and its gradient are smooth and bounded (at 0.5 m
that is a tenth of a dB); and for the extended filter `quadratic` gives what its linearisation leaves out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit
from pydantic import Field

from testbed import frames
from testbed.quantity import Config, DecibelMilliwatts, Decibels, Metres, Seconds
from testbed.types import Array, Site
from testbed.units import SPEED_OF_LIGHT, from_db

LIMITS_DBM = (-200.0, 100.0)  # no reader reports anything beyond: it is a fault, not a measurement
DIPOLE_MEAN_DB = 3.36  # mean over the sphere of -20 log10 F, F = cos(π/2 cos α) / sin α of a half-wave dipole (Balanis, eq. 4-84)
NEPER_DB = 10 / math.log(10)  # dB per unit of the natural logarithm of a power


class RssiConfig(Config):
    """The budget, and how far reads scatter about it.

    With `reference_dbm`, the level at 1 m on boresight, the budget is left aside. `correlation_s`: errors of one antenna's reads are alike
    over such times (a fade passes in λ/2 of motion), so reads that follow faster count for less; 0 takes every read as new evidence.
    """

    sigma_db: Annotated[Decibels, Field(gt=0, le=40)] = 4.0
    correlation_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.2
    path_loss_exponent: Annotated[float, Field(gt=0, le=12)] = 4.0
    reference_dbm: Annotated[DecibelMilliwatts, Field(ge=-200, le=100)] | None = None
    modulation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] = 8.0
    polarisation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] = 3.0
    orientation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] | None = (
        None  # one way; DIPOLE_MEAN_DB for a dipole, 0 for an isotropic tag
    )
    use_pattern: bool = True
    near_m: Annotated[Metres, Field(ge=0.01, le=1)] = 0.1


def measured(rssi: Array) -> Array:
    """RSSI with NaN, which no filter uses, in place of what can't be one."""
    with np.errstate(invalid="ignore"):
        return np.where((rssi >= LIMITS_DBM[0]) & (rssi <= LIMITS_DBM[1]), rssi, np.nan)


def fixed_antennas(site: Site, method: str) -> None:
    """ValueError, naming them, where the site has antennas that move with a body, or none at all: `method` can't place those."""
    if not len(site.antennas):
        raise ValueError(f"{method}: the site has no antennas")
    carried = site.antennas.id[site.antennas.carrier != ""]
    if len(carried):
        raise ValueError(
            f"{method}: the place of {', '.join(carried[:3])} is not known, it is carried: leave out antennas on bodies that move"
        )


class RssiModel:
    """h and its gradient for any antenna and tag of a site, vectorised over entries.

    ValueError, in the name of `method`, for a site that can't be used: carried antennas, or no carrier frequencies and no reference_dbm.
    """

    def __init__(self, config: RssiConfig, site: Site, method: str) -> None:
        fixed_antennas(site, method)
        antennas = site.antennas
        self._position, self._boresight = antennas.position, frames.rotate(antennas.quaternion, np.array([1.0, 0.0, 0.0]))
        self._slope, self._near2 = config.path_loss_exponent * NEPER_DB, config.near_m**2
        self._level = _levels(config, site, method)
        half = np.minimum(antennas.beamwidth, np.pi) / 2
        with np.errstate(divide="ignore"):
            power = np.where(half < np.pi / 2, np.log(0.5) / np.log(np.cos(half)), 0.0)
        self._power = power if config.use_pattern else np.zeros(len(antennas))  # cos^0: the same in all directions
        self._floor = from_db(-antennas.front_to_back)

    def expected(self, position: Array, antenna: Array, tag: Array) -> Array:
        """(E, ...) dBm at positions (E, ..., 3) of the tags (E,) by the antennas (E,)."""
        return self._evaluate(position, antenna, tag, np.empty((0, 0, 3)))

    def linearised(self, position: Array, antenna: Array, tag: Array) -> tuple[Array, Array]:
        """(E, ...) dBm as `expected`, and its gradient (E, ..., 3) in dB/m."""
        gradient = np.empty((len(antenna), math.prod(position.shape[1:-1]), 3))
        return self._evaluate(position, antenna, tag, gradient), gradient.reshape(position.shape)

    def quadratic(self, position: Array, antenna: Array, tag: Array) -> tuple[Array, Array, Array]:
        """At positions (E, 3): (E,) dBm, gradient (E, 3) dB/m, and Hessian (E, 3, 3) dB/m² by differences over 1e-4 of the distance."""
        step = 1e-4 * np.sqrt(((position - self._position[antenna]) ** 2).sum(axis=1) + self._near2)
        level, gradient = self.linearised(position[:, None] + _CORNER * step[:, None, None], antenna, tag)
        hessian = (gradient[:, 1:] - gradient[:, :1]) / step[:, None, None]
        return level[:, 0], gradient[:, 0], (hessian + hessian.transpose(0, 2, 1)) / 2

    def distance(self, rssi: Array, antenna: Array, tag: Array) -> Array:
        """m: the distance on boresight that a level (...) in dBm stands for, by the law alone; NaN for NaN."""
        return np.exp((self._level[antenna, tag] - rssi) / self._slope)

    def _evaluate(self, position: Array, antenna: Array, tag: Array, gradient: Array) -> Array:
        """`expected`; fills `gradient` unless it is empty."""
        points = np.ascontiguousarray(position).reshape(len(antenna), math.prod(position.shape[1:-1]), 3)
        level = np.empty(points.shape[:2])
        _budget(
            points, antenna, self._level[antenna, tag], self._position, self._boresight, self._power, self._floor, self._slope, self._near2,
            level, gradient,
        )  # fmt: skip
        return level.reshape(position.shape[:-1])

    def link(self, antenna: int, tag: int) -> Link:
        """The same for one antenna and tag in plain numbers."""
        origin, boresight = self._position[antenna].tolist(), self._boresight[antenna].tolist()
        level, power, floor = (float(a) for a in (self._level[antenna, tag], self._power[antenna], self._floor[antenna]))
        return Link(origin, boresight, level, self._slope, self._near2, power, floor)


_CORNER = np.concatenate([np.zeros((1, 3)), np.eye(3)])


@njit(cache=True, error_model="numpy")
def _budget(points, antenna, at_1m, origin, boresight, power, floor, slope, near2, level, gradient):
    """level (E, P) dBm and, unless it is empty, gradient (E, P, 3) at the points (E, P, 3) seen from the antennas (E,)."""
    for e in range(points.shape[0]):
        a = antenna[e]
        bx, by, bz, p, f = boresight[a, 0], boresight[a, 1], boresight[a, 2], power[a], floor[a]
        for k in range(points.shape[1]):
            rx, ry, rz = points[e, k, 0] - origin[a, 0], points[e, k, 1] - origin[a, 1], points[e, k, 2] - origin[a, 2]
            s2 = rx * rx + ry * ry + rz * rz + near2
            s = np.sqrt(s2)
            cosine = (rx * bx + ry * by + rz * bz) / s
            lobe, pattern = 0.0, 1.0  # d pattern / d cosine, pattern
            if p > 0.0:
                lobe, pattern = 0.0, f
                if cosine > 1e-6:
                    raised = (1.0 - f) * cosine**p
                    lobe, pattern = p * raised / cosine, f + raised
            level[e, k] = at_1m[e] + NEPER_DB * np.log(pattern * pattern) - 0.5 * slope * np.log(s2)
            if len(gradient):
                steep = 2.0 * NEPER_DB * lobe / pattern
                radial, axial = -(slope + steep * cosine) / s2, steep / s
                gradient[e, k, 0] = radial * rx + axial * bx
                gradient[e, k, 1] = radial * ry + axial * by
                gradient[e, k, 2] = radial * rz + axial * bz


def _levels(config: RssiConfig, site: Site, method: str) -> Array:
    """(antennas, tags) dBm at 1 m on boresight: as configured, else as measured at the antenna, else by the budget."""
    measured_there = np.isfinite(site.antennas.reference)
    if config.reference_dbm is not None:
        return np.full((len(site.antennas), len(site.tags)), config.reference_dbm)
    if len(measured_there) and measured_there.all():
        return np.repeat(site.antennas.reference[:, None], len(site.tags), axis=1)
    if not len(site.frequencies):
        raise ValueError(f"{method}: the site names no carrier frequencies to reckon a level at 1 m from: set reference_dbm")
    wavelength = SPEED_OF_LIGHT / np.mean(site.frequencies)
    antenna = site.antennas.power + 2 * (site.antennas.gain - config.polarisation_loss_db)
    common = 40 * math.log10(wavelength / (4 * math.pi)) - config.modulation_loss_db
    turned = np.where(site.tags.pattern == "dipole", DIPOLE_MEAN_DB, 0.0)
    if config.orientation_loss_db is not None:
        turned = np.full(len(site.tags), config.orientation_loss_db)
    return antenna[:, None] + 2 * (site.tags.gain - turned)[None, :] + common


@dataclass(frozen=True)
class Link:
    """One antenna and one tag: the model in plain numbers, for a filter that is written for one target."""

    origin: Sequence[float]
    boresight: Sequence[float]
    level: float
    slope: float
    near2: float
    power: float
    floor: float

    def expected(self, x: Array) -> float:
        """dBm at the position x[:3]."""
        _, s2, front = self._seen_from(x)
        pattern = self.floor + (1 - self.floor) * front**self.power  # 0^0 is 1, the same in all directions
        return self.level - self.slope / 2 * math.log(s2) + 2 * NEPER_DB * math.log(pattern)

    def gradient(self, x: Array) -> tuple[float, float, float]:
        """dB/m at the position x[:3]."""
        r, s2, front = self._seen_from(x)
        steep = 0.0
        if front > 0 and self.power > 0:
            lobe = (1 - self.floor) * front ** (self.power - 1)
            steep = 2 * NEPER_DB * self.power * lobe / (self.floor + lobe * front)
        radial, axial = (-self.slope - steep * front) / s2, steep / math.sqrt(s2)
        gx, gy, gz = (radial * a + axial * b for a, b in zip(r, self.boresight, strict=True))
        return gx, gy, gz

    def _seen_from(self, x: Array) -> tuple[tuple[float, float, float], float, float]:
        rx, ry, rz = float(x[0]) - self.origin[0], float(x[1]) - self.origin[1], float(x[2]) - self.origin[2]
        s2 = rx * rx + ry * ry + rz * rz + self.near2
        cosine = (rx * self.boresight[0] + ry * self.boresight[1] + rz * self.boresight[2]) / math.sqrt(s2)
        return (rx, ry, rz), s2, cosine if cosine > 1e-6 else 0.0


class ReadVariance:
    """How much each read counts: sigma², times (1 + ρ) / (1 - ρ) with ρ = exp(-Δt / τ) for a read Δt after its row's last by that antenna.

    Errors that stay alike over τ carry no more information however often they are read; with that factor a stream of any rate
    gives one independent read every 2τ. A read given twice at one time counts as good as nothing.
    """

    def __init__(self, config: RssiConfig, rows: int, antennas: int) -> None:
        self._variance, self._tau = config.sigma_db**2, config.correlation_s
        self._last = np.full((rows, antennas), -np.inf)

    def of(self, row: Array, antenna: Array, t: Array) -> Array:
        """(E,) dB²: the variance of reads by `antenna` at `t` for the rows."""
        if self._tau == 0:
            return np.full(len(row), self._variance)
        apart = np.maximum(t - self._last[row, antenna], 1e-4 * self._tau)
        return self._variance / np.tanh(apart / (2 * self._tau))

    def took(self, row: Array, antenna: Array, t: Array) -> None:
        """These reads were used."""
        self._last[row, antenna] = t
