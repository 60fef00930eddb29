"""Open-RMF's building maps: a level's walls, doors, models and lanes, drawn over a plan in pixels and measured here and there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from testbed.columns import Array
from testbed.geometry import Roads
from worlds.importers.files import FARTHEST, WorldFileError, said
from worlds.importers.plain_yaml import mapping, plain_yaml

MOST = 50_000  # items of one kind
UNLIKE = 0.1  # measurements that disagree by more than this share are no scale


@dataclass(frozen=True)
class Item:
    """A thing that stands: what it is, under which name, where (m, m, rad), how high above the floor (m)."""

    kind: str
    name: str
    x: float
    y: float
    yaw: float
    z: float


@dataclass(frozen=True, eq=False)
class Level:
    """A level in metres with y up: walls and doors (n, 2, 2), names of the doors, items, and lanes as a network, None without any.

    scale is metres a unit of the drawing; `notes` says in sentences what was left out.
    """

    scale: float
    walls: Array
    doors: Array
    door_names: tuple[str, ...]
    items: tuple[Item, ...]
    roads: Roads | None
    notes: tuple[str, ...] = field(default=())


def building(place: Path, level: str | None) -> Level:
    """A level of a building's file, the only one where `level` is None. WorldFileError, with the place in it, for what can't be read."""
    name = place.name
    told = mapping(plain_yaml(place), name)
    levels = mapping(told.get("levels"), f"{name}: levels")
    if level is None and len(levels) != 1:
        raise WorldFileError(f"{name}: say which level is wanted, of {', '.join(levels) or 'none'}")
    chosen = next(iter(levels)) if level is None else level
    if chosen not in levels:
        raise WorldFileError(f"{name}: there is no level {said(chosen)}, there are {', '.join(levels)}")
    return _level(mapping(levels[chosen], f"{name}: levels.{chosen}"), str(told.get("coordinate_system", "reference_image")), name)


def _level(told: dict[str, Any], system: str, name: str) -> Level:
    if system not in ("reference_image", "cartesian_meters"):
        raise WorldFileError(f"{name}: coordinates are read in reference_image and cartesian_meters, not in {said(system)}")
    drawn = np.array([_point(row, f"{name}: vertices.{i}") for i, row in enumerate(_items(told, "vertices", name))]).reshape(-1, 2)
    scale = _scale(told, drawn, name) if system == "reference_image" else 1.0
    signs = scale * np.array([1.0, -1.0 if system == "reference_image" else 1.0])
    vertices = drawn * signs
    if len(vertices) and not (np.abs(vertices) <= FARTHEST).all():
        raise WorldFileError(f"{name}: a vertex lies more than {FARTHEST / 1000:g} km away: look at the measurements")
    walls = _pairs(told, "walls", len(vertices), name)
    doors = _pairs(told, "doors", len(vertices), name)
    roads, notes = _roads(told, vertices, name)
    items = tuple(_model(row, signs, f"{name}: models.{i}") for i, row in enumerate(_items(told, "models", name)))
    return Level(
        scale=scale,
        walls=vertices[[w[:2] for w in walls]].reshape(-1, 2, 2) if walls else np.zeros((0, 2, 2)),
        doors=vertices[[d[:2] for d in doors]].reshape(-1, 2, 2) if doors else np.zeros((0, 2, 2)),
        door_names=tuple(str(_parameter(d[2], "name", "")) or f"door{i}" for i, d in enumerate(doors, start=1)),
        items=items,
        roads=roads,
        notes=notes,
    )


def _items(told: dict[str, Any], key: str, name: str) -> list[Any]:
    found = told.get(key) or []
    if not isinstance(found, list) or len(found) > MOST:
        raise WorldFileError(f"{name}: {key} is a list of at most {MOST:,}, not {said(found)}")
    return found


def _point(row: Any, where: str) -> tuple[float, float]:
    if not isinstance(row, list) or len(row) < 2:
        raise WorldFileError(f"{where}: x and y are wanted, not {said(row)}")
    return _real(row[0], where), _real(row[1], where)


def _real(value: Any, where: str, most: float = 1e7) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or abs(value) > most:
        raise WorldFileError(f"{where}: a number up to ±{most:g} is wanted, not {said(value)}")
    return float(value)


def _pairs(told: dict[str, Any], key: str, vertices: int, name: str) -> list[tuple[int, int, dict[str, Any]]]:
    """(first vertex, second, parameters) of each item; of a wall that has no length nothing is left."""
    found = []
    for i, row in enumerate(_items(told, key, name)):
        where = f"{name}: {key}.{i}"
        if not isinstance(row, list) or len(row) < 2:
            raise WorldFileError(f"{where}: two vertices are wanted, not {said(row)}")
        for end in row[:2]:
            if isinstance(end, bool) or not isinstance(end, int) or not 0 <= end < vertices:
                raise WorldFileError(f"{where}: there is no vertex {said(end)}, they are 0 to {vertices - 1}")
        found.append((row[0], row[1], mapping(row[2] if len(row) > 2 else {}, where)))
    return found


def _parameter(parameters: dict[str, Any], key: str, default: Any) -> Any:
    """A parameter's value; it is written with its type before it, as in [3, 9.3]."""
    value = parameters.get(key)
    return value[1] if isinstance(value, list) and len(value) == 2 else default


