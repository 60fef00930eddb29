"""What reads of tags that stand still decide without a position: which side, moved or not, one tag or two with one EPC.

By phase on one carrier: λ/2 of distance is a turn (4π d / λ). Left out: cables of unequal length, whose phase stands between two antennas.
"""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.types import Reads

MOVED_RAD = 0.5  # 1.4 cm of distance at 866 MHz: far above the phase noise of a mean, far below a step
STEADY = 0.9  # length of the mean phasor, above which phases are one cluster
APART_DB = 2.5  # between levels of two tags; one tag's levels differ by the reader's step of 1 dB
LEAST_SHARE = 0.2  # of the reads that each of two tags has


def phasor(reads: Reads) -> complex:
    """The mean of e^{iφ}: its angle is the mean phase, its length how steady that is (1 for the same phase always); 0 for no reads."""
    phase = reads.phase[np.isfinite(reads.phase)]
    return complex(np.exp(1j * phase).mean()) if len(phase) else 0j


def side(reads: Reads, first: int, second: int) -> int:
    """+1 where a tag is nearer to the antenna `second`, -1 nearer to `first`, by the difference of their mean phases in (-π, π].

    For a reader whose phase grows with distance. 0 where one of them has no steady phase. Right as long as the distances differ by less
    than λ/4.
    """
    a, b = (phasor(_of(reads, antenna)) for antenna in (first, second))
    if min(abs(a), abs(b)) < STEADY:
        return 0
    return int(np.sign(np.angle(a * b.conjugate())))


def moved(before: Reads, after: Reads) -> bool:
    """Whether a tag has moved between two times: its mean phase at some antenna has turned by more than half a radian.

    Antennas at which it has no steady phase before and after, as two tags with one EPC have, say nothing.
    """
    for antenna in np.intersect1d(before.antenna, after.antenna):
        a, b = phasor(_of(before, antenna)), phasor(_of(after, antenna))
        if min(abs(a), abs(b)) >= STEADY and abs(np.angle(a * b.conjugate())) > MOVED_RAD:
            return True
    return False


def shares_an_epc(reads: Reads) -> bool:
    """Whether reads under one EPC are of two tags: at some antenna two levels, each with a steady phase of its own.

    A reader that flips its phase by π does so at one level.
    """
    return any(_two_tags(_of(reads, antenna)) for antenna in np.unique(reads.antenna))


def _two_tags(reads: Reads) -> bool:
    level: Array = np.sort(reads.rssi[np.isfinite(reads.rssi)])
    if len(level) < 2 or np.diff(level).max() < APART_DB:
        return False
    k = int(np.argmax(np.diff(level)))
    middle = (level[k] + level[k + 1]) / 2
    weak, strong = reads.take(reads.rssi < middle), reads.take(reads.rssi > middle)
    if min(len(weak), len(strong)) < LEAST_SHARE * len(level):
        return False
    a, b = phasor(weak), phasor(strong)
    return bool(min(abs(a), abs(b)) >= STEADY and abs(np.angle(a * b.conjugate())) > MOVED_RAD)


def _of(reads: Reads, antenna: int) -> Reads:
    return reads.take(reads.antenna == antenna)
