"""Meshes from files: COLLADA, STL and OBJ. Only where their surfaces are; STL and OBJ know neither units nor which way is up."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from testbed.columns import Array
from worlds.importers.collada import MAX_TRIANGLES, collada
from worlds.importers.files import FARTHEST, MAX_MESH, WorldFileError, read, said

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def load_mesh(place: Path, limit: int = MAX_MESH) -> tuple[Array, Array]:
    """Corners (V, 3) and triangles (T, 3) of a file: COLLADA in metres and z up, the others as they are.

    WorldFileError for a kind that isn't known, for a file that is none of its kind, and for one beyond the limits.
    """
    kinds = {".dae": collada, ".stl": stl, ".obj": obj}
    kind = kinds.get(place.suffix.lower())
    if kind is None:
        raise WorldFileError(f"{place.name}: meshes are read from {', '.join(kinds)}, not from {place.suffix or 'files without an ending'}")
    vertices, triangles = kind(read(place, limit), place.name)
    if len(triangles) > MAX_TRIANGLES:
        raise WorldFileError(f"{place.name}: more than {MAX_TRIANGLES:,} triangles: make it simpler")
    return vertices, triangles


def within_reach(vertices: Array, name: str) -> Array:
    """The corners as they are. WorldFileError where one isn't finite or lies farther away than any hall reaches."""
    if not (np.abs(vertices) <= FARTHEST).all():
        raise WorldFileError(f"{name}: a corner lies more than {FARTHEST / 1000:g} km away: look at its unit and scale")
    return vertices


def stl(content: bytes, name: str) -> tuple[Array, Array]:
    """Binary or text; three corners a triangle. A binary file may begin with the word "solid" too: its length tells."""
    many = int.from_bytes(content[80:84], "little")
    if len(content) >= 84 and len(content) == 84 + many * _FACET.itemsize:
        corners = np.frombuffer(content, dtype=_FACET, offset=84)["corners"].astype(np.float64)
    else:
        corners = _stl_text(content, name)
    if not np.isfinite(corners).all():
        raise WorldFileError(f"{name}: a corner is not finite")
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _stl_text(content: bytes, name: str) -> Array:
    words = content.split()
    if not words or words[0].lower() != b"solid":
        raise WorldFileError(f"{name}: is no STL: neither text that begins with solid nor as long as its number of triangles says")
    rows = [words[i + 1 : i + 4] for i, word in enumerate(words) if word == b"vertex"]
    try:
        corners = np.array(rows, dtype=np.float64).reshape(-1, 3, 3)
    except ValueError:
        raise WorldFileError(f"{name}: its corners are not three numbers each, three a triangle") from None
    return corners


def obj(content: bytes, name: str) -> tuple[Array, Array]:
    """Wavefront OBJ: `v` and `f` lines; polygons as fans, numbers below nought counted from the last corner."""
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(content.split(b"\n"), start=1):
        word, *rest = line.split() or [b""]
        try:
            if word == b"v":
                x, y, z = (float(v) for v in rest[:3])
                vertices.append([x, y, z])
            elif word == b"f":
                corners = [_corner(int(text.split(b"/")[0]), len(vertices)) for text in rest]
                faces += [(corners[0], a, b) for a, b in pairwise(corners[1:])]
        except (ValueError, IndexError):
            raise WorldFileError(f"{name}:{number}: {said(line.decode(errors='replace'))} is no corner or face") from None
    points, triangles = np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise WorldFileError(f"{name}: a corner is not finite")
    if len(triangles) and triangles.max() >= len(points):
        raise WorldFileError(f"{name}: a face has a corner that is not there, of {len(points)}")
    return points, triangles


def _corner(number: int, many: int) -> int:
    """The place of a corner that a file counts from 1, or from the end."""
    place = number - 1 if number > 0 else many + number
    if number == 0 or place < 0 or place > 2**31:
        raise ValueError
    return place
