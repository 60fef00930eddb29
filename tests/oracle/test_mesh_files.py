"""Meshes as they are read here against trimesh and pycollada; what is watertight, and how large, likewise."""

from pathlib import Path

import numpy as np
import pytest

from worlds.importers.mesh_files import load_mesh
from worlds.importers.solids import is_closed, shells, solids, volume, welded

trimesh = pytest.importorskip("trimesh")
pycollada = pytest.importorskip("collada")
OWN = sorted((Path(__file__).parents[1] / "files" / "worlds").rglob("*.*"))
SHARED = sorted((Path(__file__).parents[3] / "shared" / "worlds").rglob("*.*"))
MESHES = [p for p in [*OWN, *SHARED] if p.suffix.lower() in (".dae", ".stl", ".obj")]


def by_pycollada(path):
    """(T, 3, 3) m, z up, of every triangle in the scene."""
    document = pycollada.Collada(str(path))
    found = []
    for geometry in document.scene.objects("geometry"):
        for primitive in geometry.primitives():
            triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
            found.append(triangles.vertex[triangles.vertex_index])
    corners = np.concatenate(found).astype(np.float64) * document.assetInfo.unitmeter
    return corners[..., [0, 2, 1]] * [1, -1, 1] if document.assetInfo.upaxis == "Y_UP" else corners


@pytest.mark.parametrize("path", MESHES, ids=lambda p: p.name)
def test_triangles_are_those_that_others_read(path):
    points, faces = load_mesh(path)
    if path.suffix.lower() == ".dae":
        corners = by_pycollada(path)
    else:
        mesh = trimesh.load(path, force="mesh", process=False)
        corners = np.asarray(mesh.vertices)[mesh.faces]
    own = points[faces]
    assert own.shape == corners.shape
    scale = np.ptp(own, axis=(0, 1)).max()
    np.testing.assert_allclose(own.mean(axis=1).mean(axis=0), corners.mean(axis=1).mean(axis=0), atol=1e-6 * scale)
    np.testing.assert_allclose(np.sort(own.reshape(-1, 3), axis=0), np.sort(corners.reshape(-1, 3), axis=0), atol=1e-5 * scale)


@pytest.mark.filterwarnings("ignore:.*:RuntimeWarning:trimesh")  # it divides by the volume of a single triangle
@pytest.mark.parametrize("path", MESHES, ids=lambda p: p.name)
def test_what_is_closed_and_how_large_is_what_trimesh_says(path):
    points, faces = welded(*load_mesh(path))
    mesh = trimesh.Trimesh(points, faces, process=False)
    _, times = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    if times.max() > 2:  # shells that touch along an edge: trimesh tears them apart there, which leaves holes that are none
        assert solids(points, faces).open == 0
        return
    parts = mesh.split(only_watertight=False, repair=False)
    own = shells(faces)
    assert sum(is_closed(s) for s in own) == sum(p.is_watertight and p.is_winding_consistent for p in parts)
    found = solids(points, faces)
    assert found.open == sum(not p.is_watertight for p in parts)
    solid = sum(abs(p.volume) for p in parts if p.is_watertight)
    closed = found.meshes.take(found.meshes.closed)
    mine = 8 * found.boxes.half.prod(axis=1).sum() + (abs(volume(closed.vertices, closed.triangles)) if len(closed) else 0.0)
    assert mine == pytest.approx(solid, rel=1e-4)
    boxes = [p for p in parts if p.is_watertight and len(p.vertices) == 8 and p.bounding_box_oriented.volume <= abs(p.volume) * (1 + 1e-3)]
    assert len(found.boxes) == len(boxes)
