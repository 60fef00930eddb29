"""From wrapped phases to how far the phase turned over a step: smoothing, outliers, unwrapping, and whether to trust it.

Phases are wrapped modulo the reader's period P (2π or π) and some are wrong. Wrapped numbers must not be averaged, so all is done on
the phasors exp(2jπ phase/P). The reads of one channel make short windows. In each window a line of phase over time is sought whose
phasors agree best, over all rates that a walk can have, so that a fast walk does not smear them; reads far from the line are
outliers and left out of a second fit. From window to window the phase goes on as the rates of both say, and where they are of one
channel the phases themselves decide, to a fraction of a period. A channel that comes back after hops corrects what was added up
meanwhile.

Breaks where reads are so rare that rates of two periods between neighbouring reads agree alike; the flag of trust says so then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numba import njit
from pydantic import Field

from testbed.quantity import Config, MetresPerSecond, Seconds
from testbed.types import Array, Reads
from testbed.units import SPEED_OF_LIGHT

FEWEST = 6  # reads that make a line: any four lie on one, at some rate
STRAIGHT, WORST = 0.8, 0.6  # shares of the reads of a window that are near its line: below, it is cut in halves; is not trusted


class StreamConfig(Config):
    """How the reader reports phases, and how they are followed.

    wraps_at    : the reader's period; sign: 1 where its phase falls as the tag goes away (-4πd/λ), -1 where it grows
    fastest_mps : the fastest step that is sought
    window      : so many reads of one channel, within `window_s`, are taken for a line
    by          : "lines", all of the above, or "neighbours", the plain unwrap from read to read, as a control
    far         : outliers are further from the line than this share of the period
    """

    wraps_at: Literal["pi", "2pi"] = "2pi"
    sign: Literal[1, -1] = 1
    fastest_mps: Annotated[MetresPerSecond, Field(gt=0, le=20)] = 2.5
    window: Annotated[int, Field(ge=4, le=1000)] = 20
    window_s: Annotated[Seconds, Field(ge=0.005, le=1)] = 0.25
    far: Annotated[float, Field(gt=0, lt=0.5)] = 0.15
    by: Literal["lines", "neighbours"] = "lines"
    least_reads: Annotated[int, Field(ge=2, le=10_000)] = 12
    longest_gap_s: Annotated[Seconds, Field(gt=0, le=10)] = 0.1

    @property
    def period(self) -> float:
        """P, rad."""
        return np.pi if self.wraps_at == "pi" else 2 * np.pi


@dataclass(frozen=True)
class Change:
    """How far the phase turned over E steps, rad, growing with distance, at the mean carrier. spread: its standard error.

    misdeclared : the reads can't come from a reader that wraps as it is said to
    """

    change: Array
    spread: Array
    trusted: Array
    reads: Array
    misdeclared: Array


class PhaseStream:
    """The reads of B rows since their last action, and what they say of a step."""

    def __init__(self, config: StreamConfig, frequencies: Array) -> None:
        self.config, self._ratio = config, np.asarray(frequencies) / float(np.mean(frequencies))
        self._fastest = config.fastest_mps * 4 * np.pi * float(np.max(frequencies)) / SPEED_OF_LIGHT

    def start(self, rows: int) -> None:
        """Forget all reads."""
        self._row: list[Array] = []
        self._reads: list[tuple[Array, Array, Array]] = []

    def take(self, row: Array, reads: Reads) -> Array:
        """Keep reads, one a row at most; which of them can be used (a phase that is a number)."""
        good = np.isfinite(reads.phase)
        self._row.append(np.asarray(row)[good])
        self._reads.append((np.asarray(reads.t)[good], np.asarray(reads.phase)[good], np.asarray(reads.channel)[good].astype(np.int64)))
        return good

    def forget(self, rows: Array) -> None:
        """Drop what some rows have read."""
        if self._row:
            self._split(rows)

    def _split(self, rows: Array) -> tuple[Array, tuple[Array, ...]]:
        """Take the reads of some rows out: (row, (t, phase, channel)), in order of row and time."""
        row = np.concatenate(self._row)
        columns = [np.concatenate(c) for c in zip(*self._reads, strict=True)]
        mine = np.isin(row, rows)
        self._row, self._reads = [row[~mine]], [(columns[0][~mine], columns[1][~mine], columns[2][~mine])]
        order = np.lexsort((columns[0][mine], row[mine]))
        return row[mine][order], tuple(c[mine][order] for c in columns)

    def change(self, rows: Array, began: Array, ended: Array) -> Change:
        """What the reads kept say of the steps of `rows` (E,) between `began` and `ended` (E,) s; they are dropped then."""
        n = len(rows)
        found = np.zeros((n, 5))
        found[:, 0] = np.nan
        if self._row:
            row, (t, phase, channel) = self._split(rows)
            first, last = np.searchsorted(row, rows, "left"), np.searchsorted(row, rows, "right")
            for i in range(n):
                a, b = int(first[i]), int(last[i])
                inside = slice(a + int(np.searchsorted(t[a:b], began[i])), a + int(np.searchsorted(t[a:b], ended[i], "right")))
                found[i] = self._one(t[inside], phase[inside], channel[inside], float(began[i]), float(ended[i]))
        return Change(found[:, 0], found[:, 1], found[:, 2] > 0, found[:, 3].astype(np.int64), found[:, 4] > 0)

    def _one(self, t: Array, phase: Array, channel: Array, began: float, ended: float) -> tuple[float, float, float, float, float]:
        c = self.config
        if not len(t):
            return np.nan, 0.0, 0.0, 0.0, 0.0
        if misdeclared(phase, c.period):
            return np.nan, 0.0, 0.0, float(len(t)), 1.0
        if c.by == "neighbours":
            turns = np.diff(phase)
            total = float((turns - c.period * np.round(turns / c.period)).sum())
            return -c.sign * total, 0.0, float(len(t) >= c.least_reads), float(len(t)), 0.0
        gap = float(np.diff(t, prepend=began, append=ended).max())
        total, spread, doubt = followed(t, phase, channel, self._ratio, c.period, self._fastest, c.window, c.window_s, c.far, began, ended)
        enough = len(t) >= c.least_reads and gap <= c.longest_gap_s and np.isfinite(total) and doubt < 1.0
        return -c.sign * total, spread, float(enough), float(len(t)), 0.0


def misdeclared(phase: Array, period: float) -> bool:
    """Whether phases (N,) can't come from a reader of that period.

    A phase beyond the period is proof. One that is said to wrap at 2π and never leaves [0, π), though modulo π its phases are all over
    the place, wraps at π: 40 phases would do that by chance once in 10¹².
    """
    if (phase < -1e-9).any() or (phase > period + 1e-9).any():
        return True
    if period < 6.0 or len(phase) < 40:
        return False
    return bool((phase <= np.pi + 1e-9).all() and abs(np.exp(2j * phase).mean()) < 0.5)


@njit(cache=True)
def followed(t, phase, channel, ratio, period, fastest, most, window, far, began, ended):
    """(turn of the phase from `began` to `ended`, standard error, doubt) of reads in order of time; doubt of 1 and more: don't trust it."""
    n, scale = len(t), 2 * np.pi / period
    first, stretch, size = 0, 0, most
    total, variance, doubt, windows = 0.0, 0.0, 0.0, 0
    before_t, before_end, before_rate, before_var = began, began, 0.0, 0.0
    seen_phase, seen_total, seen_var = np.zeros(len(ratio)), np.zeros(len(ratio)), np.full(len(ratio), -1.0)
    while first < n:
        c = channel[first]
        if first >= stretch:
            stretch = first + 1
            while stretch < n and channel[stretch] == c:
                stretch += 1
            size = _even(stretch - first, most)
        last = first
        while last + 1 < stretch and last - first + 1 < size and t[last + 1] - t[first] <= window:
            last += 1
        if last - first + 1 < FEWEST and (windows > 0 or stretch < n):  # too few for a line: their gap is bridged by rates
            first = last + 1
            continue
        middle, angle, rate, noise, used, near, last, whole = _straight(t, phase, first, last, scale, fastest * ratio[c], far * period)
        if used < FEWEST and windows > 0:
            first = last + 1
            continue
        rate /= ratio[c]
        rate_var = 12 * noise**2 / (max(used, 1.0) * max(t[last] - t[near], 1e-3) ** 2)
        if windows == 0:
            total, variance = rate * (middle - began), rate_var * (middle - began) ** 2
        else:  # either rate up to the middle of the gap between the windows
            between = 0.5 * (before_end + t[near])
            one, other = between - before_t, middle - between
            total += before_rate * one + rate * other
            variance += before_var * one**2 + rate_var * other**2
            doubt = max(doubt, 0.5 * abs(rate - before_rate) * (t[near] - before_end) / (0.4 * period))
        if seen_var[c] >= 0.0:
            off = angle - seen_phase[c] - (total - seen_total[c]) * ratio[c]
            off -= period * np.round(off / period)
            since = max(variance - seen_var[c], 0.0)
            doubt = max(doubt, abs(off) / (0.35 * period), 3.0 * np.sqrt(since) / (0.5 * period))
            total += off / ratio[c]
            variance = seen_var[c] + 2 * noise**2 / max(used, 1.0)
        if used < WORST * whole:
            doubt = max(doubt, 1.0)
        seen_phase[c], seen_total[c], seen_var[c] = angle, total, variance
        before_t, before_end, before_rate, before_var, windows = middle, t[last], rate, rate_var, windows + 1
        first = last + 1
    if windows == 0:
        return np.nan, 0.0, 2.0
    rest = ended - before_t
    spread = np.sqrt(variance + before_var * rest**2)
    return total + before_rate * rest, spread, max(doubt, 3.0 * spread / (0.5 * period))


