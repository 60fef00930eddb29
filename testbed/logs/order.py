"""Rows into the order of their times, as far as a bound on lateness allows; wrong clocks found by how far they run ahead."""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.logs.bad import BadRows

EARLY = "time before the start of the log"
AHEAD = "time far ahead of the rows before"
LATE = "later than lateness_s allows"


class Order:
    """One stream of a file. A row arrives when the latest time before it in the file does: that is its `t_arrival`."""

    def __init__(self, lateness_s: float, longest_gap_s: float, bad: BadRows) -> None:
        self._lateness, self._gap, self._bad = lateness_s, longest_gap_s, bad
        self._newest: float | None = None
        self.moved = 0  # rows that came after a row with a later time, and are sorted

    def take(self, line: Array, t: Array) -> tuple[Array, Array]:
        """(which rows to keep (N,) bool, t_arrival (N,) s) of rows with finite times t, in the order of the file."""
        if not len(t):
            return np.ones(0, dtype=bool), np.empty(0)
        first = float(t[0]) if self._newest is None else self._newest
        ahead = self._ahead(t, first)
        newest = np.maximum.accumulate(np.where(ahead, -np.inf, np.maximum(t, first)))
        newest = np.maximum(newest, first)
        late = ~ahead & (newest - t > self._lateness)
        self._bad.add(line[ahead], AHEAD, t[ahead])
        self._bad.add(line[late], LATE, t[late])
        keep = ~(ahead | late)
        self.moved += int((keep & (t < newest)).sum())
        self._newest = float(newest[-1])
        return keep, newest

    def _ahead(self, t: Array, first: float) -> Array:
        """Rows that run farther ahead of all good rows before them than the longest gap."""
        reached = np.maximum.accumulate(np.concatenate([[first], t]))
        if not (np.diff(reached) > self._gap).any():
            return np.zeros(len(t), dtype=bool)
        newest, ahead = first, np.zeros(len(t), dtype=bool)
        for i, value in enumerate(t.tolist()):
            if value - newest > self._gap:
                ahead[i] = True
            elif value > newest:
                newest = value
        return ahead
