"""Meshes as obstacles: gaps, hollows, shells that overlap, sheets without an inside, and the pieces of a scene."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import WORLD, Boxes, Meshes
from testbed.scene import Body, Scene
from testbed.solid import holders, mesh_holder
from worlds.mesh_rays import MeshRays
from worlds.raycast import BoxCaster

FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def cuboid(low, high):
    """(8, 3) corners and (12, 3) triangles, counter-clockwise from outside."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return low + CORNERS * (high - low), FACES


def one(*shells, closed=True, body=WORLD, material=0):
    """One mesh of several shells."""
    vertices, triangles, n = [], [], 0
    for corners, faces in shells:
        vertices.append(corners)
        triangles.append(faces + n)
        n += len(corners)
    triangles = np.concatenate(triangles)
    return Meshes(np.concatenate(vertices), triangles, np.zeros(len(triangles)), [body], [material], [closed])


def found(mesh, start, end, entry=40.0, per_metre=3.0):
    return MeshRays(mesh, [entry] * len(mesh), [per_metre] * len(mesh), 0).crossings(
        np.atleast_2d(start).astype(float), np.atleast_2d(end).astype(float)
    )


def test_a_cuboid_is_counter_clockwise_from_outside():
    corners, faces = cuboid((0, 0, 0), (1, 2, 3))
    a, b, c = corners[faces].transpose(1, 0, 2)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(6.0)


def test_an_open_rack_passes_rays_between_its_uprights():
    uprights = [cuboid((x, y, 0), (x + 0.1, y + 0.1, 2)) for x in (0.0, 1.9) for y in (0.0, 0.9)]
    boards = [cuboid((0, 0, z), (2, 1, z + 0.02)) for z in (0.5, 1.5)]
    rack = one(*uprights, *boards)
    between = found(rack, [[1.0, -1, 1.0], [0.5, -1, 0.2], [-1, 0.5, 1.0]], [[1.0, 2, 1.0], [1.5, 2, 0.3], [3, 0.5, 1.0]])
    assert len(between) == 0
    through = found(rack, [0.05, -1, 1.0], [0.05, 2, 1.0])
    np.testing.assert_allclose(through.enter, [1.0, 1.9])
    np.testing.assert_allclose(through.length, [0.1, 0.1])
    down = found(rack, [1.0, 0.5, 3], [1.0, 0.5, -1])
    np.testing.assert_allclose(down.length, [0.02, 0.02])


def test_shells_that_overlap_are_one_and_one_turned_inside_out_is_a_hole():
    crossing = found(one(cuboid((0, 0, 0), (2, 1, 1)), cuboid((1, 0, 0), (3, 1, 1))), [-1, 0.4, 0.6], [4, 0.4, 0.6])
    np.testing.assert_allclose([crossing.enter, crossing.length], [[1.0], [3.0]])
    touching = found(one(cuboid((0, 0, 0), (1, 1, 1)), cuboid((1, 0, 0), (3, 1, 1))), [-1, 0.4, 0.6], [4, 0.4, 0.6])
    np.testing.assert_allclose([touching.enter, touching.length], [[1.0], [3.0]])
    corners, faces = cuboid((1, 1, 1), (2, 2, 2))
    hollow = one(cuboid((0, 0, 0), (3, 3, 3)), (corners, faces[:, ::-1]))
    wall = found(hollow, [-1, 1.4, 1.6], [4, 1.4, 1.6])
    np.testing.assert_allclose(wall.enter, [1.0, 3.0])
    np.testing.assert_allclose(wall.length, [1.0, 1.0])
    from_within = found(hollow, [1.5, 1.4, 1.6], [1.6, 1.4, 1.6])
    assert len(from_within) == 0
    np.testing.assert_array_equal(mesh_holder([[1.5, 1.5, 1.5], [0.5, 0.5, 0.5], [4, 4, 4]], hollow), [-1, 0, -1])


def test_a_mesh_with_its_faces_all_turned_round_is_as_solid():
    corners, faces = cuboid((0, 0, 0), (1, 1, 1))
    crossing = found(one((corners, faces[:, ::-1])), [-1, 0.4, 0.6], [2, 0.4, 0.6])
    np.testing.assert_allclose([crossing.enter, crossing.length], [[1.0], [1.0]])


