"""The camera's geometry, against closed forms and against OpenCV's own pinhole model."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.view import Camera

CAMERA = Camera("c", np.array([1.0, -8.0, 3.0]), np.array([2.0, 1.0, 1.0]), np.radians(50), 640, 480)
coordinate = st.floats(-20, 20, allow_nan=False)


def test_what_it_looks_at_is_in_the_middle_of_the_picture():
    pixel, depth = CAMERA.project(CAMERA.target)
    np.testing.assert_allclose(pixel, [319.5, 239.5], atol=1e-9)  # whole numbers are the middles of pixels
    assert depth == pytest.approx(np.linalg.norm(CAMERA.target - CAMERA.position))


def test_right_is_right_and_up_is_up():
    north = Camera("c", np.zeros(3), np.array([0.0, 1.0, 0.0]), np.pi / 2, 400, 200)
    pixel, depth = north.project([[1.0, 10.0, 0.0], [0.0, 10.0, 1.0]])
    np.testing.assert_allclose(pixel, [[199.5 + 10.0, 99.5], [199.5, 99.5 - 10.0]])  # 100 px are 45°, or 10 m at 10 m
    np.testing.assert_allclose(depth, 10.0)


def test_the_field_of_view_is_the_height_of_the_picture():
    up = Camera("c", np.zeros(3), np.array([1.0, 0.0, 0.0]), 2 * np.arctan(0.5), 64, 48)
    pixel, _ = up.project([[2.0, 0.0, 1.0], [2.0, 0.0, -1.0]])
    np.testing.assert_allclose(pixel[:, 1], [-0.5, 47.5])  # the outer rims of the first and the last row


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=20))
def test_it_projects_as_opencv_does(points):
    points = np.array(points)
    axes = CAMERA.axes * [[1.0], [-1.0], [-1.0]]  # OpenCV's eye: x to the right, y down, z ahead
    focal = 240.0 / np.tan(np.radians(25))
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    pixel, depth = CAMERA.project(points)
    np.testing.assert_allclose(depth, (points - CAMERA.position) @ axes[2], atol=1e-9)
    ahead = depth >= 0.5
    if ahead.any():
        wanted, _ = cv2.projectPoints(points[ahead], cv2.Rodrigues(axes)[0], -axes @ CAMERA.position, matrix, None)
        np.testing.assert_allclose(pixel[ahead], wanted[:, 0], rtol=1e-6, atol=1e-5)
    assert np.isnan(pixel[depth < CAMERA.near]).all()


@given(st.floats(0, 639), st.floats(0, 479), st.floats(0.2, 100))
def test_a_pixel_and_its_depth_lead_back_to_the_point(u, v, depth):
    point = CAMERA.position + depth * CAMERA.directions([u, v])
    pixel, found = CAMERA.project(point)
    np.testing.assert_allclose([*pixel, found], [u, v, depth], rtol=1e-9, atol=1e-6)


def test_the_rays_of_all_pixels_are_their_directions():
    small = Camera("c", CAMERA.position, CAMERA.target, 1.0, 12, 9)
    u, v = np.meshgrid(np.arange(12), np.arange(9))
    np.testing.assert_allclose(small.rays(), small.directions(np.stack([u, v], axis=-1)), atol=1e-12)


def test_the_matrices_are_those_of_opengl():
    """gluPerspective and gluLookAt, from their definitions."""
    f, near, far = 1 / np.tan(np.radians(25)), CAMERA.near, CAMERA.far
    third, fourth = (far + near) / (near - far), 2 * far * near / (near - far)
    wanted = [[f * 0.75, 0, 0, 0], [0, f, 0, 0], [0, 0, third, fourth], [0, 0, -1, 0]]
    np.testing.assert_allclose(CAMERA.projection_matrix(), wanted)
    view = CAMERA.view_matrix()
    np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(view @ [*CAMERA.position, 1], [0, 0, 0, 1], atol=1e-12)
    assert np.linalg.det(view) == pytest.approx(1.0)


def test_a_camera_that_looks_straight_down_has_north_at_the_top():
    down = Camera("c", np.array([3.0, 4.0, 10.0]), np.array([3.0, 4.0, 0.0]), np.pi / 2, 100, 100)
    pixel, _ = down.project([[3.0, 5.0, 0.0], [4.0, 4.0, 0.0]])
    np.testing.assert_allclose(pixel, [[49.5, 44.5], [54.5, 49.5]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": CAMERA.position}, "stands where it looks"),
        ({"position": [0.0, np.nan, 1.0]}, "its position must be three finite numbers"),
        ({"field_of_view": np.pi}, "field of view"),
        ({"width": 4}, "8 to 4096 px"),
        ({"near": 5.0, "far": 1.0}, "0 < near < far"),
    ],
)
def test_a_camera_that_can_not_look_is_refused(change, message):
    good = {"name": "c", "position": CAMERA.position, "target": CAMERA.target}
    with pytest.raises(ValueError, match=message):
        Camera(**{**good, **change})