def _scale(told: dict[str, Any], drawn: Array, name: str) -> float:
    """Metres a pixel: the mean over all measurements, as Open-RMF has it."""
    found = []
    for i, (a, b, parameters) in enumerate(_pairs(told, "measurements", len(drawn), name)):
        where = f"{name}: measurements.{i}"
        metres, pixels = _real(_parameter(parameters, "distance", None), where), float(np.hypot(*(drawn[a] - drawn[b])))
        if metres <= 0 or pixels <= 0:
            raise WorldFileError(f"{where}: {metres:g} m over {pixels:g} pixels is no scale")
        found.append(metres / pixels)
    if not found:
        raise WorldFileError(f"{name}: there are no measurements, and without one nobody knows how large a pixel is")
    if max(found) > (1 + UNLIKE) * min(found):
        raise WorldFileError(f"{name}: its measurements disagree: from {min(found):.3g} to {max(found):.3g} m a pixel")
    return float(np.mean(found))


def _model(row: Any, signs: Array, where: str) -> Item:
    told = mapping(row, where)
    x, y, z, yaw = (_real(told.get(key, 0.0), f"{where}.{key}") for key in ("x", "y", "z", "yaw"))
    kind = told.get("model_name")
    if not isinstance(kind, str):
        raise WorldFileError(f"{where}: it has no model_name")
    place = np.array([x, y]) * signs
    if not (np.abs([*place, z]) <= FARTHEST).all():
        raise WorldFileError(f"{where}: it lies more than {FARTHEST / 1000:g} km away")
    return Item(kind, str(told.get("name") or kind), float(place[0]), float(place[1]), yaw, z)


def _roads(told: dict[str, Any], vertices: Array, name: str) -> tuple[Roads | None, tuple[str, ...]]:
    """The lanes, those of them that hang together with most metres; ways that are there twice made one."""
    lanes, ways, twice = _pairs(told, "lanes", len(vertices), name), {}, 0
    for a, b, parameters in lanes:
        if a == b or not np.hypot(*(vertices[a] - vertices[b])) > 1e-6:
            raise WorldFileError(f"{name}: a lane from vertex {a} to vertex {b} has no length")
        both = _parameter(parameters, "bidirectional", False) is True
        twice += (a, b) in ways or (b, a) in ways
        if (b, a) in ways:
            ways[b, a] = False  # there and back is a way that runs both ways
        else:
            ways[a, b] = ways.get((a, b), True) and not both
    if not ways:
        return None, ()
    part = {vertex: vertex for way in ways for vertex in way}
    for a, b in ways:
        joined, old = _root(part, a), _root(part, b)
        part[old] = joined
    length = {way: float(np.hypot(*(vertices[way[0]] - vertices[way[1]]))) for way in ways}
    metres: dict[int, float] = {}
    for way in ways:
        metres[_root(part, way[0])] = metres.get(_root(part, way[0]), 0.0) + length[way]
    main = max(metres, key=lambda root: metres[root])
    kept = [way for way in ways if _root(part, way[0]) == main]
    used, segments = np.unique(kept, return_inverse=True)
    notes = [f"of {twice} more, the way is there already: each is taken as one"] if twice else []
    if len(kept) < len(ways):
        notes.append(f"left out: {len(ways) - len(kept)} of {sum(metres.values()) - metres[main]:.1f} m that hang together with no others")
    return Roads(vertices[used], segments.reshape(-1, 2), np.array([ways[way] for way in kept])), tuple(notes)


def _root(part: dict[int, int], vertex: int) -> int:
    while part[vertex] != vertex:
        part[vertex] = part[part[vertex]]
        vertex = part[vertex]
    return vertex
