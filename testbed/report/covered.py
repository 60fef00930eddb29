"""The coverage of a run's site as its report shows it, where the scenario asks for it: `report: {coverage: {height_m: [1.0]}}`.

Made from the scenario alone, which says where everything stands; of a sweep, its first point is shown.
"""

from __future__ import annotations

from dataclasses import dataclass

from testbed.coverage import DEAD, HEARD, CoverageError, covered
from testbed.coverage.output import HEADS, LEFT_OUT, rows
from testbed.report.figures import Drawing
from testbed.report.figures_coverage import coverage_maps
from testbed.report.grids import Cell, Grid, Head
from testbed.report.study import GONE, Study
from testbed.simulate import Simulator


@dataclass(frozen=True)
class Site:
    """What the page shows of it: shares of the floor, what is to be said, and the maps."""

    grid: Grid | None
    notes: tuple[str, ...]
    drawings: tuple[Drawing, ...] = ()


def site(study: Study) -> Site | None:
    """The coverage that the scenario asks for; None where it asks for none. What can't be had any more is told in a note."""
    if study.scenario is None:
        return None
    scenario = study.scenario.points()[0].scenario
    asked = scenario.report.coverage
    if asked is None:
        return None
    try:
        with Simulator(scenario) as simulator:
            found = covered(simulator, step_m=asked.step_m, height_m=asked.height_m, tag=asked.tag, sensors=asked.sensors)
            drawings = coverage_maps(found, simulator.scene, simulator.at_rest().truth)
    except (*GONE, CoverageError, ImportError) as error:
        return Site(None, (f"The maps can't be made on this machine: {error}",))
    label = study.label(0)
    told = (
        f"An antenna reads a point where a visit does so with {100 * HEARD:.0f} % or more; a point is dead where one visit of every "
        f"antenna together reads a tag with less than {100 * DEAD:.0f} %.{f' This is the site at {label}.' if label else ''}",
        " ".join(LEFT_OUT),
    )
    heads = (Head(HEADS[0], number=False), *map(Head, HEADS[1:]))
    grid = Grid("Share of the floor that is read", heads, tuple(tuple(map(Cell, row)) for row in rows(found)))
    return Site(grid, told, drawings)
