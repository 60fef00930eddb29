"""What readers report of detections: which antennas are one reader, what can be no count, what was told before, whose silence counts."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimators.rssi_model import fixed_antennas
from testbed.types import Array, Site


class Readers:
    """The readers of a site, and which antennas each has. ValueError, in the name of `method`, where one's place is not known.

    of (A,): the reader of each antenna; antennas (R, most) the antennas of each, -1 beyond its own; names (R,).
    """

    def __init__(self, site: Site, method: str) -> None:
        fixed_antennas(site, method)
        antennas = site.antennas
        lost = np.flatnonzero(~(np.isfinite(antennas.position).all(axis=1) & np.isfinite(antennas.quaternion).all(axis=1)))
        if len(lost):
            i = lost[0]
            raise ValueError(f"{method}: the place of antenna {antennas.id[i]} of reader {antennas.reader[i] or '(unnamed)'} is not known")
        self.names, self.of = np.unique(antennas.reader, return_inverse=True)
        each = np.bincount(self.of, minlength=len(self.names))
        self.antennas = np.full((len(self.names), each.max()), -1, dtype=np.int64)
        for reader in range(len(self.names)):
            self.antennas[reader, : each[reader]] = np.flatnonzero(self.of == reader)


class Reports:
    """Counts as they come in for B rows: refuses what can't be, and tells what is told twice.

    ValueError, naming the row, for a block without queries, more reads than queries, and an antenna that the site doesn't have.
    """

    def __init__(self, rows: int, antennas: int, method: str) -> None:
        self._method, self._last = method, np.full((rows, antennas), np.iinfo(np.int64).min)

    def new(self, row: Array, data: Any) -> Array:
        """(E,) bool: entries that have not been told before; a reader's rounds count upwards, save those that are late."""
        self._check(row, data)
        known = self._last[row, data.antenna] == data.round
        self._last[row, data.antenna] = data.round
        return ~known

    def _check(self, row: Array, data: Any) -> None:
        for wrong, says in (
            ((data.antenna < 0) | (data.antenna >= self._last.shape[1]), "is of an antenna that the site doesn't have"),
            (data.queries < 1, "asked nothing: a block has at least one query"),
            ((data.n < 0) | (data.n > data.queries), "has a count that is not between 0 and its queries"),
        ):
            if wrong.any():
                i = int(np.flatnonzero(wrong)[0])
                what = f"round {data.round[i]}, antenna {data.antenna[i]}: {data.n[i]} reads of {data.queries[i]} queries"
                raise ValueError(f"{self._method}: row {row[i]}, {what}: it {says}")


class Held:
    """Silences that count only if their reader hears the tag in the same round: kept until one of its antennas does.

    The round of a reader is over when a round of another number of it begins.
    """

    def __init__(self, rows: int, readers: Readers) -> None:
        self._readers = readers
        antennas = len(readers.of)
        self._round = np.full((rows, antennas), -1, dtype=np.int64)  # of the silence that is held, -1 for none
        self._t = np.zeros((rows, antennas))
        self._queries = np.zeros((rows, antennas), dtype=np.int64)
        self._heard = np.full((rows, len(readers.names)), -1, dtype=np.int64)  # the round in which a reader heard the tag last

    def sort(self, row: Array, data: Any) -> tuple[Array, Array, Array, Array, Array]:
        """(row, antenna, n, t, queries) of all that counts now: of the entries, and of silences held before them."""
        reader, antenna, round_ = self._readers.of[data.antenna], np.asarray(data.antenna, dtype=np.int64), data.round
        read = data.n > 0
        self._heard[row[read], reader[read]] = round_[read]
        counts = self._heard[row, reader] == round_
        quiet = ~counts
        self._round[row[quiet], antenna[quiet]] = round_[quiet]
        self._t[row[quiet], antenna[quiet]] = data.t[quiet]
        self._queries[row[quiet], antenna[quiet]] = data.queries[quiet]
        entry, place = np.nonzero(read[:, None] & (self._readers.antennas[reader] >= 0))
        a, b = self._readers.antennas[reader[entry], place], row[entry]
        waiting = (self._round[b, a] == round_[entry]) & (self._round[b, a] >= 0)
        a, b = a[waiting], b[waiting]
        self._round[b, a] = -1
        none = np.zeros(len(a), dtype=np.int64)
        return (
            np.concatenate([row[counts], b]),
            np.concatenate([antenna[counts], a]),
            np.concatenate([np.asarray(data.n, dtype=np.int64)[counts], none]),
            np.concatenate([data.t[counts], self._t[b, a]]),
            np.concatenate([np.asarray(data.queries, dtype=np.int64)[counts], self._queries[b, a]]),
        )
