"""What a reader's log says of its channel: levels, noise, flips, spread between carriers; each with its standard error.

    RSSI = C_a - 10 n log10(d) + ways · D_a(θ) + b_place + k_(a,c) + ε                    n = 2 one way, 4 for backscatter

n is what physics says: a slope fitted over a few metres of distances takes up what walls do. C is a level for each antenna, b the fading
of a place (half a wavelength wide), k of a port and carrier, ε the noise from read to read. ε and the phase noise are taken from
differences of neighbouring reads of one link on one carrier, so that fading doesn't count: variance of a difference 2 σ². Neighbouring
differences share a read, which makes the relative standard error of σ √(3 / 4N) in the place of √(1 / 2N). A read that is flipped by π
changes two differences: a share q of jumps is 2 p (1 - p). The error of a level is that of its places alone: the mean of k over the
carriers is part of C, and the spread of k over the root of their number is how far from it another antenna of the same make may lie.

Left out: slow drift, fading that changes where nothing moves (a person walks by), and a tag's own turning, which is part of C and b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.calibrate import CalibrationError
from testbed.calibrate.known_reads import KnownReads
from testbed.columns import Array
from testbed.radio.artefacts import phase_noise
from testbed.units import SPEED_OF_LIGHT, wrap

NEIGHBOURS_S = 0.3
LEAST_PAIRS = 30
LEAST_READS = 10  # of an antenna, below which no level is fitted to it
MOVED_WAVES = 1 / 16  # of a wavelength between two reads, beyond which the phase between them isn't known well enough
RANDOM_RAD = 0.6  # root mean square of differences, folded by π: phases without any relation have 0.91
SWEEPS = 60
STEPS_DB = (1.0, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class Figure:
    """A fitted number with its standard error; error NaN where one place says nothing of it. n: what it is counted over."""

    value: float
    error: float
    n: int


@dataclass(frozen=True)
class ChannelFit:
    """level (A,) dBm at 1 m on boresight, NaN where an antenna was not heard enough; the same without patterns: round_level.

    place: spread between places, dB; total: spread about one level for all antennas without patterns, dB, all included.
    Figures that the log can't tell are None. rssi_step: the unit that levels come in, dB; 0 for none that is known.
    """

    exponent: float
    level: Array
    level_error: Array
    round_level: float
    total: Figure
    place: Figure | None
    rssi_noise: Figure | None
    rssi_step: float
    carriers: Figure | None
    phase_noise: Figure | None
    flips: Figure | None


def fit(known: KnownReads, antennas: int, ways: int, carriers: Array, half_turns: bool) -> ChannelFit:
    """The channel of a log. ways: 1 or 2; carriers (C,) Hz, or none; half_turns: phases are modulo π, so that flips can't be seen.

    CalibrationError for a log in which no antenna has LEAST_READS reads.
    """
    n = 2.0 * ways
    bare = known.rssi + 10 * n * np.log10(known.distance)
    flat = bare - ways * known.pattern
    heard = np.bincount(known.antenna, minlength=antennas) >= LEAST_READS
    if not heard.any():
        raise CalibrationError(f"no antenna has {LEAST_READS} reads of tags at known places: a longer log is wanted")
    step = _step(known.rssi)
    level, error, spread = _levels(known, flat, heard)
    residual = flat - level[known.antenna]
    noise = _noise(known, residual, step)
    round_level, total = _round(known, bare, antennas)
    phase, flips = (None, None) if len(known) < 2 else _phases(known, carriers, half_turns)
    return ChannelFit(
        n, level, error, round_level, total, spread, noise, step, _carriers(known, residual, noise), phase, None if half_turns else flips
    )


def _step(rssi: Array) -> float:
    """The largest usual unit that all levels are whole numbers of; 0 for none."""
    return next((s for s in STEPS_DB if np.abs(rssi / s - np.round(rssi / s)).max(initial=0.0) < 1e-6), 0.0)


def _by(group: Array, value: Array) -> tuple[Array, Array, Array]:
    """(groups, mean of each, which group each row is of)."""
    groups, of = np.unique(group, return_inverse=True)
    return groups, np.bincount(of, weights=value) / np.bincount(of), of


def _levels(known: KnownReads, flat: Array, heard: Array) -> tuple[Array, Array, Figure | None]:
    """(level (A,), its standard error (A,), spread between places): each place counts once, however often it was read."""
    pair, mean, _ = _by(known.place * len(heard) + known.antenna, flat)
    of = pair % len(heard)
    level, error = np.full(len(heard), np.nan), np.full(len(heard), np.nan)
    squares, free = 0.0, 0
    for a in np.flatnonzero(heard):
        here = mean[of == a]
        level[a] = here.mean()
        if len(here) > 1:
            error[a] = here.std(ddof=1) / np.sqrt(len(here))
            squares, free = squares + here.var() * len(here), free + len(here) - 1
    if not free:
        return level, error, None
    spread = float(np.sqrt(squares / free))
    return level, error, Figure(spread, spread / np.sqrt(2 * free), free)


def _round(known: KnownReads, bare: Array, antennas: int) -> tuple[float, Figure]:
    """One level for all antennas, alike all round, and what reads differ from it."""
    pair, mean, of = _by(known.place * antennas + known.antenna, bare)
    level = float(mean.mean())
    weight = 1 / np.bincount(of)[of]
    sigma = float(np.sqrt(weight @ (bare - level) ** 2 / weight.sum()))
    return level, Figure(sigma, sigma / np.sqrt(2 * max(len(pair) - 1, 1)), len(pair))


def _pairs(known: KnownReads) -> tuple[Array, Array]:
    """(i, j): neighbouring reads of one link on one carrier, near in time."""
    order = np.lexsort((known.t, known.channel, known.tag, known.antenna))
    i, j = order[:-1], order[1:]
    same = (known.antenna[i] == known.antenna[j]) & (known.tag[i] == known.tag[j]) & (known.channel[i] == known.channel[j])
    same &= known.t[j] - known.t[i] < NEIGHBOURS_S
    return i[same], j[same]


def _noise(known: KnownReads, residual: Array, step: float) -> Figure | None:
    """σ of ε, what rounding to `step` adds taken off (Sheppard); below a third of a step, that is its error."""
    i, j = _pairs(known)
    fine = np.isfinite(residual[i]) & np.isfinite(residual[j])
    if fine.sum() < LEAST_PAIRS:
        return None
    difference = (residual[j] - residual[i])[fine]
    raw = float(np.mean(difference**2)) / 2
    sigma = float(np.sqrt(max(raw - step**2 / 12, 0.0)))
    if sigma < step / 3:  # whether levels jump at all then hangs on how near to a step's edge they lie
        return Figure(sigma, step / 3, len(difference))
    return Figure(sigma, float(raw * np.sqrt(3 / len(difference)) / (2 * sigma)) if sigma > 0 else 0.0, len(difference))


def _carriers(known: KnownReads, residual: Array, noise: Figure | None) -> Figure | None:
    """Spread of k between the carriers of an antenna: means over places, each place's own level taken off, chance taken off."""
    squares, free, off = 0.0, 0, 0.0
    for a in np.unique(known.antenna):
        mine = known.take((known.antenna == a) & np.isfinite(residual))
        here = residual[(known.antenna == a) & np.isfinite(residual)]
        channels, channel = np.unique(mine.channel, return_inverse=True)
        cell, mean, _ = _by(np.unique(mine.place, return_inverse=True)[1] * len(channels) + channel, here)
        place, c = cell // len(channels), cell % len(channels)
        several = np.isin(place, np.flatnonzero(np.bincount(place) > 1))  # one carrier alone says nothing of differences
        place, c, mean = place[several], c[several], mean[several]
        if len(np.unique(c)) < 2:
            continue
        k, left = _additive(place, c, mean)
        squares, free = squares + float(((k - k.mean()) ** 2).sum()), free + len(k) - 1
        each = np.bincount(np.unique(c, return_inverse=True)[1])
        spare = len(mean) - len(np.unique(place)) - len(k) + 1
        chance = float((left**2).sum()) / spare if spare > 0 else (noise.value**2 if noise else 0.0) / (len(here) / len(cell))
        off += float((chance / each).mean()) * (len(k) - 1)
    if not free:
        return None
    spread = float(np.sqrt(max((squares - off) / free, 0.0)))
    return Figure(spread, float(np.sqrt(squares / free) / np.sqrt(2 * free)), free)


