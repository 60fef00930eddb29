"""Who an entry of a stream speaks to: the streams of recordings, routed to the rows of an estimator.

A row is one target of one recording. A read goes to every target that has the tag, the read of a reference tag to every row
of its recording, odometry to the body that carries it, and a round to every row whose tags it asked, the silent ones included.

Two kinds are put together from reads: a snapshot is all that was read of one target at one instant, a reference snapshot all that was
read of the reference tags. It is there when the last of its reads has arrived. Of entries at one time for one row, those of a kind
earlier in the alphabet come first: reference snapshots before snapshots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from testbed.columns import Array, Table
from testbed.guidance import Actions
from testbed.recording import Recording
from testbed.types import Counts, Heading, Heights, Odometry, Ranges, Reads, ReferenceSnapshots, RoundCounts, Rounds, Snapshots

Stream = TypeVar("Stream", bound=Table)


@dataclass(frozen=True, eq=False)
class Lists:
    """For each of some groups a list of (row, tag): group g has those from start[g] to start[g + 1]."""

    start: Array
    row: Array
    tag: Array  # -1 where a kind is not about tags

    @classmethod
    def of(cls, group: Array, row: Array, tag: Array | None, groups: int) -> Lists:
        """From triples in any order; rows and tags ascend in each list."""
        tag = np.full(len(row), -1) if tag is None else tag
        order = np.lexsort((tag, row, group))
        start = np.concatenate([[0], np.cumsum(np.bincount(group, minlength=groups))])
        return cls(start.astype(np.int64), row[order], tag[order])


@dataclass(frozen=True, eq=False)
class Counted:
    """The non-zero counts of a feed's rounds, by (entry of the feed, tag)."""

    key: Array  # ascending
    n: Array
    tags: int

    def look_up(self, entry: Array, tag: Array) -> Array:
        """The count of each (entry, tag), 0 where it has no row: silence."""
        if not len(self.key):
            return np.zeros(len(entry), dtype=np.int32)
        wanted = entry * self.tags + tag
        place = np.minimum(np.searchsorted(self.key, wanted), len(self.key) - 1)
        return np.where(self.key[place] == wanted, self.n[place], 0)


@dataclass(frozen=True, eq=False)
class Feed:
    """One kind of stream on its way: N entries in the order of their turns, and the group of rows that each is for.

    key : (N,) s, when an entry's turn comes (see `turn`), ascending; entries of one turn are in the order of t
    """

    kind: str
    table: Any  # a Table of N entries with a time `t`
    key: Array
    group: Array  # (N,)
    lists: Lists
    counts: Counted | None = None  # rounds only

    def width(self) -> Array:
        """(N,) for how many rows each entry is."""
        return np.diff(self.lists.start)[self.group]

    def spread(self, a: int, b: int) -> tuple[Array, Array]:
        """Entries a to b once for each of their rows: the index of the entry, and the place in `lists`."""
        width = self.width()[a:b]
        entry = np.repeat(np.arange(a, b), width)
        nth = np.arange(len(entry)) - np.repeat(np.cumsum(width) - width, width)
        return entry, self.lists.start[self.group[entry]] + nth

    def data(self, entry: Array, place: Array) -> Table:
        """What an estimator gets of each (entry, row)."""
        asked = self.table.take(entry)
        if self.counts is None:
            return asked
        tag = self.lists.tag[place]
        same = {name: getattr(asked, name) for name in ("t_start", "round", "reader", "antenna", "queries")}
        return RoundCounts(t=asked.t_end, tag=tag, n=self.counts.look_up(entry, tag), **same)


def feeds(recordings: Sequence[Recording], kinds: frozenset[str], hold: float) -> list[Feed]:
    """A feed for each of `kinds`; the rows are numbered by recording, then target. One site for all recordings.

    ValueError for a kind that no stream is known for, and for counts without their round.
    """
    unknown = sorted(kinds - KINDS)
    if unknown:
        raise ValueError(f"no stream is known as {unknown[0]!r}: an estimator may consume {', '.join(sorted(KINDS))}")
    return [_ROUTES[kind](recordings, hold) for kind in sorted(kinds)]


def turn(t: Array, t_arrival: Array, hold: float) -> Array:
    """When an entry's turn comes: at its own time if it is there after waiting `hold`, else when it arrives, less the wait.

    So reports that come within `hold` of their time are taken in the order of their times, later ones as they come.
    """
    return np.where(t_arrival <= t + hold, t, t_arrival - hold)


def _feed(kind: str, table: Any, group: Array, lists: Lists, hold: float) -> Feed:
    key = turn(table.t, table.t_arrival, hold)
    order = np.lexsort((table.t, key))
    return Feed(kind, table.take(order), key[order], group[order], lists)


def _first_rows(recordings: Sequence[Recording]) -> Array:
    """(recordings + 1,) the first row of each recording, and the number of rows."""
    return np.cumsum([0] + [len(r.targets) for r in recordings])


