"""A mail trolley: a roll cage on four wheels, with cartons inside, perhaps a person who pushes it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.geometry import Boxes, Mounts
from testbed.quantity import Kilograms, Metres
from worlds import people
from worlds.parts import MATERIALS, STAND_OFF, Builder
from worlds.vehicles import Chassis, Wheel

WHEEL_RADIUS = 0.0625  # m: the usual 125 mm wheel
BAR = 0.03  # m, thickness of posts and bars
BARS = 4  # bars of a mesh side: a mesh of 50 mm is closed to 0.33 m waves along its wires and open across; bars leave gaps as well
DECK = 0.20  # m, top of the base
OVERHANG = 0.12  # m, from the axles to either end


class Trolley:
    """A roll cage: steel base and corner posts, barred sides and back, open in front; `load` is the share filled with cartons.

    Origin below the middle of its rear axle, OVERHANG from its back, for the two rear wheels are fixed, the two in front swivel.
    Tag mounts: front, back, left, right (half-way up, outside), top, and load (on the lowest carton, inside the open front; on
    the strap there if it is empty).
    """

    class Config(quantity.Config):
        length_m: Annotated[Metres, Field(ge=0.4, le=2)] = 0.8
        width_m: Annotated[Metres, Field(ge=0.4, le=1.5)] = 0.7
        height_m: Annotated[Metres, Field(ge=0.6, le=2.2)] = 1.7
        load: Annotated[float, Field(ge=0, le=1)] = 0.6
        mass_kg: Annotated[Kilograms, Field(gt=5, le=500)] = 50.0
        load_mass_kg: Annotated[Kilograms, Field(ge=0, le=1000)] = 120.0
        pusher: bool = False

    def __init__(self, config: Config) -> None:
        self.config = config
        self._back, self._front = -OVERHANG, config.length_m - OVERHANG
        self._built = Builder()
        self._frame()
        self._cartons()
        self._mounts()
        if config.pusher:
            people.stand(self._built, 1.75, self._back - 0.35)

    def _frame(self) -> None:
        back, front, y, top, built = self._back, self._front, self.config.width_m / 2, self.config.height_m, self._built
        built.box("steel", (back, -y, DECK - 0.05), (front, y, DECK))
        for px in (back, front - BAR):
            for py in (-y, y - BAR):
                built.box("steel", (px, py, DECK), (px + BAR, py + BAR, top))
        for z in np.linspace(DECK, top, BARS + 1)[1:] - BAR:
            for py in (-y, y - BAR):
                built.box("steel", (back + BAR, py, z), (front - BAR, py + BAR, z + BAR))
            built.box("steel", (back, -y + BAR, z), (back + BAR, y - BAR, z + BAR))
        for wx in (0.0, front - OVERHANG):
            for wy in (-y + 0.05, y - 0.05):
                built.box("rubber", (wx - WHEEL_RADIUS, wy - 0.02, 0.0), (wx + WHEEL_RADIUS, wy + 0.02, 2 * WHEEL_RADIUS))

    def _cartons(self) -> None:
        """Two stacks side by side, in layers of some 0.3 m as far as the load reaches."""
        back, front, y = self._back + BAR + 0.02, self._front - BAR - 0.02, self.config.width_m / 2 - BAR - 0.02
        filled = (self.config.height_m - DECK - 0.05) * self.config.load
        if filled < 0.05:
            return
        layers = max(1, round(filled / 0.3))
        for layer in range(layers):
            low, high = DECK + filled * layer / layers, DECK + filled * (layer + 1) / layers - 0.005
            split = 0.1 * y * (-1) ** layer  # cartons of unequal size: joints don't line up
            self._built.box("carton", (back, -y, low), (front, split - 0.005, high))
            self._built.box("carton", (back, split + 0.005, low), (front, y, high))

    def _mounts(self) -> None:
        middle, y, height = (self._back + self._front) / 2, self.config.width_m / 2, (DECK + self.config.height_m) / 2
        mount = self._built.mount
        mount("front", (self._front + STAND_OFF, 0.0, height), 0.0)
        mount("back", (self._back - STAND_OFF, 0.0, height), np.pi)
        mount("left", (middle, y + STAND_OFF, height), np.pi / 2)
        mount("right", (middle, -y - STAND_OFF, height), -np.pi / 2)
        mount("top", (middle, 0.0, self.config.height_m + STAND_OFF), pitch=-np.pi / 2)
        mount("load", (self._front - BAR - 0.02 + STAND_OFF, 0.1, DECK + 0.15), 0.0)

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """Boxes in the body frame and the names of their materials."""
        return self._built.boxes(), MATERIALS

    def mounts(self) -> Mounts:
        """Places for tags in the body frame."""
        return self._built.mounts()

    def chassis(self) -> Chassis:
        """The rear wheels' motors stand for the hands that push it: up to 250 N, a strong person's push."""
        c, y = self.config, self.config.width_m / 2
        built = Builder()
        built.box("steel", (self._back, -y, DECK - 0.05), (self._front, y, c.height_m))
        loaded = c.load_mass_kg * c.load
        height = (c.mass_kg * c.height_m * 0.4 + loaded * (DECK + (c.height_m - DECK) * c.load / 2)) / (c.mass_kg + loaded)
        ahead = self._front - OVERHANG
        return Chassis(
            hull=built.boxes(),
            wheels=(Wheel("left", 0.0, y - 0.05, WHEEL_RADIUS), Wheel("right", 0.0, -y + 0.05, WHEEL_RADIUS)),
            castors=((ahead, y - 0.05, WHEEL_RADIUS), (ahead, -y + 0.05, WHEEL_RADIUS)),
            mass=c.mass_kg + loaded,
            com=((self._back + self._front) / 2, 0.0, height),
            force=250.0,
        )
