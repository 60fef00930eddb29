"""A hall with a network of roads, and racks between them: where a forklift drives that is to be located by its roads alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed import quantity, rng
from testbed.columns import Array
from testbed.geometry import Roads
from testbed.protocols import ActorPlan
from testbed.quantity import Metres, Point2
from testbed.roads import RoadGraph, project
from testbed.route import Route
from testbed.scene import Scene
from worlds.hall import BaseHall
from worlds.parts import UPRIGHT, GateSize, Part, RackSize, floor_pose, gate, rack, wall
from worlds.road_racks import Stand, stands
from worlds.vehicles import Drivable

WALL = 0.2  # m

# a stand-in for the network of El Mokhtari et al., "Indoor localization by particle map matching", Fig. 2: 26 segments, 216 m
_X, _Y = (0.0, 6.0, 15.0, 26.0, 34.0), (0.0, 8.0, 19.0, 25.0)
W3_NODES: tuple[Point2, ...] = tuple((x, y) for y in _Y for x in _X)
W3_SEGMENTS: tuple[tuple[int, int], ...] = (
    (0, 1), (1, 2), (2, 3), (3, 4), (5, 6), (7, 8), (8, 9), (10, 11), (11, 12), (13, 14), (15, 16), (16, 17), (17, 18),
    (18, 19), (0, 5), (2, 7), (3, 8), (4, 9), (5, 10), (6, 11), (8, 13), (9, 14), (10, 15), (11, 16), (12, 17), (14, 19),
)  # fmt: skip


class RoadHall(BaseHall):
    """Roads as given by nodes and segments (W3, 34 x 25 m, where left out), racks beside them, four walls round all.

    Bodies: rack1, ... along the roads in the order of their segments, right side first; gate1, ... over the middles of the segments
    that `gates` lists, walked through along the segment; wall_south, wall_east, wall_north, wall_west. `one_way` lists segments that
    run from their first node to their second alone. Nothing but a gate stands nearer to a road than half of `road_width_m`.
    """

    class Config(quantity.Config):
        nodes_m: Annotated[list[Point2], Field(min_length=2, max_length=2000)] = Field(default_factory=lambda: list(W3_NODES))
        segments: Annotated[list[tuple[int, int]], Field(min_length=1, max_length=5000)] = Field(default_factory=lambda: list(W3_SEGMENTS))
        one_way: Annotated[list[int], Field(max_length=5000)] = Field(default_factory=list)
        road_width_m: Annotated[Metres, Field(ge=1.2, le=10)] = 3.4
        margin_m: Annotated[Metres, Field(ge=1.0, le=20)] = 3.2
        height_m: Annotated[Metres, Field(ge=3, le=20)] = 6.0
        racks: bool = True
        rack_levels: Annotated[int, Field(ge=1, le=6)] = 3
        rack_depth_m: Annotated[Metres, Field(ge=0.4, le=2)] = 1.1
        bay_length_m: Annotated[Metres, Field(ge=0.8, le=4)] = 2.7
        gates: Annotated[list[int], Field(max_length=200)] = Field(default_factory=list)
        fill: Annotated[float, Field(ge=0, le=1)] = 0.8
        liquid: Annotated[float, Field(ge=0, le=1)] = 0.1
        layout_seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1

        @model_validator(mode="after")
        def _is_a_network(self) -> RoadHall.Config:
            network(self)  # its own words say what is wrong with it, and where
            for name in ("one_way", "gates"):
                listed: list[int] = getattr(self, name)
                wrong = next((i for i in listed if not 0 <= i < len(self.segments)), None)
                if wrong is not None:
                    raise ValueError(f"{name}: there is no segment {wrong}, they are 0 to {len(self.segments) - 1}")
                if len(set(listed)) < len(listed):
                    raise ValueError(f"{name}: a segment is listed twice in {listed}")
            if self.gates and self.road_width_m < 2.0:
                raise ValueError(f"gates want roads 2 m wide or more, road_width_m is {self.road_width_m:g}")
            if self.rack_levels * 1.5 > self.height_m:
                raise ValueError(f"{self.rack_levels} levels of 1.5 m don't fit under height_m {self.height_m:g}")
            return self

    config: Config

    def roads(self) -> Roads:
        return network(self.config)

    def parts(self) -> list[Part]:
        return [*self._racks(), *self._gates(), *self._walls()]

    def _racks(self) -> list[Part]:
        c = self.config
        if not c.racks:
            return []
        clear = c.road_width_m / 2
        inside = self.bounds()[:, :2] + [[WALL + 0.1], [-WALL - 0.1]]
        found = stands(self.roads(), clear, c.rack_depth_m, c.bay_length_m + UPRIGHT, UPRIGHT, inside)
        return [self._rack(f"rack{i}", stand) for i, stand in enumerate(found, start=1)]

    def _rack(self, name: str, stand: Stand) -> Part:
        c = self.config
        size = RackSize(stand.bays, c.rack_levels, c.bay_length_m, c.rack_depth_m)
        return rack(
            name, floor_pose(stand.center[0], stand.center[1], stand.yaw), size, c.fill, c.liquid, rng.stream(c.layout_seed, 0, name)
        )

    def _gates(self) -> list[Part]:
        roads, width = self.roads(), min(self.config.road_width_m - 0.4, 2.9)
        found = []
        for i, segment in enumerate(self.config.gates, start=1):
            (ax, ay), (bx, by) = roads.nodes[roads.segments[segment]]
            pose = floor_pose((ax + bx) / 2, (ay + by) / 2, np.arctan2(by - ay, bx - ax))
            found.append(gate(f"gate{i}", pose, GateSize(width, 2.5)))
        return found

    def _walls(self) -> list[Part]:
        (x0, y0, _), (x1, y1, h) = self.bounds()
        out = WALL / 2
        return [
            wall("wall_south", (x0 + WALL, y0 + out), (x1 - WALL, y0 + out), h, WALL),
            wall("wall_east", (x1 - out, y0), (x1 - out, y1), h, WALL),
            wall("wall_north", (x1 - WALL, y1 - out), (x0 + WALL, y1 - out), h, WALL),
            wall("wall_west", (x0 + out, y1), (x0 + out, y0), h, WALL),
        ]

    def bounds(self) -> Array:
        c = self.config
        nodes, reach = np.array(c.nodes_m), c.margin_m + WALL
        return np.array([[*(nodes.min(axis=0) - reach), 0.0], [*(nodes.max(axis=0) + reach), c.height_m]])

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The hall with its actors at rest. ValueError, naming the way point, for the route of a vehicle that leaves the roads."""
        for plan in actors:
            if isinstance(plan.route, Route) and isinstance(plan.actor, Drivable):  # a person goes where there is room
                self._keeps_to_the_roads(plan.id, plan.route)
        return super().scene(actors)

    def _keeps_to_the_roads(self, actor: str, route: Route) -> None:
        _, _, distance = project(self.roads(), np.array(route.waypoints_m))
        off = np.flatnonzero(distance > self.config.road_width_m / 2)
        if len(off):
            x, y = route.waypoints_m[off[0]]
            raise ValueError(
                f"actor {actor}: way point {off[0]} at ({x:g}, {y:g}) is off the roads, {distance[off[0]]:.1f} m from the nearest"
            )


def network(config: RoadHall.Config) -> Roads:
    """The roads of a configuration. ValueError, naming the place, for what is no network."""
    one_way = np.isin(np.arange(len(config.segments)), config.one_way)
    return RoadGraph(Roads(np.array(config.nodes_m), np.array(config.segments), one_way)).roads
