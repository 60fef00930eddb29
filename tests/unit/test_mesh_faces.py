"""Faces of meshes that reflect: those of a cuboid as of the box that it is, rectangles of many triangles, and no others."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes, Meshes
from testbed.radio.mesh_faces import rectangles
from testbed.radio.reflection import reflectors
from testbed.scene import Body, Scene
from worlds.importers.solids import cylinder

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)
HALL = np.array([[-4.0, -4.0, 0.0], [4.0, 4.0, 5.0]])


def mesh(vertices, faces, closed=True):
    return Meshes(vertices, faces, np.zeros(len(faces)), [0], [0], [closed])


def both(center, half, quaternion):
    """One block as a box and as a mesh."""
    box = Boxes(np.array([center]), np.array([quaternion]), np.array([half]), body=[0], material=[0])
    points = np.array(center) + frames.rotate(np.array(quaternion), CORNERS * half)
    body = (Body("block", "model", frames.IDENTITY),)
    return Scene(body, box, ("concrete",), HALL), Scene(body, Boxes.empty(), ("concrete",), HALL, meshes=mesh(points, FACES))


@pytest.mark.parametrize("quaternion", [frames.IDENTITY[3:], frames.from_euler(0.4, 0.2, -0.7)], ids=["upright", "askew"])
def test_a_cuboid_reflects_as_the_box_that_it_is(quaternion):
    box, meshed = both((0.5, -0.3, 2.0), (1.5, 0.6, 1.0), quaternion)
    wanted, found = (reflectors(scene, 1.0, floor=None) for scene in (box, meshed))
    assert len(found) == len(wanted) == 6
    order = [np.lexsort(np.round(faces.normal, 6).T) for faces in (wanted, found)]
    for name in ("origin", "normal"):
        np.testing.assert_allclose(getattr(found, name)[order[1]], getattr(wanted, name)[order[0]], atol=1e-9)
    np.testing.assert_allclose(np.sort(found.half[order[1]]), np.sort(wanted.half[order[0]]), atol=1e-9)
    np.testing.assert_array_equal(found.permittivity, wanted.permittivity)
    np.testing.assert_array_equal(found.box, 0)
    np.testing.assert_allclose(np.cross(found.u, found.v), found.normal, atol=1e-12)


def test_a_mesh_inside_out_looks_outward_all_the_same():
    points = CORNERS + np.array([0.0, 0, 2])
    for faces in (FACES, FACES[:, ::-1]):
        for face in rectangles(mesh(points, faces), 1.0):
            assert face.normal @ (face.origin - [0, 0, 2]) == pytest.approx(1.0)


def test_only_large_flat_rectangles_of_closed_meshes_reflect():
    points, faces = cylinder(1.0, 2.0)
    assert list(rectangles(mesh(points, faces), 0.5)) == []  # a disc is no rectangle, the sides are too small
    assert len(list(rectangles(mesh(points, faces), 0.3))) == 32
    assert list(rectangles(mesh(CORNERS, FACES[2:], closed=False), 0.1)) == []
    assert len(list(rectangles(mesh(CORNERS * [2, 0.1, 1], FACES), 1.0))) == 2
