"""The interpolant of the truth, against closed forms."""

import numpy as np
import pytest

from testbed import frames
from testbed.recording import Recording, Trial
from testbed.scene import Truth, Zones
from testbed.types import Antennas, Site, Tags, Targets


def circle(rate, radius=1.0, speed=1.5, seconds=4.0):
    t = np.arange(int(seconds * rate) + 1) / rate
    angle = speed / radius * t
    q = frames.from_euler(angle + np.pi / 2)
    return Truth(
        t=t, poses=np.concatenate([np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * t], 1), q], 1)[:, None], bodies=("a",)
    )


def test_a_bend_is_interpolated_far_below_the_phase_noise():
    truth, t = circle(120), np.linspace(0.1, 3.9, 2001)
    pose = truth.pose(0, t)
    exact = np.stack([np.cos(1.5 * t), np.sin(1.5 * t)], 1)
    assert np.abs(pose[:, :2] - exact).max() < 1e-6  # m; a wavelength's worth of phase noise is 1e-4 m
    turned = frames.yaw_of(frames.multiply(frames.conjugate(frames.from_euler(1.5 * t + np.pi / 2)), pose[:, 3:]))
    assert np.abs(turned).max() < 1e-6
    assert np.abs(np.linalg.norm(truth.velocity(0, t)[:, :2], axis=1) - 1.5).max() < 1e-4


def test_straight_motion_is_exact():
    t = np.arange(11) / 10
    poses = np.tile(frames.IDENTITY, (11, 1, 1))
    poses[:, 0, 0] = 2 * t
    truth, at = Truth(t=t, poses=poses, bodies=("a",)), np.linspace(0, 1, 77)
    np.testing.assert_allclose(truth.pose(0, at)[:, 0], 2 * at, atol=1e-14)
    np.testing.assert_allclose(truth.velocity(0, at)[:, 0], 2.0, atol=1e-12)


def test_velocity_is_the_derivative_of_the_pose():
    truth, t, h = circle(30), np.linspace(0.2, 3.8, 100), 1e-6
    numeric = (truth.pose(0, t + h)[:, :3] - truth.pose(0, t - h)[:, :3]) / (2 * h)
    np.testing.assert_allclose(truth.velocity(0, t), numeric, atol=1e-6)


def test_a_quaternion_that_changes_sign_is_the_same_rotation():
    truth = circle(60)
    poses = np.array(truth.poses)
    poses[::3, :, 3:] *= -1
    flipped, t = Truth(t=truth.t, poses=poses, bodies=("a",)), np.linspace(0, 4, 500)
    np.testing.assert_allclose(frames.matrix(flipped.pose(0, t)[:, 3:]), frames.matrix(truth.pose(0, t)[:, 3:]), atol=1e-12)


def test_before_and_after_the_recording_nothing_moves():
    truth = circle(60)
    np.testing.assert_array_equal(truth.pose(0, [-1.0, 99.0])[:, :3], truth.poses[[0, -1], 0, :3])
    np.testing.assert_array_equal(truth.velocity(0, [-1.0, 99.0]), 0)


def test_an_unknown_body_is_named():
    with pytest.raises(KeyError, match="no moving body 'b'; there are a"):
        circle(10).index("b")


def test_zones_are_found_and_borders_belong():
    zones = Zones(name=["in", "out"], bounds=[[0, 0, 1, 1], [1, 0, 2, 1]])
    np.testing.assert_array_equal(zones.locate([[0.5, 0.5], [1.0, 1.0], [1.5, 0.2], [3, 3]]), [0, 0, 1, -1])


def test_a_target_on_a_turning_body_has_the_speed_of_its_lever_arm():
    truth = circle(240)
    site = Site(antennas=Antennas.empty(), tags=Tags.empty(), frequencies=np.empty(0))
    recording = Recording(0, 4.0, site, {}, Targets(name=["t", "w"], body=["a", ""]), ())
    arm = np.concatenate([[0.0, -0.5, 1.0], frames.from_euler(0.0)])  # half a metre outwards of the circle
    trial = Trial(recording, truth, np.array([0, -1]), np.stack([arm, np.arange(7.0)]), {})
    states = trial.target_states(np.array([1.0, 2.0]))
    np.testing.assert_allclose(np.linalg.norm(states[:, 0, 3:5], axis=1), 1.5 * 1.5, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(states[:, 0, :2], axis=1), 1.5, atol=1e-6)
    np.testing.assert_array_equal(states[:, 1], [[0, 1, 2, 0, 0, 0]] * 2)
