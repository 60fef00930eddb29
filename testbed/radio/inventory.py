"""When a reader asks and who answers: Gen2 inventory, slot by slot.

A reader visits its ports in turn; a visit is one inventory round of all tags that hear it, or as much of one as `longest_visit`
leaves time for. With one port there is nothing to change to, and rounds follow each other. A round is framed slotted ALOHA: in a
frame of 2^Q slots every tag that was not read yet answers in one, drawn at random. One answer is a read, more are a collision,
and Q follows from what was heard (Annex D of the Gen2 standard: a collision adds STEP to Q, an empty slot takes it away; a
rounded Q that changes opens a new frame). A round ends with a frame without collisions.

So tags share the reader's time, collide, and come in no order, and how often each is read has the right mean and spread.
Simulating the slots costs about as much as an aggregate would: 20-50 ns each.

Sessions. With `dual_target` A and B are asked in turn and every tag answers in every round. Otherwise a tag that was read is
*not asked* until its flag falls back: in session 0 at the end of the visit, in session 1 after its persistence, in sessions 2
and 3 after so long without power. Select leaves tags out altogether. Silence of one that was not asked is no data.

Every draw is a function of (antenna, its visit's number, tag, frame): a tag that doesn't answer changes nothing for the others.
Left out: capture of the stronger of two answers, lost commands and CRC errors, flags set by another reader, the link's margin
within a round (whoever can answer at its start does; the reads themselves are checked against the channel afterwards).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from testbed.columns import Array
from testbed.radio.profiles import Profile, slots

ALONE = 0.05  # s: what a reader with one port does in so long, some rounds of all tags, is reported as one visit
STEP = 0.35  # by which Q moves: the standard says 0.1 to 0.5
LARGEST_Q = 12
PERSISTENCE = {1: (0.5, 5.0), 2: (2.0, 10.0), 3: (2.0, 10.0)}  # s: Gen2 Table 6-20; it only says "more than 2 s" for sessions 2 and 3


@dataclass(frozen=True)
class Hearing:
    """Which tags can answer which antenna when: time in cells of `step` s, and for antenna a in cell c tags[first[a, c] : first[a, c + 1]].

    begin : number of the first cell, which lasts from begin · step
    first : (antennas, cells + 1) int64; tags : (M,) int64, ascending in each cell
    """

    step: float
    begin: int
    first: Array
    tags: Array

    @property
    def end(self) -> float:
        """s: when the last cell is over."""
        return (self.begin + self.first.shape[1] - 1) * self.step


@dataclass(frozen=True)
class Inventory:
    """What a reader did. Visits: antenna, its number among that antenna's, rounds begun, start and end (s). Reads: visit, tag, time (s).

    silenced : (S, 2) int64, (visit, tag) of tags that their session flag kept from being asked in the whole visit
    collisions : of each visit, slots in which several answered at once
    """

    antenna: Array
    number: Array
    rounds: Array
    start: Array
    end: Array
    visit: Array
    tag: Array
    t: Array
    silenced: Array
    collisions: Array


class _Reader(NamedTuple):
    """The numbers of a profile that the kernel wants."""

    query: float
    adjust: float
    empty: float
    collision: float
    success: float
    between: float
    switch: float
    shortest: float
    longest: float
    q: int
    session: int
    single: bool


def hearing(antennas: int, cells: int, step: float, antenna: Array, cell: Array, tag: Array, begin: int = 0) -> Hearing:
    """From (antenna, cell, tag) triples, in any order; cells are counted from `begin`."""
    place = antenna * cells + cell
    order = np.lexsort((tag, place))
    bounds = np.searchsorted(place[order], np.arange(antennas * cells + 1))
    first = np.stack([bounds[a * cells : (a + 1) * cells + 1] for a in range(antennas)]) if antennas else np.zeros((0, cells + 1), np.int64)
    return Hearing(float(step), begin, first.astype(np.int64), tag[order].astype(np.int64))


class Interrogator:
    """One reader at work on its ports from 0 to `duration` s. It goes on where it stopped, whatever the pieces of time it is given.

    seed : () uint64, the reader's in this trial; antenna_key (A,) and tag_key (T,) uint64
    asked : (T,) bool, whom Select lets through; persistence : (T,) s of each tag's session flag
    """

    def __init__(
        self, profile: Profile, duration: float, seed: Array, antenna_key: Array, tag_key: Array, asked: Array, persistence: Array
    ) -> None:
        several = len(antenna_key) > 1
        self._reader = _Reader(
            *slots(profile.link).__dict__.values(),
            between=profile.between_rounds,
            switch=profile.port_switch if several else 0.0,
            shortest=ALONE if not several and profile.dual_target else 0.0,  # with one target whom it asks changes from round to round
            longest=profile.longest_visit,
            q=profile.start_q,
            session=profile.session,
            single=not profile.dual_target,
        )
        self._duration = float(duration)
        self._keys = np.asarray(seed, dtype=np.uint64)[()], np.array(antenna_key), np.array(tag_key)
        self._setting = np.array(asked), np.array(persistence, dtype=np.float64)
        self._port, self._start = 0, self._reader.switch
        self._number, self._expected = np.zeros(len(antenna_key), dtype=np.int64), np.full(len(antenna_key), 1 << profile.start_q)
        self._until = np.full(len(tag_key), -np.inf)

    @property
    def shortest_visit(self) -> float:
        """s from one visit to the next, at the least."""
        reader = self._reader
        return max(reader.shortest, reader.switch + min(reader.longest, reader.between + reader.query))

    def ports_before(self, t: float) -> Array:
        """(M,) ports that it may begin to visit before `t` s, the one it is at first."""
        ports = len(self._number)
        ahead = int((t - self._start) / self.shortest_visit) + 1 if t > self._start else 0
        return (self._port + np.arange(min(ahead, ports))) % max(ports, 1)

    def run(self, heard: Hearing) -> Inventory:
        """All visits that begin before the end of `heard`, which must not begin after the reader's present time."""
        room, end = 0, min(heard.end, self._duration)
        while True:
            silent = np.empty((room, 2), dtype=np.int64)
            state = self._number.copy(), self._expected.copy(), self._until.copy()
            place = self._port, self._start
            port, start, visits, ends, visit, tag, t, needed = _run(
                self._reader, heard.first, heard.tags, heard.step, heard.begin, end, self._duration, *place, *self._keys, *self._setting,
                *state, silent,
            )  # fmt: skip
            if needed <= room:
                break
            room = needed  # once more, with room for all: nothing else changes
        self._port, self._start = port, start
        self._number, self._expected, self._until = state
        return Inventory(visits[:, 0], visits[:, 1], visits[:, 2], ends[:, 0], ends[:, 1], visit, tag, t, silent[:needed], visits[:, 3])


