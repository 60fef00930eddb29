"""Speed of rays through meshes: every crossing here against Embree's every hit, through trimesh, of the same mesh in the same run."""

import time

import numpy as np
import pytest

from testbed.geometry import Meshes
from worlds.mesh_rays import MeshRays

pytestmark = pytest.mark.benchmark
AT_LEAST = 0.4  # times as fast as Embree, which reckons in single precision and misses edges


def test_all_crossings_of_a_mesh_against_embree():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    shape = trimesh.util.concatenate(
        [trimesh.creation.torus(0.8, 0.25, transform=trimesh.transformations.translation_matrix([2 * i, 0, 0])) for i in range(8)]
    )
    rng = np.random.default_rng(3)
    start, end = rng.uniform([-2, -2, -1], [16, 2, 1], (2, 20_000, 3))
    own = MeshRays(Meshes(shape.vertices, shape.faces, np.zeros(len(shape.faces)), [0], [0], [True]), [1.0], [1.0], 0)
    embree = RayMeshIntersector(shape)
    way = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    own.obstruction(start[:10], end[:10])
    seconds = np.full((5, 2), np.inf)
    for i in range(5):
        for k, call in enumerate((lambda: own.obstruction(start, end), lambda: embree.intersects_location(start, way, multiple_hits=True))):
            began = time.perf_counter()
            call()
            seconds[i, k] = time.perf_counter() - began
    mine, theirs = seconds.min(axis=0)
    figures = f"{1e6 * mine / len(start):.2f} µs a segment, Embree {1e6 * theirs / len(start):.2f}"
    assert theirs > AT_LEAST * mine, figures
