"""A published table beside ours: every cell of a scenario's `published` with the figure of this run, in the table's own unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.evaluate import Interval, Rows, figure_of, mean_interval, plain
from testbed.scenario import Figure, Publication, PublishedTable


@dataclass(frozen=True)
class Beside:
    """A published figure and ours.

    ours   : mean over trials, its standard error and 95 % interval, in the table's unit; NaN where the run has no such figure
    inside : whether ours lies in the accepted band (of a difference, its whole 95 % interval), None where no band is given
    note   : the cell's own, or why there is no figure
    """

    figure: Figure
    ours: Interval
    inside: bool | None
    note: str


@dataclass(frozen=True)
class ComparedTable:
    """A published table with ours beside it, cell by cell."""

    table: PublishedTable
    cells: tuple[Beside, ...]


@dataclass(frozen=True)
class Comparison:
    """A publication with all of its tables compared."""

    publication: Publication
    tables: tuple[ComparedTable, ...]


def compare(publications: Sequence[Publication], rows: Rows, world: Rows) -> tuple[Comparison, ...]:
    """The publications of a scenario (`Scenario.published`) beside the results of a run of it."""
    return tuple(
        Comparison(one, tuple(ComparedTable(t, tuple(_beside(f, t.scale, rows, world) for f in t.figures)) for t in one.tables))
        for one in publications
    )


def _beside(figure: Figure, scale: float, rows: Rows, world: Rows) -> Beside:
    claim = figure.claim
    if figure.point is None:
        return Beside(figure, mean_interval(np.empty(0)), None, "not run: the sweep has no such point")
    found, missing = figure_of(claim, rows, world, figure.point)
    ours = Interval(found.mean * scale, found.se * scale, found.low * scale, found.high * scale, found.n)
    inside = None
    if figure.accept is not None:
        low, high = (ours.low, ours.high) if claim.is_difference else (ours.mean, ours.mean)
        inside = bool(figure.accept[0] <= low and high <= figure.accept[1])
    return Beside(figure, ours, inside, figure.note or missing)


def document(compared: Sequence[Comparison], sets: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """As `testbed run --json` prints it under "published"; `sets` is what the sweep sets at each point."""
    return [
        {
            "source": one.publication.source,
            "note": one.publication.note,
            "tables": [
                {"title": t.table.title, "unit": t.table.unit, "cells": [_cell(cell, sets) for cell in t.cells]} for t in one.tables
            ],
        }
        for one in compared
    ]


def _cell(cell: Beside, sets: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    figure = cell.figure
    swept = figure.at if figure.point is None else sets[figure.point]
    out: dict[str, Any] = {"estimator": figure.subject, "metric": figure.metric, "statistic": figure.statistic, "set": dict(swept)}
    out |= {"paper": figure.paper, "ours": plain(cell.ours.mean), "se": plain(cell.ours.se), "n": cell.ours.n}
    if figure.accept is not None:
        out |= {"accept": list(figure.accept), "inside": cell.inside}
    return {**out, "note": cell.note} if cell.note else out
