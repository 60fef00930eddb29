"""The command `testbed export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run, or of one recording in it.")],
    to: Annotated[str, typer.Option(metavar="FORMAT", help="itemtest, sllurp, tum, epcis, mcap, rerun or parquet.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the files; RUN/export where left out.")] = None,
    point: Annotated[int | None, typer.Option(help="This point of the sweep only, from 0.")] = None,
    trial: Annotated[int | None, typer.Option(help="This trial only, from 0.")] = None,
) -> None:
    """Write the recordings of a run in the formats of others: reader logs, trajectories, events at gates, MCAP, Rerun, Parquet."""
    from testbed import cli
    from testbed.export.run import export as written

    try:
        for path in written(folder, to, out or folder / "export", point, trial):
            cli._out().print(str(path), soft_wrap=True)
    except (ValueError, ImportError) as error:
        raise typer.Exit(cli._complain(str(error))) from None
