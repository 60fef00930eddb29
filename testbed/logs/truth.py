"""Where a target truly was, from a file beside the log: TUM trajectories, libRSF's point2, or a table with t, x, y and perhaps z."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs.bad import BadRows, LogError
from testbed.logs.blocks import blocks, head
from testbed.logs.cells import split_row
from testbed.logs.contents import Path3
from testbed.logs.samples import FAR_M, path_of
from testbed.logs.site import TruthModel
from testbed.logs.units import Clock

MAX_SAMPLES = 10_000_000
ONE = ""  # the name of the target that a file without a column for it speaks of


def read_truth(path: str | Path, how: TruthModel, start_s: float) -> tuple[dict[str, Path3], BadRows]:
    """True paths by target ("" for the only one), t in s from `start_s` on the file's clock, and the rows that were left out.

    LogError for a file that can't be read, or has no sound row.
    """
    path, bad = Path(path), BadRows()
    lines, names, places = _layout(path, how)
    found: dict[str, list[tuple[str, list[float]]]] = {}
    count = 0
    for block in blocks(path):
        for number, text in enumerate(block.text.decode("utf-8", "replace").split("\n")[:-1], start=block.line):
            if number <= lines or not text.strip() or text.startswith("#"):
                continue
            cells = split_row(text, ",") if names else text.split()
            row = _row(cells, places, how.height_m)
            if row is None:
                bad.add(np.array([number]), "no true place", [text])
                continue
            count += 1
            target = cells[names.index("target")].strip() if "target" in names else ONE
            found.setdefault(target, []).append(row)
            if count > MAX_SAMPLES:
                raise LogError(f"{path}: over {MAX_SAMPLES:,} true places: thin them out")
    bad.check_share(count, str(path))
    if not found:
        raise LogError(f"{path}: no row holds a true place")
    clock = Clock(how.time_unit, start_s)
    return {target: _path(rows, clock, path) for target, rows in found.items()}, bad


def _layout(path: Path, how: TruthModel) -> tuple[int, list[str], list[int]]:
    """(lines before the rows, names of the columns, places of t, x, y and perhaps z)."""
    if how.kind == "tum":
        return 0, [], [0, 1, 2, 3]
    if how.kind == "librsf":
        return 0, [], [1, 2, 3]
    lines = head(path)
    names = [name.strip().lower() for name in split_row(lines[0], ",")] if lines else []
    if not {"t", "x", "y"} <= set(names) or len(set(names)) < len(names):
        raise LogError(
            f"{path}: the columns t, x and y (and perhaps z and target) are wanted, once each; the header has {', '.join(names[:12])}"
        )
    return 1, names, [names.index(name) for name in ("t", "x", "y", "z") if name in names]


def _row(cells: list[str], places: list[int], height: float) -> tuple[str, list[float]] | None:
    if len(cells) <= max(places):
        return None
    try:
        position = [float(cells[place]) for place in places[1:]]
    except ValueError:
        return None
    position += [height] * (3 - len(position))
    return (cells[places[0]].strip(), position) if all(abs(v) < FAR_M for v in position) else None


def _path(rows: list[tuple[str, list[float]]], clock: Clock, path: Path) -> Path3:
    t = clock.seconds(pa.array([time for time, _ in rows], pa.string()))
    position: Array = np.array([place for _, place in rows])
    there = np.isfinite(t)
    if not there.any():
        raise LogError(f"{path}: no row has a time in {clock.unit}")
    return path_of(t[there], position[there])
