"""From the triangles of a file to what rays can see through the gaps of: boxes where they are boxes, solid meshes, and sheets.

Corners at one place are made one, and what hangs together by its edges is a shell. Shells are judged one by one: a cuboid becomes a
box, which is exact and reflects; another closed shell stays the mesh that it is; one with a hole in its surface has no inside and
counts as sheets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes

WELD = 1e-6  # of a mesh's size: corners nearer than this are one
SQUARE = 1e-5  # of a shell's size: how far a cuboid's corners may lie off, which covers files with six digits
THIN = 1e-12  # of a shell's size cubed: less volume is none


@dataclass(frozen=True, eq=False)
class Solids:
    """What a file's triangles became: boxes and meshes in the frame of the file; `open` says how many of the meshes are sheets."""

    boxes: Boxes
    meshes: Meshes

    @property
    def open(self) -> int:
        """How many meshes are not closed."""
        return int((~self.meshes.closed).sum())


def solids(vertices: Array, triangles: Array) -> Solids:
    """Boxes and meshes of triangles (T, 3) over corners (V, 3) m, body and material 0.

    One closed mesh holds all closed shells that are no boxes; each open shell is a mesh of its own. Where shells are turned inside out
    beside others that aren't, one is the hole in another: then none of them is made a box.
    """
    vertices, triangles = welded(vertices, triangles)
    closed, boxes, sheets = [], [], []
    for shell in shells(triangles):
        own = oriented(shell)
        (closed if is_closed(own) else sheets).append(own)
    signs = {np.sign(volume(vertices, shell)) for shell in closed}
    rest = []
    for shell in closed:
        found = None if {-1.0, 1.0} <= signs else cuboid(vertices, shell)
        (rest if found is None else boxes).append(shell if found is None else found)
    parts = [_mesh(vertices, np.concatenate(rest), True)] if rest else []
    return Solids(Boxes.concatenate(boxes), Meshes.concatenate(parts + [_mesh(vertices, shell, False) for shell in sheets]))


def welded(vertices: Array, triangles: Array) -> tuple[Array, Array]:
    """Corners that lie within WELD of each other made one; triangles that have lost their extent left out."""
    if not len(triangles):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    size = max(float(np.ptp(vertices[triangles.ravel()], axis=0).max()), 1e-9)
    _, first, place = np.unique(np.round(vertices / (WELD * size)).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    faces = place.ravel()[triangles]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[distinct]


def shells(triangles: Array) -> list[Array]:
    """The triangles (n, 3) of each part that hangs together by its edges, in the order of their first triangles."""
    n = len(triangles)
    if not n:
        return []
    _, place = np.unique(np.sort(_edges(triangles), axis=1), axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    together = np.diff(place.ravel()[order]) == 0
    a, b = order[:-1][together] % n, order[1:][together] % n
    _, part = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    return [triangles[part == p] for p in dict.fromkeys(part.tolist())]


def is_closed(triangles: Array) -> bool:
    """Whether every edge is passed as often one way as the other: then the surface has no rim."""
    edges = _edges(triangles)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, place = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    return bool(not np.bincount(place.ravel(), np.where(edges[:, 0] == low, 1.0, -1.0)).any())


def oriented(triangles: Array) -> Array:
    """The shell with its triangles turned one way round, where each edge has just two of them; else as it is."""
    edges, n = _edges(triangles), len(triangles)
    _, place, times = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    if is_closed(triangles) or (times != 2).any():
        return triangles
    order = np.argsort(place.ravel(), kind="stable").reshape(-1, 2)  # the two triangles' edges at each edge
    a, b = order[:, 0] % n, order[:, 1] % n
    same = edges[order[:, 0], 0] == edges[order[:, 1], 0]  # both pass it in one direction: one of them is the wrong way round
    graph = coo_array((np.where(same, 2.0, 1.0), (a, b)), shape=(n, n)).tocsr()
    graph = graph.maximum(graph.T).tocsr()
    turned = np.zeros(n, dtype=bool)
    way, before = breadth_first_order(graph, 0, directed=False)
    for face in way[1:]:
        turned[face] = turned[before[face]] ^ (graph[before[face], face] == 2.0)
    return np.where(turned[:, None], triangles[:, ::-1], triangles)


def _edges(triangles: Array) -> Array:
    """(3 n, 2): the edges of n triangles, all first ones first."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def volume(vertices: Array, triangles: Array) -> float:
    """m³ inside of a closed shell, negative where it is turned inside out."""
    corners = vertices[triangles] - vertices[triangles[0, 0]]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6


def cuboid(vertices: Array, triangles: Array) -> Boxes | None:
    """The shell as one box, where it is one: eight corners, three pairs of faces at right angles; None where it isn't."""
    corners = vertices[np.unique(triangles)]
    if len(corners) != 8 or len(triangles) != 12:
        return None
    center, size = corners.mean(axis=0), float(np.ptp(corners, axis=0).max())
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    if (length <= (SQUARE * size) ** 2).any():
        return None
    axes = _right_angles(normal / length[:, None])
    if axes is None:
        return None
    off = (corners - center) @ axes
    half = np.abs(off).max(axis=0)
    if np.abs(np.abs(off) - half).max() > SQUARE * size or (half <= SQUARE * size / 100).any() or len(np.unique(off > 0, axis=0)) < 8:
        return None
    return Boxes(center[None], _quaternion(axes)[None], half[None], body=np.zeros(1), material=np.zeros(1))


def _right_angles(normals: Array) -> Array | None:
    """(3, 3), right-handed columns: the three directions that the faces look along, or None where they are not three at right angles."""
    first = normals[0]
    second = next((n for n in normals if abs(n @ first) < 1e-4), None)
    if second is None:
        return None
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    axes = np.stack([first, second, np.cross(first, second)], axis=1)
    near = np.abs(np.abs(normals @ axes) - 1).min(axis=1)
    if near.max() > 1e-6:
        return None
    upright = np.abs(axes).argmax(axis=0)  # axes that are those of the frame are called by their own names
    if (np.abs(axes).max(axis=0) > 1 - 1e-12).all() and len(set(upright.tolist())) == 3:
        return np.eye(3)
    return axes


def _quaternion(axes: Array) -> Array:
    """(4,) w, x, y, z of a rotation matrix, by its largest part."""
    m = axes
    squares = np.array([m.trace(), *(2 * m[i, i] - m.trace() for i in range(3))]) + 1
    k = int(squares.argmax())
    parts = np.array(
        [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]],
        ]
    )
    return frames.normalise(parts[k])