@njit(cache=True)
def _even(reads, most):
    """How many reads a window has, so that `reads` make windows of one size of about `most`: the last one is no poor remainder."""
    return int(np.ceil(reads / max(1, int(np.round(reads / most)))))


@njit(cache=True)
def _straight(t, phase, first, last, scale, fastest, far):
    """The window from `first`, cut where its reads leave the line: somebody started or stopped there.

    (middle s, phase there, rate rad/s, noise rad, reads used, first and last read on the line, reads between them)
    """
    while True:
        middle, angle, rate, noise, used = _line(t, phase, first, last + 1, scale, fastest, far)
        near, end = _ends(t, phase, first, last + 1, middle, angle, rate, scale, far)
        count = last - first + 1
        if near - first >= FEWEST:  # what comes before the line is a window of its own
            last = near - 1
        elif end < last and end - first >= 7:
            last = end  # a read beyond it may lie near the line by chance: it must not bend it
        elif used < STRAIGHT * (end - near + 1) and count >= 12:
            last = first + count // 2 - 1
        else:
            return middle, angle, rate, noise, used, near, end, end - near + 1


@njit(cache=True)
def _ends(t, phase, first, end, middle, angle, rate, scale, far):
    """First and last read on the line: such as have at least three of four on it inwards, for one read in three is near it by chance."""
    period, count = 2 * np.pi / scale, end - first
    on = np.zeros(count)
    for i in range(count):
        away = phase[first + i] - rate * (t[first + i] - middle) - angle
        away -= period * np.round(away / period)
        on[i] = abs(away) <= far
    low, high = 0, count - 1
    while low + 4 < count and not (on[low] and on[low : low + 4].sum() >= 3):
        low += 1
    while high > low + 4 and not (on[high] and on[high - 3 : high + 1].sum() >= 3):
        high -= 1
    return first + low, first + high


