"""COLLADA 1.4 and 1.5 (Khronos): the triangles of its scene, in metres and with z up. Colours, skins and animations are left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from testbed.columns import Array
from worlds.importers.files import WorldFileError, child, children, local, numbers, said, text, xml

MAX_NODES = 20_000  # instances of nodes and geometries: a node that names another twice, and so on, would be without end
MAX_TRIANGLES = 500_000
HUGE = 1e9  # of the file's own unit
# the axes of the file as those of the world, whose z is up and whose viewer looks along +y (COLLADA 1.4.1, 5-19)
UP = {
    "X_UP": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "Y_UP": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "Z_UP": np.eye(3),
}


@dataclass(frozen=True, eq=False)
class _Library:
    """What a document holds, by id."""

    name: str
    geometries: dict[str, tuple[Array, Array]]
    nodes: dict[str, Element]


def collada(content: bytes, name: str) -> tuple[Array, Array]:
    """Corners (V, 3) m and triangles (T, 3) of a document's scene. WorldFileError, with the place, for what is no such document."""
    root = xml(content, name)
    if local(root) != "COLLADA":
        raise WorldFileError(f"{name}: is no COLLADA document, its root is <{local(root)[:40]}>")
    scale, turn = _units(root, name)
    geometries = {g.get("id", ""): _geometry(g, name) for lib in children(root, "library_geometries") for g in children(lib, "geometry")}
    nodes = {n.get("id", ""): n for n in root.iter() if local(n) == "node" and n.get("id")}
    library = _Library(name, geometries, nodes)
    placed = list(_instances(root, library)) or [(np.eye(4), mesh) for mesh in geometries.values()]
    vertices, triangles, corners, many = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0, 0
    for matrix, (points, faces) in placed:
        many += len(faces)
        if many > MAX_TRIANGLES:
            raise WorldFileError(f"{name}: more than {MAX_TRIANGLES:,} triangles: make it simpler")
        vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
        triangles.append((faces if np.linalg.det(matrix[:3, :3]) >= 0 else faces[:, ::-1]) + corners)
        corners += len(points)
    return np.concatenate(vertices) * scale @ turn.T, np.concatenate(triangles)


def _units(root: Element, name: str) -> tuple[float, Array]:
    asset = child(root, "asset")
    unit = None if asset is None else child(asset, "unit")
    scale = 1.0 if unit is None else float(numbers(unit.get("meter", "1"), 1, f"{name}: unit", 1e6)[0])
    up = "Y_UP" if asset is None else text(child(asset, "up_axis")) or "Y_UP"  # the standard's own default
    if not scale > 0:
        raise WorldFileError(f"{name}: a unit of {scale:g} m is none")
    if up not in UP:
        raise WorldFileError(f"{name}: up_axis is one of {', '.join(UP)}, not {said(up)}")
    return scale, UP[up]


# ---------------------------------------------------------------- geometries


def _geometry(geometry: Element, name: str) -> tuple[Array, Array]:
    where = f"{name}: geometry {said(geometry.get('id', ''))}"
    mesh = child(geometry, "mesh")
    if mesh is None:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)  # a spline has no surface
    vertices = child(mesh, "vertices")
    source = None if vertices is None else next((i for i in children(vertices, "input") if i.get("semantic") == "POSITION"), None)
    if source is None:
        raise WorldFileError(f"{where}: has no positions")
    points = _source(mesh, source.get("source", ""), where)
    faces = [np.zeros((0, 3), dtype=np.int64)]
    for primitive in mesh:
        if local(primitive) in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
            faces.append(_faces(primitive, where))
    found = np.concatenate(faces)
    if len(found) and not (found.min() >= 0 and found.max() < len(points)):
        raise WorldFileError(f"{where}: a triangle has a corner that is not there, of {len(points)} positions")
    return points, found


def _source(mesh: Element, url: str, where: str) -> Array:
    """(n, 3): the numbers of a source, three by three as its accessor says."""
    source = next((s for s in children(mesh, "source") if f"#{s.get('id')}" == url), None)
    array = None if source is None else child(source, "float_array")
    if source is None or array is None:
        raise WorldFileError(f"{where}: there is no source {said(url)}")
    values = numbers(array.text or "", None, where, HUGE)
    common = child(source, "technique_common")
    accessor = None if common is None else child(common, "accessor")
    stride = 3 if accessor is None else _whole(accessor.get("stride", "3"), 3, 16, where)
    offset = 0 if accessor is None else _whole(accessor.get("offset", "0"), 0, 1_000_000, where)
    rows = (len(values) - offset) // stride
    if rows < 1 or (len(values) - offset) % stride:
        raise WorldFileError(f"{where}: {len(values)} numbers from {offset} on are not positions of {stride} each")
    return values[offset:].reshape(rows, stride)[:, :3]


