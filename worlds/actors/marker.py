"""A small thing that carries tags and is in nobody's way: a carton of a hand's width, for studies of estimators alone."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.geometry import Boxes, Mounts
from testbed.quantity import Metres
from worlds.parts import MATERIALS, STAND_OFF, Builder


class Marker:
    """A cube of `size_m` that stands on its own origin, which may be above the floor. One tag mount, top.

    Left out: everything that a body does to a radio link, unless it stands in the way of one.
    """

    class Config(quantity.Config):
        size_m: Annotated[Metres, Field(gt=0, le=1)] = 0.1

    def __init__(self, config: Config) -> None:
        self.config = config
        half = config.size_m / 2
        self._built = Builder()
        self._built.box("carton", (-half, -half, 0.0), (half, half, config.size_m))
        self._built.mount("top", (0.0, 0.0, config.size_m + STAND_OFF), pitch=-np.pi / 2)

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """One box in the body frame and the names of the materials."""
        return self._built.boxes(), MATERIALS

    def mounts(self) -> Mounts:
        """A place for a tag."""
        return self._built.mounts()