def _mesh(vertices: Array, triangles: Array, closed: bool) -> Meshes:
    used, place = np.unique(triangles, return_inverse=True)
    return Meshes(vertices[used], place.reshape(-1, 3), np.zeros(len(triangles)), np.zeros(1), np.zeros(1), np.array([closed]))


# ---------------------------------------------------------------- shapes that a file gives by their measures


def cylinder(radius: float, length: float, sides: int = 32) -> tuple[Array, Array]:
    """Corners and triangles of an upright prism about the origin with as much volume as the cylinder."""
    turn = 2 * np.pi * np.arange(sides) / sides
    fair = radius * np.sqrt(turn[1] / np.sin(turn[1]))
    ring = np.stack([fair * np.cos(turn), fair * np.sin(turn)], axis=1)
    low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (-length / 2, length / 2))
    vertices = np.concatenate([low, high, [[0, 0, -length / 2], [0, 0, length / 2]]])
    i = np.arange(sides)
    j, bottom, top = (i + 1) % sides, np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [(i, j, j + sides), (i, j + sides, i + sides), (j, i, bottom), (i + sides, j + sides, top)]
    return vertices, np.concatenate([np.stack(f, axis=1) for f in faces])


def sphere(radius: float, rings: int = 12) -> tuple[Array, Array]:
    """Corners and triangles of a polyhedron about the origin with as much volume as the sphere."""
    sides = 2 * rings
    polar, turn = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(sides) / sides
    ring = np.stack(
        [np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn)), np.outer(np.cos(polar), np.ones(sides))], axis=-1
    )
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i = np.arange(sides)
    j, top, bottom = (i + 1) % sides, np.full(sides, len(vertices) - 2), np.full(sides, len(vertices) - 1)
    faces = [(i, j, top), (j + sides * (rings - 2), i + sides * (rings - 2), bottom)]
    for k in range(rings - 2):
        a, b = i + sides * k, j + sides * k
        faces += [(a, a + sides, b + sides), (a, b + sides, b)]
    triangles = np.concatenate([np.stack(f, axis=1) for f in faces])
    fair = (4 / 3 * np.pi / volume(vertices, triangles)) ** (1 / 3)
    return vertices * radius * fair, triangles
