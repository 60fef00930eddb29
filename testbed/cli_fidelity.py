"""The command `testbed fidelity`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def fidelity(
    folder: Annotated[Path, typer.Argument(help="Output folder of a run: the simulated reads.")],
    log: Annotated[Path, typer.Argument(help="A reader's log: the real ones.")],
    site: Annotated[Path, typer.Option(help="The log's site: antennas, tags, how it is written (YAML).")],
    out: Annotated[Path, typer.Option(help="The page to write.")] = Path("fidelity.html"),
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Compare simulated reads with real ones: gaps, phase noise, RSSI spread, jumps, by quantiles and a distance, as a page."""
    from testbed import cli
    from testbed import fidelity as likeness
    from testbed.archive import StoreError
    from testbed.export.kept import recordings
    from testbed.logs import LogError, load_site, read_log

    try:
        real = read_log(log, load_site(site)).reads
    except LogError as error:
        raise typer.Exit(cli._complain(str(error))) from None
    found = likeness.compare(real, recordings(folder)[0].reads)
    try:
        out.write_text(likeness.page(found, log.name, folder.name), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{out} can't be written: {error.strerror}") from None
    if as_json:
        cli._print_json(likeness.document(found))
        return
    for one in found:
        cli._out().print(f"{one.figure:16} distance {one.distance:.3f}, medians {one.real[2]:.4g} real, {one.simulated[2]:.4g} simulated")
    cli._out().print(f"written to {out}", soft_wrap=True)
