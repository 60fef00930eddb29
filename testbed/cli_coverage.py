"""The command `testbed coverage`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def coverage(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a scenario that ships.")],
    step: Annotated[float, typer.Option(help="Width of a cell of the grid, m.")] = 0.25,
    height: Annotated[
        list[float] | None, typer.Option(help="Height above the floor, m; may come several times.", show_default="1.0")
    ] = None,
    tag: Annotated[str, typer.Option(metavar="MODEL", help="The tag that is asked for; it is taken as the same all round.")] = "monza_4",
    sensor: Annotated[list[str] | None, typer.Option(metavar="ID", help="This rfid sensor only; may come several times.")] = None,
    sets: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Set a value of the scenario; may come several times.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; runs/NAME-coverage where left out, or runs/NAME-coverage-2, ...")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the coverage that is in --out.")] = False,
) -> None:
    """Map where a site's readers hear a tag, and its dead zones: a page with pictures over the plan, Parquet, and shares of the floor.

    Nothing is simulated: moving bodies stand where the scenario starts them, and fades are taken by their probability.
    """
    from testbed import cli
    from testbed.api import scenario_of
    from testbed.coverage import CoverageError, covered
    from testbed.coverage import output as coverage_output
    from testbed.progress import choose
    from testbed.report.figures_coverage import coverage_maps
    from testbed.simulate import Simulator

    loaded = scenario_of(scenario, sets=sets or ())
    folder = cli._folder(out, f"{loaded.name}-coverage", several=False)
    coverage_output.check(folder, force)  # before the work, not after it
    try:
        with Simulator(loaded) as simulator:
            progress = choose(sys.stderr, of="links")
            found = covered(simulator, step_m=step, height_m=height or [1.0], tag=tag, sensors=sensor or (), progress=progress)
            drawings = coverage_maps(found, simulator.scene, simulator.at_rest().truth)
    except CoverageError as error:
        raise typer.Exit(cli._complain(str(error))) from None
    coverage_output.write(found, drawings, folder, force)
    if as_json:
        cli._print_json(coverage_output.document(found))
    else:
        coverage_output.show(cli._out(), found)
        cli._out().print(f"written to {folder}: open {folder / coverage_output.PAGE}", soft_wrap=True)
