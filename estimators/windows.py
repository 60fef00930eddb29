"""What was heard lately: the newest value of each antenna, for methods that look at signal strengths side by side."""

from __future__ import annotations

import numpy as np

from estimators.rssi_model import measured
from testbed.types import Array, Event


class Newest:
    """The newest RSSI per row and antenna; per row, reference tag and antenna where `tags` (R,) lists the tags to tell apart.

    A read without RSSI is as good as none. Late reads do not replace newer ones.
    """

    def __init__(self, rows: int, antennas: int, tags: Array | None = None) -> None:
        self._tags = tags if tags is None else np.asarray(tags)
        if self._tags is not None:
            self._order = np.argsort(self._tags)
        shape = (rows, antennas) if self._tags is None else (rows, len(self._tags), antennas)
        self._value, self._time = np.full(shape, np.nan), np.full(shape, -np.inf)

    def add(self, event: Event) -> Array:
        """Take the event's reads; (E,) bool, which of them said something."""
        reads = event.data
        at: tuple[Array, ...] = (event.row, reads.antenna)
        if self._tags is not None:
            at = (event.row, self._order[np.searchsorted(self._tags, reads.tag, sorter=self._order)], reads.antenna)
        heard = np.isfinite(measured(reads.rssi))
        newer = heard & (reads.t >= self._time[at])
        at = tuple(a[newer] for a in at)
        self._value[at], self._time[at] = reads.rssi[newer], reads.t[newer]
        return heard

    def rssi(self, t: Array, memory: float, rows: Array | slice = slice(None)) -> Array:
        """(rows, [tags,] antennas) dBm: what was heard within `memory` s before t (rows,), NaN elsewhere. All rows, or those given."""
        time = self._time[rows]
        now = np.reshape(t, (-1, *(1,) * (time.ndim - 1)))
        return np.where(now - time <= memory, self._value[rows], np.nan)


class Latest:
    """The newest RSSI in arrays of one shape per row, such as (references, antennas), taken from snapshots with gaps.

    A reader serves its antennas in turn, so that a snapshot often holds one level alone, and the others stand from before.
    """

    def __init__(self, rows: int, *shape: int) -> None:
        self._value, self._time = np.full((rows, *shape), np.nan), np.full((rows, *shape), -np.inf)

    def add(self, rows: Array, t: Array, rssi: Array) -> None:
        """rssi (E, *shape) dBm of the rows (E,), heard at t (E,) s; NaN where nothing was."""
        now = np.reshape(t, (-1, *(1,) * (rssi.ndim - 1)))
        new = np.isfinite(measured(rssi)) & (now >= self._time[rows])
        self._value[rows] = np.where(new, rssi, self._value[rows])
        self._time[rows] = np.where(new, now, self._time[rows])

    def rssi(self, rows: Array, t: Array, memory: float) -> Array:
        """(E, *shape) dBm of the rows (E,): what was heard within `memory` s before t (E,), NaN elsewhere."""
        now = np.reshape(t, (-1, *(1,) * (self._time.ndim - 1)))
        return np.where(now - self._time[rows] <= memory, self._value[rows], np.nan)
