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


class StreamConfig(Config):
    """How the reader reports phases, and how they are followed.

    wraps_at    : the reader's period; sign: 1 where its phase falls as the tag goes away (-4πd/λ), -1 where it grows
    fastest_mps : the fastest step that is sought
    window      : so many reads of one channel, within `window_s`, are taken for a line
    far         : outliers are further from the line than this share of the period
    """

    wraps_at: Literal["pi", "2pi"] = "2pi"
    sign: Literal[1, -1] = 1
    fastest_mps: Annotated[MetresPerSecond, Field(gt=0, le=20)] = 2.5
    window: Annotated[int, Field(ge=4, le=1000)] = 20
    window_s: Annotated[Seconds, Field(ge=0.005, le=1)] = 0.25
    far: Annotated[float, Field(gt=0, lt=0.5)] = 0.15
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
    n = len(t)
    scale = 2 * np.pi / period
    first = 0
    total, variance, doubt = 0.0, 0.0, 0.0
    before_t, before_rate, before_var, windows = began, 0.0, 0.0, 0
    size = most
    channels = len(ratio)
    seen_phase, seen_total, seen_var = np.zeros(channels), np.zeros(channels), np.full(channels, -1.0)
    stretch = 0  # where the reads of one channel in a row end
    while first < n:
        if first >= stretch:
            stretch = first + 1
            while stretch < n and channel[stretch] == channel[first]:
                stretch += 1
            parts = max(1, int(np.round((stretch - first) / most)))
            size = int(np.ceil((stretch - first) / parts))  # windows of one size: the last one is no poor remainder
        last = first
        while last + 1 < stretch and last - first + 1 < size and t[last + 1] - t[first] <= window:
            last += 1
        count = last - first + 1
        if count < 4 and windows > 0:  # too few to make a line: the gap that they leave is bridged by rates
            first = last + 1
            continue
        c = channel[first]
        middle, angle, rate, noise, used = _line(t, phase, first, last + 1, scale, fastest * ratio[c], far * period)
        rate /= ratio[c]
        width = max(t[last] - t[first], 1e-3)
        rate_var = 12 * noise**2 / (max(used, 1.0) * width**2)
        apart = middle - before_t
        if windows == 0:
            total, variance = rate * apart, rate_var * apart**2
        else:
            advance = 0.5 * (before_rate + rate) * apart
            spread = 0.25 * (before_var + rate_var) * apart**2
            total, variance = total + advance, variance + spread
            if seen_var[c] >= 0.0:
                off = angle - seen_phase[c] - (total - seen_total[c]) * ratio[c]
                off -= period * np.round(off / period)
                since = max(variance - seen_var[c], 0.0)
                doubt = max(doubt, abs(off) / (0.4 * period), 3.0 * np.sqrt(since) / (0.5 * period))
                total += off / ratio[c]
                variance = seen_var[c] + 2 * noise**2 / max(used, 1.0)
        if used < 0.6 * count:
            doubt = max(doubt, 1.0)
        seen_phase[c], seen_total[c], seen_var[c] = angle, total, variance
        before_t, before_rate, before_var, windows = middle, rate, rate_var, windows + 1
        first = last + 1
    if windows == 0:
        return np.nan, 0.0, 2.0
    rest = ended - before_t
    return total + before_rate * rest, np.sqrt(variance + before_var * rest**2), doubt


@njit(cache=True)
def _line(t, phase, first, end, scale, fastest, far):
    """(middle s, phase there, rate rad/s, noise rad, reads used) of the line that the phasors of a window agree with best."""
    middle = 0.0
    for i in range(first, end):
        middle += t[i]
    middle /= end - first
    width = max(t[end - 1] - t[first], 1e-3)
    step = 0.25 / (scale * width) * 2 * np.pi / 2
    half = int(fastest / step) + 1
    best, rate = -1.0, 0.0
    for k in range(-half, half + 1):
        r, i_sum = k * step, 0.0
        q_sum = 0.0
        for i in range(first, end):
            a = scale * (phase[i] - r * (t[i] - middle))
            i_sum += np.cos(a)
            q_sum += np.sin(a)
        power = i_sum * i_sum + q_sum * q_sum
        if power > best + 1e-9:
            best, rate = power, r
    angle, noise, used = 0.0, 0.3, 0.0
    period = 2 * np.pi / scale
    reach = 2 * far
    for _ in range(3):
        i_sum, q_sum = 0.0, 0.0
        for i in range(first, end):
            off = phase[i] - rate * (t[i] - middle)
            if used > 0:
                away = off - angle
                away -= period * np.round(away / period)
                if abs(away) > reach:
                    continue
            i_sum += np.cos(scale * off)
            q_sum += np.sin(scale * off)
        angle = np.arctan2(q_sum, i_sum) / scale
        s_tt, s_ty, s_yy, s_t, s_y, used = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(first, end):
            away = phase[i] - rate * (t[i] - middle) - angle
            away -= period * np.round(away / period)
            if abs(away) <= reach:
                d = t[i] - middle
                s_tt, s_ty, s_yy, s_t, s_y, used = s_tt + d * d, s_ty + d * away, s_yy + away * away, s_t + d, s_y + away, used + 1
        if used >= 3 and s_tt - s_t * s_t / used > 1e-9:
            slope = (s_ty - s_t * s_y / used) / (s_tt - s_t * s_t / used)
            rate += slope
            angle += (s_y - slope * s_t) / used
            rest = s_yy - s_y * s_y / used - slope * (s_ty - s_t * s_y / used)
            noise = np.sqrt(max(rest, 0.0) / max(used - 2, 1.0)) + 1e-3
        reach = far
    return middle, angle, rate, noise, used
