"""What renders are made of, without a physics engine: meshes, the floor's shadows, stubs of walls, edges, the window of the movers."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed import frames
from testbed.geometry import Boxes, Zones
from testbed.view import Camera
from worlds.camera import STUB, covering, edges, stubs
from worlds.ground import MARGIN, Ground, corners
from worlds.paint import colour
from worlds.parts import MATERIALS
from worlds.stage import LIGHT, mesh

UPRIGHT = frames.IDENTITY[3:]


def boxes_of(*rows):
    """Boxes from (center, half) pairs, upright."""
    center, half = (np.array([r[i] for r in rows], dtype=float) for i in (0, 1))
    return Boxes(center, np.tile(UPRIGHT, (len(rows), 1)), half)


def random_boxes(seed, n=4):
    rng = np.random.default_rng(seed)
    return Boxes(rng.uniform(-2, 2, (n, 3)), frames.normalise(rng.normal(size=(n, 4))), rng.uniform(0.1, 1, (n, 3)))


@given(st.integers(0, 2**32 - 1))
def test_meshes_are_closed_look_outwards_and_have_the_volume_of_their_boxes(seed):
    boxes = random_boxes(seed)
    points, normals, triangles = mesh(boxes)
    a, b, c = points[triangles.reshape(-1, 3)].transpose(1, 0, 2)
    facing = np.cross(b - a, c - a)
    np.testing.assert_allclose(facing / np.linalg.norm(facing, axis=1)[:, None], normals[triangles[::3]], atol=1e-9)
    np.testing.assert_allclose(facing.sum(axis=0), 0, atol=1e-9)  # closed
    volume = np.einsum("ij,ij->i", a, facing).reshape(len(boxes), -1).sum(axis=1) / 6  # the divergence theorem
    np.testing.assert_allclose(volume, 8 * boxes.half.prod(axis=1))


def test_a_shadow_has_the_area_and_the_place_of_the_closed_form():
    ground = Ground(np.array([[0.0, 0.0, 0.0], [10.0, 8.0, 5.0]]), Zones.empty())
    low, half = 1.0, np.array([0.6, 0.4, 0.7])
    shadow = ground.shadow(boxes_of(([5.0, 4.0, low + half[2]], half)))
    reach = LIGHT[:2] / LIGHT[2] * 2 * half[2]  # the hull of two rectangles, one pushed by `reach`
    area = 4 * half[0] * half[1] + 2 * half[0] * abs(reach[1]) + 2 * half[1] * abs(reach[0])
    rim = 2 * (2 * half[0] + 2 * half[1] + np.abs(reach).sum()) * ground.cell / 2  # OpenCV fills the cells on the outline as well
    assert shadow.sum() * ground.cell**2 == pytest.approx(area + rim, rel=0.02)
    rows, columns = np.indices(shadow.shape)
    middle = [(shadow * columns).sum() / shadow.sum(), (shadow * rows).sum() / shadow.sum()]
    fallen = np.array([5.0, 4.0]) - LIGHT[:2] / LIGHT[2] * (low + half[2])
    np.testing.assert_allclose(middle, ground.cells(fallen), atol=1.0)
    assert shadow.max() == pytest.approx(1.0, abs=0.01)


def test_the_floor_reaches_beyond_the_hall_and_knows_its_cells():
    ground = Ground(np.array([[-1.0, 2.0, 0.0], [9.0, 6.0, 5.0]]), Zones(np.array(["a"]), np.array([[0, 2.5, 4, 5.0]])))
    np.testing.assert_allclose(ground.cells(np.array([-1 - MARGIN, 2 - MARGIN])), -0.5)
    assert ground.plain.shape == (ground.size[1], ground.size[0], 3)
    column, row = np.round(ground.cells(np.array([2.0, 5.0]))).astype(int)
    assert ground.plain[row, column].sum() < ground.plain[row + 20, column + 20].sum()  # the zone's rim is drawn


def test_a_hall_of_any_size_has_a_floor_of_bounded_size():
    ground = Ground(np.array([[0.0, 0.0, 0.0], [500.0, 20.0, 5.0]]), Zones.empty())
    assert ground.plain.shape[1] <= 2048


def test_of_a_wall_that_is_cut_off_a_stub_is_left():
    walls = boxes_of(([0, 0, 3], [5, 0.1, 3]), ([0, 0, 5.5], [1, 1, 0.5]), ([2, 2, 0.05], [1, 1, 0.05]))
    left = stubs(walls)
    np.testing.assert_allclose(corners(left)[..., 2].max(axis=1), [STUB, 0.1])
    np.testing.assert_allclose(corners(left)[..., 2].min(axis=1), 0, atol=1e-12)
    np.testing.assert_array_equal(left.half[:, :2], [[5, 0.1], [1, 1]])
    assert not len(stubs(Boxes.empty()))


def test_one_that_does_not_stand_upright_goes_as_a_whole():
    lean = Boxes(np.array([[0, 0, 1.0]]), frames.from_euler(0.0, 0.4)[None], np.array([[0.2, 0.2, 1.0]]))
    assert not len(stubs(lean))


def test_planes_have_no_edges_and_creases_do():
    camera = Camera("c", np.array([0.0, 0.0, 3.0]), np.array([5.0, 0.0, 0.0]), 1.0, 320, 240)
    rays = camera.rays()
    angle = 2 * np.tan(0.5) / 240
    floor, wall = -3.0 / rays[..., 2], 6.0 / rays[..., 0]
    assert edges(np.where(rays[..., 2] < 0, floor, np.inf)[60:], angle)[1:].min() > 0.99
    assert edges(wall, angle).min() > 0.99
    corner = edges(np.minimum(np.where(rays[..., 2] < 0, floor, np.inf), wall), angle)
    v = camera.project([6.0, 0.0, 0.0])[0][1]
    dark = np.flatnonzero(corner[:, 160] < 0.95)
    assert len(dark)
    assert np.abs(dark - v).max() < 2


@given(st.integers(0, 2**32 - 1))
def test_the_window_holds_every_pixel_of_the_boxes(seed):
    camera = Camera("c", np.array([0.0, -6.0, 2.0]), np.zeros(3), 0.8, 160, 120)
    boxes = random_boxes(seed)
    pixels, depth = camera.project(corners(boxes))
    window = covering(camera, boxes)
    assert window is not None
    assert 0 <= window.left <= camera.width - window.width
    assert 0 <= window.top <= camera.height - window.height
    if (depth > camera.near).all():
        mask = np.zeros((120, 160), np.uint8)
        for hull in pixels:
            cv2.fillConvexPoly(mask, cv2.convexHull(np.round(hull).astype(np.int32)), 1)
        mask[window.top : window.top + window.height, window.left : window.left + window.width] = 0
        assert not mask[1:-1, 1:-1].any()


def test_movers_behind_the_camera_need_no_drawing():
    camera = Camera("c", np.array([0.0, 0.0, 2.0]), np.array([5.0, 0.0, 2.0]), 0.8, 160, 120)
    assert covering(camera, boxes_of(([-5, 0, 1], [1, 1, 1]))) is None
    assert covering(camera, Boxes.empty()) is None
    assert covering(camera, boxes_of(([0, 0, 1], [1, 1, 2]))) == (0, 0, 160, 120)  # it is inside


def test_every_material_has_a_colour_and_steel_differs_from_thing_to_thing():
    assert len({colour("thing", m) for m in MATERIALS}) == len(MATERIALS)
    steel = {colour(kind, "steel") for kind in ("rack", "gate", "forklift", "trolley")}
    assert len(steel) == 4
    brightness = sorted(np.dot(c, [0.2126, 0.7152, 0.0722]) for c in steel)
    assert min(np.diff(brightness)) > 0.03  # told apart without hue
    assert colour("thing", "unobtainium") == colour("other", "unheard of")
