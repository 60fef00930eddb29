"""What readers report of detections: which antennas are one reader, what can be no count, what was told before, whose silence counts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from estimators.rssi_model import fixed_antennas
from testbed.types import Array, Site

NEVER = np.iinfo(np.int64).min  # a round that there is not


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


class Found(NamedTuple):
    """Counts that say something, F of them: of which row and antenna, complete at which time (s), out of how many queries."""

    row: Array
    antenna: Array
    n: Array
    t: Array
    queries: Array


class Reports:
    """Counts as they come in for B rows: refuses what can't be, tells what is told twice, and whose silence counts.

    With `heard` a silence counts only if its reader hears the tag in the same round (which may turn out later, at another antenna
    of it); without, every silence counts.
    ValueError, naming the row, for a block without queries, more reads than queries, and an antenna that the site doesn't have.
    """

    def __init__(self, rows: int, readers: Readers, method: str, heard: bool) -> None:
        self._method, self._readers, self._only_heard = method, readers, heard
        antennas = len(readers.of)
        self._last = np.full((rows, antennas), NEVER, dtype=np.int64)  # the last round that was told of
        self._waiting = np.full((rows, antennas), NEVER, dtype=np.int64)  # the round of a silence that waits for its reader
        self._t, self._queries = np.zeros((rows, antennas)), np.zeros((rows, antennas), dtype=np.int64)
        self._heard = np.full((rows, len(readers.names)), NEVER, dtype=np.int64)  # the last round in which a reader heard the tag

    def sort(self, row: Array, data: Any) -> tuple[Array, Found]:
        """Whether entries (E,) are new, and all that counts now: of them, and of silences that have waited."""
        used = np.empty(len(row), dtype=np.bool_)
        wrong, *found = _sort(
            row, data.antenna, data.round, data.n, data.t, data.queries, self._readers.of, self._readers.antennas, self._only_heard,
            self._last, self._waiting, self._t, self._queries, self._heard, used,
        )  # fmt: skip
        if wrong >= 0:
            self._refuse(row, data, wrong)
        return used, Found(*found)

    def _refuse(self, row: Array, data: Any, i: int) -> None:
        what = f"round {data.round[i]}, antenna {data.antenna[i]}: {data.n[i]} reads of {data.queries[i]} queries"
        if not 0 <= data.antenna[i] < len(self._readers.of):
            says = "it is of an antenna that the site doesn't have"
        elif data.queries[i] < 1:
            says = "a block has at least one query"
        else:
            says = "a count lies between 0 and its queries"
        raise ValueError(f"{self._method}: row {row[i]}, {what}: {says}")


@njit(cache=True)
def _sort(row, antenna, round_, n, t, queries, reader_of, antennas_of, only_heard, last, waiting, held_t, held_queries, heard, used):
    size = len(row) * (1 + antennas_of.shape[1])
    rows, antennas, counts = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    times, asked, f = np.empty(size), np.empty(size, dtype=np.int64), 0
    for e in range(len(row)):
        b, a = row[e], antenna[e]
        if a < 0 or a >= len(reader_of) or queries[e] < 1 or n[e] < 0 or n[e] > queries[e]:
            return e, rows[:0], antennas[:0], counts[:0], times[:0], asked[:0]
        used[e] = last[b, a] != round_[e]
        if not used[e]:
            continue
        last[b, a] = round_[e]
        r = reader_of[a]
        if n[e] > 0:
            heard[b, r] = round_[e]
        if only_heard and heard[b, r] != round_[e]:
            waiting[b, a], held_t[b, a], held_queries[b, a] = round_[e], t[e], queries[e]
            continue
        rows[f], antennas[f], counts[f], times[f], asked[f] = b, a, n[e], t[e], queries[e]
        f += 1
        for other in antennas_of[r]:
            if n[e] > 0 and other >= 0 and waiting[b, other] == round_[e]:
                waiting[b, other] = NEVER
                rows[f], antennas[f], counts[f], times[f], asked[f] = b, other, 0, held_t[b, other], held_queries[b, other]
                f += 1
    return -1, rows[:f], antennas[:f], counts[:f], times[:f], asked[:f]
