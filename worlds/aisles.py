"""A store of pallet racks in rows, with aisles between them and a cross aisle at either end: the road network of a warehouse."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity, rng
from testbed.columns import Array
from testbed.geometry import Roads, Zones
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.parts import Part, RackSize, floor_pose, rack, tray, wall

WALL = 0.2  # m
FLUE = 0.2  # m between racks that stand back to back


class Aisles(BaseHall):
    """`aisles` aisles along x, each between two racks that face it, and a cross aisle along y at either end.

    Bodies: rack1 and rack2 south and north of aisle 1, rack3 and rack4 of aisle 2, ...; tray1, ... above the aisles with
    antenna mounts a1, a2, ... that look down; four outer walls with antenna mounts on wall_west and wall_east. Roads: node 2i is
    the west end of aisle i (from 0), node 2i + 1 its east end; segment i is aisle i, the next ones lead along the cross aisles.
    """

    class Config(quantity.Config):
        aisles: Annotated[int, Field(ge=1, le=20)] = 3
        bays: Annotated[int, Field(ge=1, le=40)] = 6
        levels: Annotated[int, Field(ge=1, le=6)] = 3
        aisle_width_m: Annotated[Metres, Field(ge=1.2, le=6)] = 3.0
        cross_aisle_m: Annotated[Metres, Field(ge=1.5, le=10)] = 3.5
        bay_length_m: Annotated[Metres, Field(ge=0.8, le=4)] = 2.7
        rack_depth_m: Annotated[Metres, Field(ge=0.4, le=2)] = 1.1
        level_height_m: Annotated[Metres, Field(ge=0.6, le=3)] = 1.5
        antennas_per_aisle: Annotated[int, Field(ge=0, le=20)] = 4
        fill: Annotated[float, Field(ge=0, le=1)] = 0.8
        liquid: Annotated[float, Field(ge=0, le=1)] = 0.1
        layout_seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1

    config: Config

    @property
    def _size(self) -> RackSize:
        c = self.config
        return RackSize(c.bays, c.levels, c.bay_length_m, c.rack_depth_m, c.level_height_m)

    @property
    def _pitch(self) -> float:
        """From one aisle to the next, m."""
        return self.config.aisle_width_m + 2 * self.config.rack_depth_m + FLUE

    def _middle(self, aisle: int) -> float:
        """y of an aisle's middle line (from 0), m."""
        return FLUE / 2 + self.config.rack_depth_m + self.config.aisle_width_m / 2 + aisle * self._pitch

    def _extent(self) -> tuple[float, float, float]:
        return 2 * self.config.cross_aisle_m + self._size.length, self.config.aisles * self._pitch, self._size.height + 1.5

    def parts(self) -> list[Part]:
        c, size = self.config, self._size
        x, y, h = self._extent()
        out, parts = WALL / 2, []
        for aisle in range(c.aisles):
            middle, aside = self._middle(aisle), c.aisle_width_m / 2 + c.rack_depth_m / 2
            for number, (dy, yaw) in enumerate(((-aside, np.pi), (aside, 0.0)), start=2 * aisle + 1):
                random = rng.stream(c.layout_seed, 0, f"rack{number}")
                parts.append(rack(f"rack{number}", floor_pose(x / 2, middle + dy, yaw), size, c.fill, c.liquid, random))
            if c.antennas_per_aisle:
                ends = ((c.cross_aisle_m, middle), (x - c.cross_aisle_m, middle))
                parts.append(tray(f"tray{aisle + 1}", *ends, size.height + 0.5, c.antennas_per_aisle))
        return [
            *parts,
            wall("wall_south", (0.0, -out), (x, -out), h, WALL),
            wall("wall_east", (x + out, -WALL), (x + out, y + WALL), h, WALL, antennas=c.aisles),
            wall("wall_north", (x, y + out), (0.0, y + out), h, WALL),
            wall("wall_west", (-out, y + WALL), (-out, -WALL), h, WALL, antennas=c.aisles),
        ]

    def bounds(self) -> Array:
        x, y, h = self._extent()
        return np.array([[-WALL, -WALL, 0.0], [x + WALL, y + WALL, h]])

    def zones(self) -> Zones:
        c = self.config
        x, y, _ = self._extent()
        lanes = [(c.cross_aisle_m, self._middle(i) - c.aisle_width_m / 2, x - c.cross_aisle_m, self._middle(i) + c.aisle_width_m / 2)
                 for i in range(c.aisles)]  # fmt: skip
        names = [f"aisle{i + 1}" for i in range(c.aisles)] + ["cross_west", "cross_east"]
        return Zones(np.array(names), np.array([*lanes, (0, 0, c.cross_aisle_m, y), (x - c.cross_aisle_m, 0, x, y)]))

    def roads(self) -> Roads:
        c = self.config
        x, _, _ = self._extent()
        nodes = [(end, self._middle(i)) for i in range(c.aisles) for end in (c.cross_aisle_m / 2, x - c.cross_aisle_m / 2)]
        along = [(2 * i, 2 * i + 1) for i in range(c.aisles)]
        across = [(2 * i + side, 2 * i + 2 + side) for i in range(c.aisles - 1) for side in (0, 1)]
        return Roads(np.array(nodes), np.array(along + across))
