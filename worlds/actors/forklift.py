"""A three-wheeled counterbalance forklift, steered and driven by its rear wheel, perhaps with a pallet on its forks."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.geometry import Boxes, Mounts
from testbed.quantity import Kilograms, Metres
from worlds import people
from worlds.parts import MATERIALS, STAND_OFF, Builder, pallet
from worlds.vehicles import Chassis, Wheel

FRONT_RADIUS, REAR_RADIUS = 0.23, 0.18  # m
FACE = 0.42  # m from the front axle to the face of the forks
FORKS = 1.15  # m, their length
SEAT = 0.98  # m, its height and that of the counterweight
ROOF = 2.05  # m, overhead guard


class Forklift:
    """Origin below the middle of the front axle, forks towards +x; loosely a 1.6 t electric three-wheeler.

    Tag mounts: left, right (on the body), back (counterweight), top (overhead guard), mast, and load (front of the goods, or
    the tip of the forks without). Antenna mount "reader" above the forks, looking forward.
    """

    class Config(quantity.Config):
        load: Literal["none", "cartons", "liquid"] = "cartons"
        load_height_m: Annotated[Metres, Field(ge=0.3, le=2.0)] = 1.1
        load_mass_kg: Annotated[Kilograms, Field(ge=0, le=2000)] = 350.0
        fork_height_m: Annotated[Metres, Field(ge=0.05, le=1.0)] = 0.15
        wheelbase_m: Annotated[Metres, Field(ge=0.9, le=2.5)] = 1.3
        width_m: Annotated[Metres, Field(ge=0.8, le=1.6)] = 1.05
        mass_kg: Annotated[Kilograms, Field(ge=500, le=6000)] = 2800.0
        driver: bool = True

    def __init__(self, config: Config) -> None:
        self.config = config
        self._built = Builder()
        self._body()
        self._front()
        self._mounts()
        if config.driver:
            people.sit(self._built, -self._rear * 0.55 + 0.12, SEAT)

    @property
    def _rear(self) -> float:
        return self.config.wheelbase_m + 0.3  # m from the origin to the back of the counterweight

    def _body(self) -> None:
        half, rear, built = self.config.width_m / 2, self._rear, self._built
        built.box("steel", (-rear, -half, 0.35), (-rear * 0.55, half, SEAT))  # counterweight
        built.box("steel", (-rear * 0.55, -half, 0.3), (0.25, half, 0.62))
        built.box("plastic", (-rear * 0.55, -0.3, 0.62), (-rear * 0.55 + 0.5, 0.3, SEAT))
        for px in (-rear + 0.25, 0.15):
            for py in (-half, half - 0.05):
                built.box("steel", (px, py, SEAT if px < 0 else 0.62), (px + 0.05, py + 0.05, ROOF))
        built.box("steel", (-rear + 0.25, -half, ROOF), (0.2, half, ROOF + 0.05))
        for py in (-half + 0.02, half - 0.2):
            built.box("rubber", (-FRONT_RADIUS, py, 0.0), (FRONT_RADIUS, py + 0.18, 0.29))
        built.box("rubber", (-self.config.wheelbase_m - 0.18, -0.1, 0.0), (-self.config.wheelbase_m + 0.18, 0.1, 0.34))

    def _front(self) -> None:
        c, built = self.config, self._built
        for side in (1, -1):
            low, high = sorted((side * 0.28, side * 0.38))
            built.box("steel", (0.26, low, 0.08), (0.38, high, ROOF))  # mast
            low, high = sorted((side * 0.2, side * 0.32))
            built.box("steel", (FACE, low, c.fork_height_m - 0.04), (FACE + FORKS, high, c.fork_height_m))
        built.box("steel", (0.38, -0.45, c.fork_height_m - 0.04), (FACE, 0.45, c.fork_height_m + 0.45))  # carriage
        if c.load != "none":
            goods = "carton" if c.load == "cartons" else "liquid_pallet"
            pallet(built, (FACE + 0.01, -0.4), (FACE + 1.21, 0.4), c.fork_height_m + 0.001, goods, c.load_height_m)

    def _mounts(self) -> None:
        c, half, mount = self.config, self.config.width_m / 2, self._built.mount
        mount("left", (-0.3, half + STAND_OFF, 0.5), np.pi / 2)
        mount("right", (-0.3, -half - STAND_OFF, 0.5), -np.pi / 2)
        mount("back", (-self._rear - STAND_OFF, 0.0, 0.7), np.pi)
        mount("top", (-self._rear / 2, 0.0, ROOF + 0.05 + STAND_OFF), pitch=-np.pi / 2)
        mount("mast", (0.38 + STAND_OFF, 0.33, ROOF - 0.1), 0.0)
        loaded = c.load != "none"
        mount("load", (FACE + (1.21 if loaded else FORKS) + STAND_OFF, 0.0, c.fork_height_m + (c.load_height_m / 2 if loaded else 0.05)))
        mount("reader", (0.38 + STAND_OFF, 0.0, ROOF - 0.05), use="antenna", group="reader")

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """Boxes in the body frame and the names of their materials."""
        return self._built.boxes(), MATERIALS

    def mounts(self) -> Mounts:
        """Places for tags and for an antenna of its own."""
        return self._built.mounts()

    def chassis(self) -> Chassis:
        """Front wheels roll free, the rear wheel steers and drives; the load moves the centre of mass forward."""
        c, half, rear = self.config, self.config.width_m / 2, self._rear
        built = Builder()
        built.box("steel", (-rear, -half, 0.35), (0.38, half, ROOF))
        load = 0.0 if c.load == "none" else c.load_mass_kg
        reach, height = (1.22, c.load_height_m) if load else (FORKS, 0.1)
        built.box("steel", (0.38, -0.45, c.fork_height_m), (FACE + reach, 0.45, c.fork_height_m + height))
        own, ahead = -0.62 * c.wheelbase_m, FACE + 0.61
        mass = c.mass_kg + load
        return Chassis(
            hull=built.boxes(),
            wheels=(
                Wheel("left", 0.0, half - 0.11, FRONT_RADIUS),
                Wheel("right", 0.0, -half + 0.11, FRONT_RADIUS),
                Wheel("rear", -c.wheelbase_m, 0.0, REAR_RADIUS, steered=True),
            ),
            mass=mass,
            com=((c.mass_kg * own + load * ahead) / mass, 0.0, (c.mass_kg * 0.6 + load * (c.fork_height_m + c.load_height_m / 2)) / mass),
            force=6000.0,
            wheel_mass=25.0,
        )
