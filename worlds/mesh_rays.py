"""Every mesh on a segment, and how much of it: triangles in trees of bounds, the mesh side of `worlds.raycast`.

What counts. A line is inside of a closed mesh where its surface goes round it; a crossing is a stretch of the segment inside, longer than
`SURFACE` (1e-9 m), and costs entry_db + per_metre_db * length. So a ray passes between the uprights of a rack, which its hull would
not let through. An open mesh has no inside: of the surfaces that a segment meets in it every first of two is a crossing of no
length, which costs entry_db, and the last one, where their number is odd. A segment that runs within a face is inside or not.
"""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.geometry import Meshes
from testbed.protocols import Crossings, Obstruction
from worlds.mesh_kernels import DEPTH, LEAF, Trees, build, cast


class MeshRays:
    """Meshes as obstacles. `meshes` are in the world frame; entry_db, per_metre_db (M,) are those of each mesh; mesh m is piece
    `first_piece` + m of the scene.
    """

    def __init__(self, meshes: Meshes, entry_db: Array, per_metre_db: Array, first_piece: int) -> None:
        self._trees = planted(meshes)
        self._entry, self._per_metre = np.asarray(entry_db, dtype=np.float64), np.asarray(per_metre_db, dtype=np.float64)
        self._first_piece = first_piece

    def obstruction(self, start: Array, end: Array) -> Obstruction:
        """What stands on segments `start` (N, 3) to `end` (N, 3), m."""
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        return self._cast(start, end, none, none, nothing, nothing)

    def crossings(self, start: Array, end: Array) -> Crossings:
        """Every crossing, by segment and in no other order."""
        count = self.obstruction(start, end).count.astype(np.int64)
        segment, first = np.repeat(np.arange(len(start)), count), np.cumsum(count) - count
        mesh, enter, inside = np.empty(len(segment), dtype=np.int64), np.empty(len(segment)), np.empty(len(segment))
        self._cast(start, end, first, mesh, enter, inside)
        return Crossings(segment=segment, box=self._first_piece + mesh, enter=enter, length=inside)

    def _cast(self, start: Array, end: Array, *listing: Array) -> Obstruction:
        counts, losses = np.zeros(len(start), dtype=np.int32), np.zeros(len(start))
        cast(self._trees, self._entry, self._per_metre, start, end, counts, losses, *listing)
        return Obstruction(count=counts, loss=losses)


def planted(meshes: Meshes) -> Trees:
    """The trees over M >= 1 meshes."""
    bounds, first, count, corners, root, extent = [], [], [], [], [], []
    nodes = things = 0
    for m in range(len(meshes)):
        own = meshes.vertices[meshes.triangles[meshes.mesh == m]]
        box, child, many, order = build(own.min(axis=1), own.max(axis=1), LEAF, nodes, things)
        for column, value in ((bounds, box), (first, child), (count, many), (corners, own[order]), (root, nodes), (extent, box[0])):
            column.append(value)
        nodes, things = nodes + len(box), things + len(own)
    around = np.array(extent)
    box, child, many, order = build(around[:, :3].copy(), around[:, 3:].copy(), 1, nodes, 0)
    if 2 * np.log2(max(things, 2)) + 4 > DEPTH:
        raise ValueError(f"{things} triangles are too many for the trees of rays")
    return Trees(
        bounds=np.concatenate([*bounds, box]),
        first=np.concatenate([*first, child]),
        size=np.concatenate([*count, many]),
        corners=np.ascontiguousarray(np.concatenate(corners)),
        root=np.array(root, dtype=np.int64),
        mesh=order.astype(np.int64),
        top=nodes,
        closed=np.asarray(meshes.closed),
    )
