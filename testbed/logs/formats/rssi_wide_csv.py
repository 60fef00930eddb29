"""RSSI of one beacon with a column an anchor (rssi_1, rssi_2, ...), a row a sample, and perhaps true x and y in it.

The files of the BLE RSS dataset of a flat (calib2021): ts in ns, x, heading, y, rssi_1 to rssi_6. An empty cell is an anchor that heard
nothing. A place that repeats the one before to the last digit is an old one, and no truth.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs.bad import LogError
from testbed.logs.blocks import blocks, head
from testbed.logs.cells import Cells, parse, split_row
from testbed.logs.contents import Contents, Job, Path3, finished
from testbed.logs.layout import Layout
from testbed.logs.samples import FAR_M, path_of
from testbed.logs.units import numbers

LAYOUT = Layout(names={}, time_unit="ns")
ROLES = {"time": "time", "antenna": "antenna", "tag": "tag", "rssi": "rssi"}
PREFIX = "rssi_"
BEACON = "beacon"


class RssiWideCsv:
    """Time in ns (or as declared), RSSI in dBm, places in m; ports of the site are what stands behind `rssi_`."""

    says = "CSV with a column an anchor: ts (ns), x, y (m, the truth, where they are there), rssi_1, rssi_2, ... (dBm)"

    def read(self, job: Job) -> Contents:
        lines = head(job.path)
        names = [name.strip() or f"column {i}" for i, name in enumerate(split_row(lines[0], ","))] if lines else []
        levels = [name for name in names if name.startswith(PREFIX)]
        time = job.site.log.columns.get("time", "ts")
        if time not in names or not levels or len(set(names)) < len(names):
            listed = ", ".join(names[:12])
            raise LogError(f"{job.path}: the columns {time} and {PREFIX}1, {PREFIX}2, ... are wanted, once each; the header has {listed}")
        layout = LAYOUT.declared(job.site.log)
        taker, rows = job.taker(layout), []
        for block in blocks(job.path, job.progress):
            wanted = [time, *levels, *(axis for axis in "xy" if axis in names)]
            cells = parse(block, names, wanted, ",", job.bad)
            if block.line == 1 and len(cells) and cells.line[0] == 1:
                cells = Cells(cells.line[1:], {name: column[1:] for name, column in cells.columns.items()})
            if len(cells):
                long = _long(cells, time, levels)
                if len(long):
                    taker.take(long, ROLES, layout)
                rows.append((cells, taker.clock.seconds(cells.columns[time])))
        contents = finished(job, taker, layout)
        truth = _truth(rows) if {"x", "y"} <= set(names) else None
        found = {contents.tags[0]: truth} if truth is not None and contents.tags else {}
        return Contents(contents.streams, contents.tags, contents.start_s, contents.notes, found, layout)


def _long(cells: Cells, time: str, levels: list[str]) -> Cells:
    """A row for each anchor that heard something, in the order of rows and anchors."""
    n, m = len(cells), len(levels)
    heard = np.array([[text not in ("", "nan", "NaN") for text in cells.columns[name].to_pylist()] for name in levels]).T.ravel()
    row, which = np.repeat(np.arange(n), m)[heard], np.tile(np.arange(m), n)[heard]
    every = np.stack([np.array(cells.columns[name].to_pylist(), dtype=object) for name in levels], axis=1).reshape(n, m)
    times = np.array(cells.columns[time].to_pylist(), dtype=object)
    ports = np.array([name.removeprefix(PREFIX) for name in levels], dtype=object)
    columns = {"time": times[row], "antenna": ports[which], "tag": np.full(len(row), BEACON, dtype=object), "rssi": every[row, which]}
    return Cells(cells.line[row], {name: pa.array(list(values), pa.string()) for name, values in columns.items()})


def _truth(rows: list[tuple[Cells, Array]]) -> Path3 | None:
    """The true path: samples whose place is new."""
    if not rows:
        return None
    t = np.concatenate([times for _, times in rows])
    xy = np.concatenate([np.stack([numbers(cells.columns[axis])[0] for axis in "xy"], axis=1) for cells, _ in rows])
    sound = np.isfinite(t) & (t >= 0) & np.isfinite(xy).all(axis=1) & (np.abs(np.nan_to_num(xy)) < FAR_M).all(axis=1)
    t, xy = t[sound], xy[sound]
    fresh = np.ones(len(t), dtype=bool)
    fresh[1:] = (np.diff(xy, axis=0) != 0).any(axis=1)
    if not fresh.any():
        return None
    return path_of(t[fresh], np.column_stack([xy[fresh], np.zeros(fresh.sum())]))
