"""A dock hall: what comes in from the trucks goes through a gate in the dividing wall, past trolleys that are parked beside it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed import quantity, rng
from testbed.columns import Array
from testbed.geometry import Zones
from testbed.quantity import Degrees, Metres
from worlds.actors.trolley import Trolley
from worlds.hall import BaseHall
from worlds.parts import GateSize, Part, RackSize, floor_pose, gate, pallet_stack, rack, wall

WALL = 0.2  # m
DOOR = 3.2  # m, clear width of a door in the dividing wall
DIVIDE = 5.0  # m, x of the dividing wall: the dock apron lies before it, the hall behind
GATE_X = DIVIDE + 0.25  # m, the posts stand just inside the doors
PLACE = 0.95  # m of wall for each parked trolley
BAY, DEPTH = 1.8, 1.0  # m


class DockGate(BaseHall):
    """A hall over (0, 0) to (length, width), the dock apron ("outside") in the west, the store ("inside") in the east.

    Bodies: gate1, gate2, ... from the south in the doors of wall_dock, walked through along +x, each with antenna mounts left_low,
    left_high, right_low, right_high, top_left, top_right; parked1, ... trolleys beside the doors, nearest to gate1 first,
    alternately inside and outside; rack1 along the north wall, rack2 along the south wall, rack3 an island in the middle, rack4
    along the east wall; pallet1, ... on the apron; the four outer walls, with antenna mounts a1, a2, ... on wall_north and wall_south.
    """

    class Config(quantity.Config):
        length_m: Annotated[Metres, Field(ge=12, le=60)] = 14.0
        width_m: Annotated[Metres, Field(ge=8, le=60)] = 12.0
        height_m: Annotated[Metres, Field(ge=4.5, le=15)] = 6.0
        gates: Annotated[int, Field(ge=1, le=8)] = 2
        gate_width_m: Annotated[Metres, Field(ge=1.2, le=2.9)] = 2.6
        gate_height_m: Annotated[Metres, Field(ge=2.0, le=2.9)] = 2.5
        gate_toe_deg: Annotated[Degrees, Field(ge=0, le=60)] = 25.0
        antenna_low_m: Annotated[Metres, Field(ge=0.2, le=2.9)] = 0.7
        antenna_high_m: Annotated[Metres, Field(ge=0.2, le=2.9)] = 1.7
        parked_trolleys: Annotated[int, Field(ge=0, le=60)] = 6
        racks: Annotated[int, Field(ge=0, le=4)] = 3
        rack_levels: Annotated[int, Field(ge=1, le=4)] = 3
        fill: Annotated[float, Field(ge=0, le=1)] = 0.75
        liquid: Annotated[float, Field(ge=0, le=1)] = 0.1
        pallets: Annotated[int, Field(ge=0, le=4)] = 2
        layout_seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1

        @model_validator(mode="after")
        def _fits(self) -> DockGate.Config:
            if self.gates * (DOOR + 0.8) > self.width_m:
                raise ValueError(f"{self.gates} gates need a hall {self.gates * (DOOR + 0.8):g} m wide, width_m is {self.width_m:g}")
            if max(self.antenna_low_m, self.antenna_high_m) >= self.gate_height_m:
                raise ValueError(f"the antennas must hang below the crossbar at gate_height_m {self.gate_height_m:g}")
            places = len(_parking(self))
            if self.parked_trolleys > places:
                raise ValueError(f"parked_trolleys: {self.parked_trolleys} asked for, beside {self.gates} gates there is room for {places}")
            if self.rack_levels * 1.5 > self.height_m:
                raise ValueError(f"{self.rack_levels} levels of 1.5 m don't fit under height_m {self.height_m:g}")
            return self

    config: Config

    def parts(self) -> list[Part]:
        c = self.config
        doors = _doors(c)
        size = GateSize(c.gate_width_m, c.gate_height_m, low=c.antenna_low_m, high=c.antenna_high_m, toe=np.radians(c.gate_toe_deg))
        gates = [gate(f"gate{i}", floor_pose(GATE_X, y), size) for i, y in enumerate(doors, start=1)]
        trolley = Trolley(Trolley.Config())
        parked = [
            Part(f"parked{i}", "trolley", pose, trolley.boxes()[0], trolley.mounts())
            for i, pose in enumerate(_parking(c)[: c.parked_trolleys], start=1)
        ]
        return [*self._walls(doors), *gates, *self._racks(), *parked, *self._pallets()]

    def _walls(self, doors: list[float]) -> list[Part]:
        c, out = self.config, WALL / 2
        x, y, h = c.length_m, c.width_m, c.height_m
        openings = [(d - DOOR / 2, d + DOOR / 2) for d in doors]
        return [
            wall("wall_south", (0.0, -out), (x, -out), h, WALL, antennas=4),
            wall("wall_east", (x + out, -WALL), (x + out, y + WALL), h, WALL),
            wall("wall_north", (x, y + out), (0.0, y + out), h, WALL, antennas=4),
            wall("wall_west", (-out, y + WALL), (-out, -WALL), h, WALL),
            wall("wall_dock", (DIVIDE, 0.0), (DIVIDE, y), h, WALL, openings),
        ]

    def _racks(self) -> list[Part]:
        c = self.config
        x, y = c.length_m, c.width_m
        first, last = DIVIDE + 3.2, x - 0.3  # the lane behind the gates stays free
        along = RackSize(int((last - first) / (BAY + 0.1)), c.rack_levels, BAY, DEPTH)
        island = RackSize(max(1, int((last - first - 2.4) / (BAY + 0.1))), c.rack_levels, BAY, DEPTH)
        east = RackSize(max(1, int((y - 2 * (DEPTH + 2.6)) / (BAY + 0.1))), c.rack_levels, BAY, DEPTH)
        middle = (first + last) / 2
        places = [
            (along, floor_pose(middle, y - DEPTH / 2 - 0.1, 0.0)),
            (along, floor_pose(middle, DEPTH / 2 + 0.1, np.pi)),
            (island, floor_pose(middle - (0.6 if c.racks > 3 else 0.0), y / 2, 0.0)),
            (east, floor_pose(x - DEPTH / 2 - 0.1, y / 2, -np.pi / 2)),
        ]
        return [
            rack(f"rack{i}", pose, size, c.fill, c.liquid, rng.stream(c.layout_seed, 0, f"rack{i}"))
            for i, (size, pose) in enumerate(places[: c.racks], start=1)
        ]

    def _pallets(self) -> list[Part]:
        y = self.config.width_m
        places = [(0.7, 0.6, "carton"), (0.7, y - 0.6, "liquid_pallet"), (2.2, y - 0.6, "carton"), (2.2, 0.6, "carton")]
        return [
            pallet_stack(f"pallet{i}", floor_pose(px, py), goods)
            for i, (px, py, goods) in enumerate(places[: self.config.pallets], start=1)
        ]

    def bounds(self) -> Array:
        c = self.config
        return np.array([[-WALL, -WALL, 0.0], [c.length_m + WALL, c.width_m + WALL, c.height_m]])

    def zones(self) -> Zones:
        c = self.config
        return Zones(np.array(["outside", "inside"]), np.array([[0, 0, DIVIDE, c.width_m], [DIVIDE, 0, c.length_m, c.width_m]]))


def _doors(c: DockGate.Config) -> list[float]:
    """y of the middle of each door, m: evenly along the wall."""
    return [c.width_m * (i + 0.5) / c.gates for i in range(c.gates)]


def _parking(c: DockGate.Config) -> list[Array]:
    """Poses of all places to park beside the doors, clear of the passages, nearest to gate1 first, inside before outside."""
    doors = _doors(c)
    edges = [0.15, *(e for d in doors for e in (d - DOOR / 2 - 0.05, d + DOOR / 2 + 0.05)), c.width_m - 0.15]
    free = []
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        count = int((high - low) / PLACE + 1e-9)
        free += [low + (high - low) * (i + 0.5) / count for i in range(count)]
    free.sort(key=lambda y: (abs(y - doors[0]), y))
    return [floor_pose(x, y, yaw) for y in free for x, yaw in ((DIVIDE + 0.35, 0.0), (DIVIDE - 0.35, np.pi))]
