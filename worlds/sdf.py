"""A hall that somebody modelled for Gazebo: an SDFormat world, its models and their collision meshes."""

from __future__ import annotations

from collections import Counter
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes
from worlds.hall import BaseHall
from worlds.importers.files import FileConfig, ReadsFiles
from worlds.importers.hall import check_materials, chosen, many, material, plain_names, room, with_sides
from worlds.importers.sdf_file import Model, SdfWorld
from worlds.parts import Part

MODEL_PATH = ("models", "../models", ".", "..")
Patterns = Annotated[dict[str, str], Field(max_length=200)]


class Sdf(ReadsFiles, BaseHall):
    """Every model at the top of the world file is a body under its own name, with tag mounts on its sides (front.1, ..., left, back, right,
    top).

    Their collision shapes are boxes where they are boxes, and meshes that rays pass the gaps of where they aren't; `notes` says how
    many of which. The floor is z = 0: a ground plate that lies higher is left out by `leave_out`. Nothing moves but the scenario's actors.

    path         : the file, relative to the scenario's folder
    model_path   : folders, relative to the file's, in which model:// names are looked for, in their order
    leave_out    : models (patterns over names) that are not wanted, such as a roof
    drop_prefix  : what names of models begin with in vain
    kinds        : by pattern, what a model is ("wall", "rack", ...): a renderer cuts off walls; "model" without one
    materials    : by pattern, what a model is made of; `material` without one
    """

    class Config(FileConfig):
        path: Annotated[str, Field(min_length=1, max_length=1000)]
        model_path: Annotated[list[str], Field(min_length=1, max_length=20)] = Field(default_factory=lambda: list(MODEL_PATH))
        leave_out: Annotated[list[str], Field(max_length=200)] = Field(default_factory=list)
        drop_prefix: Annotated[str, Field(max_length=200)] = ""
        kinds: Patterns = Field(default_factory=dict)
        materials: Patterns = Field(default_factory=dict)
        material: str = "steel"

        @model_validator(mode="after")
        def _knows_its_materials(self) -> Sdf.Config:
            check_materials([self.material, *self.materials.values()])
            return self

    config: Config

    @cached_property
    def _file(self) -> SdfWorld:
        place = self.config.placed(self.config.path)
        folders = [Path(place.parent / folder).resolve() for folder in self.config.model_path]
        return SdfWorld(place, [folder for folder in folders if folder.is_dir()])

    @cached_property
    def _parts(self) -> list[Part]:
        wanted = [m for m in self._file.bodies if m.shapes and not any(fnmatchcase(m.name, p) for p in self.config.leave_out)]
        names = plain_names([m.name.removeprefix(self.config.drop_prefix) for m in wanted])
        return [self._part(name, model) for name, model in zip(names, wanted, strict=True)]

    def parts(self) -> list[Part]:
        return self._parts

    def _part(self, name: str, model: Model) -> Part:
        c, boxes, meshes = self.config, [], []
        of = material(c.materials, name, c.material)
        for shape in model.shapes:
            own = shape.solids
            boxes.append(
                own.boxes.with_(
                    center=frames.to_world(shape.pose, own.boxes.center),
                    quaternion=frames.multiply(shape.pose[3:], own.boxes.quaternion),
                    material=np.full(len(own.boxes), of),
                )
            )
            placed = frames.to_world(shape.pose, own.meshes.vertices)
            meshes.append(own.meshes.with_(vertices=placed, material=np.full(len(own.meshes), of)))
        return with_sides(name, chosen(c.kinds, name, "model"), model.pose, Boxes.concatenate(boxes), Meshes.concatenate(meshes))

    def bounds(self) -> Array:
        return room(self.parts(), self.config.path)

    def notes(self) -> list[str]:
        """In sentences what the file's shapes became, and what of it was left out."""
        parts = self.parts()
        closed = sum(int(p.meshes.closed.sum()) for p in parts)
        thin = Counter(p.name for p in parts for closed_ in p.meshes.closed if not closed_)
        triangles = sum(int(p.meshes.closed[p.meshes.mesh].sum()) for p in parts)
        found = [
            f"{many(len(parts), 'body', 'bodies')}: {many(sum(len(p.boxes) for p in parts), 'box', 'boxes')}, and "
            f"{many(closed, 'solid mesh', 'solid meshes')} of {triangles} triangles"
        ]
        if thin:
            named = ", ".join(f"{name} ({n})" for name, n in thin.items())
            found.append(f"{many(sum(thin.values()), 'mesh is', 'meshes are')} not watertight, with entry loss alone: {named}")
        if self._file.left_out:
            found.append(f"left out: {', '.join(f'{tag} ({n})' for tag, n in sorted(self._file.left_out.items()))}")
        return found
