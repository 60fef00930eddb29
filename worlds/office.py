"""An office with a desk in the way: for a person who is guided to a box on a chair, three metres off."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.columns import Array
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.parts import STAND_OFF, Builder, Part, floor_pose, wall

WALL = 0.15  # m
HEIGHT = 2.6  # m of the ceiling


class Office(BaseHall):
    """A room from (0, 0) to (length, width) with concrete walls.

    Bodies: desk1 in the middle, across the straight way from (1.0, 2.2) to chair1, which stands at (4.2, 2.5) and bears a carton with a tag
    mount "box" 1 m above the floor, on the side that looks along -x; cabinet1, of steel, along the wall behind. With `desk: false`
    the way is free.
    """

    class Config(quantity.Config):
        length_m: Annotated[Metres, Field(ge=5, le=50)] = 6.0
        width_m: Annotated[Metres, Field(ge=4, le=50)] = 5.0
        desk: bool = True

    config: Config

    def parts(self) -> list[Part]:
        x, y, out = self.config.length_m, self.config.width_m, WALL / 2
        walls = [
            wall("wall_south", (0.0, -out), (x, -out), HEIGHT, WALL),
            wall("wall_east", (x + out, -WALL), (x + out, y + WALL), HEIGHT, WALL),
            wall("wall_north", (x, y + out), (0.0, y + out), HEIGHT, WALL),
            wall("wall_west", (-out, y + WALL), (-out, -WALL), HEIGHT, WALL),
        ]
        return [*([_desk()] if self.config.desk else []), _chair(), _cabinet(x), *walls]

    def bounds(self) -> Array:
        return np.array([[-WALL, -WALL, 0.0], [self.config.length_m + WALL, self.config.width_m + WALL, HEIGHT]])


def _desk() -> Part:
    built = Builder()
    built.box("wood", (-0.35, -0.7, 0.70), (0.35, 0.7, 0.74))
    for x in (-0.33, 0.27):
        for y in (-0.68, 0.62):
            built.box("steel", (x, y, 0.0), (x + 0.06, y + 0.06, 0.70))
    return built.part("desk1", "desk", floor_pose(2.7, 2.35))


def _chair() -> Part:
    built = Builder()
    built.box("plastic", (-0.2, -0.2, 0.42), (0.2, 0.2, 0.46))
    built.box("steel", (-0.03, -0.03, 0.0), (0.03, 0.03, 0.42))
    built.box("carton", (-0.2, -0.15, 0.46), (0.04, 0.15, 1.1))  # at the seat's edge, where somebody who comes near gets within reach of it
    built.mount("box", (-0.2 - STAND_OFF, 0.0, 1.0), np.pi)
    return built.part("chair1", "chair", floor_pose(4.2, 2.5))


def _cabinet(length: float) -> Part:
    built = Builder()
    built.box("steel", (-0.2, -0.6, 0.0), (0.2, 0.6, 1.8))
    return built.part("cabinet1", "cabinet", floor_pose(length - 0.25, 1.0))
