"""A log file to streams: the entry of this package."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from testbed.columns import Array, Table
from testbed.logs.bad import BadRows, LogError
from testbed.logs.contents import Contents, Job, Path3
from testbed.logs.registry import format_of
from testbed.logs.site import SiteModel
from testbed.progress import Progress
from testbed.types import Reads


@dataclass(frozen=True)
class Log:
    """A log as data.

    streams  : by kind ("reads", "ranges", "odometry"), t from the log's start; tags : ids that `Reads.tag` indexes
    duration : s, to the last row. start_s : of the log's own clock. truth : true paths by target, of formats that hold them
    """

    path: Path
    streams: dict[str, Table]
    tags: list[str]
    duration: float
    start_s: float
    bad: BadRows
    notes: list[str] = field(default_factory=list)
    truth: dict[str, Path3] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Good rows of all streams."""
        return sum(len(stream) for stream in self.streams.values())

    @property
    def reads(self) -> Reads:
        """The stream of reads, empty where there is none."""
        found = self.streams.get("reads")
        return found if isinstance(found, Reads) else Reads.empty()


def read_log(path: str | Path, site: SiteModel, progress: Progress | None = None) -> Log:
    """Read a log as `site.log` declares it.

    The text is read in blocks of 4 MiB; what stays in memory are the columns, about 50 bytes a read.
    LogError, in one sentence, for a file that can't be read, contradicts its declaration, or holds no row.
    """
    path, bad = Path(path), BadRows()
    contents: Contents = format_of(site.log.kind).read(Job(path, site, bad, progress))
    if not any(len(stream) for stream in contents.streams.values()):
        said = bad.summary() or "; ".join(contents.notes)
        raise LogError(f"{path}: no row can be used{': ' + said if said else ''}")
    return Log(path, contents.streams, contents.tags, _last(contents), contents.start_s, bad, contents.notes, contents.truth)


def _last(contents: Contents) -> float:
    times: list[Array] = [np.asarray(t) for s in contents.streams.values() if (t := getattr(s, "t", None)) is not None and len(s)]
    return float(max(t.max() for t in times))
