"""What a format makes of one file, and the reading that all row formats share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from testbed.columns import Array, Table
from testbed.logs.bad import BadRows, LogError
from testbed.logs.blocks import blocks, head
from testbed.logs.cells import Cells, parse, split_row
from testbed.logs.layout import Layout
from testbed.logs.reads import ReadsTaker
from testbed.logs.site import SiteModel
from testbed.logs.units import Clock
from testbed.progress import Progress


@dataclass(frozen=True)
class Path3:
    """True places over time: t (K,) s from the log's start, ascending, position (K, 3) m."""

    t: Array
    position: Array


@dataclass(frozen=True)
class Contents:
    """Streams by kind, ids of the tags that they index, the start on the log's own clock (s), true paths by target where a log has them."""

    streams: dict[str, Table]
    tags: list[str]
    start_s: float
    notes: list[str] = field(default_factory=list)
    truth: dict[str, Path3] = field(default_factory=dict)
    layout: Layout | None = None


@dataclass(frozen=True)
class Job:
    """One file to read: what formats are made of."""

    path: Path
    site: SiteModel
    bad: BadRows
    progress: Progress | None = None

    def clock(self, unit: str) -> Clock:
        """The log's clock, in the unit that the site declares, else in the format's."""
        return Clock(self.site.log.time_unit or unit, self.site.log.start_s)  # pyright: ignore[reportArgumentType]

    def taker(self, layout: Layout) -> ReadsTaker:
        """For the reads of this file."""
        return ReadsTaker(self.site, self.clock(layout.time_unit), self.bad, str(self.path))


Header = Callable[[Sequence[str]], tuple[int, list[str]]]


def first_line(lines: Sequence[str]) -> tuple[int, list[str]]:
    """(lines that come before the rows, names of the columns) of a file whose first line names them."""
    return 1, split_row(lines[0], ",") if lines and lines[0].strip() else []


def read_rows(job: Job, layout: Layout, header: Header = first_line) -> Contents:
    """A delimited file of reads. LogError for a file without the header that its format has."""
    skipped, names = header(head(job.path))
    if len(names) < 2:
        raise LogError(f"{job.path}: a header is wanted that names the columns, as a log of kind {job.site.log.kind} has it")
    columns, layout = layout.found(names, job.site.log, str(job.path))
    taker, wanted = job.taker(layout), list(dict.fromkeys(columns.values()))
    for block in blocks(job.path, job.progress):
        cells = (
            parse(block, names, wanted, layout.delimiter, job.bad, layout.comment)
            if block.line > skipped
            else _after(block.text, block.line, skipped, names, wanted, layout, job.bad)
        )
        if len(cells):
            taker.take(cells, columns, layout)
    return finished(job, taker, layout)


def _after(text: bytes, line: int, skipped: int, names: Sequence[str], wanted: Sequence[str], layout: Layout, bad: BadRows) -> Cells:
    """The first block without the lines before its rows."""
    from testbed.logs.blocks import Block

    for _ in range(skipped - line + 1):
        text = text[text.find(b"\n") + 1 :] if b"\n" in text else b""
    if not text:
        return Cells(np.empty(0, dtype=np.int64), {})
    return parse(Block(text, skipped + 1), names, wanted, layout.delimiter, bad, layout.comment)


def finished(job: Job, taker: ReadsTaker, layout: Layout) -> Contents:
    """The stream of reads, with what is to be said of it. LogError where nothing is left."""
    job.bad.check_share(taker.count + taker.strange, str(job.path))
    reads = taker.table()
    return Contents({"reads": reads}, taker.tags.ids, taker.clock.start or 0.0, taker.notes(reads), layout=layout)