def _faces(primitive: Element, where: str) -> Array:
    """(n, 3): a primitive as triangles; polygons as fans round their first corner."""
    inputs = list(children(primitive, "input"))
    at = [_whole(i.get("offset", "0"), 0, 64, where) for i in inputs]
    own = next((o for i, o in zip(inputs, at, strict=True) if i.get("semantic") == "VERTEX"), None)
    if own is None:
        raise WorldFileError(f"{where}: a primitive doesn't say which number is the corner")
    step = max(at) + 1
    kind, runs = local(primitive), [_indices(p.text or "", where) for p in children(primitive, "p")]
    if any(len(run) % step for run in runs):
        raise WorldFileError(f"{where}: the numbers of its {kind} are not {step} a corner")
    corners = [run[own::step] for run in runs]
    if kind == "polylist":
        counts = _indices(text(child(primitive, "vcount")), where)
        whole = np.concatenate([*corners, np.zeros(0, dtype=np.int64)])
        if (counts < 3).any() or counts.sum() != len(whole):
            raise WorldFileError(f"{where}: the corners of its polygons don't add up")
        corners = np.split(whole, np.cumsum(counts)[:-1]) if len(counts) else []
    return np.concatenate([np.zeros((0, 3), dtype=np.int64), *(_split(kind, c, where) for c in corners)])


def _split(kind: str, corners: Array, where: str) -> Array:
    if kind == "triangles":
        if len(corners) % 3:
            raise WorldFileError(f"{where}: {len(corners)} corners are not triangles")
        return corners.reshape(-1, 3)
    if len(corners) < 3:
        raise WorldFileError(f"{where}: a polygon has {len(corners)} corners")
    if kind == "tristrips":
        found = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        found[1::2] = found[1::2, ::-1]
        return found
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)


def _indices(content: str, where: str) -> Array:
    values = numbers(content, None, where, HUGE)
    if (values != np.floor(values)).any():
        raise WorldFileError(f"{where}: a corner's number is not whole")
    return values.astype(np.int64)


def _whole(content: str, low: int, high: int, where: str) -> int:
    value = numbers(content, 1, where)[0]
    if value != int(value) or not low <= value <= high:
        raise WorldFileError(f"{where}: a whole number from {low} to {high} is wanted, not {said(content)}")
    return int(value)


# ---------------------------------------------------------------- the scene


def _instances(root: Element, library: _Library) -> Iterator[tuple[Array, tuple[Array, Array]]]:
    """Every geometry in the scene with its matrix (4, 4)."""
    scene = child(root, "scene")
    named = None if scene is None else child(scene, "instance_visual_scene")
    url = "" if named is None else named.get("url", "")
    scenes = [s for lib in children(root, "library_visual_scenes") for s in children(lib, "visual_scene")]
    chosen = next((s for s in scenes if f"#{s.get('id')}" == url), scenes[0] if scenes else None)
    waiting = [] if chosen is None else [(node, np.eye(4), 0) for node in children(chosen, "node")]
    visited = 0
    while waiting:
        node, above, depth = waiting.pop(0)
        visited += 1
        if visited + len(waiting) > MAX_NODES or depth > 100:
            raise WorldFileError(f"{library.name}: its nodes name each other more than {MAX_NODES:,} times over")
        matrix = above @ _matrix(node, library.name)
        for part in node:
            url = part.get("url", "")
            if local(part) == "node":
                waiting.append((part, matrix, depth + 1))
            elif local(part) == "instance_node":
                if url[1:] not in library.nodes:
                    raise WorldFileError(f"{library.name}: there is no node {said(url)}")
                waiting.append((library.nodes[url[1:]], matrix, depth + 1))
            elif local(part) == "instance_geometry":
                if url[1:] not in library.geometries:
                    raise WorldFileError(f"{library.name}: there is no geometry {said(url)}")
                yield matrix, library.geometries[url[1:]]


def _matrix(node: Element, name: str) -> Array:
    """(4, 4): a node's transformations, one after the other."""
    where, found = f"{name}: node {said(node.get('id', ''))}", np.eye(4)
    for part in node:
        step, kind = np.eye(4), local(part)
        if kind == "matrix":
            step = numbers(part.text or "", 16, where, HUGE).reshape(4, 4)
        elif kind == "translate":
            step[:3, 3] = numbers(part.text or "", 3, where, HUGE)
        elif kind == "scale":
            step[:3, :3] = np.diag(numbers(part.text or "", 3, where, HUGE))
        elif kind == "rotate":
            step[:3, :3] = _rotation(numbers(part.text or "", 4, where, HUGE), where)
        elif kind in ("skew", "lookat"):
            raise WorldFileError(f"{where}: a {kind} is not read: let the exporter write a matrix")
        found = found @ step
    return found


def _rotation(given: Array, where: str) -> Array:
    """(3, 3) of axis and degrees, by Rodrigues' formula."""
    length = float(np.linalg.norm(given[:3]))
    if length == 0:
        raise WorldFileError(f"{where}: a rotation about no axis")
    x, y, z = given[:3] / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(given[3])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
