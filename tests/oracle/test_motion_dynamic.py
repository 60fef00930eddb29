"""Vehicles on wheels: they run straight, keep to their route, are bit-identical, and survive what they run into."""

import hashlib
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from testbed import frames, plugins, rng
from testbed.protocols import ActorPlan
from testbed.route import Route
from worlds.parts import floor_pose
from worlds.paths import plan

pytest.importorskip("pybullet")
ROUND = Route(waypoints_m=[(2, 2), (8, 2), (8, 6), (3, 7)], speed_mps=1.2)


@pytest.fixture(scope="module")
def floor():
    cls = plugins.load("worlds", "open_floor")
    hall = cls(cls.Config(length_m=40, width_m=40, posts=4))
    yield hall
    hall.close()


@pytest.fixture(scope="module")
def dock():
    cls = plugins.load("worlds", "dock_gate")
    hall = cls(cls.Config())
    yield hall
    hall.close()


def actor(kind, route, name="a1", motion="dynamic", **config):
    cls = plugins.load("actors", kind)
    (x0, y0), (x1, y1) = route.waypoints_m[:2]
    return ActorPlan(name, kind, motion, cls(cls.Config(**config)), route, floor_pose(x0, y0, np.arctan2(y1 - y0, x1 - x0)))


def move(hall, *actors, duration=15.0, trial=0):
    return hall.move(hall.scene(actors), actors, duration, 11, trial)


def off_its_own_line(positions):
    """Greatest distance (m) from the straight line fitted to the positions (N, 2): the second principal direction."""
    centred = positions - positions.mean(axis=0)
    return np.abs(centred @ np.linalg.svd(centred, full_matrices=False)[2][1]).max()


@pytest.mark.parametrize("kind", ["trolley", "forklift"])
@pytest.mark.parametrize("heading", [0.0, 0.3, -1.1, 2.5])
def test_at_constant_speed_a_vehicle_leaves_its_own_line_by_less_than_a_fifth_of_a_millimetre(floor, kind, heading):
    start = np.array([20.0, 20.0]) - 9 * np.array([np.cos(heading), np.sin(heading)])
    end = start + 18 * np.array([np.cos(heading), np.sin(heading)])
    route = Route(waypoints_m=[tuple(start), tuple(end)], speed_mps=1.2, acceleration_mps2=0.6)
    truth = move(floor, actor(kind, route), duration=12.0)
    steady = (truth.t > 2.2) & (truth.t < 12.0)  # it reaches its speed after 2 s and brakes after 15 s
    track = truth.poses[steady, 0]
    speed = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1) * 120
    np.testing.assert_allclose(speed, 1.2, rtol=2e-3)
    assert off_its_own_line(track[:, :2]) < 0.2e-3
    assert np.ptp(track[:, 2]) < 0.05e-3  # wheels don't rattle


@pytest.mark.parametrize("kind", ["trolley", "forklift"])
def test_a_vehicle_keeps_to_its_route_through_bends_and_reaches_its_end(floor, kind):
    truth = move(floor, actor(kind, ROUND), duration=20.0)
    trip = plan(ROUND, rng.stream(11, 0, "actors.a1.route"))
    line = trip.state(np.linspace(0, trip.arrival, 3000))[0]
    position = truth.poses[:, 0, :2]
    assert np.hypot(*(position[::6, None] - line).transpose(2, 0, 1)).min(axis=1).max() < 0.15
    np.testing.assert_allclose(position[-1], ROUND.waypoints_m[-1], atol=0.01)
    wanted = trip.pose(truth.t)
    assert np.linalg.norm(position - wanted[:, :2], axis=1).max() < 0.15  # in time, too
    turned = np.abs(frames.yaw_of(frames.multiply(frames.conjugate(wanted[:, 3:]), truth.poses[:, 0, 3:])))
    assert turned.max() < 0.15


@pytest.mark.parametrize("kind", ["trolley", "forklift"])
def test_a_vehicle_turns_round_where_its_route_doubles_back(floor, kind):
    truth = move(floor, actor(kind, Route(waypoints_m=[(20, 20), (23, 20), (20, 20)])), duration=20.0)
    np.testing.assert_allclose(truth.poses[-1, 0, :2], [20, 20], atol=0.02)
    assert abs(frames.yaw_of(truth.poses[-1, 0, 3:])) > 3.1
    assert truth.poses[:, 0, 0].max() < 23.05