def _joined(recordings: Sequence[Recording], name: str, kind: type[Stream]) -> tuple[Stream, Array]:
    """All recordings' streams of one name in one table, and which recording each entry is of."""
    parts = [(i, r.streams[name]) for i, r in enumerate(recordings) if name in r.streams]
    for _, part in parts:
        if not isinstance(part, kind):
            raise TypeError(f"the stream {name!r} is made of {type(part).__name__}, not of {kind.__name__}")
    table = kind.concatenate([p for _, p in parts if isinstance(p, kind)])
    return table, np.repeat([i for i, _ in parts], [len(p) for _, p in parts]).astype(np.int64)


def _tags_of_rows(recordings: Sequence[Recording]) -> tuple[Array, Array, Array]:
    """(recording, row, tag) of every tag that some target has."""
    first = _first_rows(recordings)
    found = [
        (i, first[i] + target, int(tag)) for i, r in enumerate(recordings) for target, tags in enumerate(r.target_tags) for tag in tags
    ]
    recording, row, tag = np.array(found, dtype=np.int64).reshape(-1, 3).T
    return recording, row, tag


def _reads(recordings: Sequence[Recording], hold: float) -> Feed:
    reads, recording = _joined(recordings, "reads", Reads)
    tags = len(recordings[0].site.tags)
    of, row, tag = _tags_of_rows(recordings)
    lists = Lists.of(of * tags + tag, row, tag, tags * len(recordings))
    return _feed("reads", reads, recording * tags + reads.tag, lists, hold)


def _reference_reads(recordings: Sequence[Recording], hold: float) -> Feed:
    reads, recording = _joined(recordings, "reads", Reads)
    wanted = np.isin(reads.tag, recordings[0].site.references.tag)
    first = _first_rows(recordings)
    lists = Lists.of(np.repeat(np.arange(len(recordings)), np.diff(first)), np.arange(first[-1]), None, len(recordings))
    return _feed("reference_reads", reads.take(wanted), recording[wanted], lists, hold)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Reads put into the cells (owner, instant, slot, antenna) of snapshots: N snapshots, in the order of owner and time."""

    owner: Array  # (N,) a row, or a recording
    t: Array  # (N,) s
    t_arrival: Array  # (N,) s
    at: tuple[Array, Array, Array]  # of each read: snapshot, slot, antenna
    order: Array  # in which the reads are listed in `at`

    @classmethod
    def of(cls, reads: Reads, owner: Array, slot: Array) -> _Cells:
        order = np.lexsort((reads.t, owner))
        owner, t = owner[order], reads.t[order]
        begins = np.ones(len(order), dtype=bool)
        begins[1:] = (np.diff(owner) != 0) | (np.diff(t) != 0)
        first = np.flatnonzero(begins)
        arrival = np.maximum.reduceat(reads.t_arrival[order], first) if len(first) else np.empty(0)
        return cls(owner[first], t[first], arrival, (np.cumsum(begins) - 1, slot[order], reads.antenna[order]), order)

    def filled(self, values: Array, slots: int, antennas: int) -> Array:
        """(N, slots, antennas): the reads' values in their cells, NaN elsewhere; of several in one cell the last that is a number."""
        cells = np.full((len(self.t), slots, antennas), np.nan)
        ordered = values[self.order]
        there = ~np.isnan(ordered)
        cells[tuple(place[there] for place in self.at)] = ordered[there]
        return cells


def _snapshots(recordings: Sequence[Recording], hold: float) -> Feed:
    reads, recording = _joined(recordings, "reads", Reads)
    tags, antennas = len(recordings[0].site.tags), len(recordings[0].site.antennas)
    of, row, tag = _tags_of_rows(recordings)
    slot = _position_in_list(row)
    rows = int(_first_rows(recordings)[-1])
    slots = int(slot.max(initial=0)) + 1
    own = np.full((rows, slots), -1)
    own[row, slot] = tag
    lists = Lists.of(of * tags + tag, np.arange(len(row)), None, tags * len(recordings))  # of a read: which (row, slot) it is for
    group = recording * tags + reads.tag
    times = np.diff(lists.start)[group]
    entry = np.repeat(np.arange(len(reads)), times)
    nth = np.arange(len(entry)) - np.repeat(np.cumsum(times) - times, times)
    pair = lists.row[lists.start[group[entry]] + nth]
    mine = reads.take(entry)
    cells = _Cells.of(mine, row[pair], slot[pair])
    rssi, phase = (cells.filled(values, slots, antennas) for values in (mine.rssi, mine.phase))
    every = np.arange(rows)
    table = Snapshots(cells.t, cells.t_arrival, own[cells.owner], rssi, phase)
    return _feed("snapshots", table, cells.owner, Lists.of(every, every, None, rows), hold)


def _position_in_list(row: Array) -> Array:
    """(N,) how many entries before have the same row; rows ascend."""
    starts = np.flatnonzero(np.diff(row, prepend=-1))
    return np.arange(len(row)) - np.repeat(starts, np.diff(np.append(starts, len(row))))


