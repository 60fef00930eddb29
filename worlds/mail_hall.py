"""A mail hall: gates side by side in a dividing wall, roll cages parked on either side of each."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed import frames, quantity
from testbed.columns import Array
from testbed.geometry import Zones
from testbed.quantity import Degrees, Metres
from worlds.actors.trolley import OVERHANG, Trolley
from worlds.hall import BaseHall
from worlds.parts import GateSize, Part, floor_pose, gate, wall

WALL = 0.2  # m
DOOR = 3.2  # m, clear width of the opening that a gate stands in
PITCH = 9.0  # m from one gate to the next
SIDE = 6.0  # m from the gates' plane to either end of the hall
# in a gate's frame, m: the middles of the places to park, which look at the passage; the nearest ones first
PLACES = [(x, side * y) for y in (2.05, 3.0) for x in (1.0, -1.0) for side in (1, -1)]


class MailHall(BaseHall):
    """Gates gate1, gate2, ... from the south, PITCH apart in a wall at x = 6 m, walked through along +x from "outside" to "inside".

    Each has antenna mounts left_low, left_high, right_low, right_high, top_left, top_right as every gate: the low ones look `gate_toe_deg`
    outwards, the high ones inwards. Beside each stand up to 8 roll cages, parked1, ... (gate by gate, the nearest ones first),
    their fronts to the passage. Nothing else stands in the hall: trolleys come and go.
    """

    class Config(quantity.Config):
        gates: Annotated[int, Field(ge=1, le=40)] = 1
        gate_width_m: Annotated[Metres, Field(ge=1.2, le=2.9)] = 2.6
        gate_height_m: Annotated[Metres, Field(ge=2.0, le=2.9)] = 2.5
        gate_toe_deg: Annotated[Degrees, Field(ge=0, le=80)] = 40.0
        antenna_low_m: Annotated[Metres, Field(ge=0.2, le=2.9)] = 0.7
        antenna_high_m: Annotated[Metres, Field(ge=0.2, le=2.9)] = 1.5
        parked_trolleys: Annotated[int, Field(ge=0, le=len(PLACES))] = 6
        walls: bool = True

        @model_validator(mode="after")
        def _fits(self) -> MailHall.Config:
            if max(self.antenna_low_m, self.antenna_high_m) >= self.gate_height_m:
                raise ValueError(f"the antennas must hang below the crossbar at gate_height_m {self.gate_height_m:g}")
            return self

    config: Config

    def parts(self) -> list[Part]:
        c = self.config
        size = GateSize(c.gate_width_m, c.gate_height_m, low=c.antenna_low_m, high=c.antenna_high_m, toe=np.radians(c.gate_toe_deg))
        poses = [floor_pose(SIDE, y) for y in self._doors()]
        gates = [gate(f"gate{i}", pose, size) for i, pose in enumerate(poses, start=1)]
        return [*(self._walls() if c.walls else []), *gates, *self._parked(poses)]

    def _doors(self) -> Array:
        return PITCH * (np.arange(self.config.gates) + 0.5)

    def _walls(self) -> list[Part]:
        openings = [(y - DOOR / 2, y + DOOR / 2) for y in self._doors()]
        return [wall("wall_gates", (SIDE - 0.25, 0.0), (SIDE - 0.25, PITCH * self.config.gates), 4.0, WALL, openings)]

    def _parked(self, gates: list[Array]) -> list[Part]:
        trolley, found = Trolley(Trolley.Config()), []
        boxes, mounts = trolley.boxes()[0], trolley.mounts()
        middle = trolley.config.length_m / 2 - OVERHANG  # of the cage, before the axle that is its origin
        for pose in gates:
            for x, y in PLACES[: self.config.parked_trolleys]:
                own = floor_pose(x, y + np.sign(y) * middle, -np.sign(y) * np.pi / 2)
                found.append(Part(f"parked{len(found) + 1}", "trolley", frames.compose(pose, own), boxes, mounts))
        return found

    def bounds(self) -> Array:
        return np.array([[0.0, 0.0, 0.0], [2 * SIDE, PITCH * self.config.gates, 4.0]])

    def zones(self) -> Zones:
        y = PITCH * self.config.gates
        return Zones(np.array(["outside", "inside"]), np.array([[0, 0, SIDE, y], [SIDE, 0, 2 * SIDE, y]]))
