"""Cells to numbers in SI, by the unit that is declared for them. Nothing is guessed: what does not fit is NaN and said to be so."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs.arrow import pc
from testbed.logs.bad import LogError

TimeUnit = Literal["s", "ms", "us", "ns", "iso"]
PhaseUnit = Literal["rad", "deg", "steps4096"]
RssiUnit = Literal["dbm", "cdbm"]
ChannelUnit = Literal["index", "index1", "mhz", "khz", "hz"]
DopplerUnit = Literal["hz", "hz16"]

EXPONENT = {"s": "", "ms": "e-3", "us": "e-6", "ns": "e-9"}
PHASE = {"rad": 1.0, "deg": np.pi / 180, "steps4096": 2 * np.pi / 4096}
TURN = {"rad": 2 * np.pi, "deg": 360.0, "steps4096": 4096.0}
RSSI = {"dbm": 1.0, "cdbm": 100.0}
DOPPLER = {"hz": 1.0, "hz16": 16.0}
CARRIER = {"mhz": 1e6, "khz": 1e3, "hz": 1.0}
NUMBER = r"^[+-]?(\d{1,40}\.?\d{0,40}|\.\d{1,40})([eE][+-]?\d{1,3})?$"
NOTHING = pa.array(["", "nan", "NaN", "None", "null", "N/A", "-"])
EARLIEST, LATEST = -1.0, 1e11  # s: beyond is no time of any log
NANO = 1_000_000_000
_NUMBER = re.compile(NUMBER.strip("^$"))
_ISO = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(\.\d{1,30})?(Z|[+-]\d\d:?\d\d)?")


def numbers(cells: pa.Array) -> tuple[Array, Array]:
    """(values (N,) float64, unreadable (N,) bool). An empty cell is NaN and not unreadable; infinity is unreadable."""
    if not pa.types.is_string(cells.type):
        if not (pa.types.is_integer(cells.type) or pa.types.is_floating(cells.type)):
            raise LogError(f"a column of numbers is wanted where there is one of {cells.type}")
        found = pc.cast(cells, pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        return found, np.isinf(found)
    blank = pc.is_in(cells, NOTHING)
    given = pc.if_else(blank, pa.scalar(None, pa.string()), cells) if pc.any(blank).as_py() else cells
    found = _floats(given).to_numpy(zero_copy_only=False)
    unreadable = ~np.isfinite(found) & ~blank.to_numpy(zero_copy_only=False)
    return found, unreadable


def _floats(cells: pa.Array) -> pa.Array:
    try:
        return pc.cast(cells, pa.float64())
    except pa.ArrowInvalid:
        readable = pc.match_substring_regex(cells, NUMBER)
        return pc.cast(pc.if_else(readable, cells, pa.scalar(None, pa.string())), pa.float64())


# ---------------------------------------------------------------- time


@dataclass
class Clock:
    """Times of a log as seconds from its start. `start` is in seconds of the log's own clock; None until the first times are seen.

    Whole nanoseconds are counted as integers, so that a difference of large times is exact; finer texts go by float64.
    """

    unit: TimeUnit
    start: float | None = None
    _start_ns: int | None = None

    def __post_init__(self) -> None:
        if self.start is not None:
            self._start_ns = round(self.start * NANO)

    def seconds(self, cells: pa.Array) -> Array:
        """(N,) s from the start, NaN for what is no time in the declared unit."""
        text = _decimal_seconds(cells, self.unit)
        ns = _nanoseconds(text)
        if ns is not None:
            count, there = ns
            if self._start_ns is None and there.any():
                self._start_ns = int(count[there].min())
                self.start = self._start_ns / NANO
            return np.where(there, (count - (self._start_ns or 0)) / NANO, np.nan)
        value = _floats(text).to_numpy(zero_copy_only=False)
        value = np.where((value >= EARLIEST) & (value <= LATEST), value, np.nan)
        if self._start_ns is None and np.isfinite(value).any():
            self.start = float(np.nanmin(value))
            self._start_ns = round(self.start * NANO)
        return value - (self.start or 0.0)


def _decimal_seconds(cells: pa.Array, unit: TimeUnit) -> pa.Array:
    """Texts of decimal numbers of seconds, null where there is none."""
    if pa.types.is_timestamp(cells.type):
        count = pc.cast(pc.cast(cells, pa.timestamp("ns"), safe=False), pa.int64())
        return pc.binary_join_element_wise(pc.cast(count, pa.string()), "e-9", "")
    if not pa.types.is_string(cells.type):
        if not (pa.types.is_integer(cells.type) or pa.types.is_floating(cells.type)):
            raise LogError(f"a column of times is wanted where there is one of {cells.type}")
        cells = pc.cast(cells, pa.string())
    if unit == "iso":
        return _from_iso(cells)
    if not EXPONENT[unit]:
        return _readable(cells)
    scaled = pc.binary_join_element_wise(cells, EXPONENT[unit], "")
    try:
        pc.cast(scaled, pa.float64())
        return scaled
    except pa.ArrowInvalid:  # no number, or one with an exponent of its own
        return pa.array([_scaled(text, EXPONENT[unit]) for text in cells.to_pylist()], pa.string())


def _readable(cells: pa.Array) -> pa.Array:
    """The cells that are numbers, null for others."""
    try:
        pc.cast(cells, pa.float64())
        return cells
    except pa.ArrowInvalid:
        return pc.if_else(pc.match_substring_regex(cells, NUMBER), cells, pa.scalar(None, pa.string()))


def _scaled(text: str | None, exponent: str) -> str | None:
    """A number's text with another power of ten."""
    if text is None or _NUMBER.fullmatch(text) is None:
        return None
    mantissa, _, own = text.lower().partition("e")
    return f"{mantissa}e{int(own or 0) + int(exponent[1:])}"


