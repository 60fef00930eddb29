"""Samples of other kinds than reads (ranges, odometry, true places), put into the order of time with the same bound on lateness."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.columns import Array
from testbed.logs.bad import BadRows
from testbed.logs.contents import Path3
from testbed.logs.order import Order
from testbed.logs.site import LogModel

FAR_M = 1e6


def ordered(line: Array, t: Array, columns: Mapping[str, Array], log: LogModel, bad: BadRows) -> dict[str, Array]:
    """Columns with t and t_arrival, by time; rows that come too late are put down."""
    keep, arrival = Order(log.lateness_s, log.longest_gap_s, bad).take(line, t)
    order = np.flatnonzero(keep)[np.argsort(t[keep], kind="stable")]
    return {"t": t[order], "t_arrival": arrival[order], **{name: column[order] for name, column in columns.items()}}


def path_of(t: Array, position: Array) -> Path3:
    """True places in the order of time, one a time."""
    order = np.argsort(t, kind="stable")
    t, position = t[order], position[order]
    first = np.ones(len(t), dtype=bool)
    first[1:] = np.diff(t) > 0
    return Path3(t[first], position[first])


def refuse(line: Array, good: Array, wrong: Array, what: str, cells: Array, bad: BadRows) -> None:
    """Put down rows that are wrong, once each; `good` is changed."""
    new = np.flatnonzero(good & wrong)
    if len(new):
        bad.add(line[new], what, np.asarray(cells, dtype=object)[new])
        good[new] = False
