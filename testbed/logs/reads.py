"""Cells of a log of reads to numbers: every row good or put down as bad, block by block, then all of them in order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs import sanity
from testbed.logs.bad import BadRows, LogError
from testbed.logs.cells import Cells
from testbed.logs.layout import Layout
from testbed.logs.names import PortNames, TagNames
from testbed.logs.order import EARLY, Order
from testbed.logs.site import LogModel, SiteModel
from testbed.logs.units import DOPPLER, PHASE, RSSI, Clock, numbers, places
from testbed.types import Reads

MAX_READS = 50_000_000  # about 50 bytes each
BEFORE_S = 1e-6  # a row may lie so little before the declared start

COLUMNS = {"t": np.float64, "t_arrival": np.float64, "antenna": np.int32, "tag": np.int32, "channel": np.int16}
TURNS = {"2pi": 2 * np.pi, "pi": np.pi}
MEASURED = ("rssi", "phase", "doppler")


@dataclass
class ReadsTaker:
    """Takes blocks of cells; `table` is what came of them. One file's log of one site."""

    site: SiteModel
    clock: Clock
    bad: BadRows
    path: str
    log: LogModel = field(init=False)
    tags: TagNames = field(init=False)

    def __post_init__(self) -> None:
        self.log, self.tags, self.ports = self.site.log, TagNames(self.site), PortNames(self.site)
        self.order = Order(self.log.lateness_s, self.log.longest_gap_s, self.bad)
        self._carriers = self.site.carriers()
        self._parts: dict[str, list[Array]] = {name: [] for name in (*COLUMNS, *MEASURED)}
        self.count = self.strange = 0
        self.layout: Layout | None = None

    def take(self, cells: Cells, columns: dict[str, str], layout: Layout) -> None:
        """A block of rows whose cells are `columns` by role. LogError where there are more than memory is meant for."""
        self.layout = layout
        by_role = {role: cells.columns[name] for role, name in columns.items()}
        good = np.ones(len(cells), dtype=bool)
        found = {"t": self._times(cells.line, by_role["time"], good)}
        found |= self._names(cells.line, by_role, good)
        found |= self._measured(cells.line, by_role, layout, good)
        index = np.flatnonzero(good)
        index = index[found["tag"][index] >= 0]  # the site does not name the others: no mistake, and no use
        keep, arrival = self.order.take(cells.line[index], found["t"][index])
        found["t_arrival"] = np.full(len(cells), np.nan)
        found["t_arrival"][index] = arrival
        index = index[keep]
        for name, parts in self._parts.items():
            parts.append(found[name][index].astype(COLUMNS.get(name, np.float64), copy=False))
        self.count += len(index)
        self.strange += int((good & (found["tag"] == -1)).sum())
        if self.count > MAX_READS:
            raise LogError(f"{self.path}: over {MAX_READS:,} reads: split the log by time")

    def _times(self, line: Array, cells: pa.Array, good: Array) -> Array:
        t = self.clock.seconds(cells)
        self._refuse(line, good, np.isnan(t), f"no time in {self.clock.unit}", cells)
        if self.log.start_s is not None:
            self._refuse(line, good, t < -BEFORE_S, EARLY, cells)
        return t

    def _names(self, line: Array, cells: dict[str, pa.Array], good: Array) -> dict[str, Array]:
        antenna, tag = self.ports.indices(cells["antenna"], cells.get("reader")), self.tags.codes(cells["tag"])
        self._refuse(line, good, antenna < 0, "an antenna port that the site does not have", cells["antenna"])
        self._refuse(line, good, tag == -2, "no EPC", cells["tag"])
        channel = np.zeros(len(line), dtype=np.int64)
        if "channel" in cells and self.layout is not None:
            channel, wrong = places(cells["channel"], self.layout.channel_unit, self._carriers)
            self._refuse(line, good, wrong, f"no channel of the hop table ({self.layout.channel_unit})", cells["channel"])
        return {"antenna": antenna, "tag": tag, "channel": channel}

    def _measured(self, line: Array, cells: dict[str, pa.Array], layout: Layout, good: Array) -> dict[str, Array]:
        found = {}
        for name in MEASURED:
            if name not in cells:
                found[name] = np.full(len(line), np.nan)
                continue
            value, unreadable = numbers(cells[name])
            self._refuse(line, good, unreadable, f"{name} is no number", cells[name])
            at = np.flatnonzero(good)
            if name == "rssi":
                good[at] &= sanity.check_rssi(line[at], value[at], layout.rssi_unit, self.bad)
                value = value / RSSI[layout.rssi_unit]
            elif name == "phase":
                good[at] &= sanity.check_phase(line[at], value[at], layout.phase_unit, self.bad)
                value = _wrapped(self.log.phase_sign * value * PHASE[layout.phase_unit], TURNS[self.log.phase_wrap])
            else:
                value = value / DOPPLER[layout.doppler_unit]
            found[name] = value
        return found

    def _refuse(self, line: Array, good: Array, wrong: Array, what: str, cells: pa.Array) -> None:
        """Put down rows that are wrong, once each."""
        new = np.flatnonzero(good & wrong)
        if len(new):
            self.bad.add(line[new], what, (cells[int(i)].as_py() for i in new))
            good[new] = False

    def table(self) -> Reads:
        """All good rows, by time; rows of one time in the order of the file."""
        columns = {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in self._parts.items()}
        self._parts = {name: [] for name in self._parts}
        order = np.argsort(columns["t"], kind="stable")
        if (order[1:] > order[:-1]).all():
            return Reads(**columns)
        return Reads(**{name: column[order] for name, column in columns.items()})

    def notes(self, reads: Reads) -> list[str]:
        """Doubts about the whole, in words. LogError for a contradiction."""
        found = []
        if self.layout is not None:
            seen = sanity.Seen(self.layout.phase_unit, self.log.phase_wrap, self.layout.rssi_unit)
            found = seen.notes(reads.t, reads.antenna, reads.tag, reads.channel, reads.rssi, reads.phase, self.path)
        if self.strange:
            names = sorted(self.tags.strangers, key=lambda n: -self.tags.strangers[n])
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            found.append(f"{self.strange} reads of tags that the site does not name: {', '.join(names[:3])}{more}")
        if self.order.moved:
            found.append(f"{self.order.moved} rows came out of order, within {self.log.lateness_s:g} s, and were sorted")
        return found


def _wrapped(angle: Array, modulus: float) -> Array:
    """Angles in [0, modulus), those that lie there already bit for bit."""
    with np.errstate(invalid="ignore"):
        outside = (angle < 0) | (angle >= modulus)
    if not outside.any():
        return angle
    wrapped = np.mod(angle, modulus)
    wrapped = np.where(wrapped >= modulus, 0.0, wrapped)
    return np.where(outside, wrapped, angle)
