"""Which points are inside which boxes, against a test written out box by box."""

import numpy as np

from testbed import frames
from testbed.geometry import Boxes
from testbed.scene import Body, Scene
from testbed.solid import holder, holders


def boxes(n, seed=0):
    rng = np.random.default_rng(seed)
    turn = frames.from_euler(*rng.uniform(-np.pi, np.pi, (3, n)))
    return Boxes(rng.uniform(-2, 2, (n, 3)), turn, rng.uniform(0.1, 0.8, (n, 3)))


def test_points_are_inside_the_first_box_that_holds_them():
    solid, points = boxes(20), np.random.default_rng(1).uniform(-3, 3, (2000, 3))
    found = holder(points, solid)
    for point, got in zip(points, found, strict=True):
        local = frames.rotate(frames.conjugate(solid.quaternion), point - solid.center)
        inside = np.flatnonzero((np.abs(local) < solid.half).all(axis=1))
        assert got == (inside[0] if len(inside) else -1)
    assert (found >= 0).sum() > 100


def test_a_surface_holds_nothing_and_no_box_holds_anything():
    one = Boxes([[0.0, 0, 0]], [[1.0, 0, 0, 0]], [[1.0, 1, 1]])
    assert holder(np.array([[1.0, 0, 0], [0, -1, 0], [0.999999, 0, 0], [0, 0, 0]]), one).tolist() == [-1, -1, 0, 0]
    assert holder(np.zeros((3, 3)), Boxes.empty()).tolist() == [-1, -1, -1]


def test_what_rides_is_asked_of_its_own_body_and_what_stands_of_what_stands():
    q, pose = [[1.0, 0, 0, 0]] * 3, frames.IDENTITY
    bodies = (
        Body("cart", "cart", pose, moving=True),
        Body("hall", "hall", np.array([5.0, 0, 0, 1, 0, 0, 0])),
        Body("fork", "fork", pose, True),
    )
    solid = Boxes([[0.0, 0, 0], [1.0, 0, 0], [9.0, 0, 0]], q, [[0.5, 0.5, 0.5]] * 3, body=[0, 1, 2])
    scene = Scene(bodies, solid, ("steel",), np.zeros((2, 3)))
    point = np.array([[0.0, 0, 0], [6.0, 0, 0], [9.0, 0, 0]])
    assert holders(scene, np.array([-1, -1, -1]), point).tolist() == [-1, 1, -1]
    assert holders(scene, np.array([0, 0, 0]), point).tolist() == [0, -1, -1]
    assert holders(scene, np.array([1, 1, 1]), point).tolist() == [-1, -1, 2]