def test_ends_inside_count_from_there_and_short_segments_not_at_all():
    block = one(cuboid((0, 0, 0), (1, 1, 1)))
    np.testing.assert_allclose(found(block, [0.25, 0.4, 0.6], [0.75, 0.4, 0.6]).length, [0.5])
    np.testing.assert_allclose(found(block, [0.25, 0.4, 0.6], [5.0, 0.4, 0.6]).length, [0.75])
    assert len(found(block, [0.25, 0.4, 0.6], [0.25, 0.4, 0.6])) == 0
    assert len(found(block, [-2, 0.4, 0.6], [-0.1, 0.4, 0.6])) == 0  # the line goes on into it, the segment does not


def test_an_open_mesh_takes_its_entry_loss_alone():
    corners, faces = cuboid((0, 0, 0), (1, 1, 1))
    lidless = one((corners, faces[:-2]), closed=False)  # without the two triangles at x = 1
    rays = MeshRays(lidless, [40.0], [300.0], 0)
    start, end = np.array([[-1, 0.4, 0.6], [0.5, -1, 0.6], [0.4, 0.4, -1]]), np.array([[4, 0.4, 0.6], [0.5, 4, 0.6], [0.4, 0.4, 0.5]])
    seen = rays.obstruction(start, end)
    np.testing.assert_array_equal(seen.count, [1, 1, 1])  # one surface; two of them; one, and the end inside
    np.testing.assert_array_equal(seen.loss, [40.0, 40.0, 40.0])
    assert (rays.crossings(start, end).length == 0).all()


def test_many_surfaces_on_one_ray():
    sheets = [cuboid((2 * i, 0, 0), (2 * i + 1, 1, 1)) for i in range(150)]  # more hits than the first buffer holds
    crossing = found(one(*sheets), [-1, 0.4, 0.6], [400, 0.4, 0.6])
    np.testing.assert_allclose(crossing.length, np.ones(150), atol=1e-12)


def test_boxes_and_meshes_are_pieces_of_one_scene():
    bodies = (Body("wall", "wall", frames.IDENTITY), Body("rack", "rack", np.array([5.0, 0, 0, *frames.from_euler(np.pi / 2)])))
    box = Boxes(np.array([[1.0, 0, 1]]), np.array([[1.0, 0, 0, 0]]), np.array([[0.1, 1, 1]]), body=[0], material=[0])
    mesh = one(cuboid((-0.5, 1.0, 0), (0.5, 1.5, 2)), body=1, material=1)
    scene = Scene(bodies, box, ("concrete", "steel"), np.array([[0.0, -2, 0], [8, 2, 3]]), meshes=mesh)
    caster = BoxCaster(scene, np.array([4.0, 40.0]), np.array([10.0, 0.0]))
    start, end = np.array([[0.0, 0.1, 1.0]]), np.array([[8.0, 0.1, 1.0]])
    crossing = caster.crossings(start, end, np.zeros((1, 0, 7)), np.zeros(1, dtype=int))
    np.testing.assert_array_equal(crossing.box, [0, 1])
    np.testing.assert_allclose(crossing.enter, [0.9, 3.5])  # turned by a quarter, y becomes -x: from 5 - 1.5 m
    np.testing.assert_allclose(crossing.length, [0.2, 0.5])
    assert caster.static(start, end).loss[0] == pytest.approx(4 + 2 + 40)
    assert [scene.bodies[b].name for b in scene.piece_body[crossing.box]] == ["wall", "rack"]
    np.testing.assert_array_equal(scene.piece_material[crossing.box], [0, 1])
    np.testing.assert_array_equal(holders(scene, [WORLD, WORLD, WORLD], [[1, 0, 1], [3.7, 0.1, 1], [3, 0, 1]]), [0, 1, -1])


def test_meshes_are_joined_and_taken_apart():
    parts = [one(cuboid((3 * i, 0, 0), (3 * i + 1, 1, 1)), body=i) for i in range(3)]
    both = Meshes.concatenate(parts)
    assert len(both) == 3
    assert len(both.triangles) == 36
    assert both.take(np.array([False, True, False])).equals(parts[1])
    np.testing.assert_array_equal(both.owner(), np.repeat([0, 1, 2], 8))
    assert len(Meshes.concatenate([])) == 0
