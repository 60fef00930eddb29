"""What a coverage leaves behind: a table for people, a JSON document, Parquet, figures and one page that holds them all.

coverage.parquet   a row per point of the floor and antenna within reach of it
points.parquet     a row per point, those inside of things too: over all antennas
coverage.json      shares of the floor, dead zones
coverage.html      the page; *.svg its figures, each by itself
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from jinja2 import Environment, StrictUndefined
from rich.console import Console
from rich.table import Table

from testbed import tables
from testbed.archive import StoreError
from testbed.coverage.maps import COUNTED, DEAD, HEARD, Coverage, DeadZone

if TYPE_CHECKING:
    from testbed.report.figures import Drawing

LINKS, POINTS, DOCUMENT, PAGE = "coverage.parquet", "points.parquet", "coverage.json", "coverage.html"
MOST_ZONES = 5  # named in the table and on the page, of each height; all are in the document
UNITS = {
    "x_m": "m", "y_m": "m", "z_m": "m", "rssi_dbm": "dBm", "distance_m": "m", "loss_db": "dB", "line_of_sight": "share of the Fresnel zone",
}  # fmt: skip
SHAPED = re.compile(r"var\(--[a-z]+, (#[0-9A-Fa-f]{6})\)")  # a colour that a page may change
LEFT_OUT = (
    "The tag has its model's gain in every direction: how it hangs, and what it is stuck on, is left out.",
    "Tags don't compete for the reader's time, and no session or Select silences one: a crowd is read less often than one tag.",
    "Moving bodies stand where the scenario starts them.",
    "Fades of different antennas are taken as independent of each other; within about a wavelength a point stands for its surroundings.",
    "A point between the goods of a rack counts as floor; one inside of something does not.",
)


# ---------------------------------------------------------------- figures of it


def document(found: Coverage) -> dict[str, Any]:
    """The summary as JSON: for each height and for all of them together; null where there is no floor."""
    shares, floor = found.shares(), np.sum(~found.inside, axis=(1, 2))
    heights = [_height(found, k, shares[k]) for k in range(len(found.z))]
    total = [_plain((shares[:, i][floor > 0] * floor[floor > 0]).sum() / max(floor.sum(), 1)) if floor.sum() else None for i in range(3)]
    return {
        "scenario": found.scenario,
        "tag": found.tag,
        "step_m": found.step_m,
        "antennas": {str(id): str(sensor) for id, sensor in zip(found.antenna, found.sensor, strict=True)},
        "read_by_antenna_at": HEARD,
        "dead_below": DEAD,
        "share_read_by": {str(n): share for n, share in zip(COUNTED, total, strict=True)},
        "heights": heights,
    }


def _height(found: Coverage, k: int, shares: Any) -> dict[str, Any]:
    floor, cell = ~found.inside[k], found.step_m**2
    levels = found.level[k][floor & ~found.dead[k]]
    levels = levels[np.isfinite(levels)]
    return {
        "height_m": float(found.z[k]),
        "floor_m2": float(floor.sum() * cell),
        "inside_m2": float(found.inside[k].sum() * cell),
        "share_read_by": {str(n): _plain(share) for n, share in zip(COUNTED, shares, strict=True)},
        "dead_share": _plain(found.dead[k].sum() / floor.sum()) if floor.any() else None,
        "dead_m2": float(found.dead[k].sum() * cell),
        "rssi_dbm": {f"p{q}": _plain(np.percentile(levels, q)) if len(levels) else None for q in (5, 50, 95)},
        "dead_zones": [
            {"area_m2": z.area_m2, "center_m": list(z.center_m), "bounds_m": [list(corner) for corner in z.bounds_m]}
            for z in found.dead_zones(k)
        ],
    }


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def links(found: Coverage) -> pa.Table:
    """A row per point and antenna within reach of it: where, which, and what is told of it. Other pairs are never read."""
    k, j, i, antenna = np.nonzero(np.isfinite(found.distance))
    at = (k, j, i, antenna)
    columns = {
        "x_m": found.x[i], "y_m": found.y[j], "z_m": found.z[k], "antenna": found.antenna[antenna], "sensor": found.sensor[antenna],
        "probability": found.probability[at], "rssi_dbm": found.rssi[at], "line_of_sight": found.clear[at],
        "loss_db": found.loss[at], "distance_m": found.distance[at],
    }  # fmt: skip
    return tables.frame(columns, UNITS)


def points(found: Coverage) -> pa.Table:
    """A row per point: whether it is inside of something, and what all antennas make of it together."""
    z, y, x = np.meshgrid(found.z, found.y, found.x, indexing="ij")
    columns = {
        "x_m": x, "y_m": y, "z_m": z, "inside": found.inside, "probability": found.read, "antennas": found.antennas,
        "rssi_dbm": found.level, "dead": found.dead,
    }  # fmt: skip
    return tables.frame({name: values.ravel() for name, values in columns.items()}, UNITS)


# ---------------------------------------------------------------- files


def check(folder: Path, force: bool) -> None:
    """StoreError where a coverage can't be written: in place of another one without `force`, or among other files."""
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"{folder} is a file: choose another folder for the coverage")
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not (folder / DOCUMENT).exists():
        raise StoreError(f"{folder} is not empty and holds no coverage: choose another folder")
    if not force:
        raise StoreError(f"{folder} holds a coverage already: replace it with --force, or use another folder")


