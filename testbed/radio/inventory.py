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

ALONE = 0.05  # s: what a reader with one port does in so long, some rounds, is reported as one visit
STEP = 0.35  # by which Q moves: the standard says 0.1 to 0.5
LARGEST_Q = 12
PERSISTENCE = {1: (0.5, 5.0), 2: (2.0, 10.0), 3: (2.0, 10.0)}  # s: Gen2 Table 6-20; it only says "more than 2 s" for sessions 2 and 3


@dataclass(frozen=True)
class Hearing:
    """Which tags can answer which antenna when: time in cells of `step` s, and for antenna a in cell c tags[first[a, c] : first[a, c + 1]].

    first : (antennas, cells + 1) int64; tags : (M,) int64, ascending in each cell
    """

    step: float
    first: Array
    tags: Array


@dataclass(frozen=True)
class Inventory:
    """What a reader did. Visits: antenna, its number among that antenna's, rounds begun, start and end (s). Reads: visit, tag, time (s).

    silenced : (S, 2) int64, (visit, tag) of tags that their session flag kept from being asked in the whole visit
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


def hearing(antennas: int, cells: int, step: float, antenna: Array, cell: Array, tag: Array) -> Hearing:
    """From (antenna, cell, tag) triples, in any order."""
    place = antenna * cells + cell
    order = np.lexsort((tag, place))
    bounds = np.searchsorted(place[order], np.arange(antennas * cells + 1))
    first = np.stack([bounds[a * cells : (a + 1) * cells + 1] for a in range(antennas)]) if antennas else np.zeros((0, cells + 1), np.int64)
    return Hearing(step, first.astype(np.int64), tag[order].astype(np.int64))


def inventory(
    profile: Profile, heard: Hearing, duration: float, seed: Array, antenna_key: Array, tag_key: Array, asked: Array, persistence: Array
) -> Inventory:
    """All visits of a reader in [0, duration] s.

    seed : () uint64, the reader's in this trial; antenna_key (A,) and tag_key (T,) uint64
    asked : (T,) bool, whom Select lets through; persistence : (T,) s of each tag's session flag
    """
    reader = _Reader(
        *slots(profile.link).__dict__.values(),
        between=profile.between_rounds,
        switch=profile.port_switch if len(antenna_key) > 1 else 0.0,
        shortest=0.0 if len(antenna_key) > 1 else ALONE,
        longest=profile.longest_visit,
        q=profile.start_q,
        session=profile.session,
        single=not profile.dual_target,
    )
    visits, reads, silent = _run(
        reader, heard.first, heard.tags, heard.step, float(duration), np.uint64(seed), antenna_key, tag_key, asked, persistence
    )
    visit, read = np.array(visits).reshape(-1, 5), np.array(reads).reshape(-1, 3)
    return Inventory(
        antenna=visit[:, 0].astype(np.int64),
        number=visit[:, 1].astype(np.int64),
        rounds=visit[:, 2].astype(np.int64),
        start=visit[:, 3],
        end=visit[:, 4],
        visit=read[:, 0].astype(np.int64),
        tag=read[:, 1].astype(np.int64),
        t=read[:, 2],
        silenced=np.array(silent, dtype=np.int64).reshape(-1, 2),
    )


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
def _round(reader, t, end, q, keys, seed, read):
    """One round over tags with `keys` (n,) from t on, at most until `end`: fills `read` (n,) with the time of each read, NaN for none.

    Returns the time after it.
    """
    waiting, many, frame, level = np.arange(len(keys)), len(keys), 0, float(q)
    count, last = np.zeros(1 << LARGEST_Q, dtype=np.int64), np.zeros(1 << LARGEST_Q, dtype=np.int64)
    t += reader.query
    while True:
        size = 1 << q
        count[:size] = 0
        for i in waiting[:many]:
            slot = int(_draw(seed, keys[i], frame) >> np.uint64(32)) % size
            count[slot] += 1
            last[slot] = i
        collided = False
        for slot in range(size):
            if count[slot] == 0:
                t, level = t + reader.empty, max(level - STEP, 0.0)
            elif count[slot] == 1:
                t += reader.success
            else:
                t, level, collided = t + reader.collision, min(level + STEP, float(LARGEST_Q)), True
            if t > end:
                return end
            if count[slot] == 1:
                read[last[slot]] = t
            if int(np.floor(level + 0.5)) != q:
                break
        kept = 0
        for i in waiting[:many]:
            if np.isnan(read[i]):
                waiting[kept] = i
                kept += 1
        many, frame = kept, frame + 1
        if int(np.floor(level + 0.5)) == q and not collided:
            return t
        q = int(np.floor(level + 0.5))
        t += reader.adjust


@njit(cache=True)
def _visit(reader, start, stop, q, here, tag_key, own, until, persistence, reads, visit):
    """Rounds over the tags `here` from `start` on, one at least, until `shortest` is over. Returns end, rounds, reads of the last round.

    `until` (T,) is when each tag's flag falls back; a tag whose flag is set isn't asked.
    """
    end, rounds, found = start, 0, 1 << q
    while rounds == 0 or (end < start + reader.shortest and end < stop):
        asked = here[until[here] <= end]
        read = np.full(len(asked), np.nan)
        q = min(int(np.floor(np.log2(max(found, 1)) + 0.5)), LARGEST_Q)
        end = _round(reader, end + reader.between, stop, q, tag_key[asked], _mixed(own + np.uint64(rounds)), read)
        found = 0
        for i in np.argsort(read):
            if np.isnan(read[i]):
                break
            found += 1
            reads.append((visit, int(asked[i]), float(read[i])))
            if reader.single:
                until[asked[i]] = np.inf if reader.session == 0 else read[i] + persistence[asked[i]]
        rounds += 1
    if reader.session == 0:  # without power it is forgotten
        until[here] = end
    return end, rounds, found


@njit(cache=True)
def _run(reader, first, tags, step, duration, seed, antenna_key, tag_key, asked, persistence):
    """Visits in turn until the time is up.

    Returns (port, number, rounds, start, end) of visits, (visit, tag, time) of reads, (visit, tag) of the silenced.
    """
    visits, reads, silent = [(0, 0, 0, 0.0, 0.0) for _ in range(0)], [(0, 0, 0.0) for _ in range(0)], [(0, 0) for _ in range(0)]
    ports = len(antenna_key)
    number, expected = np.zeros(ports, dtype=np.int64), np.full(ports, 1 << reader.q, dtype=np.int64)
    until = np.full(len(tag_key), -np.inf)
    port, start = 0, reader.switch
    while ports and start < duration:
        cell = min(int(start / step), first.shape[1] - 2)
        here = tags[first[port, cell] : first[port, cell + 1]]
        here = here[asked[here]]
        for k in here[until[here] > start]:
            silent.append((len(visits), k))
            if reader.session >= 2:  # its power keeps the flag
                until[k] = max(until[k], start + persistence[k])
        q = min(int(np.floor(np.log2(max(expected[port], 1)) + 0.5)), LARGEST_Q)
        own = _mixed(_mixed(seed ^ antenna_key[port]) + np.uint64(number[port]))
        stop = min(start + reader.longest, duration) if ports > 1 else duration
        end, rounds, expected[port] = _visit(reader, start, stop, q, here, tag_key, own, until, persistence, reads, len(visits))
        visits.append((port, number[port], rounds, start, end))
        number[port] += 1
        port, start = (port + 1) % ports, end + reader.switch
    return visits, reads, silent
