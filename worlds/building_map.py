"""A hall from an Open-RMF building map: walls and furniture as drawn, lanes as a network of roads."""

from __future__ import annotations

from collections import Counter
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes, Roads
from testbed.quantity import Metres, Point3
from testbed.roads import RoadGraph
from worlds.hall import BaseHall
from worlds.importers.building_file import Item, Level, building
from worlds.importers.files import FileConfig, ReadsFiles, WorldFileError
from worlds.importers.hall import check_materials, many, material, plain_names, room, with_sides
from worlds.parts import MATERIALS, Part, floor_pose, wall

PANEL = 0.05  # m: thickness of a closed door
SHORTEST = 0.01  # m: a wall below it is none


class BuildingMap(ReadsFiles, BaseHall):
    """Bodies: wall1, ... as drawn, their doors gaps or, closed, panels under the doors' names; models under their names, with tag
    mounts on their sides (front.1, ..., left, back, right, top). A model's shape isn't in the file: it is a cuboid of what `sizes_m` says.

    path      : the file, relative to the scenario's folder
    level     : which one, where there are several
    sizes_m   : by pattern over model names, length (along its own x), width and height; models without one are left out, and noted
    materials : by pattern over model names, what they are made of; `material` without one
    lanes     : whether lanes become roads, for those that can't be driven on are refused
    """

    class Config(FileConfig):
        path: Annotated[str, Field(min_length=1, max_length=1000)]
        level: str | None = None
        wall_height_m: Annotated[Metres, Field(gt=0, le=50)] = 2.5
        wall_thickness_m: Annotated[Metres, Field(gt=0, le=2)] = 0.1
        wall_material: str = "concrete"
        doors: Literal["open", "closed"] = "open"
        sizes_m: Annotated[dict[str, Point3], Field(max_length=200)] = Field(default_factory=dict)
        materials: Annotated[dict[str, str], Field(max_length=200)] = Field(default_factory=dict)
        material: str = "wood"
        lanes: bool = True

        @model_validator(mode="after")
        def _makes_sense(self) -> BuildingMap.Config:
            check_materials([self.wall_material, self.material, *self.materials.values()])
            wrong = next((name for name, size in self.sizes_m.items() if not all(0 < s <= 100 for s in size)), None)
            if wrong is not None:
                raise ValueError(f"sizes_m: {wrong!r} wants measures above 0 and up to 100 m, not {list(self.sizes_m[wrong])}")
            return self

    config: Config

    @cached_property
    def level(self) -> Level:
        """What the file says."""
        return building(self.config.placed(self.config.path), self.config.level)

    def parts(self) -> list[Part]:
        return self._parts

    @cached_property
    def _parts(self) -> list[Part]:
        return [*self._walls(), *self._doors(), *self._models()]

    def _walls(self) -> list[Part]:
        found = []
        for (x0, y0), (x1, y1) in self.level.walls.tolist():
            if np.hypot(x1 - x0, y1 - y0) >= SHORTEST:
                found.append(self._wall(f"wall{len(found) + 1}", (x0, y0), (x1, y1)))
        return found

    def _wall(self, name: str, start: tuple[float, float], end: tuple[float, float]) -> Part:
        part = wall(name, start, end, self.config.wall_height_m, self.config.wall_thickness_m)
        of = MATERIALS.index(self.config.wall_material)
        return Part(name, "wall", part.pose, part.boxes.with_(material=np.full(len(part.boxes), of)), part.mounts)

    def _doors(self) -> list[Part]:
        if self.config.doors == "open":
            return []
        found = []
        for name, ((x0, y0), (x1, y1)) in zip(plain_names(self.level.door_names), self.level.doors.tolist(), strict=True):
            if np.hypot(x1 - x0, y1 - y0) >= SHORTEST:
                part = wall(name, (x0, y0), (x1, y1), min(2.1, self.config.wall_height_m), PANEL)
                boxes = part.boxes.with_(material=np.full(len(part.boxes), MATERIALS.index("wood")))
                found.append(Part(name, "door", part.pose, boxes, part.mounts))
        return found

    def _models(self) -> list[Part]:
        known = [(item, size) for item in self.level.items if (size := self._size(item)) is not None]
        names = plain_names([item.name.rpartition("/")[2] for item, _ in known])
        return [self._model(name, item, size) for name, (item, size) in zip(names, known, strict=True)]

    def _size(self, item: Item) -> Point3 | None:
        return next((size for pattern, size in self.config.sizes_m.items() if fnmatchcase(item.kind, pattern)), None)

    def _model(self, name: str, item: Item, size: Point3) -> Part:
        of, half = material(self.config.materials, item.kind, self.config.material), np.array([size]) / 2
        boxes = Boxes(half * [0, 0, 1], frames.IDENTITY[None, 3:], half, body=np.zeros(1), material=np.array([of]))
        pose = floor_pose(item.x, item.y, item.yaw)
        pose[2] = item.z
        return with_sides(name, item.kind.rpartition("/")[2], pose, boxes, Meshes.empty())

    def roads(self) -> Roads | None:
        """The lanes. WorldFileError where nobody could drive on them."""
        roads = self.level.roads if self.config.lanes else None
        if roads is None:
            return None
        try:
            return RoadGraph(roads).roads
        except ValueError as error:
            raise WorldFileError(f"{self.config.path}: its lanes are no network ({error}): lanes: false leaves them out") from None

    def bounds(self) -> Array:
        nodes = np.zeros((0, 2)) if (roads := self.roads()) is None else roads.nodes
        parts = self.parts()
        if not len(parts) + len(nodes):
            raise WorldFileError(f"{self.config.path}: there is neither a wall nor a lane in it")
        around = [nodes, *([room(parts, self.config.path)[:, :2]] if parts else [])]
        corners = np.concatenate(around)
        return np.array([[*corners.min(axis=0), 0.0], [*corners.max(axis=0), max(3.0, self.config.wall_height_m)]])

    def notes(self) -> list[str]:
        """In sentences what the file became, and what of it was left out."""
        level, unknown = self.level, Counter(item.kind for item in self.level.items if self._size(item) is None)
        length = np.hypot(*(level.walls[:, 1] - level.walls[:, 0]).T).sum()
        doors = f"{many(len(level.doors), 'door', 'doors')} {self.config.doors}"
        found = [f"{many(len(level.walls), 'wall', 'walls')} of {length:.1f} m at {level.scale * 1000:.3f} mm a pixel, {doors}"]
        if (roads := self.roads()) is not None:
            ends = roads.nodes[roads.segments]
            found.append(f"{many(len(roads.segments), 'lane', 'lanes')} of {np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum():.1f} m")
        if unknown:
            named = ", ".join(f"{kind} ({n})" for kind, n in unknown.items())
            found.append(f"{many(sum(unknown.values()), 'model is', 'models are')} left out: sizes_m doesn't tell how large: {named}")
        return [*found, *level.notes]
