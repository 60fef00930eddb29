"""Pages over many runs: the leaderboard, and runs compared. One file each, without scripts, that asks nobody for anything."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from testbed.archive import StoreError
from testbed.compare import SURE, Pair, Side
from testbed.leaderboard import Board, Entry, Place
from testbed.report import figures_board
from testbed.report.amounts import NOTHING, capital, counted, interval, listed, number, seconds
from testbed.report.figures import Drawing, Styles
from testbed.report.figures_run import spelled
from testbed.report.grids import Cell, Grid, Head, mean_cell


@dataclass(frozen=True)
class Section:
    """A part of a page."""

    id: str
    heading: str
    grids: tuple[Grid, ...] = ()
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True)
class Page:
    """A page before it is markup."""

    title: str
    summary: str
    sections: tuple[Section, ...]
    notes: tuple[str, ...]

    def html(self) -> str:
        """The page as one file."""
        template = resources.files("testbed.report") / "template"
        source, style = ((template / name).read_text(encoding="utf-8") for name in ("board.html", "report.css"))
        environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
        return environment.from_string(source).render(page=self, style=style)

    def write(self, path: Path) -> Path:
        """The page as a file, whole or not at all. StoreError where the disk refuses."""
        rough = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            rough.write_text(self.html(), encoding="utf-8")
            rough.replace(path)
        except OSError as error:
            rough.unlink(missing_ok=True)
            raise StoreError(f"the page can't be written to {path}: {error.strerror or error}") from error
        return path


# ---------------------------------------------------------------- the leaderboard


def leaderboard(board: Board) -> Page:
    """Who leads where, in tables and figures."""
    styles = Styles(board.estimators)
    cost = figures_board.pareto(board, styles, "pareto")
    sections = [
        Section("overall", "Over all", (overall(board),)),
        Section("errors", "Errors", (), (figures_board.errors(board, styles, "errors"),)),
        *([Section("cost", "Error and time", (), (cost,))] if cost else []),
        Section("places", "Every scenario", tuple(of_place(board, place) for place in board.places)),
    ]
    notes = [
        "A trial is the unit; intervals are 95 % confidence intervals of the mean by Student's t. An estimator leads where no other is "
        f"shown to have the lower mean on the same trials (p after Holm over the whole board at least {SURE:g}).",
        "Errors are of trials with a value: read them beside the trials that crashed and the rows without one.",
        "Wall times are of the machine that made them, at that time.",
    ]
    if any(p.has_bound for p in board.places):
        notes.append(
            "The bound is the posterior Cramér-Rao bound on the root mean square error, of the model that the scenario names, for methods "
            "that go forward: one that looks back, or knows more than the model, may be below it."
        )
    return Page("Leaderboard", _summary(board), tuple(sections), (*notes, *(capital(n) + "." for n in board.notes)))


def _summary(board: Board) -> str:
    first = board.overall()[0]
    where = counted(len(board.places), "scenario")
    text = f"{capital(where)}, {counted(len(board.estimators), 'estimator')}, by {spelled(board.column)}."
    if math.isfinite(first[3]):
        text += (
            f" {first[0]} leads in {first[2]} of {counted(first[1], 'scenario')}, with {number(first[3])} times the least error on average."
        )
    return text


def overall(board: Board) -> Grid:
    """An estimator a row."""
    heads = (Head("estimator", number=False), Head("scenarios"), Head("leads in"), Head("error by the least one", "geometric mean"))
    rows = tuple((Cell(id), Cell(str(n)), Cell(str(led)), Cell(number(ratio))) for id, n, led, ratio in board.overall())
    return Grid("Estimators over all scenarios: how often they lead, and how many times the least error theirs is", heads, rows)


def of_place(board: Board, place: Place) -> Grid:
    """One scenario: an estimator a row, the least error first."""
    heads = [Head("estimator", number=False), Head(spelled(board.column), "± standard error, 95 % interval")]
    heads += [Head("rms error (m)")] if place.has_bound else []
    heads += [Head("p against the leader", "after Holm"), Head("wall time per update"), Head("trials"), Head("crashed"), Head("no value")]
    rows = tuple(_entry(e, place.has_bound) for e in place.entries)
    bound = f"; no error below {number(place.bound.mean, place.bound.se)} m rms is possible for its model" if place.has_bound else ""
    return Grid(f"{place.label}{bound}", tuple(heads), rows)


def _entry(e: Entry, bounded: bool) -> tuple[Cell, ...]:
    cells = [Cell(f"{e.estimator} ✓ leads" if e.leads else e.estimator, (), "good" if e.leads else ""), mean_cell(e.error)]
    cells += [Cell(number(e.rms.mean, e.rms.se))] if bounded else []
    cost = seconds(e.cost.mean) + (" (front)" if e.front else "")
    return (*cells, _p(e.p), Cell(cost), Cell(f"{e.error.n:,}"), _count(e.failed), _count(e.empty))


def _p(p: float) -> Cell:
    return Cell(NOTHING if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}")


def _count(n: int) -> Cell:
    return Cell(f"{n:,}", (), "bad" if n else "")


# ---------------------------------------------------------------- runs compared


def compared(pairs: Sequence[Pair], runs: Sequence[str]) -> Page:
    """Pairs in a table, with their distributions."""
    shown = [p for p in pairs if p.p_holm < SURE]
    spread = figures_board.distributions(pairs, "distributions")
    sections = (
        Section("differences", "Differences", (differences(pairs),), (figures_board.differences(pairs, "differences"),)),
        Section("sides", "Each by itself", (sides(pairs),), (spread,) if spread else ()),
    )
    summary = f"{capital(counted(len(pairs), 'pair'))} of {listed(list(runs))}: a difference is shown in {len(shown)}."
    notes = (
        "What is compared are the same trials (and targets) on both sides; of runs with different seeds these are independent.",
        f"A difference is called shown where p, after Holm over all pairs here, is below {SURE:g}. Intervals hold each for itself.",
        "d is the mean difference by the standard deviation of the differences; the share is of trials with the left above the right.",
        "Trials that crashed and rows without a value are counted for each side; errors are of the others.",
    )
    return Page("Runs compared", summary, sections, notes)


def differences(pairs: Sequence[Pair]) -> Grid:
    """A pair a row."""
    heads = (
        Head("left − right", number=False),
        Head("of", number=False),
        Head("difference", "± standard error, 95 % interval"),
        Head("effect d"),
        Head("left above", "% of trials"),
        Head("p", "after Holm"),
        Head("trials"),
        Head("conclusion", number=False),
    )
    return Grid("Mean differences on the same trials", heads, tuple(_pair(p) for p in pairs))


def _pair(p: Pair) -> tuple[Cell, ...]:
    verdict = Cell(p.verdict, (), "good" if p.p_holm < SURE else "")
    share = number(100 * p.above.mean) if p.above.n else NOTHING
    names = Cell(f"{p.left.label} − {p.right.label}", (p.at,) if p.at else ())
    return (
        names,
        Cell(spelled(p.column)),
        mean_cell(p.difference),
        Cell(number(p.d)),
        Cell(share),
        _p(p.p_holm),
        Cell(f"{p.difference.n:,}"),
        verdict,
    )


def sides(pairs: Sequence[Pair]) -> Grid:
    """A side a row: its mean, its quantiles over trials, and what is not among them."""
    found: dict[tuple[str, str, str], Side] = {}
    for pair in pairs:
        for side in (pair.left, pair.right):
            found.setdefault((pair.at, pair.column, side.label), side)
    heads = [Head("", number=False), Head("of", number=False), Head("mean", "95 % interval")]
    heads += [Head(text) for text in ("p5", "p25", "median", "p75", "p95", "largest", "trials", "crashed", "no value")]
    rows = []
    for (at, column, label), side in found.items():
        spread = [Cell(number(v, side.mean.se)) for v in side.quantiles]
        mean = Cell(number(side.mean.mean, side.mean.se), (interval(side.mean),))
        counts = (Cell(f"{side.mean.n:,}"), _count(side.failed), _count(side.empty))
        rows.append((Cell(label, (at,) if at else ()), Cell(spelled(column)), mean, *spread, *counts))
    return Grid("Each side by itself: values of trials, crashes apart", tuple(heads), tuple(rows))
