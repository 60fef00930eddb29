"""Text of libRSF, a measurement a line: `range2 t range σ x y anchor …` (m), and `odom2diff t left right 0 base …` of a differential drive.

The labyrinth of TU Chemnitz. Its readme is wrong: column 3 is the left wheel's speed, column 4 the right one's, and column 6 half the
wheel base, so that the yaw rate is (right - left) / (2 base); checked against the true headings. Anchors by number are ports of the site.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs.blocks import blocks
from testbed.logs.contents import Contents, Job
from testbed.logs.layout import Layout
from testbed.logs.names import PortNames
from testbed.logs.samples import ordered, refuse
from testbed.logs.units import Clock
from testbed.types import Odometry, Ranges

LAYOUT = Layout(names={}, time_unit="s")
LEAST = {"range2": 7, "odom2diff": 6}  # cells that a line has at least, its word included
MOST_M, MOST_MPS, MOST_RADPS = 1000.0, 100.0, 50.0
FAILED = "no number"


class Librsf:
    """Time in s, ranges in m, wheel speeds in m/s. Other words are passed over."""

    says = "text of libRSF: lines of range2 (t, range, σ, anchor's x and y, anchor) and odom2diff (t, left, right wheel, half wheel base)"

    def read(self, job: Job) -> Contents:
        rows = _rows(job)
        clock = job.clock("s")
        every = np.array([r[1] for word in rows for r in rows[word]], dtype=object)
        if len(every):
            clock.seconds(pa.array([str(t) for t in every], pa.string()))  # the earliest of either kind is the start
        ranges, odometry = self._ranges(job, rows["range2"], clock), self._odometry(job, rows["odom2diff"], clock)
        job.bad.check_share(len(ranges) + len(odometry), str(job.path))
        return Contents({"ranges": ranges, "odometry": odometry}, [], clock.start or 0.0, layout=LAYOUT.declared(job.site.log))

    def _ranges(self, job: Job, rows: list[tuple[int, str, list[str]]], clock: Clock) -> Ranges:
        line, t, values, good = _numbers(rows, clock, (0,), job)
        anchor = PortNames(job.site).indices(pa.array([cells[4] for _, _, cells in rows], pa.string()))
        with np.errstate(invalid="ignore"):
            refuse(line, good, ~((values[:, 0] >= 0) & (values[:, 0] <= MOST_M)), "range out of bounds", values[:, 0], job.bad)
        refuse(line, good, anchor < 0, "an anchor that the site does not have", np.array([c[4] for _, _, c in rows], dtype=object), job.bad)
        columns = {"anchor": anchor[good], "target": np.zeros(good.sum(), dtype=np.int64), "range": values[good, 0]}
        return Ranges(**ordered(line[good], t[good], columns, job.site.log, job.bad))

    def _odometry(self, job: Job, rows: list[tuple[int, str, list[str]]], clock: Clock) -> Odometry:
        line, t, values, good = _numbers(rows, clock, (0, 1, 3), job)
        left, right, base = values.T
        with np.errstate(invalid="ignore", divide="ignore"):
            speed, yaw_rate = (left + right) / 2, (right - left) / (2 * base)
            wrong = ~((np.abs(speed) <= MOST_MPS) & (np.abs(yaw_rate) <= MOST_RADPS))
        refuse(line, good, wrong, "a speed out of bounds", speed, job.bad)
        columns = {"carrier": np.zeros(good.sum(), dtype=np.int64), "speed": speed[good], "yaw_rate": yaw_rate[good]}
        return Odometry(**ordered(line[good], t[good], columns, job.site.log, job.bad))


def _rows(job: Job) -> dict[str, list[tuple[int, str, list[str]]]]:
    """(line, time, cells behind it) of the lines that are read, by word."""
    found: dict[str, list[tuple[int, str, list[str]]]] = {word: [] for word in LEAST}
    for block in blocks(job.path, job.progress):
        for number, text in enumerate(block.text.decode("utf-8", "replace").split("\n")[:-1], start=block.line):
            cells = text.split()
            if not cells or cells[0] not in LEAST:
                continue
            if len(cells) < LEAST[cells[0]]:
                job.bad.add(np.array([number]), "too few cells", [text])
                continue
            found[cells[0]].append((number, cells[1], cells[2:]))
    return found


def _numbers(rows: list[tuple[int, str, list[str]]], clock: Clock, wanted: tuple[int, ...], job: Job) -> tuple[Array, Array, Array, Array]:
    """(lines (N,), times (N,) s, numbers (N, wanted), which rows are sound (N,))."""
    line, good = np.array([number for number, _, _ in rows], dtype=np.int64), np.ones(len(rows), dtype=bool)
    t = clock.seconds(pa.array([time for _, time, _ in rows], pa.string())) if rows else np.empty(0)
    values = np.full((len(rows), len(wanted)), np.nan)
    for i, (_, _, cells) in enumerate(rows):
        for k, place in enumerate(wanted):
            try:
                values[i, k] = float(cells[place])
            except ValueError:
                continue
    shown = np.array([" ".join([time, *cells])[:60] for _, time, cells in rows], dtype=object)
    refuse(line, good, np.isnan(t) | ~np.isfinite(values).all(axis=1), FAILED, shown, job.bad)
    return line, t, values, good
