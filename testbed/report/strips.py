"""What every antenna heard of a tag over time: phase, RSSI, reads per round and line of sight. Computed here, drawn elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.columns import Array
from testbed.plugins import BrokenPlugin, UnknownPlugin, load
from testbed.protocols import Caster
from testbed.radio.links import Ends
from testbed.radio.materials import losses
from testbed.radio.sight import CHUNK, Obstacles, sight
from testbed.report.cases import Case
from testbed.sensors.rfid_section import RfidConfig
from testbed.types import Counts, Reads, Rounds
from testbed.units import SPEED_OF_LIGHT

MOST_TAGS, MOST_ROWS = 3, 12
SLOTS = 240  # instants that a strip tells apart
LOOKS = 120  # at which lines of sight are looked at; a trolley goes some 0.1 m from one to the next
LOST = 40.0  # dB: what loses more is as good as blocked
PAUSE = 4.0  # of an antenna's usual turns: if the next has not come after so long, the reader was not at work
ROUNDING = 1e-3  # s: a reader's clock may put a read so much before the beginning of its round


@dataclass(frozen=True, eq=False)
class Strip:
    """One tag: a row for each of R antennas, a column for each slot of time. NaN where there is nothing to show.

    edges  : (M + 1,) s, of the slots; rows: (R,) indices of antennas; more: how many further antennas read the tag
    phase  : (R, M) rad, of the last read in the slot; rssi: (R, M) dBm, mean
    rounds : (R, M) mean number of reads in a round, over those rounds that asked the tag; all NaN where a log has no rounds
    clear  : (R, K) share of the first Fresnel zone (0.6 of it) that is clear, in K steps of equal length; None where that can't be told
    """

    tag: int
    name: str
    edges: Array
    rows: Array
    more: int
    phase: Array
    rssi: Array
    rounds: Array
    clear: Array | None


def strips(case: Case) -> tuple[list[Strip], int]:
    """The strips of those target tags that were heard most, and how many more target tags were heard."""
    reads, recording = case.reads, case.trial.recording
    heard = np.bincount(reads.tag, minlength=len(recording.site.tags))
    counts = recording.streams.get("counts")
    if not len(reads) and isinstance(counts, Counts):
        heard = np.bincount(counts.tag, weights=counts.n, minlength=len(heard)).astype(np.int64)
    wanted = np.unique([int(tag) for tags in recording.target_tags for tag in tags]).astype(np.int64)
    wanted = wanted[heard[wanted] > 0]
    chosen = np.sort(wanted[np.argsort(-heard[wanted], kind="stable")][:MOST_TAGS])
    found = [_strip(case, int(tag), reads.take(reads.tag == tag)) for tag in chosen]
    seen = _seen(case, found)
    return [replace(one, clear=clear) for one, clear in zip(found, seen, strict=True)], len(wanted) - len(chosen)


def _strip(case: Case, tag: int, reads: Reads) -> Strip:
    visits = _visits(case, tag)
    antennas = len(case.antennas)
    heard = np.bincount(reads.antenna, minlength=antennas)
    if visits is not None and not len(reads):
        heard = np.bincount(visits.rounds.antenna, weights=visits.n, minlength=antennas)
    rows = np.sort(np.argsort(-heard, kind="stable")[:MOST_ROWS])
    more = int((heard > 0).sum() - (heard[rows] > 0).sum())
    edges = np.linspace(0.0, case.duration, SLOTS + 1)
    phase, rssi, rounds = (np.full((len(rows), SLOTS), np.nan) for _ in range(3))
    for row, antenna in enumerate(rows):
        own = reads.take(reads.antenna == antenna)
        if visits is None:
            spans = np.searchsorted(own.t, edges)
            phase[row], rssi[row] = _last(own.phase, spans[:-1], spans[1:]), _mean(own.rssi, spans[:-1], spans[1:])
            continue
        here = visits.rounds.antenna == antenna
        start, n = visits.rounds.t_start[here], visits.n[here]
        first, last = _turns(start, edges)
        bounds = np.searchsorted(own.t, np.append(start - ROUNDING, np.inf))
        reads_from, reads_to = bounds[first], bounds[last]
        phase[row], rssi[row] = _last(own.phase, reads_from, reads_to), _mean(own.rssi, reads_from, reads_to)
        rounds[row] = _mean(np.where(visits.asked[here], n, np.nan), first, last)
    return Strip(tag, str(case.trial.recording.site.tags.id[tag]), edges, rows, more, phase, rssi, rounds, None)


@dataclass(frozen=True, eq=False)
class _Visits:
    """All rounds in order of time: how often each read the tag, and whether it asked it."""

    rounds: Rounds
    n: Array
    asked: Array


def _visits(case: Case, tag: int) -> _Visits | None:
    streams = case.trial.recording.streams
    rounds, counts = streams.get("rounds"), streams.get("counts")
    if not isinstance(rounds, Rounds) or not len(rounds):
        return None
    rounds = rounds.take(np.argsort(rounds.t_start, kind="stable"))
    n = np.zeros(len(rounds))
    if isinstance(counts, Counts):
        own = counts.take(counts.tag == tag)
        key = (int(rounds.antenna.max()) + 1) * rounds.round.astype(np.int64) + rounds.antenna
        order = np.argsort(key)
        place = np.searchsorted(key[order], (int(rounds.antenna.max()) + 1) * own.round.astype(np.int64) + own.antenna)
        n[order[place]] = own.n
    sets = case.trial.recording.asked_sets
    asked = sets[rounds.asked, tag] if len(sets) else np.ones(len(rounds), dtype=bool)
    return _Visits(rounds, n, asked)


def _turns(start: Array, edges: Array) -> tuple[Array, Array]:
    """(M,), (M,): the rounds of an antenna, which begin at `start` (V,), that each slot shows: from one to before the other.

    Those that begin in it; where none does, the one before, as long as the antenna's next turn has not come.
    """
    first, last = np.searchsorted(start, edges[:-1]), np.searchsorted(start, edges[1:])
    usual = np.median(np.diff(start)) if len(start) > 1 else 0.0
    before = np.clip(first - 1, 0, max(len(start) - 1, 0))
    if len(start):
        held = (first == last) & (first > 0) & (edges[:-1] - start[before] < PAUSE * usual)
        first = np.where(held, before, first)
    return first, last


def _mean(value: Array, first: Array, last: Array) -> Array:
    """(M,) mean of value[first:last], NaN left out; NaN where nothing is left."""
    there = np.isfinite(value)
    total, many = (np.concatenate([[0.0], np.cumsum(v)]) for v in (np.where(there, value, 0.0), there))
    n = many[last] - many[first]
    return np.divide(total[last] - total[first], n, out=np.full(len(first), np.nan), where=n > 0)


def _last(value: Array, first: Array, last: Array) -> Array:
    """(M,) the last of value[first:last] that is a number."""
    latest = np.concatenate([[-1], np.maximum.accumulate(np.where(np.isfinite(value), np.arange(len(value)), -1))])[last]
    found = np.full(len(first), np.nan)
    there = latest >= first
    found[there] = value[latest[there]]
    return found


# ---------------------------------------------------------------- line of sight


def _seen(case: Case, found: Sequence[Strip]) -> list[Array | None]:
    """The share of the zone that is clear, for each strip's antennas over time."""
    frequencies = case.trial.recording.site.frequencies
    if case.scenario is None or not len(frequencies) or not found:
        return [None] * len(found)
    wavelength = SPEED_OF_LIGHT / float(np.mean(frequencies))
    try:
        world = load("worlds", case.scenario.world.kind)(case.scenario.world.config)
    except (UnknownPlugin, BrokenPlugin, ValueError):
        return [None] * len(found)
    try:
        caster = world.caster(case.scene, "boxes", *losses(case.scene.materials))
        return [_clear(case, one, caster, wavelength) for one in found]
    except ImportError:
        return [None] * len(found)
    finally:
        world.close()


