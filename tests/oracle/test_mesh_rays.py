"""Rays through meshes against trimesh's own intersections, and through boxes made of triangles against the slab test."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes, Meshes
from testbed.scene import Body, Scene
from testbed.solid import mesh_holder
from worlds.mesh_rays import MeshRays
from worlds.raycast import BoxCaster

trimesh = pytest.importorskip("trimesh")
ENTRY, PER_METRE = 2.0, 5.0


def meshes_of(*shapes):
    return Meshes.concatenate(
        [Meshes(s.vertices, s.faces, np.zeros(len(s.faces)), [i], [0], [bool(s.is_watertight)]) for i, s in enumerate(shapes)]
    )


def rays_of(meshes):
    return MeshRays(meshes, np.full(len(meshes), ENTRY), np.full(len(meshes), PER_METRE), 0)


def segments(rng, n, reach):
    return rng.uniform(-reach, reach, (n, 3)), rng.uniform(-reach, reach, (n, 3))


def shapes():
    """Round, hollow, pierced, concave: each closed, of another size, and turned."""
    bracket = trimesh.creation.extrude_triangulation(
        np.array([[0, 0], [1, 0], [1, 0.2], [0.2, 0.2], [0.2, 1], [0, 1]]),
        np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]),
        0.5,
    )
    found = [
        trimesh.creation.icosphere(subdivisions=3, radius=0.8),
        trimesh.creation.annulus(0.4, 0.9, 0.6),
        trimesh.creation.torus(0.8, 0.25),
        bracket,
    ]
    for i, shape in enumerate(found):
        shape.apply_transform(trimesh.transformations.random_rotation_matrix(np.full(3, 0.21 * (i + 1))))
    return found


@pytest.mark.parametrize("shape", shapes(), ids=["ball", "ring", "torus", "bracket"])
def test_lengths_inside_are_those_between_trimesh_s_hits(shape):
    assert shape.is_watertight
    start, end = segments(np.random.default_rng(5), 1500, 1.5)
    found = rays_of(meshes_of(shape)).crossings(start, end)
    inside = np.bincount(found.segment, found.length, minlength=len(start))
    way = end - start
    length = np.linalg.norm(way, axis=1)
    tester = trimesh.ray.ray_triangle.RayMeshIntersector(shape)  # float64, unlike Embree
    where, ray, _ = tester.intersects_location(start, way, multiple_hits=True)
    along = np.einsum("ij,ij->i", where - start[ray], way[ray] / length[ray, None])
    wanted, pieces, began = np.zeros(len(start)), np.zeros(len(start), dtype=int), np.zeros(len(start), dtype=bool)
    for i in range(len(start)):
        at = np.unique(np.round(np.sort(along[(ray == i) & (along > 0)]), 9))  # one hit an edge, not two
        ends = np.concatenate([[0.0], at]) if len(at) % 2 else at  # an odd number ahead: it starts inside
        began[i] = len(at) % 2 == 1
        pairs = np.minimum(ends.reshape(-1, 2), length[i])
        wanted[i], pieces[i] = (pairs[:, 1] - pairs[:, 0]).sum(), (pairs[:, 1] - pairs[:, 0] > 1e-9).sum()
    np.testing.assert_allclose(inside, wanted, atol=1e-8)
    np.testing.assert_array_equal(np.bincount(found.segment, minlength=len(start)), pieces)
    assert began.sum() > 5
    np.testing.assert_array_equal(mesh_holder(start, meshes_of(shape)) == 0, began)
    np.testing.assert_array_equal(shape.contains(start), began)


def test_boxes_of_triangles_are_crossed_as_boxes_are():
    rng, n = np.random.default_rng(6), 40
    center, half = rng.uniform(-3, 3, (n, 3)), rng.uniform(0.05, 0.6, (n, 3))
    quaternion = frames.normalise(rng.normal(size=(n, 4)))
    body = np.arange(n)
    boxes = Boxes(center, quaternion, half, body=body, material=np.zeros(n))
    bodies = tuple(Body(f"b{i}", "crate", frames.IDENTITY) for i in range(n))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    cube = trimesh.creation.box(extents=(2, 2, 2))
    assert len(cube.vertices) == len(corners)
    parts = [
        Meshes(c + frames.rotate(q, cube.vertices * h), cube.faces, np.zeros(12), [i], [0], [True])
        for i, (c, q, h) in enumerate(zip(center, quaternion, half, strict=True))
    ]
    hall = np.array([[-4.0] * 3, [4.0] * 3])
    solid = BoxCaster(Scene(bodies, boxes, ("steel",), hall), np.array([ENTRY]), np.array([PER_METRE]))
    hollow = Scene(bodies, Boxes.empty(), ("steel",), hall, meshes=Meshes.concatenate(parts))
    meshed = BoxCaster(hollow, np.array([ENTRY]), np.array([PER_METRE]))
    start, end = segments(rng, 20_000, 3.5)
    a, b = solid.static(start, end), meshed.static(start, end)
    np.testing.assert_array_equal(a.count, b.count)
    np.testing.assert_allclose(a.loss, b.loss, atol=1e-8)
    nobody = np.zeros((1, 0, 7)), np.zeros(len(start), dtype=np.int64)
    one, other = solid.crossings(start, end, *nobody), meshed.crossings(start, end, *nobody)
    np.testing.assert_array_equal(one.segment, other.segment)
    np.testing.assert_array_equal(one.box, other.box)
    np.testing.assert_allclose(one.enter, other.enter, atol=1e-9)
    np.testing.assert_allclose(one.length, other.length, atol=1e-8)
    assert len(one) > 5000


def test_no_ray_slips_through_an_edge_or_a_corner():
    """Rays aimed exactly at corners and the middles of edges, along the axes and askew, from a point inside: each leaves once."""
    shape = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    edges = shape.vertices[shape.edges_unique].mean(axis=1)
    aims = np.concatenate([shape.vertices, edges])
    for origin in (np.zeros(3), np.array([0.25, -0.125, 0.0625])):
        start = np.tile(origin, (len(aims), 1))
        found = rays_of(meshes_of(shape)).crossings(start, origin + 3 * (aims - origin))
        np.testing.assert_array_equal(np.bincount(found.segment, minlength=len(aims)), 1)
        np.testing.assert_allclose(found.length, np.linalg.norm(aims - origin, axis=1), atol=1e-12)
