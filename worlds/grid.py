"""A hall from an octile map of the MovingAI pathfinding benchmarks."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed import frames
from testbed.columns import Array
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.importers.cells import boxes_of, octile
from worlds.importers.files import FARTHEST, FileConfig, ReadsFiles, WorldFileError, read_text
from worlds.importers.hall import check_materials, many, room, without_sides
from worlds.parts import MATERIALS, Part


class Grid(ReadsFiles, BaseHall):
    """Cells that nobody walks through, merged to boxes, are one body "walls"; the map's lower left corner is the origin.

    path   : the map, relative to the scenario's folder
    cell_m : the side of a cell, which the map doesn't tell
    """

    class Config(FileConfig):
        path: Annotated[str, Field(min_length=1, max_length=1000)]
        cell_m: Annotated[Metres, Field(ge=0.01, le=100)] = 1.0
        height_m: Annotated[Metres, Field(gt=0, le=100)] = 3.0
        material: str = "concrete"

        @model_validator(mode="after")
        def _knows_its_material(self) -> Grid.Config:
            check_materials([self.material])
            return self

    config: Config

    @cached_property
    def _full(self) -> Array:
        place = self.config.placed(self.config.path)
        full = octile(read_text(place), place.name)
        if max(full.shape) * self.config.cell_m > FARTHEST:
            raise WorldFileError(f"{place.name}: it would reach farther than {FARTHEST / 1000:g} km: look at cell_m")
        return full

    def parts(self) -> list[Part]:
        if not self._full.any():
            return []
        c = self.config
        boxes = boxes_of(self._full, c.cell_m, np.zeros(3), c.height_m, MATERIALS.index(c.material))
        return [without_sides("walls", "wall", frames.IDENTITY, boxes)]

    def bounds(self) -> Array:
        if self._full.any():
            room(self.parts(), self.config.path)
        rows, columns = self._full.shape
        return np.array([[0.0, 0, 0], [columns * self.config.cell_m, rows * self.config.cell_m, self.config.height_m]])

    def notes(self) -> list[str]:
        """In a sentence what the map became."""
        return [f"{self._full.sum()} of {self._full.size} cells are full: {many(sum(len(p.boxes) for p in self.parts()), 'box', 'boxes')}"]