def inventory(
    profile: Profile, heard: Hearing, duration: float, seed: Array, antenna_key: Array, tag_key: Array, asked: Array, persistence: Array
) -> Inventory:
    """All visits of a reader in [0, duration] s; see `Interrogator`. What is heard in the last cell holds until the end."""
    missing = int(np.ceil(duration / heard.step)) - (heard.begin + heard.first.shape[1] - 1)
    if missing > 0 and heard.first.shape[1] > 1:
        raise ValueError(f"heard ends at {heard.end:g} s, before the inventory does at {duration:g} s: give cells for all of it")
    return Interrogator(profile, duration, seed, antenna_key, tag_key, asked, persistence).run(heard)


# ---------------------------------------------------------------- the slots


@njit(cache=True)
def _mixed(z):
    """The finaliser of SplitMix64, as in `testbed.rng`."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
def _draw(seed, tag, frame):
    return _mixed(_mixed(seed ^ _mixed(tag + np.uint64(0x9E3779B97F4A7C15))) + np.uint64(frame) * np.uint64(0x9E3779B97F4A7C15))


@njit(cache=True)
def _round(reader, t, end, q, waiting, many, tag_key, seed, slot, found, when):
    """One round over the tags waiting[:many] from t on, at most until `end`. `waiting` is used up, slot (2, 2^LARGEST_Q) is for work.

    Writes tags and times of reads into `found` and `when`, in order. Returns the time after the round, how many reads, and how many
    collisions.
    """
    reads, frame, level, collisions = 0, 0, float(q), 0
    t += reader.query
    while True:
        size, collided = 1 << q, False
        for place in range(size):
            slot[0, place] = 0
        for i in range(many):
            place = int(_draw(seed, tag_key[waiting[i]], frame) >> np.uint64(32)) % size
            slot[0, place] += 1
            slot[1, place] = i
        for place in range(size):
            if slot[0, place] == 0:
                t, level = t + reader.empty, max(level - STEP, 0.0)
            elif slot[0, place] == 1:
                t += reader.success
            else:
                t, level, collided = t + reader.collision, min(level + STEP, float(LARGEST_Q)), True
            if t > end:
                return end, reads, collisions
            if slot[0, place] == 1:
                found[reads], when[reads] = waiting[slot[1, place]], t
                waiting[slot[1, place]] = -1
                reads += 1
            elif slot[0, place] > 1:
                collisions += 1
            if int(level + 0.5) != q:
                break
        kept = 0
        for i in range(many):
            if waiting[i] >= 0:
                waiting[kept] = waiting[i]
                kept += 1
        many, frame = kept, frame + 1
        if int(level + 0.5) == q and not collided:
            return t, reads, collisions
        q = int(level + 0.5)
        t += reader.adjust


@njit(cache=True)
def _visit(reader, start, stop, expected, here, tag_key, own, until, persistence, slot, found, when):
    """Rounds over the tags `here` from `start` on, one at least, until `shortest` is over.

    `until` (T,) is when each tag's flag falls back; a tag whose flag is set isn't asked. Reads are added to `found` and `when`.
    Returns end, rounds, reads of the last round, reads in all, collisions in all.
    """
    end, rounds, reads, collisions = start, 0, 0, 0
    waiting = np.empty(len(here), dtype=np.int64)
    while rounds == 0 or (end < start + reader.shortest and end < stop):
        many = 0
        for k in here:
            if until[k] <= end:
                waiting[many] = k
                many += 1
        q = min(int(np.log2(max(expected, 1)) + 0.5), LARGEST_Q)
        seed = _mixed(own + np.uint64(rounds))
        end, expected, met = _round(reader, end + reader.between, stop, q, waiting, many, tag_key, seed, slot, found[reads:], when[reads:])
        collisions += met
        if reader.single:
            for i in range(reads, reads + expected):
                until[found[i]] = np.inf if reader.session == 0 else when[i] + persistence[found[i]]
        reads += expected
        rounds += 1
    if reader.session == 0:  # without power it is forgotten
        for k in here:
            until[k] = end
    return end, rounds, expected, reads, collisions


@njit(cache=True)
def _run(
    reader, first, tags, step, begin, last, duration, port, start, seed, antenna_key, tag_key, asked, persistence,
    number, expected, until, silent,
):  # fmt: skip
    """Visits in turn, from `port` at `start` on, as long as they begin before `last`. Writes (visit, tag) of the silenced to `silent`,
    as far as it reaches.

    number, expected (A,) and until (T,) are the reader's memory and go on being used.
    Returns port and start of the next visit, (port, number, rounds, collisions) and (start, end) of visits, visit, tag and time of reads,
    and how many are silenced.
    """
    ports, count, many, silenced = len(antenna_key), 0, 0, 0
    span = max(duration - start, 0.0)
    if ports > 1:
        span = min(span, max(last - start, 0.0) + reader.longest)
    most = int((span + reader.shortest) / reader.success) + 1
    found, when, of = np.empty(most, dtype=np.int64), np.empty(most), np.empty(most, dtype=np.int64)
    most = int(span / max(reader.shortest, reader.switch + min(reader.longest, reader.between + reader.query))) + 2
    visits, ends = np.empty((most, 4), dtype=np.int64), np.empty((most, 2))
    slot = np.zeros((2, 1 << LARGEST_Q), dtype=np.int64)
    here = np.empty(len(tag_key), dtype=np.int64)
    while ports and start < last:
        cell, hear = min(max(int(start / step) - begin, 0), first.shape[1] - 2), 0
        for i in range(first[port, cell], first[port, cell + 1]):
            k = tags[i]
            if asked[k]:
                here[hear] = k
                hear += 1
                if until[k] > start:
                    if silenced < len(silent):
                        silent[silenced, 0], silent[silenced, 1] = count, k
                    silenced += 1
                    if reader.session >= 2:  # its power keeps the flag
                        until[k] = max(until[k], start + persistence[k])
        own = _mixed(_mixed(seed ^ antenna_key[port]) + np.uint64(number[port]))
        stop = min(start + reader.longest, duration) if ports > 1 else duration
        end, rounds, expected[port], reads, collisions = _visit(
            reader, start, stop, expected[port], here[:hear], tag_key, own, until, persistence, slot, found[many:], when[many:]
        )
        for i in range(many, many + reads):
            of[i] = count
        many += reads
        visits[count, 0], visits[count, 1], visits[count, 2], visits[count, 3] = port, number[port], rounds, collisions
        ends[count, 0], ends[count, 1] = start, end
        number[port] += 1
        count += 1
        port, start = (port + 1) % ports, end + reader.switch
    return port, start, visits[:count], ends[:count], of[:many], found[:many], when[:many], silenced
