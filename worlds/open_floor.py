"""An empty floor with antenna posts round it: nothing in the way, for calibration and for studies of estimators alone."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.columns import Array
from testbed.geometry import Zones
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.parts import Part, post


class OpenFloor(BaseHall):
    """A rectangle of floor from (0, 0) with posts "post1", ... counter-clockwise from the origin, each with antenna mounts low and high.

    posts: 0, 4 (the corners) or 8 (the corners and the middles of the sides). They look at the middle of the floor.
    """

    class Config(quantity.Config):
        length_m: Annotated[Metres, Field(ge=2, le=200)] = 8.0
        width_m: Annotated[Metres, Field(ge=2, le=200)] = 6.0
        height_m: Annotated[Metres, Field(ge=2, le=30)] = 5.0
        posts: Literal[0, 4, 8] = 4
        post_height_m: Annotated[Metres, Field(ge=1.2, le=20)] = 2.5

    config: Config

    def parts(self) -> list[Part]:
        x, y = self.config.length_m, self.config.width_m
        corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
        middles = [(x / 2, 0.0), (x, y / 2), (x / 2, y), (0.0, y / 2)]
        places = {0: [], 4: corners, 8: [p for pair in zip(corners, middles, strict=True) for p in pair]}[self.config.posts]
        return [post(f"post{i}", px, py, (x / 2, y / 2), self.config.post_height_m) for i, (px, py) in enumerate(places, start=1)]

    def bounds(self) -> Array:
        c = self.config
        return np.array([[-0.2, -0.2, 0.0], [c.length_m + 0.2, c.width_m + 0.2, max(c.height_m, c.post_height_m + 0.1)]])

    def zones(self) -> Zones:
        return Zones(np.array(["floor"]), np.array([[0.0, 0.0, self.config.length_m, self.config.width_m]]))