def _reference_snapshots(recordings: Sequence[Recording], hold: float) -> Feed:
    reads, recording = _joined(recordings, "reads", Reads)
    site, first = recordings[0].site, _first_rows(recordings)
    slot = np.full(len(site.tags), -1)
    slot[site.references.tag] = np.arange(len(site.references))
    wanted = slot[reads.tag] >= 0
    reads, recording = reads.take(wanted), recording[wanted]
    cells = _Cells.of(reads, recording, slot[reads.tag])
    rssi = cells.filled(reads.rssi, len(site.references), len(site.antennas))
    lists = Lists.of(np.repeat(np.arange(len(recordings)), np.diff(first)), np.arange(first[-1]), None, len(recordings))
    return _feed("reference_snapshots", ReferenceSnapshots(cells.t, cells.t_arrival, rssi), cells.owner, lists, hold)


def _by_target(name: str, kind: type[Table], column: str) -> Callable[[Sequence[Recording], float], Feed]:
    """The route of a stream with a column that holds the index of the target it is about, -1 where it is about none."""

    def route(recordings: Sequence[Recording], hold: float) -> Feed:
        table, recording = _joined(recordings, name, kind)
        about = getattr(table, column) >= 0
        table, recording = table.take(about), recording[about]
        first = _first_rows(recordings)
        row = np.arange(first[-1])
        return _feed(name, table, first[recording] + getattr(table, column), Lists.of(row, row, None, len(row)), hold)

    return route


def _rounds(recordings: Sequence[Recording], hold: float) -> Feed:
    rounds, recording = _joined(recordings, "rounds", Rounds)
    tags = len(recordings[0].site.tags)
    asked = [r.asked_sets if len(r.asked_sets) else np.ones((1, tags), dtype=bool) for r in recordings]
    first_set = np.cumsum([0] + [len(sets) for sets in asked])
    of, row, tag = _tags_of_rows(recordings)
    pairs = list(_asked(asked, of, tag))
    group = np.repeat([g for g, _ in pairs], [len(p) for _, p in pairs]).astype(np.int64)
    pair = np.concatenate([np.empty(0, dtype=np.int64), *(p for _, p in pairs)])
    lists = Lists.of(group, row[pair], tag[pair], int(first_set[-1]))
    key = turn(rounds.t, rounds.t_arrival, hold)
    order = np.lexsort((rounds.t, key))
    in_turn = rounds.take(order)
    counts = _counted(recordings, in_turn, recording[order], tags)
    return Feed("rounds", in_turn, key[order], (first_set[recording] + rounds.asked)[order], lists, counts)


def _asked(sets_of: list[Array], of: Array, tag: Array) -> Iterator[tuple[int, Array]]:
    """Each asked set by its number over all recordings, with the (recording, row, tag) triples that it asks."""
    number = 0
    for i, sets in enumerate(sets_of):
        for mask in sets:
            yield number, np.flatnonzero((of == i) & mask[tag])
            number += 1


def _counted(recordings: Sequence[Recording], rounds: Rounds, recording: Array, tags: int) -> Counted:
    """The counts of all recordings, each by the entry of `rounds` that it belongs to."""
    counts, counts_of = _joined(recordings, "counts", Counts)
    if not len(counts):
        return Counted(np.empty(0, dtype=np.int64), counts.n, tags)
    top = int(max(rounds.round.max(initial=0), counts.round.max())) + 1
    antennas = len(recordings[0].site.antennas)
    asked = np.append((recording * top + rounds.round) * antennas + rounds.antenna, np.iinfo(np.int64).max)
    answered = (counts_of * top + counts.round) * antennas + counts.antenna
    order = np.argsort(asked, kind="stable")
    entry = order[np.searchsorted(asked[order], answered)]
    missing = np.flatnonzero(asked[entry] != answered)
    if len(missing):
        i = missing[0]
        raise ValueError(f"counts: round {counts.round[i]} of antenna {counts.antenna[i]} has a count but is not among the rounds")
    key = entry * tags + counts.tag
    by_key = np.argsort(key, kind="stable")
    return Counted(key[by_key], counts.n[by_key], tags)


_ROUTES: dict[str, Callable[[Sequence[Recording], float], Feed]] = {
    "reads": _reads,
    "reference_reads": _reference_reads,
    "snapshots": _snapshots,
    "reference_snapshots": _reference_snapshots,
    "rounds": _rounds,
    "odometry": _by_target("odometry", Odometry, "carrier"),
    "heading": _by_target("heading", Heading, "carrier"),
    "ranges": _by_target("ranges", Ranges, "target"),
    "heights": _by_target("heights", Heights, "carrier"),
    "actions": _by_target("actions", Actions, "target"),
}
KINDS = frozenset(_ROUTES)  # what an estimator may name in `consumes`
