"""Flat rectangles in the surfaces of closed meshes: what of them reflects as the faces of boxes do. Faces of other outlines do not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from testbed.columns import Array
from testbed.geometry import Meshes

FLAT = 1e-4  # rad between two triangles of one face, and m between their planes a metre of the mesh
FULL = 0.99  # of the rectangle round a face: as much as this of it is there


class Face(NamedTuple):
    """A rectangle: its middle, its normal out of the mesh, its edges' directions, half their lengths (m), and the mesh that it is of."""

    origin: Array
    normal: Array
    u: Array
    v: Array
    half: Array
    mesh: int


def rectangles(meshes: Meshes, min_area: float) -> Iterator[Face]:
    """The rectangular faces of at least `min_area` m² of all closed meshes, in the frame of the meshes."""
    for m in np.flatnonzero(meshes.closed):
        triangles = meshes.triangles[meshes.mesh == m]
        corners = meshes.vertices[triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1) / 2
        kept = area > 0
        triangles, corners, normal, area = triangles[kept], corners[kept], normal[kept] / (2 * area[kept, None]), area[kept]
        inside_out = np.einsum("ij,ij->", corners[:, 0] - corners[0, 0], normal * area[:, None]) < 0
        for own in _flat_parts(triangles, corners, normal):
            if area[own].sum() >= min_area:
                face = _rectangle(corners[own], -normal[own[0]] if inside_out else normal[own[0]], float(area[own].sum()), int(m))
                if face is not None:
                    yield face


def _flat_parts(triangles: Array, corners: Array, normal: Array) -> Iterator[Array]:
    """Indices of triangles that hang together by edges and lie in one plane, part by part."""
    n = len(triangles)
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, place = np.unique(edges, axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    together = np.diff(place.ravel()[order]) == 0
    a, b = order[:-1][together] % n, order[1:][together] % n
    flat = np.einsum("ij,ij->i", normal[a], normal[b]) > np.cos(FLAT)
    _, part = connected_components(coo_array((np.ones(flat.sum()), (a[flat], b[flat])), shape=(n, n)), directed=False)
    size = np.ptp(corners, axis=(0, 1)).max(initial=0.0)
    for p in dict.fromkeys(part.tolist()):
        own = np.flatnonzero(part == p)
        height = corners[own] @ normal[own[0]]
        if np.ptp(height) <= FLAT * size:  # many slight bends in a row are no plane
            yield own


def _rectangle(corners: Array, normal: Array, area: float, mesh: int) -> Face | None:
    edges = (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)
    length = np.linalg.norm(edges, axis=1)
    for k in np.argsort(-length)[:4]:  # a diagonal between two triangles is longer than the rectangle's own edges
        u = edges[k] / length[k]
        u = u - (u @ normal) * normal
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        points = corners.reshape(-1, 3) @ np.stack([u, v], axis=1)
        low, high = points.min(axis=0), points.max(axis=0)
        if area >= FULL * np.prod(high - low):
            middle = (low + high) / 2
            origin = middle[0] * u + middle[1] * v + (corners[0, 0] @ normal) * normal
            return Face(origin, normal, u, v, (high - low) / 2, mesh)
    return None
