"""The command `testbed calibrate`: a model by its name (`testbed.calibrate.MODELS`), fitted to what SOURCE measures."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from testbed.calibrate import Calibration

DOCUMENT, MEASURED = "calibration.json", "measured.parquet"


def calibrate(
    source: Annotated[
        str, typer.Argument(help="What makes the measurements: a scenario (a file, or a name that ships), or a reader's log.")
    ],
    model: Annotated[
        str | None,
        typer.Option(help="logistic_beta: detections over distance and angle; reader_log (with --site): levels, noise, flips, pace."),
    ] = None,
    site: Annotated[Path | None, typer.Option(help="SOURCE is a log: antennas, tags at known places, how it is written (YAML).")] = None,
    truth: Annotated[Path | None, typer.Option(help="True paths of the site's targets, for a log.")] = None,
    ways: Annotated[
        int | None, typer.Option(min=1, max=2, help="Slope of path loss, fixed by physics: 1 way (2, a beacon) or 2 (4, backscatter).")
    ] = None,
    profile: Annotated[str | None, typer.Option(help="The reader of a log: r420, fx7500, sargas.")] = None,
    trials: Annotated[int | None, typer.Option(help="Trials to run, in place of the scenario's number.")] = None,
    seed: Annotated[int | None, typer.Option(help="Root of all randomness, in place of the scenario's.")] = None,
    block: Annotated[float, typer.Option(metavar="S", help="Counts are put together over so long, s.")] = 1.0,
    sets: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Set a value of the scenario; may come several times.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the fit, what was measured and figures into this folder.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the calibration that is in --out.")] = False,
) -> None:
    """Fit a model of what readers hear to measurements at known places, and say how well it foretells what was held out."""
    from testbed import cli
    from testbed.archive import StoreError
    from testbed.calibrate import CalibrationError, Request
    from testbed.calibrate import model as named
    from testbed.progress import choose

    if out is not None and (out / DOCUMENT).exists() and not force:
        raise StoreError(f"{out} holds a calibration already: replace it with --force, or use another folder")
    if not 0.01 <= block <= 3600:
        raise typer.Exit(cli._complain(f"--block takes seconds from 0.01 to 3600, not {block:g}"))
    try:
        fit = named(model or ("logistic_beta" if site is None else "reader_log"))
        of_log = (None if site is None else str(site), None if truth is None else str(truth), ways, profile)
        found = fit(
            Request(source, trials, seed, tuple(sets or ()), block, choose(sys.stderr, of="trials" if site is None else "kB"), *of_log)
        )
    except CalibrationError as error:
        raise typer.Exit(cli._complain(str(error))) from None
    if out is not None:
        write(found, out)
    if as_json:
        cli._print_json(found.document())
        return
    found.show(cli._out())
    if out is not None:
        cli._out().print(f"written to {out}", soft_wrap=True)


def write(found: Calibration, folder: Path) -> None:
    """calibration.json, measured.parquet, the figures as SVG, and the model's own files. StoreError where the disk refuses."""
    from testbed import tables
    from testbed.archive import StoreError
    from testbed.calibrate import Files
    from testbed.coverage.output import standalone

    table, units = found.measured()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tables.write_table(tables.frame({name: getattr(table, name) for name in table.column_names()}, units), folder / MEASURED)
        for name, text in (found.files() if isinstance(found, Files) else {}).items():
            (folder / name).write_text(text, encoding="utf-8")
        for one in found.drawings():
            (folder / f"{one.name}.svg").write_text(standalone(one), encoding="utf-8")
        (folder / DOCUMENT).write_text(json.dumps(found.document(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise StoreError(f"the calibration can't be written to {folder}: {error.strerror or error}") from error
