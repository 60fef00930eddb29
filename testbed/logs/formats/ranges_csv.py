"""The testbed's own table of ranges: t, anchor, target, range; t in s, range in m, anchor a port or an id of the site.

`target` is the id of a target of the site; it may be left out where there is one.
"""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.logs.bad import LogError
from testbed.logs.blocks import blocks, head
from testbed.logs.cells import Cells, parse, split_row
from testbed.logs.contents import Contents, Job
from testbed.logs.layout import Layout
from testbed.logs.names import PortNames
from testbed.logs.samples import ordered, refuse
from testbed.logs.units import numbers
from testbed.types import Ranges

MOST_M = 10_000.0
LAYOUT = Layout(names={}, time_unit="s")


class RangesCsv:
    """SI units: s and m."""

    says = "the testbed's own CSV of ranges: t (s), anchor, range (m), and target where there are several"

    def read(self, job: Job) -> Contents:
        lines = head(job.path)
        names = [name.strip().lower() for name in split_row(lines[0], ",")] if lines else []
        if not {"t", "anchor", "range"} <= set(names) or len(set(names)) < len(names):
            raise LogError(f"{job.path}: the columns t, anchor and range are wanted, once each; the header has {', '.join(names[:12])}")
        clock, wanted = job.clock("s"), [n for n in ("t", "anchor", "range", "target") if n in names]
        parts: list[dict[str, Array]] = []
        for block in blocks(job.path, job.progress):
            cells = parse(block, names, wanted, ",", job.bad)
            if block.line == 1 and len(cells) and cells.line[0] == 1:
                cells = Cells(cells.line[1:], {name: column[1:] for name, column in cells.columns.items()})
            if len(cells):
                parts.append(self._part(cells, job, clock.seconds(cells.columns["t"])))
        none: dict[str, Array] = {name: np.empty(0) for name in ("line", "t", "anchor", "target", "range")}
        whole = {name: np.concatenate([p[name] for p in parts]) for name in none} if parts else none
        line, t = whole.pop("line"), whole.pop("t")
        ranges = Ranges(**ordered(line, t, whole, job.site.log, job.bad))
        job.bad.check_share(len(ranges), str(job.path))
        return Contents({"ranges": ranges}, [], clock.start or 0.0, layout=LAYOUT.declared(job.site.log))

    def _part(self, cells: Cells, job: Job, t: Array) -> dict[str, Array]:
        good = np.ones(len(cells), dtype=bool)
        value, _ = numbers(cells.columns["range"])
        anchor = PortNames(job.site).indices(cells.columns["anchor"])
        ids = {target.id: i for i, target in enumerate(job.site.targets)}
        target = np.zeros(len(cells), dtype=np.int64)
        if "target" in cells.columns:
            target = np.array([ids.get(text, -1) for text in cells.columns["target"].to_pylist()], dtype=np.int64)
        text = {name: np.array(column.to_pylist(), dtype=object) for name, column in cells.columns.items()}
        refuse(cells.line, good, np.isnan(t), f"no time in {job.site.log.time_unit or 's'}", text["t"], job.bad)
        with np.errstate(invalid="ignore"):
            refuse(cells.line, good, ~((value >= 0) & (value <= MOST_M)), "range out of bounds", text["range"], job.bad)
        refuse(cells.line, good, anchor < 0, "an anchor that the site does not have", text["anchor"], job.bad)
        refuse(cells.line, good, target < 0, "a target that the site does not have", text.get("target", text["t"]), job.bad)
        return {"line": cells.line[good], "t": t[good], "anchor": anchor[good], "target": target[good], "range": value[good]}
