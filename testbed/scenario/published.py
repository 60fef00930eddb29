"""What others have published of the same study: `published`, their tables set beside ours.

    published:
      source: "A. Author, Localization of tags, J. Radio 1 (2012)"
      note: antenna places are not given there and were fitted; trends are reproduced, not the digits
      tables:
        - title: "Table 1. Error of two filters"
          unit: cm
          scale: 100                # one of our units is so many of the table's: metres to centimetres
          metric: position_error_m
          statistic: mean
          cells:
            - {estimator: ekf, at: {"sensors.portal.antennas.count": 2}, paper: 86.18, accept: [80, 95]}
            - {estimator: ekf - ukf, at: {"sensors.portal.antennas.count": 2}, paper: 17.1}

A cell is one figure at one point of the sweep; `metric` and `statistic` may stand at the cell as well. A difference of two
estimators ("ekf - ukf") is taken trial by trial; "ekf > ukf" is the share of trials in which the one's figure is above the other's.
`accept`, in the table's unit, makes an expectation of the cell: a run in which our figure lies outside fails, as under `expect`.
Without it the two figures stand side by side and nothing is judged. A cell whose point the run does not have (a shorter sweep, by
--set) is shown as not run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, model_validator

from testbed.quantity import Config
from testbed.scenario.claims import WORLD, Claim, known, named, subject_of
from testbed.scenario.problems import Loc
from testbed.scenario.source import Review

if TYPE_CHECKING:
    from testbed.scenario.scenario import Point

Text = Annotated[str, Field(min_length=1, max_length=4000)]


class CellModel(Config):
    """One figure of a published table."""

    estimator: Text
    metric: Text | None = None
    statistic: Text | None = None
    at: dict[str, Any] = Field(default_factory=dict)
    paper: float | None = None
    accept: tuple[float, float] | None = None
    note: Annotated[str, Field(max_length=1000)] = ""

    @model_validator(mode="after")
    def _says_something(self) -> CellModel:
        if self.paper is None and self.accept is None:
            raise ValueError("a cell says what the paper has (paper), what is accepted (accept: [low, high]), or both")
        if self.accept is not None and self.accept[0] > self.accept[1]:
            raise ValueError(f"accept is [low, high], and {self.accept[0]:g} is above {self.accept[1]:g}")
        return self


class TableModel(Config):
    """A published table. `metric` and `statistic` are those of cells that name none."""

    title: Text
    unit: Annotated[str, Field(max_length=40)] = ""
    scale: Annotated[float, Field(gt=0, le=1e12)] = 1.0
    metric: Text | None = None
    statistic: Text | None = None
    cells: Annotated[list[CellModel], Field(min_length=1, max_length=2000)]


class PublishedModel(Config):
    """A source, its tables, and what of them can't be reproduced."""

    source: Text
    note: Text
    tables: Annotated[list[TableModel], Field(min_length=1, max_length=100)]


@dataclass(frozen=True)
class Figure:
    """One published figure: what it is called here, at which point of the sweep, and the paper's value in the table's unit.

    point is None where the sweep, which --set may have changed, never takes the values `at`: then there is nothing to compare with.
    """

    point: int | None
    at: dict[str, Any]
    subject: str
    metric: str
    statistic: str
    paper: float | None
    accept: tuple[float, float] | None
    note: str

    @property
    def claim(self) -> Claim:
        """A claim on the same figure, for whoever looks it up. Its bound is never reached."""
        return Claim(self.subject, self.metric, self.statistic, "max", math.inf, point=self.point)


@dataclass(frozen=True)
class PublishedTable:
    """A published table whose cells are found in this scenario."""

    title: str
    unit: str
    scale: float
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Publication:
    """A source with its tables."""

    source: str
    note: str
    tables: tuple[PublishedTable, ...]


def one_is_a_list(value: Any) -> Any:
    """A single publication need not stand in a list."""
    return [value] if isinstance(value, dict) else value


