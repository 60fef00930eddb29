"""How far a tag has come nearer to an antenna from one of its reads to the next, by phase: d₁ - d₀ = -wrap(φ₁ - φ₀) c / 4π f.

Whatever cables, antenna and tag add to a phase is in both and falls out. Right as long as the tag moves less than λ/8 between the two.
"""

from __future__ import annotations

import numpy as np

from testbed.types import Array, Site, Snapshots
from testbed.units import SPEED_OF_LIGHT, wrap


def one_carrier(site: Site, method: str) -> float:
    """m a radian of phase. ValueError for a site that hops: phases on two carriers can't be subtracted."""
    if len(site.frequencies) != 1:
        raise ValueError(
            f"{method}: changes of phase need one carrier, and the site has {len(site.frequencies)}: leave phase_noise_rad out"
        )
    return SPEED_OF_LIGHT / (4 * np.pi * float(site.frequencies[0]))


class PhaseChanges:
    """The last phase of each row's tags by each antenna, and what came of it at the next read."""

    def __init__(self, rows: int, antennas: int, metres: float, longest: float) -> None:
        self._antennas, self._metres, self._longest = antennas, metres, longest
        self._phase, self._time = np.empty((rows, 0, antennas)), np.empty((rows, 0, antennas))

    def take(self, rows: Array, shots: Snapshots, counts: Array) -> tuple[Array, Array]:
        """Changes of distance (E, T, M) m, NaN where there is none, and the times (E, T, M) s that they took.

        counts (E, T, M) bool: which of the phases to look at. None for the first read of a link, and after a gap longer than `longest`.
        """
        self._widen(shots.phase.shape[1])
        phase = np.where(counts, shots.phase, np.nan)
        now = np.broadcast_to(shots.t[:, None, None], phase.shape)
        slots = phase.shape[1]
        span = now - self._time[rows, :slots]
        change = np.where(span <= self._longest, -self._metres * wrap(phase - self._phase[rows, :slots]), np.nan)
        there = np.isfinite(phase)
        self._phase[rows, :slots] = np.where(there, phase, self._phase[rows, :slots])
        self._time[rows, :slots] = np.where(there, now, self._time[rows, :slots])
        return change, np.where(np.isfinite(change), span, 0.0)

    def _widen(self, slots: int) -> None:
        """Make room for targets with more tags than any before."""
        missing = slots - self._phase.shape[1]
        if missing > 0:
            room = np.full((len(self._phase), missing, self._antennas), np.nan)
            self._phase = np.concatenate([self._phase, room], axis=1)
            self._time = np.concatenate([self._time, np.full_like(room, -np.inf)], axis=1)


def change(states: Array, antenna: Array, span: Array) -> tuple[Array, Array]:
    """The change of distance (N,) m to antennas at (N, 3) over the last `span` (N,) s at states (N, 6), and its gradient (N, 6).

    Where the tag was is taken from where it is and how fast: an acceleration a in between makes an error of a · span² / 2.
    """
    position, velocity = states[:, :3], states[:, 3:]
    now, before = position - antenna, position - span[:, None] * velocity - antenna
    far, was = (np.maximum(np.linalg.norm(r, axis=1), 1e-9) for r in (now, before))
    toward, came = now / far[:, None], before / was[:, None]
    return far - was, np.concatenate([toward - came, span[:, None] * came], axis=1)
