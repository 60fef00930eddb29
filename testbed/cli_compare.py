"""The commands `testbed compare` and `testbed leaderboard`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from testbed.report.grids import Grid

Metrics = Annotated[
    list[str] | None,
    typer.Option("--metric", metavar="COLUMN", help="Compare this figure; may come several times.", show_default="position_error_m.mean"),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Output folders of finished runs.")],
    by: Annotated[
        str, typer.Option(help="run: each other run with the first. estimator: those of a run.", show_default="by runs, if two")
    ] = "",
    metric: Metrics = None,
    estimator: Annotated[list[str] | None, typer.Option(help="Only this estimator; may come several times.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page with figures as well.")] = None,
    as_json: Json = False,
) -> None:
    """Compare runs, or estimators, on the same trials: differences, how large, how sure, over how many; crashes apart from errors."""
    from testbed import cli
    from testbed.compare import CompareError, read_runs
    from testbed.compare import compare as compared
    from testbed.report import board

    how = by or ("run" if len(runs) > 1 else "estimator")
    if how not in ("run", "estimator"):
        raise typer.Exit(cli._complain(f"--by takes run or estimator, not {by!r}"))
    try:
        found = read_runs(runs)
        pairs = compared(found, how, metric or (), estimator or ())
    except CompareError as error:
        raise typer.Exit(cli._complain(str(error))) from None
    if html:
        board.compared(pairs, [run.label for run in found]).write(html)
    if as_json:
        cli._print_json({"by": how, "runs": [str(run.folder) for run in found], "pairs": [pair.document() for pair in pairs]})
        return
    _show(cli._out(), board.differences(pairs))
    _show(cli._out(), board.sides(pairs))
    if html:
        cli._out().print(f"written to {html}", soft_wrap=True)


def leaderboard(
    folder: Annotated[Path, typer.Argument(help="A folder with finished runs in it, at any depth to four.")],
    metric: Annotated[str, typer.Option(help="Rank by this figure; lower is better.")] = "position_error_m.mean",
    html: Annotated[Path | None, typer.Option(help="The page.", show_default="FOLDER/leaderboard.html")] = None,
    as_json: Json = False,
) -> None:
    """Rank estimators over all runs in a folder: a table, and a page with small multiples, error against time, and bounds."""
    from testbed import cli
    from testbed import leaderboard as ranking
    from testbed.report import board

    found = ranking.read(folder, metric)
    page = board.leaderboard(found).write(html or folder / "leaderboard.html")
    if as_json:
        cli._print_json(found.document())
        return
    for place in found.places:
        _show(cli._out(), board.of_place(found, place))
    _show(cli._out(), board.overall(found))
    for note in found.notes:
        cli._out().print(note, soft_wrap=True)
    cli._out().print(f"written to {page}", soft_wrap=True)


def _show(console: Console, grid: Grid) -> None:
    """A grid of the report as a table on the terminal: what stands under a cell stands in brackets behind it."""
    table = Table(title=grid.caption, title_justify="left")
    for head in grid.heads:
        table.add_column(head.text + (f"\n{head.under}" if head.under else ""), justify="right" if head.number else "left")
    for row in grid.rows:
        table.add_row(*(cell.text + (f" ({'; '.join(cell.under)})" if cell.under else "") for cell in row))
    console.print(table)