def _additive(place: Array, channel: Array, value: Array) -> tuple[Array, Array]:
    """(k of each carrier, what is left (M,)) of value = b_place + k_channel, by least squares in turns."""
    rows, columns = np.unique(place, return_inverse=True)[1], np.unique(channel, return_inverse=True)[1]
    k = np.zeros(columns.max() + 1)
    b = np.zeros(rows.max() + 1)
    for _ in range(SWEEPS):
        b = np.bincount(rows, weights=value - k[columns]) / np.bincount(rows)
        k = np.bincount(columns, weights=value - b[rows]) / np.bincount(columns)
    return k, value - b[rows] - k[columns]


def _phases(known: KnownReads, carriers: Array, half_turns: bool) -> tuple[Figure | None, Figure | None]:
    """(σ at -55 dBm by the law of `testbed.radio.artefacts`, probability that a read is flipped by π)."""
    i, j = _pairs(known)
    apart = known.distance[j] - known.distance[i]
    wave = SPEED_OF_LIGHT / (carriers[known.channel[i]] if len(carriers) else np.full(len(i), 866e6))
    fine = np.isfinite(known.phase[i]) & np.isfinite(known.phase[j]) & (np.abs(apart) < MOVED_WAVES * wave)
    i, j, turn = i[fine], j[fine], (known.phase[j] - known.phase[i] + 4 * np.pi * apart / wave)[fine]
    if len(turn) < LEAST_PAIRS:
        return None, None
    folded = (np.asarray(turn) + np.pi / 2) % np.pi - np.pi / 2
    if float(np.sqrt(np.mean(folded**2))) > RANDOM_RAD:
        return None, None
    scale = phase_noise(1.0, known.rssi[i]) ** 2 + phase_noise(1.0, known.rssi[j]) ** 2
    sigma = float(np.sqrt(np.mean(folded**2 / scale)))
    noise = Figure(sigma, sigma * float(np.sqrt(3 / (4 * len(turn)))), len(turn))
    if half_turns:
        return noise, None
    q = float(np.mean(np.abs(wrap(turn)) > np.pi / 2))
    if q >= 0.5:
        return noise, Figure(0.5, float("nan"), len(turn))
    p = (1 - np.sqrt(1 - 2 * q)) / 2
    u = max(p * (1 - p), 1 / len(turn))  # neighbouring pairs share a read: N var q = 4 u - 12 u²
    return noise, Figure(float(p), float(np.sqrt((u - 3 * u * u) / len(turn)) / (1 - 2 * p)), len(turn))
