"""The hall from above: hulls, footprints and ellipses against independent geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from testbed import frames
from testbed.geometry import Boxes
from testbed.report import plan
from testbed.scene import Body, Scene

coordinates = st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=3, max_size=40)


def area(polygon):
    x, y = np.asarray(polygon).T
    return 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))


@given(coordinates)
@settings(max_examples=60)
def test_a_hull_has_the_area_of_qhulls_and_turns_left(points):
    points = np.round(np.array(points), 3)
    try:
        expected = ConvexHull(points).volume
    except QhullError:  # all on a line
        return
    found = plan.hull(points)
    assert area(found) == pytest.approx(expected, abs=1e-3)
    assert {tuple(p) for p in found.tolist()} <= {tuple(p) for p in np.round(points, 6).tolist()}


def test_a_hull_of_few_points_is_what_there_is():
    assert plan.hull(np.array([[1.0, 2.0], [1.0, 2.0]])).tolist() == [[1.0, 2.0]]


@given(st.floats(0.01, 9), st.floats(0.01, 9), st.floats(-3, 3))
def test_points_of_an_ellipse_lie_at_the_95_percent_distance(a, b, turn):
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    covariance = rotation @ np.diag([a * a, b * b]) @ rotation.T
    mean = np.array([3.0, -2.0])
    apart = plan.ellipse(covariance, mean) - mean
    assert np.einsum("ni,ij,nj->n", apart, np.linalg.inv(covariance), apart) == pytest.approx(5.991464547, rel=1e-5)


def test_half_axes_agree_with_eigenvalues_and_are_nan_where_there_is_no_ellipse():
    covariance = np.array([[[2.0, 0.7], [0.7, 1.0]], [[1.0, 0.0], [0.0, 0.0]], [[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]])
    a, b, angle = plan.axes(covariance, squared=1.0)
    values, vectors = np.linalg.eigh(covariance[0])
    assert (a[0] ** 2, b[0] ** 2) == pytest.approx((values[1], values[0]))
    assert abs(np.array([np.cos(angle[0]), np.sin(angle[0])]) @ vectors[:, 1]) == pytest.approx(1.0)
    assert (a[1], b[1]) == (1.0, 0.0)
    assert np.isnan(a[2:]).all()
    assert np.isnan(b[2:]).all()


def scene(**more):
    yaw = frames.from_euler(np.radians(30.0))
    bodies = (
        Body("rack1", "rack", np.array([2.0, 3.0, 0.0, *yaw])),
        Body("gate1", "gate", frames.IDENTITY),
        Body("cart", "trolley", frames.IDENTITY, moving=True),
    )
    boxes = Boxes(
        center=[[0, 0, 0.5], [0, 0, 1.5], [0, 0, 2.4], [0, 1, 1], [1, 0, 0.2]],
        quaternion=np.tile([1.0, 0, 0, 0], (5, 1)),
        half=[[1, 0.5, 0.5], [1, 0.5, 0.5], [0.1, 1.2, 0.1], [0.1, 0.1, 1], [0.4, 0.3, 0.2]],
        body=[0, 0, 1, 1, 2],
    )
    return Scene(bodies, boxes, ("steel",), np.array([[0.0, 0, 0], [10, 8, 4]]), **more)


def test_levels_of_a_rack_have_one_footprint_turned_with_its_body():
    rack, gate = plan.standing(scene())
    assert (rack.name, rack.kind, len(rack.solid), len(rack.overhead)) == ("rack1", "rack", 1, 0)
    corners = frames.to_world(np.array([2.0, 3, 0, *frames.from_euler(np.radians(30.0))]), np.array([[1.0, 0.5, 0], [-1, -0.5, 0]]))[:, :2]
    assert np.abs(rack.solid[0][:, None] - corners).sum(axis=2).min(axis=0) == pytest.approx(0.0, abs=1e-5)
    assert area(rack.outline) == pytest.approx(2.0)
    assert (len(gate.solid), len(gate.overhead)) == (1, 1)  # a post, and a bar to walk under


def test_moving_bodies_have_outlines_in_their_own_frame_and_are_placed_by_their_pose():
    (outline,) = plan.outlines(scene())
    assert outline.min(axis=0) == pytest.approx([0.6, -0.3])
    placed = plan.placed(outline, np.array([5.0, 1.0, 0.0, *frames.from_euler(np.pi / 2)]))
    assert placed.min(axis=0) == pytest.approx([4.7, 1.6])
    assert placed.max(axis=0) == pytest.approx([5.3, 2.4])
