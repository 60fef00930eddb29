"""The pieces of geometry that a site survey speaks of as well as a scene: boxes, meshes, mounts, zones, roads.

A leaf: numpy only. What really stands and moves in a hall (`Scene`, `Truth`) is in `testbed.scene`, which estimators never import.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array, Columns, Table, column

WORLD = -1  # body index of a mount or box that stands still in the world frame


@dataclass(frozen=True, eq=False)
class Boxes(Table):
    """Solid boxes, each in the frame of its body. `body` and `material` index the scene's lists (body -1: world frame)."""

    center: Array = column("float64", ("N", 3), "m")
    quaternion: Array = column("float64", ("N", 4), "(w, x, y, z)")
    half: Array = column("float64", ("N", 3), "m, half the edge lengths")
    body: Array = column("int32", default=WORLD)
    material: Array = column("int16", default=0)


@dataclass(frozen=True, eq=False)
class Meshes(Columns):
    """M meshes of T triangles over V corners, each in the frame of its body, which never moves. Boxes say all else.

    Corners of a triangle run counter-clockwise as seen from outside. A `closed` mesh is solid; an open one is thin sheets: a ray loses
    what its material takes on entry at every second surface, and nothing inside. No two meshes share a corner.
    """

    vertices: Array = column("float64", ("V", 3), "m")
    triangles: Array = column("int64", ("T", 3))
    mesh: Array = column("int32", ("T",))
    body: Array = column("int32", ("M",))
    material: Array = column("int16", ("M",))
    closed: Array = column("bool", ("M",))

    def __len__(self) -> int:
        return len(self.body)

    @classmethod
    def empty(cls) -> Self:
        """No meshes."""
        return cls(*(np.zeros(shape) for shape in ((0, 3), (0, 3), (0,), (0,), (0,), (0,))))

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """All meshes of `parts`, in order."""
        parts = [p for p in parts if len(p)]
        if not parts:
            return cls.empty()
        corners, number = (np.cumsum([0, *map(len, column)]) for column in ([p.vertices for p in parts], parts))
        return cls(
            vertices=np.concatenate([p.vertices for p in parts]),
            triangles=np.concatenate([p.triangles + n for p, n in zip(parts, corners[:-1], strict=True)]),
            mesh=np.concatenate([p.mesh + n for p, n in zip(parts, number[:-1], strict=True)]),
            **{name: np.concatenate([getattr(p, name) for p in parts]) for name in ("body", "material", "closed")},
        )

    def take(self, index: Array) -> Self:
        """The meshes that `index` (M,) bool picks, with the corners that they use."""
        kept = np.flatnonzero(index)
        rows = np.flatnonzero(np.isin(self.mesh, kept))
        used, place = np.unique(self.triangles[rows], return_inverse=True)
        mesh = np.searchsorted(kept, self.mesh[rows])
        return type(self)(self.vertices[used], place.reshape(-1, 3), mesh, self.body[kept], self.material[kept], self.closed[kept])

    def corners(self) -> Array:
        """(T, 3, 3) m: the corners of each triangle."""
        return self.vertices[self.triangles]

    def owner(self) -> Array:
        """(V,) int: the mesh that each corner belongs to."""
        owner = np.zeros(len(self.vertices), dtype=np.int64)
        owner[self.triangles] = self.mesh[:, None]
        return owner

    def equals(self, other: Self) -> bool:
        """The same meshes, bit for bit."""
        names = ("vertices", "triangles", "mesh", "body", "material", "closed")
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)


@dataclass(frozen=True, eq=False)
class Mounts(Table):
    """Places where a tag or an antenna can be fixed, in the frame of their body, by name and group.

    `name` is unique ("rack1.bay2.3", "gate1.left_low"), `group` is what belongs together ("rack1.bay2"), `use` is "tag" or
    "antenna". +x of the quaternion points away from the surface.
    """

    name: Array = column("str")
    group: Array = column("str")
    use: Array = column("str")
    body: Array = column("int32")
    position: Array = column("float64", ("N", 3), "m")
    quaternion: Array = column("float64", ("N", 4), "(w, x, y, z)")


@dataclass(frozen=True, eq=False)
class Roads(Columns):
    """A road network: straight segments between nodes. `one_way` ones run from their first node to their second.

    Data as they come: what is no network is refused by `testbed.roads.check_roads`, before anyone drives on it.
    """

    nodes: Array = column("float64", ("V", 2), "m")
    segments: Array = column("int32", ("S", 2))
    one_way: Array = column("bool", ("S",), default=False)


@dataclass(frozen=True, eq=False)
class Zones(Table):
    """Named rectangles of the floor, axis-parallel: (x_min, y_min, x_max, y_max)."""

    name: Array = column("str")
    bounds: Array = column("float64", ("N", 4), "m")

    def locate(self, position: ArrayLike) -> Array:
        """(...,) int16: the first zone that holds each (..., 2 or 3) position, -1 for none."""
        p = np.asarray(position, dtype=np.float64)[..., None, :2]
        inside = ((p >= self.bounds[:, :2]) & (p <= self.bounds[:, 2:])).all(axis=-1)
        if not len(self):
            return np.full(inside.shape[:-1], -1, dtype=np.int16)
        return np.where(inside.any(axis=-1), inside.argmax(axis=-1), -1).astype(np.int16)
