"""A hall from a robot's map: the occupancy grid of ROS's map_server, a YAML file and a portable grey map."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed.columns import Array
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.importers.cells import boxes_of, pgm
from worlds.importers.files import MAX_MESH, FileConfig, ReadsFiles, WorldFileError, beneath, read, said
from worlds.importers.hall import check_materials, many, room, without_sides
from worlds.importers.plain_yaml import mapping, plain_yaml
from worlds.parts import MATERIALS, Part


class Occupancy(ReadsFiles, BaseHall):
    """Full cells, merged to boxes, are one body "walls" of `height_m`, for a map doesn't tell how high things are.

    A cell's grey g is p = 1 - g / 255 full, or g / 255 if the map says negate; above occupied_thresh it is full, below free_thresh free,
    between them unknown. Left out: modes other than trinary.

    path    : the map's YAML file, relative to the scenario's folder
    image   : its grey map, relative to the YAML file, in place of the one that it names
    unknown : what cells are that the robot never saw
    """

    class Config(FileConfig):
        path: Annotated[str, Field(min_length=1, max_length=1000)]
        image: Annotated[str, Field(min_length=1, max_length=1000)] | None = None
        height_m: Annotated[Metres, Field(gt=0, le=100)] = 3.0
        unknown: Literal["free", "full"] = "free"
        material: str = "concrete"

        @model_validator(mode="after")
        def _knows_its_material(self) -> Occupancy.Config:
            check_materials([self.material])
            return self

    config: Config

    @cached_property
    def _map(self) -> tuple[Array, float, Array]:
        """(full cells (rows, columns), their side in m, x, y, yaw of the lower left corner)."""
        place = self.config.placed(self.config.path)
        told = mapping(plain_yaml(place), place.name)
        image = self.config.image or told.get("image")
        if not isinstance(image, str):
            raise WorldFileError(f"{place.name}: it doesn't name its image")
        file = beneath(place.parent, image, place.name)
        if not file.is_file():
            raise WorldFileError(
                f"{place.name}: there is no {said(image)} beside it; name the grey map that there is, as in image: map.pgm"
            )
        grey, most = pgm(read(file, MAX_MESH), file.name)
        cell = _number(told, "resolution", 1e-3, 100.0, place.name)
        origin = told.get("origin")
        if not (isinstance(origin, list) and len(origin) == 3 and all(_is_number(v) and abs(v) <= 10_000 for v in origin)):
            raise WorldFileError(f"{place.name}: origin is x, y and yaw, not {said(origin)}")
        share = grey / most
        share = share if told.get("negate") in (1, True) else 1.0 - share
        full = share > _number(told, "occupied_thresh", 0.0, 1.0, place.name, 0.65)
        if self.config.unknown == "full":
            full |= share >= _number(told, "free_thresh", 0.0, 1.0, place.name, 0.196)
        return full, cell, np.array(origin, dtype=np.float64)

    def parts(self) -> list[Part]:
        full, cell, origin = self._map
        if not full.any():
            return []
        boxes = boxes_of(full, cell, origin, self.config.height_m, MATERIALS.index(self.config.material))
        return [without_sides("walls", "wall", np.array([0.0, 0, 0, 1, 0, 0, 0]), boxes)]

    def bounds(self) -> Array:
        full, cell, (x, y, yaw) = self._map
        room(self.parts(), self.config.path) if full.any() else None
        corners = np.array([[0, 0], [full.shape[1], 0], full.shape[::-1], [0, full.shape[0]]]) * cell
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        around = corners @ turn + [x, y]
        return np.array([[*around.min(axis=0), 0.0], [*around.max(axis=0), self.config.height_m]])

    def notes(self) -> list[str]:
        """In a sentence what the map became."""
        full, cell, _ = self._map
        return [
            f"{full.sum()} of {full.size} cells of {cell:g} m are full: {many(sum(len(p.boxes) for p in self.parts()), 'box', 'boxes')}"
        ]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _number(told: dict[str, Any], key: str, low: float, high: float, name: str, default: float | None = None) -> float:
    value = told.get(key, default)
    if not _is_number(value) or not low <= float(value) <= high:  # pyright: ignore[reportArgumentType]  the first half says that it is one
        raise WorldFileError(f"{name}: {key} is a number from {low:g} to {high:g}, not {said(value)}")
    return float(value)  # pyright: ignore[reportArgumentType]