def publications(
    raw: Any, points: Sequence[Point], estimators: Sequence[str], columns: Sequence[str] | None, review: Review
) -> tuple[tuple[Publication, ...], tuple[Claim, ...]]:
    """The section as written (it fits its schema), with its cells' points, and a claim for each bound that a cell wants kept.

    Mistakes are put down.
    """
    models = [PublishedModel.model_validate(one) for one in one_is_a_list(raw) or ()]
    found: list[Publication] = []
    claims: list[Claim] = []
    for i, model in enumerate(models):
        tables: list[PublishedTable] = []
        for j, table in enumerate(model.tables):
            figures: list[Figure] = []
            for k, cell in enumerate(table.cells):
                loc: Loc = ("published", *(() if isinstance(raw, dict) else (i,)), "tables", j, "cells", k)
                figure = _figure(table, cell, points, estimators, columns, loc, review)
                if figure is not None:
                    figures.append(figure)
                if figure is not None and figure.point is not None:
                    claims += _claims(figure, table.scale, review.source.line(loc))
            tables.append(PublishedTable(table.title, table.unit, table.scale, tuple(figures)))
        found.append(Publication(model.source, model.note, tuple(tables)))
    return tuple(found), tuple(claims)


def publications_without(found: Sequence[Publication], estimators: Sequence[str]) -> tuple[Publication, ...]:
    """The publications without the figures of estimators that are left out, and without tables that then have none."""
    kept: list[Publication] = []
    for one in found:
        tables = [replace(t, figures=tuple(f for f in t.figures if set(f.claim.estimators) <= set(estimators))) for t in one.tables]
        tables = [t for t in tables if t.figures]
        kept += [replace(one, tables=tuple(tables))] if tables else []
    return tuple(kept)


def written_without(raw: Any, estimators: Sequence[str]) -> list[Any]:
    """As `publications_without`, for the section as it is written in a document."""
    kept: list[Any] = []
    for one in one_is_a_list(raw) or ():
        tables = [{**t, "cells": [c for c in t["cells"] if set(named(c["estimator"])) <= {*estimators, WORLD}]} for t in one["tables"]]
        tables = [t for t in tables if t["cells"]]
        kept += [{**one, "tables": tables}] if tables else []
    return kept


def _figure(
    table: TableModel,
    cell: CellModel,
    points: Sequence[Point],
    estimators: Sequence[str],
    columns: Sequence[str] | None,
    loc: Loc,
    review: Review,
) -> Figure | None:
    before = len(review.problems)
    name = subject_of(cell.estimator, estimators, (*loc, "estimator"), review)
    metric, statistic = cell.metric or table.metric, (cell.statistic if cell.metric else cell.statistic or table.statistic) or ""
    if metric is None:
        review.note(loc, "which figure is meant? Give the cell or its table a metric, as in metric: position_error_m")
    elif columns is not None and name != WORLD:  # what the world offers is no metric's
        known(metric, statistic, columns, loc, review)
    point = _point(cell.at, points, loc, review)
    if metric is None or len(review.problems) > before:
        return None
    return Figure(point, dict(cell.at), name, metric, statistic, cell.paper, cell.accept, cell.note)


def _point(at: dict[str, Any], points: Sequence[Point], loc: Loc, review: Review) -> int | None:
    """The one point that sets what `at` says, None where there is none."""
    swept = list(points[0].set) if points else []
    for path in at:
        if path not in swept:
            review.note((*loc, "at", path), f"the sweep does not set {path}; it sets {', '.join(swept) or 'nothing'}", at_key=True)
            return None
    fitting = [point for point in points if all(point.set[path] == value for path, value in at.items())]
    if len(fitting) == 1:
        return fitting[0].index
    if fitting:
        open_paths = [path for path in swept if path not in at]
        review.note(loc, f"fits {len(fitting)} points of the sweep: say at which {' and '.join(open_paths)}, as in at: {{...}}")
    return None


def _claims(figure: Figure, scale: float, line: int | None) -> list[Claim]:
    if figure.accept is None:
        return []
    low, high = (float(bound) / scale for bound in figure.accept)
    what = (figure.subject, figure.metric, figure.statistic)
    return [Claim(*what, "min", low, line, figure.point), Claim(*what, "max", high, line, figure.point)]
