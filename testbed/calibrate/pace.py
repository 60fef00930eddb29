"""How fast a reader reads, and the time between its rounds that makes a simulated one read as fast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.calibrate.channel_fit import Figure
from testbed.columns import Array
from testbed.radio.inventory import hearing, inventory
from testbed.radio.profiles import Profile, profile
from testbed.types import Reads

BENCH_S = 10.0  # of simulated work, after which a rate is known within a read or two a second
LONGEST_S = 1.0  # between rounds, as far as a reader's section goes
HALVINGS = 14
LEAST_BLOCKS = 4


def rate(reads: Reads, duration: float) -> Figure:
    """Reads a second of the whole reader; its error from blocks of a second, or of a tenth of a log that is shorter than ten."""
    block = min(1.0, duration / 10) if duration > 0 else 1.0
    whole = int(duration / block + 1e-9)
    if whole < LEAST_BLOCKS:
        return Figure(len(reads) / max(duration, 1e-9), float("nan"), len(reads))
    counts = np.bincount((reads.t / block).astype(np.int64), minlength=whole)[:whole] / block
    return Figure(len(reads) / duration, float(counts.std(ddof=1) / np.sqrt(whole)), len(reads))


def heard_together(reads: Reads, duration: float, ports: int) -> Array:
    """(ports,) how many tags each port hears: the median over seconds of those that it read in it."""
    found = np.zeros(ports, dtype=np.int64)
    second = np.minimum(reads.t.astype(np.int64), max(int(duration) - 1, 0))
    for port in range(ports):
        mine = reads.antenna == port
        each = np.unique(np.column_stack([second[mine], reads.tag[mine]]), axis=0)
        found[port] = int(np.median(np.unique(each[:, 0], return_counts=True)[1])) if len(each) else 0
    return found


def between_rounds(name: str, wanted: float, tags: Array) -> float | None:
    """s between rounds for which a reader of that profile makes `wanted` reads/s of so many tags on each port (P,).

    None where even none at all is too slow, or 1 s too fast: then the profile's link is another one than the log's.
    """
    if wanted <= 0 or not tags.any():
        return None
    given = profile(name)

    def made(between: float) -> float:
        return _rate(replace(given, between_rounds=between), tags)

    low, high = 0.0, LONGEST_S
    if made(low) < wanted or made(high) > wanted:
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if made(middle) > wanted else (low, middle)
    return (low + high) / 2


def _rate(of: Profile, tags: Array) -> float:
    """Reads/s of a bench where tags (P,) of each port, the same ones on all ports, always answer."""
    ports, most = len(tags), int(tags.max())
    antenna, tag = np.nonzero(np.arange(most) < tags[:, None])
    heard = hearing(ports, 1, BENCH_S, antenna, np.zeros(len(tag), dtype=np.int64), tag)
    keys = np.arange(1, max(ports, most) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    done = inventory(of, heard, BENCH_S, np.uint64(1), keys[:ports], keys[:most], np.ones(most, dtype=bool), np.ones(most))  # pyright: ignore[reportArgumentType]
    return len(done.t) / BENCH_S
