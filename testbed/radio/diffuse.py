"""The diffuse part of the channel: what arrives by countless small ways, so that a fade has a place and stays there.

A path's local mean power is split by the Rice factor K (linear): a share K/(K+1) keeps the path's own phase, 1/(K+1) is
diffuse,

    h = g · ( √(K/(K+1)) · exp(-jkd) + √(1/(K+1)) · D )

with D a complex field of unit power. K follows from the soft line of sight s (`testbed.radio.sight`): K = 10 s^1.5, that is
10 dB in the open, 3-6 dB where a third to half of the zone is clear, as in an aisle, and 0, Rayleigh fading, where nothing is.

D is a sum of `WAVES` plane waves of equal strength at either end,

    D = 1/√P · Σ_p exp j( φ_p + k u_p·x_tag + k w_p·x_antenna - 2π (f - f0) τ_p ),      k = 2π f0 / c

with directions u_p and w_p uniform on the sphere, so its correlation over Δ metres at either end is sin(kΔ)/(kΔ): nought at λ/2,
below 0.22 beyond. τ_p is exponential with mean DELAY, so that carriers f fade apart, about the middle f0 of the hop table. The
waves belong to the hall and the trial, not to a tag: two tags side by side fade alike, as reference tags must, and adding a
tag or an antenna moves nothing.

A moving body takes part: of the power of D a share w² comes by way of it and depends on where it is, w falling smoothly from
STIR on the straight line to exactly 0 where the way over the body is REACH longer. Nothing moves: D is constant.

Left out: the strength of scatterers near either end (a field of equal waves has no clusters), change of direction with
distance, polarisation, and the patterns of antenna and tag towards scatterers: the diffuse power is a share of the path's own,
so a tag that points at the antenna has as little of it as of the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from testbed.columns import Array, Table, column
from testbed.rng import Counter
from testbed.units import SPEED_OF_LIGHT

OPEN_K = 10.0  # 10 dB: line of sight in large industrial halls, Rappaport, IEEE Trans. Antennas Propag. 37 (1989): 4-12 dB
FALL = 1.5  # exponent of the share that is clear: 3-6 dB for shares of 1/3 to 1/2
WAVES = 24  # a sum of so many is Gaussian to 1/24 in its fourth moment
DELAY = 5e-9  # s, mean excess delay, ways 1.5 m longer: with it RSSI at one place spreads by 0.4-2 dB over 50 FCC carriers, as in logs
STIR, REACH = 0.8, 2.5  # share of the field by way of a body in the line; m by which the way over a body is longer when it is out of it


def rice_factor(clear: ArrayLike, open_k: float = OPEN_K) -> Array:
    """K, linear, for the share of the Fresnel zone that is clear: open_k · clear^1.5."""
    return open_k * np.asarray(clear, dtype=np.float64) ** FALL


@dataclass(frozen=True, eq=False)
class Stir(Table):
    """Moving bodies that take part in links: which link, the body's key and place, and its weight w; a link's bodies in a fixed order."""

    link: Array = column("int64")
    key: Array = column("uint64")
    center: Array = column("float64", ("N", 3), "m")
    weight: Array = column("float64")


class Field:
    """The diffuse field D of one hall in one trial. `middle` Hz: of the hop table. `name` keys its draws."""

    def __init__(self, root: int, trial: int, middle: float, name: str = "radio.diffuse") -> None:
        self._middle = middle
        self._draws = Counter(root, trial, name)
        self._drawn: dict[int, tuple[Array, Array]] = {}
        self._delay = -DELAY * np.log(self._draws.uniform(0, np.arange(WAVES)))

    def at(self, antenna: Array, tag: Array, frequency: ArrayLike, stir: Stir | None = None) -> Array:
        """(N,) complex D for antennas at (N, 3) and tags at (N, 3), m, at carriers (N,) Hz; its mean power over places is 1."""
        f = np.broadcast_to(np.asarray(frequency, dtype=np.float64), (len(tag),))
        field = self._sum(0, f, tag, antenna)
        if stir is None:
            return field
        for key in np.unique(stir.key):
            own = stir.take(stir.key == key)
            here = own.link
            over = self._sum(int(key), f[here], tag[here], antenna[here], own.center)
            field[here] = np.sqrt(1 - own.weight**2) * field[here] + own.weight * over
        return field

    def _sum(self, key: int, frequency: Array, tag: Array, antenna: Array, body: Array | None = None) -> Array:
        """The sum of the waves of `key`: 0 is the hall's own, others go by way of a moving body at `body` (N, 3)."""
        start, directions = self._waves_of(key)
        places = np.concatenate([tag, antenna, np.zeros_like(tag) if body is None else body], axis=1)
        wavenumber = 2 * np.pi * self._middle / SPEED_OF_LIGHT
        return _waves(places, directions * wavenumber, start, self._delay, 2 * np.pi * (frequency - self._middle))

    def _waves_of(self, key: int) -> tuple[Array, Array]:
        """Phase (WAVES,) of each wave at the origin, and its directions (WAVES, 9) at the tag, at the antenna and at the body."""
        if key not in self._drawn:
            start = 2 * np.pi * self._draws.uniform(1, np.uint64(key), np.arange(WAVES))
            by_body = self._directions(4, key) + self._directions(5, key)  # the way there and the way on
            self._drawn[key] = start, np.concatenate([self._directions(2, key), self._directions(3, key), by_body], axis=1)
        return self._drawn[key]

    def _directions(self, end: int, key: int) -> Array:
        """(WAVES, 3) unit vectors, uniform on the sphere."""
        z = 2 * self._draws.uniform(end, np.uint64(key), np.arange(WAVES), 0) - 1
        turn, flat = 2 * np.pi * self._draws.uniform(end, np.uint64(key), np.arange(WAVES), 1), np.sqrt(1 - z * z)
        return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


@njit(cache=True)
def _waves(places, directions, start, delay, beside):
    """(N,) complex: the sum over waves of exp j(start + places · directions - beside · delay), scaled to unit power."""
    field = np.empty(len(places), dtype=np.complex128)
    for i in range(len(places)):
        real, imaginary = 0.0, 0.0
        for p in range(len(directions)):
            phase = start[p] - beside[i] * delay[p]
            for axis in range(9):
                phase += places[i, axis] * directions[p, axis]
            real += np.cos(phase)
            imaginary += np.sin(phase)
        field[i] = complex(real, imaginary) / np.sqrt(len(directions))
    return field


def weight_of(excess: ArrayLike) -> Array:
    """w in [0, STIR] of a body over which the way is `excess` m longer: STIR (1 - (e/REACH)²)², 0 beyond REACH."""
    share = np.minimum(np.asarray(excess, dtype=np.float64) / REACH, 1.0)
    return STIR * (1 - share * share) ** 2
