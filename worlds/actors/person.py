"""A person who walks: kinematic only, a few boxes of flesh that a radio link has to get past."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from testbed import quantity
from testbed.geometry import Boxes, Mounts
from testbed.quantity import Metres
from worlds import people
from worlds.parts import MATERIALS, Builder


class Person:
    """A standing adult; origin between the feet, looking along +x.

    Tag mounts chest, back, left and right (hips); antenna mount "hand", for a reader that is held in front.
    """

    class Config(quantity.Config):
        height_m: Annotated[Metres, Field(ge=1.0, le=2.2)] = 1.75

    def __init__(self, config: Config) -> None:
        self.config = config
        self._built = Builder()
        people.stand(self._built, config.height_m)
        for name, place, yaw in people.badge_places(config.height_m):
            self._built.mount(name, place, yaw)
        self._built.mount("hand", (0.45, 0.0, 0.62 * config.height_m), use="antenna", group="reader")

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """Boxes in the body frame and the names of their materials."""
        return self._built.boxes(), MATERIALS

    def mounts(self) -> Mounts:
        """Places for tags and for a hand-held reader's antenna."""
        return self._built.mounts()
