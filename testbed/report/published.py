"""Published tables beside ours, for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from testbed.published import Beside, ComparedTable, Comparison, compare
from testbed.report.amounts import NOTHING, number
from testbed.report.grids import Cell, Grid, Head, mean_cell
from testbed.report.study import Study


@dataclass(frozen=True)
class PublishedShown:
    """One source: who it is, what is fitted or not reproduced, and its tables."""

    source: str
    note: str
    grids: tuple[Grid, ...]


def published(study: Study) -> list[PublishedShown]:
    """What the scenario sets beside its results; empty where it names nothing, or can't be built any more."""
    if study.scenario is None:
        return []
    return [_shown(one, study) for one in compare(study.scenario.published, study.rows, study.stimuli)]


def _shown(one: Comparison, study: Study) -> PublishedShown:
    return PublishedShown(one.publication.source, one.publication.note, tuple(_grid(table, study) for table in one.tables))


def _grid(compared: ComparedTable, study: Study) -> Grid:
    """A row a cell of the table, in the table's order."""
    unit = compared.table.unit
    paths = list(dict.fromkeys(path for cell in compared.cells for path in _set(cell, study)))
    judged, noted = any(c.figure.accept for c in compared.cells), any(c.note for c in compared.cells)
    heads = [Head("", number=False), *(Head(path.rpartition(".")[2], path) for path in paths)]
    heads += [Head("paper", unit), Head("ours ± standard error", unit), Head("trials")]
    heads += [Head("accepted", unit)] if judged else []
    heads += [Head("", number=False)] if noted else []
    rows = tuple(_row(cell, study, paths, judged, noted) for cell in compared.cells)
    return Grid(_caption(compared, judged), tuple(heads), rows)


def _set(cell: Beside, study: Study) -> Mapping[str, Any]:
    """What the sweep sets at a cell's point."""
    return cell.figure.at if cell.figure.point is None else study.sets[cell.figure.point]


def _caption(compared: ComparedTable, judged: bool) -> str:
    said = f"{compared.table.title}; ours is the mean over trials ± standard error, under it the 95 % interval"
    banded = [c for c in compared.cells if c.inside is not None]
    return f"{said}; {sum(bool(c.inside) for c in banded)} of {len(banded)} inside the accepted band" if judged else said


def _row(cell: Beside, study: Study, paths: Sequence[str], judged: bool, noted: bool) -> tuple[Cell, ...]:
    figure, swept = cell.figure, _set(cell, study)
    what = figure.claim.column
    paper = NOTHING if figure.paper is None else _plain(figure.paper)
    row = [Cell(figure.subject, (what,)), *(Cell(str(swept.get(path, NOTHING))) for path in paths)]
    row += [Cell(paper), mean_cell(cell.ours), Cell(f"{cell.ours.n:,}")]
    if judged:
        row.append(_accepted(cell))
    return (*row, Cell(cell.note)) if noted else tuple(row)


def _accepted(cell: Beside) -> Cell:
    if cell.figure.accept is None or cell.inside is None:
        return Cell(NOTHING)
    low, high = cell.figure.accept
    mark = ("good", "✓ inside") if cell.inside else ("bad", "✗ outside")
    return Cell(mark[1], (f"{_plain(low)} to {_plain(high)}",), mark[0])


def _plain(value: float) -> str:
    """A number as the paper prints it, to ten digits."""
    return number(value) if not math.isfinite(value) else f"{value:.10g}".replace("-", "−")