def write(found: Coverage, drawings: Sequence[Drawing], folder: Path, force: bool = False) -> None:
    """All files into `folder`; of a coverage that is replaced none is left. StoreError where the disk refuses."""
    check(folder, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in (LINKS, POINTS, DOCUMENT, PAGE, *(path.name for path in folder.glob("coverage-*.svg"))):
            (folder / old).unlink(missing_ok=True)
        tables.write_table(links(found), folder / LINKS)
        tables.write_table(points(found), folder / POINTS)
        for one in drawings:
            (folder / f"{one.name}.svg").write_text(standalone(one), encoding="utf-8")
        (folder / PAGE).write_text(page(found, drawings), encoding="utf-8")
        rough = folder / f".{DOCUMENT}.{os.getpid()}.part"  # last, and at once: it says that the others are there
        rough.write_text(json.dumps(document(found), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        rough.replace(folder / DOCUMENT)
    except OSError as error:
        raise StoreError(f"the coverage can't be written to {folder}: {error.strerror or error}") from error


def standalone(drawing: Drawing) -> str:
    """A figure as an SVG file of its own, in the colours of a light page."""
    size = f'width="{drawing.width:g}pt" height="{drawing.height:g}pt"'
    spaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    size = f'{spaces} {size} font-family="DejaVu Sans, sans-serif"'
    svg = SHAPED.sub(r"\1", drawing.svg).replace("<svg ", f"<svg {size} ", 1)
    return svg.replace("</desc>", '</desc>\n<rect width="100%" height="100%" fill="#FFFFFF"/>', 1) + "\n"


def page(found: Coverage, drawings: Sequence[Drawing]) -> str:
    """One HTML page that holds all it shows."""
    template = resources.files("testbed.report") / "template"
    source, style = ((template / name).read_text(encoding="utf-8") for name in ("coverage.html", "report.css"))
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    zones = [(f"{z:g}", found.dead_zones(k)) for k, z in enumerate(found.z)]
    context = {
        "name": found.scenario,
        "heads": HEADS,
        "rows": rows(found),
        "zones": [(z, [_zone(zone) for zone in of[:MOST_ZONES]], max(0, len(of) - MOST_ZONES)) for z, of in zones],
        "drawings": drawings,
        "left_out": LEFT_OUT,
        "dead": f"{100 * DEAD:.0f}",
        "heard": f"{100 * HEARD:.0f}",
    }
    return environment.from_string(source).render(page=context, style=style)


# ---------------------------------------------------------------- for people

HEADS = ("height (m)", "floor (m²)", "by ≥ 1 antenna", "by ≥ 2", "by ≥ 3", "dead (m²)", "dead")


def rows(found: Coverage) -> list[tuple[str, ...]]:
    """Cells under HEADS, a row a height."""
    made = []
    for height in document(found)["heights"]:
        shares = [*height["share_read_by"].values()]
        numbers = (f"{height['height_m']:g}", f"{height['floor_m2']:.1f}", *map(_percent, shares), f"{height['dead_m2']:.1f}")
        made.append((*numbers, _percent(height["dead_share"])))
    return made


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f} %"


def _zone(zone: DeadZone) -> str:
    x, y, x0, y0, x1, y1 = (f"{round(v, 1) + 0.0:.1f}" for v in (*zone.center_m, *zone.bounds_m[0], *zone.bounds_m[1]))
    return f"{zone.area_m2:.1f} m² about ({x}, {y}), within x {x0} to {x1}, y {y0} to {y1}"


def show(console: Console, found: Coverage) -> None:
    """The shares of the floor, and the largest dead zones, as the command prints them."""
    table = Table(title=f"{found.scenario}: share of the floor that is read", title_justify="left", caption_justify="left")
    for head in HEADS:
        table.add_column(head, justify="right", no_wrap=True)
    for row in rows(found):
        table.add_row(*row)
    table.caption = (
        f"{found.tag}, cells of {found.step_m:g} m, {len(found.antenna)} antennas; an antenna reads a point where a visit does so with "
        f"{100 * HEARD:.0f} % or more, and it is dead where all antennas together don't reach {100 * DEAD:.0f} %"
    )
    console.print(table)
    for k, z in enumerate(found.z):
        zones = found.dead_zones(k)
        for zone in zones[:MOST_ZONES]:
            console.print(f"dead zone at {z:g} m: {_zone(zone)}", soft_wrap=True)
        if len(zones) > MOST_ZONES:
            rest = sum(zone.area_m2 for zone in zones[MOST_ZONES:])
            console.print(f"dead zones at {z:g} m: {len(zones) - MOST_ZONES} smaller ones, {rest:.1f} m² in all", soft_wrap=True)
