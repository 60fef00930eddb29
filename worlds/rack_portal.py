"""A lane past a steel rack and through a portal: antennas behind the rack lose sight of what rolls by, and get it back."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import quantity
from testbed.columns import Array
from testbed.geometry import Zones
from testbed.quantity import Metres
from worlds.hall import BaseHall
from worlds.parts import UPRIGHT, Builder, GateSize, Part, floor_pose, gate, post

LANE = 2.5  # m, y of the lane's middle
RACK_X, RACK_Y, DEPTH = 4.0, 3.8, 0.5  # m, middle of the rack and its depth: its front is 0.7 m beside a trolley of usual width
SHEET = 0.03  # m, folded steel shelves and back
BEHIND, ASIDE = 5.6, 0.4  # m, y of the stands behind the rack; how far each is from the rack's middle along x
GATE_X = 9.0  # m
STAND = 1.2  # m, height of a stand: its one antenna used here is 1 m high


class RackPortal(BaseHall):
    """A floor over (0, 0) to (12, 6.5); the lane leads along +x at y = 2.5, past rack1 (x = 4) and through gate1 (x = 9).

    Bodies: rack1, open steel shelves with a steel back, empty; behind1 and behind2, antenna stands behind it, which look straight
    across; front1, a stand on the other side of the lane, in full sight of it; gate1 as in other halls. Stands have mounts low (1 m)
    and high. With `rack: false` everything else is the same.
    """

    class Config(quantity.Config):
        rack: bool = True
        rack_length_m: Annotated[Metres, Field(ge=0.5, le=5)] = 1.2
        rack_height_m: Annotated[Metres, Field(ge=0.5, le=4)] = 2.0
        shelves: Annotated[int, Field(ge=1, le=10)] = 4

    config: Config

    def parts(self) -> list[Part]:
        stands = [("behind1", RACK_X - ASIDE, BEHIND), ("behind2", RACK_X + ASIDE, BEHIND), ("front1", RACK_X, 0.3)]
        posts = [post(name, x, y, (x, LANE), STAND) for name, x, y in stands]
        racks = [shelving("rack1", floor_pose(RACK_X, RACK_Y), self.config)] if self.config.rack else []
        return [*racks, *posts, gate("gate1", floor_pose(GATE_X, LANE), GateSize())]

    def bounds(self) -> Array:
        return np.array([[-0.2, -0.2, 0.0], [12.2, 6.7, 4.2]])

    def zones(self) -> Zones:
        return Zones(np.array(["before", "beyond"]), np.array([[0.0, 0.0, GATE_X, 6.5], [GATE_X, 0.0, 12.0, 6.5]]))


def shelving(name: str, pose: Array, size: RackPortal.Config) -> Part:
    """Steel shelves between four uprights, with a steel back away from the front (-y); the lowest shelf is near the floor."""
    built, half = Builder(), size.rack_length_m / 2
    front, back = -DEPTH / 2, DEPTH / 2
    for x in (-half, half - UPRIGHT):
        for y in (front, back - UPRIGHT):
            built.box("steel", (x, y, 0.0), (x + UPRIGHT, y + UPRIGHT, size.rack_height_m))
    inner = half - UPRIGHT
    for z in np.linspace(0.1, size.rack_height_m, size.shelves, endpoint=size.shelves > 1) - SHEET:
        built.box("steel", (-inner, front, z), (inner, back - SHEET, z + SHEET))
    built.box("steel", (-inner, back - SHEET, 0.0), (inner, back, size.rack_height_m))
    return built.part(name, "rack", pose)