def demo(hall, trial=0):
    jitter = {"start_jitter_s": 1.0, "speed_jitter": 0.1, "lateral_jitter_m": 0.1}
    t1 = actor("trolley", Route(waypoints_m=[(1.5, 3), (7.5, 3), (7.5, 8)], speed_mps=1.2, **jitter), "t1")
    f1 = actor("forklift", Route(waypoints_m=[(9.2, 8.5), (9.2, 3.5)], speed_mps=1.5, **jitter), "f1")
    p1 = actor("person", Route(waypoints_m=[(2, 9), (6.5, 9)]), "p1", motion="kinematic")
    return move(hall, t1, f1, p1, duration=5.0, trial=trial)


def digest(truth):
    return hashlib.sha256(truth.poses.tobytes()).hexdigest()


def test_runs_are_bit_identical_in_one_process_after_other_runs_and_in_another_process(dock):
    first, again = digest(demo(dock)), digest(demo(dock))
    move(dock, actor("forklift", Route(waypoints_m=[(7, 10), (7, 3)])), duration=2.0)
    other = digest(demo(dock, trial=1))
    later = digest(demo(dock))
    dock.close()  # a new client
    fresh = digest(demo(dock))
    assert first == again == later == fresh != other
    program = f"""
        import importlib.util
        spec = importlib.util.spec_from_file_location("elsewhere", {__file__!r})
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        cls = module.plugins.load("worlds", "dock_gate")
        print(module.digest(module.demo(cls(cls.Config()))))
    """
    answer = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, capture_output=True, text=True)
    assert answer.stdout.strip() == first


@pytest.mark.parametrize(("kind", "speed"), [("trolley", 0.6), ("trolley", 3.0), ("forklift", 1.5), ("forklift", 3.0)])
def test_a_vehicle_that_is_driven_into_a_rack_stops_there_on_its_wheels(dock, kind, speed):
    route = Route(waypoints_m=[(7.0, 3.2), (10, 3.2), (10, 0.5)], speed_mps=speed, acceleration_mps2=1.0)
    truth = move(dock, actor(kind, route), duration=15.0)
    upright = frames.matrix(truth.poses[:, 0, 3:])[:, 2, 2]
    assert np.degrees(np.arccos(upright.clip(-1, 1))).max() < 3.0
    assert np.abs(truth.poses[:, 0, 2]).max() < 0.02
    assert np.linalg.norm(truth.poses[-1, 0, :2] - truth.poses[-240, 0, :2]) < 0.01  # at rest for the last 2 s
    assert truth.poses[-1, 0, 1] > 1.1 + 0.5  # before the rack, whose front is at 1.1 m, by at least its own front
    speeds = np.linalg.norm(np.diff(truth.poses[:, 0, :2], axis=0), axis=1) * 120
    assert speeds.max() < speed + 0.6


def test_a_person_in_the_way_is_not_driven_through_and_the_trolley_goes_on_after(floor):
    ahead = Route(waypoints_m=[(10, 10), (16, 10)], speed_mps=1.0)
    crossing = Route(waypoints_m=[(13, 10), (13, 12)], start_s=12.0)
    truth = move(floor, actor("trolley", ahead, "t1"), actor("person", crossing, "p1", motion="kinematic"), duration=25.0)
    waiting = (truth.t > 8) & (truth.t < 12)
    front = truth.poses[waiting, 0, 0] + 0.68
    assert front.max() < 13 - 0.1  # the person's chest
    np.testing.assert_allclose(truth.poses[-1, 0, :2], [16, 10], atol=0.05)


def test_two_dynamic_vehicles_do_not_pass_through_each_other(floor):
    east, west = Route(waypoints_m=[(10, 10), (18, 10)]), Route(waypoints_m=[(18, 10), (10, 10)])
    truth = move(floor, actor("trolley", east, "t1"), actor("forklift", west, "f1"), duration=12.0)
    gap = truth.poses[:, truth.index("f1"), 0] - truth.poses[:, truth.index("t1"), 0]
    assert gap.min() > 0.68 + 1.6  # the cage's front and the load on the forks


def test_a_vehicle_that_starts_inside_something_is_refused_by_name(dock, floor):
    into = Route(waypoints_m=[(10, 0.8), (10, 3)])
    with pytest.raises(ValueError, match=r"actor a1 starts .* m inside rack2: move its first way point"):
        move(dock, actor("trolley", into), duration=1.0)
    same = Route(waypoints_m=[(10, 10), (12, 10)])
    with pytest.raises(ValueError, match=r"actor t1 starts .* inside t2"):
        move(floor, actor("trolley", same, "t1"), actor("trolley", same, "t2"), duration=1.0)


def test_what_has_no_wheels_can_not_be_dynamic(floor):
    with pytest.raises(ValueError, match="actor p1: a person has no wheels to drive on, its motion can be kinematic or parked"):
        move(floor, actor("person", ROUND, "p1"), duration=1.0)
