"""How much of a wave passes between an antenna and a tag, by how both are turned: their patterns and their polarisations.

    G = G_a · D(θ) · G_t · max(F(α)² · χ, NULL / 2)

θ is the angle off the antenna's boresight and D its pattern (`testbed.radio.antenna`). A tag's antenna is a dipole along the +y of the
tag's frame; on a mount, whose +x is the outward normal, it lies flat on the surface and level. At an angle α to it

    F(α) = cos(π/2 cos α) / sin α                          (half-wave dipole: Balanis, Antenna Theory, 4th ed., eq. 4-84)

A circular wave gives a linear tag one half, χ = 1/2, however it is rolled. A linear antenna has its field along its own +z on
boresight; towards k it is carried along without turning about k (Ludwig's third definition, IEEE Trans. AP 21, 1973, p. 116), and χ is
the squared cosine between it and the tag's dipole, both seen along k:

    e = p - (p·k) / (1 + b·k) · (b + k)                    b boresight, p the field there

Real tags have no perfect nulls. Their dipoles are bent, and the loop that matches the chip takes part of any polarisation: measured
patterns of inlays fall by 10 to 20 dB along their axis, and `NULL` is an engineering value between. A tag without a direction
(`isotropic`) takes one half of whatever comes, as the mean over all rolls would be.

Left out: a circular antenna's axial ratio, which off boresight gets worse (with it a tag's roll would count by some dB); what the
thing that a tag is on does to its pattern; the bistatic angle of reflections off dielectrics (see `testbed.radio.reflection`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from testbed.columns import Array
from testbed.radio.antenna import exponent
from testbed.radio.propagation import POLARISATION_DB
from testbed.types import Antennas, Tags

NULL_DB = 15.0  # below a tag's best direction, along its dipole
_LEAST = 10 ** (-NULL_DB / 10) / 2
_BEHIND = 1e-9  # 1 + cosine: nearer to straight behind, the direction of a linear antenna's field is not defined


def polarisation_loss(antennas: Antennas) -> Array:
    """(antennas,) dB that a tag loses to polarisation however well it hangs: a bound for whoever asks what is out of reach."""
    return np.where(antennas.polarisation == "linear", 0.0, POLARISATION_DB)


def dipole_axis(quaternion: Array) -> Array:
    """(N, 3) direction of the dipole of tags turned to `quaternion` (N, 4): their +y."""
    w, x, y, z = quaternion.T
    return np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1)


class Coupling:
    """The gain of links by how both ends are turned. ValueError for a polarisation or a tag's pattern that nobody knows."""

    def __init__(self, antennas: Antennas, tags: Tags) -> None:
        linear, dipole = _is(antennas.polarisation, "linear", "circular"), _is(tags.pattern, "dipole", "isotropic")
        table = ~np.isnan(antennas.pattern[:, 0])
        n = np.zeros(len(antennas))
        n[~table] = exponent(antennas.beamwidth[~table])
        self._antennas = antennas.gain, n, antennas.front_to_back, table, antennas.pattern, linear
        self._tags = tags.gain, dipole

    def at(self, antenna: Array, tag: Array, looking: Array, axis: Array, towards: Array) -> tuple[Array, Array]:
        """(gain (N,) dBi of both ends and polarisation together, distance (N,) m) of links.

        looking : (N, 4) how the antennas `antenna` (N,) are turned; towards : (N, 3) m, what leaves them
        axis    : (N, 3) dipoles of the tags `tag` (N,), unit vectors; behind a mirror the mirrored ones
        """
        gain, distance = np.empty(len(antenna)), np.empty(len(antenna))
        _couple(antenna, tag, looking, axis, towards, *self._antennas, *self._tags, gain, distance)
        return gain, distance


def _is(given: Array, one: str, other: str) -> Array:
    unknown = set(given.tolist()) - {one, other}
    if unknown:
        raise ValueError(f"{', '.join(sorted(map(repr, unknown)))}: neither {one} nor {other}")
    return given == one


@njit(cache=True)
def _couple(antenna, tag, looking, axis, towards, gain, n, floor, tabled, table, linear, tag_gain, dipole, found, distance):
    for i in range(len(antenna)):
        a, k = antenna[i], tag[i]
        w, x, y, z = looking[i, 0], looking[i, 1], looking[i, 2], looking[i, 3]
        bx, by, bz = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        dx, dy, dz = towards[i, 0], towards[i, 1], towards[i, 2]
        far = math.sqrt(dx * dx + dy * dy + dz * dz)
        distance[i] = far
        if far > 0.0:
            dx, dy, dz = dx / far, dy / far, dz / far
        else:
            dx, dy, dz = bx, by, bz
        cosine = min(max(bx * dx + by * dy + bz * dz, -1.0), 1.0)  # beyond 1 by rounding alone
        shape = _interpolated(table[a], cosine) if tabled[a] else _lobe(cosine, n[a], floor[a])
        taken = 0.5
        if dipole[k]:
            tx, ty, tz = axis[i, 0], axis[i, 1], axis[i, 2]
            along = tx * dx + ty * dy + tz * dz
            across = 1.0 - along * along
            if across < 1e-12:
                taken = 0.0
            else:
                taken = math.cos(math.pi / 2 * along) ** 2 / across
                if linear[a]:
                    px, py, pz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
                    turn = (px * dx + py * dy + pz * dz) / (1 + cosine) if 1 + cosine > _BEHIND else 0.0
                    px, py, pz = px - turn * (bx + dx), py - turn * (by + dy), pz - turn * (bz + dz)
                    taken *= (px * tx + py * ty + pz * tz) ** 2 / across  # e is across k already: so is all of t that it meets
                else:
                    taken *= 0.5
            taken = max(taken, _LEAST)
        found[i] = gain[a] + shape + tag_gain[k] + 10 * math.log10(taken)


@njit(cache=True)
def _lobe(cosine, n, floor):
    return max(10 * n * math.log10(cosine), -floor) if cosine > 0.0 else -floor


@njit(cache=True)
def _interpolated(table, cosine):
    degrees = math.acos(cosine) * 180 / math.pi
    k = min(int(degrees), len(table) - 2)
    return table[k] + (degrees - k) * (table[k + 1] - table[k])