def _clear(case: Case, strip: Strip, caster: Caster, wavelength: float) -> Array:
    """(R, LOOKS) share in the middle of each step."""
    truth, far = case.trial.truth, Ends(case.far.body, case.far.pose)
    t = (np.arange(LOOKS) + 0.5) * case.duration / LOOKS
    row, instant = (a.ravel() for a in np.meshgrid(np.arange(len(strip.rows)), np.arange(LOOKS), indexing="ij"))
    start = case.near.at(truth, strip.rows[row], t[instant])[:, :3]
    end = far.at(truth, np.full(len(row), strip.tag), t[instant])[:, :3]
    poses = truth.pose(np.arange(len(truth.bodies)), t[:, None]) if truth.bodies else np.empty((len(t), 0, 7))
    clear = np.empty(len(row))
    for begin in range(0, len(row), CHUNK):
        part = slice(begin, begin + CHUNK)
        n = len(row[part])
        obstacles = Obstacles(caster, poses, instant[part].astype(np.int64), np.full(n, bool(truth.bodies)))
        clear[part] = sight(start[part], end[part], wavelength, obstacles, np.full(n, LOST)).clear
    return clear.reshape(len(strip.rows), LOOKS)


# ---------------------------------------------------------------- the phase of one link


@dataclass(frozen=True, eq=False)
class Turning:
    """Phase of the reads of one tag by one antenna on one carrier, and the phase that the true range alone would give.

    t, phase (N,) s, rad : the reads; frequency Hz; whole: rad after which the reader begins again (2π or π)
    at, expected (K,)    : s, rad; not wrapped, with the constant offset of the reads on it
    agreement            : mean resultant length of reads less expected, 1 for perfect
    """

    tag: str
    antenna: int
    frequency: float
    whole: float
    t: Array
    phase: Array
    at: Array
    expected: Array
    agreement: float


