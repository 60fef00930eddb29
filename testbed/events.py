"""The order of events and their cutting into calls.

The feeds of all kinds merge by turn, then time. What is older than its row's present time is late. Between two report times
the k-th event of every row goes into one call, each row with its own time: so 600 rows cost hardly more calls than one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from testbed.columns import Array, Table
from testbed.feeds import Feed
from testbed.types import Event

SAME_TIME = 1e-9  # s: an entry this little after a report time (0.1 * 3 against 3 / 10) still counts for it
ENTRIES = 1_000_000  # (entry, row) pairs merged at once, give or take those of one report interval: about 200 MB of temporaries


@dataclass(frozen=True, eq=False)
class Batch:
    """Events that are taken before report `tick`, at most one a row; `rows` and `t` are of all of them together."""

    tick: int
    rows: Array
    t: Array
    events: list[Event]


class Merge:
    """The batches of some feeds for rows that begin at `start` (B,) s and are reported at `ticks` (K,) s.

    late : (B,) how many events were dropped because their row had passed their time; complete once `batches` is through
    """

    def __init__(self, feeds: Sequence[Feed], ticks: Array, start: Array, accepts_late: bool) -> None:
        self._feeds, self._ticks, self._accepts_late = feeds, ticks, accepts_late
        self._passed = np.array(start, dtype=np.float64)
        self.late = np.zeros(len(start), dtype=np.int64)

    def batches(self) -> Iterator[Batch]:
        """In order; nothing of what has its turn after the last tick, which no report could show."""
        # an entry is taken before the first tick that is not earlier than its turn
        ends = [np.searchsorted(f.key, self._ticks + SAME_TIME, side="right") for f in self._feeds]
        entries = [np.concatenate([[0], np.cumsum(f.width())])[end] for f, end in zip(self._feeds, ends, strict=True)]
        total = np.sum(entries, axis=0) if entries else np.zeros(len(self._ticks), dtype=np.int64)
        first = 0
        while first < len(self._ticks):
            done = total[first - 1] if first else 0
            last = max(first + 1, int(np.searchsorted(total, done + ENTRIES, side="right")))
            slices = [(int(end[first - 1]) if first else 0, int(end[last - 1])) for end in ends]
            yield from self._chunk(slices)
            first = last

    def _chunk(self, slices: list[tuple[int, int]]) -> Iterator[Batch]:
        merged = _Merged.of(self._feeds, slices, self._ticks)
        if not self._accepts_late:
            floor = np.maximum(self._passed[merged.row], np.where(merged.tick > 0, self._ticks[merged.tick - 1], -np.inf))
            late = merged.t < np.maximum(floor, _newest_before(merged.row, merged.t))
            self.late += np.bincount(merged.row[late], minlength=len(self.late))
            merged = merged.take(np.flatnonzero(~late))
        np.maximum.at(self._passed, merged.row, merged.t)
        yield from merged.cut(self._feeds)


@dataclass(frozen=True, eq=False)
class _Merged:
    """(entry, row) pairs of all feeds: ordered by row, and in each row by turn."""

    row: Array
    t: Array
    tick: Array
    feed: Array
    entry: Array
    place: Array  # in the feed's lists

    @classmethod
    def of(cls, feeds: Sequence[Feed], slices: list[tuple[int, int]], ticks: Array) -> _Merged:
        spread = [feed.spread(a, b) for feed, (a, b) in zip(feeds, slices, strict=True)]
        none = np.empty(0, dtype=np.int64)
        entry = np.concatenate([none, *(e for e, _ in spread)])
        place = np.concatenate([none, *(p for _, p in spread)])
        row = np.concatenate([none, *(f.lists.row[p] for f, (_, p) in zip(feeds, spread, strict=True))])
        t = np.concatenate([none, *(f.table.t[e] for f, (e, _) in zip(feeds, spread, strict=True))]).astype(np.float64)
        key = np.concatenate([none, *(f.key[e] for f, (e, _) in zip(feeds, spread, strict=True))])
        which = np.repeat(np.arange(len(feeds)), [len(e) for e, _ in spread])
        tick = np.searchsorted(ticks + SAME_TIME, key)
        order = np.lexsort((place, entry, which, t, key, row))
        return cls(row, t, tick, which, entry, place).take(order)

    def take(self, index: Array) -> _Merged:
        return _Merged(self.row[index], self.t[index], self.tick[index], self.feed[index], self.entry[index], self.place[index])

    def cut(self, feeds: Sequence[Feed]) -> Iterator[Batch]:
        """One batch for each tick and rank."""
        rank = _position_in_run(self.row, self.tick)
        ordered, rank = self.take(order := np.lexsort((self.row, self.feed, rank, self.tick))), rank[order]
        tables = [f.data(ordered.entry[ordered.feed == i], ordered.place[ordered.feed == i]) for i, f in enumerate(feeds)]
        before = [np.concatenate([[0], np.cumsum(ordered.feed == i)]) for i in range(len(feeds))]
        edges = np.flatnonzero(np.diff(ordered.tick) | np.diff(rank)) + 1
        bounds = [0, *edges.tolist(), len(rank)] if len(rank) else [0]
        for a, b in pairwise(bounds):
            events, at = [], a
            for i, feed in enumerate(feeds):
                c, d = int(before[i][a]), int(before[i][b])
                if d > c:
                    events.append(Event(feed.kind, ordered.row[at : at + d - c], _window(tables[i], c, d)))
                    at += d - c
            yield Batch(int(ordered.tick[a]), ordered.row[a:b], ordered.t[a:b], events)


def _newest_before(row: Array, t: Array) -> Array:
    """The largest t among the earlier entries of the same row (rows ascending), -inf where there is none."""
    values, place = np.unique(t, return_inverse=True)
    highest = np.maximum.accumulate(row * len(values) + place)
    same = np.diff(row, prepend=-1) == 0
    before = np.concatenate([[0], highest])[: len(row)] - row * len(values)
    return np.where(same, values[np.maximum(before, 0)] if len(row) else t, -np.inf)


def _position_in_run(*columns: Array) -> Array:
    """(N,) how many entries directly before share all columns with this one."""
    n = len(columns[0])
    begins = np.ones(n, dtype=bool)
    begins[1:] = np.any([np.diff(c) != 0 for c in columns], axis=0)
    return np.arange(n) - np.maximum.accumulate(np.where(begins, np.arange(n), 0))


def _window(table: Table, a: int, b: int) -> Table:
    """Rows a to b of a table as views of it. Not checked again: they were when the table was made."""
    view = copy(table)
    vars(view).update({name: getattr(table, name)[a:b] for name in table.column_names()})
    return view
