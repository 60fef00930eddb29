"""When a reader asks, and how it shares its time: inventory rounds over its antennas, and the reads they yield.

A reader serves its antennas in turn, `dwell` seconds each. A dwell holds read_rate * dwell successful reads at the most,
shared evenly among the tags that can answer (an aggregate of Gen2's slotted ALOHA with an adaptive Q: collisions and empty
slots are inside the rate; sessions and Select are left out, every tag is asked in every round).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.rng import Counter


@dataclass(frozen=True)
class Schedule:
    """The dwells of one reader: antenna (K,), visit (K,) (how often that antenna was served before), start and end (K,) s."""

    antenna: Array
    visit: Array
    start: Array
    end: Array

    def __len__(self) -> int:
        return len(self.antenna)


def schedule(antennas: int, duration: float, dwell: float, switch: float) -> Schedule:
    """All whole dwells in [0, duration], the antennas in turn, `switch` seconds apart."""
    period = dwell + switch
    count = int(np.floor((duration - dwell) / period + 1e-9)) + 1 if duration >= dwell else 0
    k = np.arange(count)
    return Schedule(k % antennas, k // antennas, k * period, k * period + dwell)


def shared_reads(can_answer: Array, capacity: float, draws: Counter, keys: tuple[Array, ...]) -> Array:
    """How often each tag is read in each dwell: int (K, T), for can_answer (K, T) bool.

    capacity / n reads each for n tags that can answer, rounded up or down at random so that the mean is exact. `keys` are
    integer counters broadcastable to (K, T) that identify dwell and tag; a tag's draw depends on its own keys alone.
    """
    answering = can_answer.sum(axis=1, keepdims=True)
    share = capacity / np.maximum(answering, 1)
    return np.where(can_answer, np.floor(share + draws.uniform(*keys)), 0).astype(np.int64)


def expand(counts: Array) -> tuple[Array, Array]:
    """Indices (into the flattened counts) and running numbers 0..n-1 of n = counts.sum() reads: each cell c repeated counts[c] times."""
    flat = counts.ravel()
    cell = np.repeat(np.arange(flat.size), flat)
    first = np.cumsum(flat) - flat
    return cell, np.arange(len(cell)) - first[cell]
