"""Maps of cells: portable grey maps, the octile maps of pathfinding benchmarks, and the boxes that their full cells make."""

from __future__ import annotations

import re

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from worlds.importers.files import WorldFileError, said

MAX_CELLS = 25_000_000
MAX_SIDE = 20_000  # cells
_HEADER = re.compile(rb"(P[25])((?:\s|#[^\n]*\n)+)(\d{1,9})((?:\s|#[^\n]*\n)+)(\d{1,9})((?:\s|#[^\n]*\n)+)(\d{1,9})\s")
PASSABLE, FULL = ".GS", "@OTW"  # of octile maps: ground and swamp; out of bounds, trees, water


def pgm(content: bytes, name: str) -> tuple[Array, int]:
    """Grey values (rows, columns), the first row on top, and the largest possible. P2 (text) and P5; WorldFileError for what is neither."""
    found = _HEADER.match(content[:4096])
    if found is None:
        raise WorldFileError(f"{name}: is no portable grey map: it begins with P2 or P5, width, height and the largest value")
    columns, rows, most = (int(found[i]) for i in (3, 5, 7))
    _check_size(rows, columns, name)
    if not 0 < most < 65536:
        raise WorldFileError(f"{name}: a largest grey of {most} is none")
    body, wanted = content[found.end() :], rows * columns
    if found[1] == b"P2":
        try:
            values = np.array(body.split()[: wanted + 1], dtype=np.int64)
        except (ValueError, OverflowError):
            raise WorldFileError(f"{name}: its cells are not numbers") from None
    else:
        wide = np.dtype(">u2" if most > 255 else "u1")
        values = np.frombuffer(body[: len(body) // wide.itemsize * wide.itemsize], dtype=wide)
    if len(values) < wanted:
        raise WorldFileError(f"{name}: {columns} x {rows} cells are wanted, {len(values)} are there")
    values = values[:wanted]
    if wanted and (values.min() < 0 or values.max() > most):
        raise WorldFileError(f"{name}: a cell is not between 0 and {most}")
    return values.reshape(rows, columns).astype(np.int64), most


def octile(content: str, name: str) -> Array:
    """(rows, columns) bool: the cells of a MovingAI map that nobody walks through, the first row on top.

    N. R. Sturtevant, "Benchmarks for grid-based pathfinding", IEEE Trans. Computational Intelligence and AI in Games 4 (2012).
    """
    lines = content.splitlines()
    head = [line.split() for line in lines[:4]]
    if len(head) < 4 or head[0][:1] != ["type"] or head[3] != ["map"]:
        raise WorldFileError(f"{name}: is no octile map: it begins with the lines type, height, width and map")
    size = {row[0]: row[1] for row in head[1:3] if len(row) == 2 and row[1].isascii() and row[1].isdecimal() and len(row[1]) < 10}
    if set(size) != {"height", "width"}:
        raise WorldFileError(f"{name}: its height and width are not told in lines 2 and 3")
    rows, columns = int(size["height"]), int(size["width"])
    _check_size(rows, columns, name)
    body = lines[4 : 4 + rows]
    if len(body) < rows:
        raise WorldFileError(f"{name}: {rows} rows are wanted, {len(body)} are there")
    for i, line in enumerate(body):
        if len(line) != columns:
            raise WorldFileError(f"{name}:{i + 5}: a row of {columns} cells is wanted, this one has {len(line)}")
        stranger = next((c for c in line if c not in PASSABLE + FULL), None)
        if stranger is not None:
            raise WorldFileError(f"{name}:{i + 5}: {said(stranger)} is no cell; there are {' '.join(PASSABLE + FULL)}")
    return np.isin(np.array([list(line) for line in body]), list(FULL))


def _check_size(rows: int, columns: int, name: str) -> None:
    if not (0 < rows <= MAX_SIDE and 0 < columns <= MAX_SIDE and rows * columns <= MAX_CELLS):
        raise WorldFileError(f"{name}: {columns} x {rows} cells: up to {MAX_SIDE:,} a side and {MAX_CELLS:,} in all are read")


def rectangles(full: Array) -> Array:
    """(R, 4) int64: first and end row, first and end column of rectangles that fill the cells `full` (rows, columns) and no others.

    Runs along the rows, those alike in rows one below the other made one; or the same along the columns, if that makes fewer.
    """
    along, across = _merged_runs(full), _merged_runs(full.T)
    return along if len(along) <= len(across) else across[:, [2, 3, 0, 1]]


def _merged_runs(full: Array) -> Array:
    edge = np.zeros((len(full), 1), dtype=np.int8)
    change = np.diff(np.concatenate([edge, full.astype(np.int8), edge], axis=1), axis=1)
    (row, first), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    if not len(row):
        return np.zeros((0, 4), dtype=np.int64)
    order = np.lexsort((row, end, first))  # runs of one extent stand together, downwards
    row, first, end = row[order], first[order], end[order]
    new = np.ones(len(row), dtype=bool)
    new[1:] = (first[1:] != first[:-1]) | (end[1:] != end[:-1]) | (row[1:] != row[:-1] + 1)
    start = np.flatnonzero(new)
    last = np.append(start[1:], len(row)) - 1
    return np.stack([row[start], row[last] + 1, first[start], end[start]], axis=1)


def boxes_of(full: Array, cell: float, origin: Array, height: float, material: int) -> Boxes:
    """Boxes on the floor, `height` m high, over the full cells (rows, columns) of `cell` m, the first row the farthest in y.

    origin : x, y (m) and yaw (rad) of the lower left corner
    """
    found = rectangles(full)
    low = np.stack([found[:, 2], len(full) - found[:, 1]], axis=1) * cell
    high = np.stack([found[:, 3], len(full) - found[:, 0]], axis=1) * cell
    turn = frames.from_euler(origin[2])
    flat = np.column_stack([(low + high) / 2, np.full(len(found), height / 2)])
    center = frames.to_world(np.concatenate([[origin[0], origin[1], 0.0], turn]), flat)
    half = np.column_stack([(high - low) / 2, np.full(len(found), height / 2)])
    return Boxes(center, np.tile(turn, (len(found), 1)), half, body=np.zeros(len(found)), material=np.full(len(found), material))
