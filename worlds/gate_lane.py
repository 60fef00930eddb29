"""A lane through one gate, with roll cages parked beside it in the passage: they stand between the antennas and what is pushed through."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.columns import Array
from testbed.geometry import Zones
from testbed.quantity import Metres
from worlds.actors.trolley import OVERHANG, Trolley
from worlds.hall import BaseHall
from worlds.parts import GateSize, Part, floor_pose, gate, wall

GATE = (5.0, 3.0)  # m, where the gate stands; the lane leads along +x
DOOR = 3.2  # m, clear width of the opening that the gate stands in
CAGE_Y = 0.93  # m from the lane's middle to the middle of a cage: 0.2 m are left beside a trolley of usual width
# the middles of the places in the passage, m along the lane from the gate: before and behind it on the left, then on the right
PLACES = [(x, side * CAGE_Y) for side in (1, -1) for x in (-0.65, 0.65)]


class GateLane(BaseHall):
    """A floor over (0, 0) to (10, 6), gate1 at (5, 3) in a wall, walked through along +x from "outside" to "inside".

    Bodies: gate1 with its antenna mounts, wall_gate, and `cages` roll cages, cage1, ..., in the passage: the first two on the left
    side, before and behind the antennas there, the other two on the right. Every cage has the tag mounts of a trolley.
    """

    class Config(quantity.Config):
        cages: Annotated[int, Field(ge=0, le=len(PLACES))] = 4
        gate_toe_deg: Annotated[quantity.Degrees, Field(ge=0, le=80)] = 40.0
        antenna_low_m: Annotated[Metres, Field(ge=0.2, le=2.4)] = 0.7
        antenna_high_m: Annotated[Metres, Field(ge=0.2, le=2.4)] = 1.7

    config: Config

    def parts(self) -> list[Part]:
        c, (x, y) = self.config, GATE
        size = GateSize(low=c.antenna_low_m, high=c.antenna_high_m, toe=np.radians(c.gate_toe_deg))
        opening = [(y - DOOR / 2, y + DOOR / 2)]
        divide = wall("wall_gate", (x - 0.25, 0.0), (x - 0.25, 2 * y), 4.0, openings=opening)
        return [divide, gate("gate1", floor_pose(x, y), size), *self._cages()]

    def _cages(self) -> list[Part]:
        trolley = Trolley(Trolley.Config())
        back = trolley.config.length_m / 2 - OVERHANG  # from a cage's middle to the axle that is its origin
        boxes, mounts = trolley.boxes()[0], trolley.mounts()
        poses = [floor_pose(GATE[0] + x - back, GATE[1] + y) for x, y in PLACES[: self.config.cages]]
        return [Part(f"cage{i}", "trolley", pose, boxes, mounts) for i, pose in enumerate(poses, start=1)]

    def bounds(self) -> Array:
        return np.array([[-0.2, -0.2, 0.0], [10.2, 2 * GATE[1] + 0.2, 4.2]])

    def zones(self) -> Zones:
        x, y = GATE
        return Zones(np.array(["outside", "inside"]), np.array([[0.0, 0.0, x, 2 * y], [x, 0.0, 2 * x, 2 * y]]))