def _nanoseconds(text: pa.Array) -> tuple[Array, Array] | None:
    """(counts (N,) int64, which are there (N,) bool); None where some text is finer than a nanosecond, or out of range."""
    try:
        exact = pc.cast(text, pa.decimal128(28, 9))
    except pa.ArrowInvalid:
        return None
    if not len(exact):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=bool)
    exact = pa.concat_arrays([exact])
    low, high = np.frombuffer(exact.buffers()[1], dtype=np.int64).reshape(-1, 2)[exact.offset : exact.offset + len(exact)].T
    there = exact.is_valid().to_numpy(zero_copy_only=False) & (high == low >> 63)
    value = low.astype(np.float64) / NANO
    return low, there & (value >= EARLIEST) & (value <= LATEST / 20)  # int64 ends in the year 2262


def _from_iso(cells: pa.Array) -> pa.Array:
    try:
        when = pc.cast(cells, pa.timestamp("ns", "UTC"))
        exact = pc.cast(when, pa.int64())
        return pc.binary_join_element_wise(pc.cast(exact, pa.string()), "e-9", "")
    except pa.ArrowInvalid:
        return pa.array([_iso(text) for text in cells.to_pylist()], pa.string())


def _iso(text: str | None) -> str | None:
    """An ISO 8601 time as decimal seconds; without a zone it is UTC."""
    fits = _ISO.fullmatch(text or "")
    if fits is None:
        return None
    day, clock, fraction, zone = fits.groups()
    try:
        whole = datetime.fromisoformat(f"{day}T{clock}").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    if zone and zone != "Z":
        sign, digits = (-1 if zone[0] == "-" else 1), zone[1:].replace(":", "")
        whole -= sign * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
    return f"{round(whole)}{fraction or ''}" if whole >= 0 else None


# ---------------------------------------------------------------- channel


def places(cells: pa.Array, unit: ChannelUnit, carriers: Array) -> tuple[Array, Array]:
    """(places in the hop table (N,) int64, not in it (N,) bool), by index or by the carrier itself, within 1 kHz. Empty cells: 0."""
    value, unreadable = numbers(cells)
    none = np.isnan(value) & ~unreadable
    if unit in ("index", "index1"):
        place = np.where(np.isfinite(value), value, 0) - (unit == "index1")
        known = len(carriers) or 1 << 15
        wrong = unreadable | (~none & ((place < 0) | (place >= known) | (place != np.round(place))))
        return np.where(none | wrong, 0, place).astype(np.int64), wrong
    if not len(carriers):
        return np.zeros(len(value), dtype=np.int64), unreadable
    order = np.argsort(carriers)
    hertz = np.where(np.isfinite(value), value, 0.0) * CARRIER[unit]
    middles = (carriers[order][1:] + carriers[order][:-1]) / 2
    place = order[np.searchsorted(middles, hertz)]
    wrong = unreadable | (~none & (np.abs(carriers[place] - hertz) > 1e3))
    return np.where(none | wrong, 0, place), wrong
