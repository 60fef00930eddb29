"""Whether a log looks as its declaration says: units that contradict what is there end the reading, doubts become notes."""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.logs.bad import BadRows, LogError
from testbed.logs.units import PHASE, RSSI, TURN

ENOUGH = 200  # reads before anything is concluded from what they don't show
DBM = (-150.0, 20.0)  # a reader's RSSI lies between
FLIP_RAD = 0.35  # how near to π a jump between neighbours must be to be a flip
NEIGHBOURS_S = 0.3
SAMPLE = 50_000
PHASE_RANGE = "phase beyond a turn"
RSSI_RANGE = "RSSI out of range"


def check_phase(line: Array, value: Array, unit: str, bad: BadRows) -> Array:
    """(N,) bool: phases (as written) that lie within a turn of the declared unit; the others are put down."""
    turn = TURN[unit]
    with np.errstate(invalid="ignore"):
        beyond = np.abs(value) > turn * (1 + 1e-9)
    if beyond.any():
        bad.add(line[beyond], f"{PHASE_RANGE} ({unit})", value[beyond])
    return ~beyond


def check_rssi(line: Array, value: Array, unit: str, bad: BadRows) -> Array:
    """(N,) bool: RSSI (as written) that a reader can report in the declared unit."""
    dbm = value / RSSI[unit]
    with np.errstate(invalid="ignore"):
        out = (dbm < DBM[0]) | (dbm > DBM[1])
    if out.any():
        bad.add(line[out], f"{RSSI_RANGE} ({unit})", value[out])
    return ~out


class Seen:
    """What a log's reads look like as a whole."""

    def __init__(self, phase_unit: str, phase_wrap: str, rssi_unit: str) -> None:
        self._phase_unit, self._wrap, self._rssi_unit = phase_unit, phase_wrap, rssi_unit

    def notes(self, t: Array, antenna: Array, tag: Array, channel: Array, rssi: Array, phase: Array, path: str) -> list[str]:
        """Doubts in words, for reads in the order of time with phase in [0, 2π). LogError for a plain contradiction."""
        found: list[str] = []
        level = rssi[np.isfinite(rssi)]
        if len(level) >= ENOUGH and self._rssi_unit == "cdbm" and (np.abs(level) < 1.5).all():
            raise LogError(f"{path}: RSSI of {level.min():g} to {level.max():g} dBm: is it in whole dBm? declare rssi_unit: dbm")
        if len(level) >= ENOUGH and (level > 0).mean() > 0.5:
            found.append("most RSSI is above 0 dBm: are these levels without their sign?")
        angle = phase[np.isfinite(phase)]
        if len(angle) < ENOUGH:
            return found
        as_written = np.where(angle > np.pi, angle - 2 * np.pi, angle) / PHASE[self._phase_unit]
        widest = np.abs(as_written).max()
        if self._phase_unit == "deg" and widest <= 2 * np.pi and np.ptp(as_written) > 2.9:
            found.append(f"no phase is beyond ±{widest:.3g}°: is it in radians? then declare phase_unit: rad")
        if self._phase_unit == "steps4096" and angle.max() / PHASE["steps4096"] <= 360 and angle.max() / PHASE["steps4096"] > 300:
            found.append("no phase is beyond 360 of 4096 steps: is it in degrees? then declare phase_unit: deg")
        covers = np.histogram(angle % np.pi, bins=12, range=(0, np.pi))[0]
        if self._wrap == "2pi" and angle.max() < np.pi * (1 + 1e-6) and (covers > 0).all():
            found.append("all phases lie within half a turn: does π wrap them? then declare phase_wrap: pi")
        flips = flip_share(t, antenna, tag, channel, phase)
        if self._wrap == "2pi" and np.isfinite(flips) and flips > 0.02:
            found.append(f"{flips:.0%} of neighbouring reads of one link jump by π: the reader flips, or two tags share an EPC")
        return found


def flip_share(t: Array, antenna: Array, tag: Array, channel: Array, phase: Array) -> float:
    """The share of neighbouring reads of one link (antenna, tag, channel) whose phases differ by π; NaN where there are none.

    Of the first reads alone, where there are many: enough to tell.
    """
    t, antenna, tag, channel, phase = (column[:SAMPLE] for column in (t, antenna, tag, channel, phase))
    order = np.lexsort((t, channel, tag, antenna))
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for column in (antenna, tag, channel):
        same &= np.diff(column[order]) == 0
    same &= np.diff(t[order]) < NEIGHBOURS_S
    step = np.abs(np.angle(np.exp(1j * np.diff(phase[order]))))[same]
    step = step[np.isfinite(step)]
    return float((np.pi - step < FLIP_RAD).mean()) if len(step) else np.nan