@njit(cache=True)
def _line(t, phase, first, end, scale, fastest, far):
    """(middle s, phase there, rate rad/s, noise rad, reads used) of the line that the phasors of a window agree with best."""
    middle = 0.5 * (t[first] + t[end - 1])
    width = max(t[end - 1] - t[first], 1e-3)
    step = np.pi / (4 * scale * width)  # an eighth of a turn from one end to the other
    half = int(fastest / step) + 1
    best, rate = -1.0, 0.0
    for k in range(-half, half + 1):
        i_sum, q_sum = 0.0, 0.0
        for i in range(first, end):
            a = scale * (phase[i] - k * step * (t[i] - middle))
            i_sum += np.cos(a)
            q_sum += np.sin(a)
        power = i_sum * i_sum + q_sum * q_sum
        if power > best + 1e-9:
            best, rate = power, k * step
    i_sum, q_sum = 0.0, 0.0
    for i in range(first, end):
        a = scale * (phase[i] - rate * (t[i] - middle))
        i_sum += np.cos(a)
        q_sum += np.sin(a)
    angle, noise, used = np.arctan2(q_sum, i_sum) / scale, 0.3, 0.0
    for turn in range(3):
        angle, rate, noise, used = _refined(t, phase, first, end, middle, angle, rate, 2 * np.pi / scale, far * (2 if turn == 0 else 1))
    return middle, angle, rate, noise, used


@njit(cache=True)
def _refined(t, phase, first, end, middle, angle, rate, period, far):
    """(phase, rate, noise, reads used) of the least-squares line through the reads within `far` of a line."""
    s_tt, s_ty, s_yy, s_t, s_y, used = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(first, end):
        d = t[i] - middle
        away = phase[i] - rate * d - angle
        away -= period * np.round(away / period)
        if abs(away) <= far:
            s_tt, s_ty, s_yy, s_t, s_y, used = s_tt + d * d, s_ty + d * away, s_yy + away * away, s_t + d, s_y + away, used + 1
    spread = s_tt - s_t * s_t / max(used, 1.0)
    if used < 3 or spread < 1e-9:
        return angle, rate, 0.3, used
    slope = (s_ty - s_t * s_y / used) / spread
    rest = s_yy - s_y * s_y / used - slope * (s_ty - s_t * s_y / used)
    return angle + (s_y - slope * s_t) / used, rate + slope, np.sqrt(max(rest, 0.0) / max(used - 2, 1.0)) + 1e-3, used
