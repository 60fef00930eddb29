"""The log of a vehicle read, its heading, and the street network that is drawn about its path."""

from itertools import pairwise

import numpy as np
import pytest
from car_logs import circle, place, written

from testbed.roads import project
from testbed.vehicle_log import local_plane, read_vehicle_log
from worlds.street_network import street_network, thinned


def test_a_log_is_read_in_its_own_time_and_plane(tmp_path):
    log = read_vehicle_log(*circle(tmp_path))
    np.testing.assert_allclose(log.t[[0, -1]], [0, 20])
    np.testing.assert_allclose(log.truth_t, log.t)
    radius = 50.0
    np.testing.assert_allclose(log.truth[:, 0], radius * np.sin(0.1 * log.t), atol=0.01)
    np.testing.assert_allclose(log.truth[:, 1], radius * (1 - np.cos(0.1 * log.t)), atol=0.01)


def test_the_heading_is_the_turn_integrated_from_the_course_of_the_first_metres(tmp_path):
    log = read_vehicle_log(*circle(tmp_path))
    course, at = log.course(15.0)
    heading = np.unwrap(log.heading(at, course))
    np.testing.assert_allclose(heading, 0.1 * log.t, atol=0.015)  # the course is that of a chord, half its arc's turn
    streams = log.streams(heading)
    assert set(streams) == {"odometry", "heading"}
    assert len(streams["odometry"]) == len(log.t)


@pytest.mark.parametrize(
    ("odometer", "truth", "message"),
    [
        (["odom3 0 1 0 0 0 0 x"], ["point3 0 1 2 3"], r"odometer.txt:1: a number is wanted after odom3"),
        (["odom3 0 1 0 0"], ["point3 0 1 2 3"], r"odometer.txt:1: odom3 wants 7 finite numbers"),
        (["odom3 0 1 0 0 0 0 nan"], ["point3 0 1 2 3"], r"odometer.txt:1: odom3 wants 7 finite numbers"),
        (["odom3 1 1 0 0 0 0 0", "odom3 1 1 0 0 0 0 0"], ["point3 0 1 2 3"], r"odometer.txt:2: the time 1 s does not come after 1 s"),
        (["odom3 0 1 0 0 0 0 0"], ["pseudorange3 0 1"], r"truth.txt: there is no line that begins with point3"),
    ],
)
def test_what_can_t_be_read_is_named_by_file_and_line(tmp_path, odometer, truth, message):
    with pytest.raises(ValueError, match=message):
        read_vehicle_log(*written(tmp_path, odometer, truth))


def test_a_path_that_is_too_short_has_no_course(tmp_path):
    log = read_vehicle_log(*circle(tmp_path, speed=0.1))
    with pytest.raises(ValueError, match="never leads 15 m away"):
        log.course(15.0)


def test_the_plane_keeps_distances():
    away = np.array([place(0, 0), place(300.0, 0), place(0, 400.0)])
    np.testing.assert_allclose(local_plane(away), [[0, 0], [300, 0], [0, 400]], atol=0.05)


def test_a_thinned_path_stays_within_its_tolerance_and_keeps_its_corners():
    x = np.linspace(0, 100, 201)
    path = np.concatenate([np.stack([x, 0.5 * np.sin(x)], axis=1), np.stack([np.full(200, 100.0), x[1:]], axis=1)])
    corners = thinned(path, 3.0)
    assert len(corners) == 3
    ends = np.stack([corners[:-1], corners[1:]], axis=1)
    apart = [min(np.hypot(*(p - a - np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a))) for a, b in ends) for p in path]
    assert max(apart) <= 3.0


def test_a_street_network_leads_along_the_path_and_has_wrong_streets_at_every_corner():
    square = np.array([[0, 0], [100, 0], [100, 100], [0, 100], [-100, 100.0]])
    x = np.concatenate([np.linspace(a, b, 100, endpoint=False) for a, b in pairwise(square)])
    roads, wrong = street_network(x, 3)
    assert wrong == 4  # two at each of two corners; the last node is none, it lies on a straight line
    assert project(roads, x)[2].max() < 3.5
    again, _ = street_network(x, 3)
    np.testing.assert_array_equal(roads.nodes, again.nodes)
    assert not np.array_equal(roads.nodes, street_network(x, 4)[0].nodes)