def turning(case: Case, rate: float = 200.0) -> Turning | None:
    """The link with most reads with a phase, on the carrier with most of them. None without a phase, or without the scenario."""
    reads = case.reads
    tags = [int(tag) for tags in case.trial.recording.target_tags for tag in tags]
    reads = reads.take(np.isfinite(reads.phase) & np.isin(reads.tag, tags))
    frequencies = case.trial.recording.site.frequencies
    if not len(reads) or not len(frequencies):
        return None
    links, many = np.unique(np.stack([reads.antenna, reads.tag, reads.channel], axis=1), axis=0, return_counts=True)
    antenna, tag, channel = links[np.argmax(many)].tolist()
    own = reads.take((reads.antenna == antenna) & (reads.tag == tag) & (reads.channel == channel))
    own = own.take(np.argsort(own.t, kind="stable"))
    sign, whole = _reported(case, antenna)
    at = np.linspace(0.0, case.duration, max(2, round(case.duration * rate) + 1))
    f = float(frequencies[channel])

    def by_range(t: Array) -> Array:
        start = case.near.at(case.trial.truth, np.full(len(t), antenna), t)[:, :3]
        end = case.far.at(case.trial.truth, np.full(len(t), tag), t)[:, :3]
        return -sign * 4 * np.pi * f / SPEED_OF_LIGHT * np.linalg.norm(end - start, axis=1)

    apart = np.exp(1j * (own.phase - by_range(own.t)) * 2 * np.pi / whole).mean()
    offset = float(np.angle(apart)) * whole / (2 * np.pi)
    name = str(case.trial.recording.site.tags.id[tag])
    return Turning(name, antenna, f, whole, own.t, np.mod(own.phase, whole), at, by_range(at) + offset, float(abs(apart)))


def _reported(case: Case, antenna: int) -> tuple[int, float]:
    """Sign of the phase that the antenna's reader reports, and rad after which it begins again."""
    reader = str(case.antennas.reader[antenna])
    for section in case.scenario.sensors if case.scenario else ():
        config = section.config
        if section.id == reader and isinstance(config, RfidConfig) and config.artefacts.phase_wrapped:
            profile = config.reader.resolved()
            return profile.phase_sign, 2 * np.pi * profile.phase_turns
    return 1, 2 * np.pi
