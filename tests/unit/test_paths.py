import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from testbed import frames, rng
from testbed.route import Route
from worlds.paths import PIVOT_ACCELERATION, PIVOT_RADIUS, PIVOT_RATE, plan, rounded, timed

coordinates = st.floats(-20, 20).map(lambda x: round(x, 2))
routes = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=7)
limits = st.tuples(st.floats(0.1, 3), st.floats(0.1, 2), st.floats(0.1, 2), st.floats(0.05, 3))  # speed, acceleration, lateral, radius


def apart(points):
    return np.hypot(*np.diff(np.array(points), axis=0).T).min() > 0.02


def trip_of(points, given_limits, start=0.0):
    speed, acceleration, lateral, radius = given_limits
    return timed(rounded(points, radius), start, speed, acceleration, lateral)


@settings(max_examples=60, deadline=None)
@given(routes, limits)
def test_no_limit_is_ever_passed(points, given_limits):
    assume(apart(points))
    speed, acceleration, lateral, _ = given_limits
    trip = trip_of(points, given_limits)
    t = np.linspace(0, trip.arrival, 2001)
    _, _, v, rate = trip.state(t)
    turning_on_the_spot = v == 0
    assert v.min() >= -1e-9
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(v * rate).max() <= lateral * (1 + 1e-6)  # v²/r of the path it is on
    assert np.abs(np.diff(v)).max() <= acceleration * np.diff(t)[0] * (1 + 1e-6) + 1e-9
    assert np.abs(rate[turning_on_the_spot]).max(initial=0) <= PIVOT_RATE * (1 + 1e-9)


@settings(max_examples=60, deadline=None)
@given(routes, limits)
def test_position_and_heading_are_continuous_and_the_end_is_reached(points, given_limits):
    assume(apart(points))
    trip = trip_of(points, given_limits)
    t = np.linspace(-1.0, trip.arrival + 1.0, 2001)
    position, heading, v, rate = trip.state(t)
    h = t[1] - t[0]
    assert np.hypot(*np.diff(position, axis=0).T).max() <= (v.max() + given_limits[1] * h) * h + 1e-9
    # the rate's own step bounds what lies between two samples
    assert np.abs(np.diff(heading)).max() <= np.abs(rate).max() * h * 1.2 + PIVOT_ACCELERATION * h * h + 1e-4
    np.testing.assert_allclose(position[0], points[0], atol=1e-12)
    np.testing.assert_allclose(position[-1], points[-1], atol=1e-8)
    assert v[-1] == rate[-1] == 0


@settings(max_examples=40, deadline=None)
@given(routes, limits)
def test_speed_and_yaw_rate_are_the_derivatives_of_position_and_heading(points, given_limits):
    assume(apart(points))
    trip = trip_of(points, given_limits)
    rng_t = np.linspace(0.01, 0.99, 37) * trip.arrival
    h = 1e-5
    (behind, heading0, _, _), (ahead, heading1, _, _) = trip.state(rng_t - h), trip.state(rng_t + h)
    _, heading, v, rate = trip.state(rng_t)
    along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    smooth = np.ones(len(rng_t), dtype=bool)
    for change in trip.t:  # a difference across the change of a phase is the mean of both sides
        smooth &= np.abs(rng_t - change) > 2 * h
    np.testing.assert_allclose(((ahead - behind) / (2 * h))[smooth], (v[:, None] * along)[smooth], atol=2e-5)
    np.testing.assert_allclose(((heading1 - heading0) / (2 * h))[smooth], rate[smooth], atol=2e-4)


@settings(max_examples=60, deadline=None)
@given(routes, st.floats(0.05, 10))
def test_corners_take_no_more_than_the_legs_have(points, radius):
    assume(apart(points))
    path = rounded(points, radius)
    assert (path.length >= 0).all()
    straight = path.radius == np.inf
    assert path.radius[~straight].min(initial=np.inf) >= PIVOT_RADIUS
    assert path.radius[~straight].max(initial=0) <= radius
    assert path.total <= np.hypot(*np.diff(np.array(points), axis=0).T).sum() + 1e-9  # rounding never makes a way longer
    np.testing.assert_allclose(path.at(path.total)[0], points[-1], atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.0, 3.0).filter(lambda a: abs(a) > 0.05), st.floats(0.2, 2))
def test_a_corner_is_as_far_from_its_way_point_as_its_tangent_says_and_symmetric(turn, radius):
    reach = 200.0
    out = reach * np.array([np.cos(turn), np.sin(turn)])
    path = rounded([(-reach, 0), (0, 0), out], radius)
    s = np.linspace(0, path.total, 3001)
    position, _, curvature = path.at(s)
    mirror, _, bent = path.at(path.total - s)
    np.testing.assert_allclose(curvature, bent, atol=1e-8 / radius)
    bisector = np.array([-1.0, 0.0]) + out / reach
    across = np.array([-bisector[1], bisector[0]]) / np.linalg.norm(bisector)
    np.testing.assert_allclose(position @ across, -(mirror @ across), atol=1e-7)
    assert np.abs(curvature).max() == pytest.approx(1 / path.radius.min())


def test_curvature_has_no_steps_in_a_rounded_corner():
    path = rounded([(0, 0), (5, 0), (5, 5)], 1.0)
    _, _, curvature = path.at(np.linspace(0, path.total, 20001))
    assert np.abs(np.diff(curvature)).max() < 2e-3
    assert curvature.max() == pytest.approx(1.0)


def test_a_square_corner_agrees_with_the_integral_of_its_curvature():
    path = rounded([(0, 0), (4, 0), (4, 4)], 0.8)
    s = np.linspace(0, path.total, 100_001)
    position, heading, curvature = path.at(s)
    h = s[1] - s[0]
    trapezium = lambda y: np.concatenate([[0.0], np.cumsum((y[1:] + y[:-1]) / 2) * h])  # noqa: E731
    np.testing.assert_allclose(trapezium(curvature), heading, atol=2e-9)
    np.testing.assert_allclose(trapezium(np.cos(heading)), position[:, 0], atol=1e-9)
    np.testing.assert_allclose(trapezium(np.sin(heading)), position[:, 1], atol=1e-9)


def test_a_straight_trip_is_the_textbook_trapezium():
    trip = timed(rounded([(0, 0), (10, 0)], 1.0), 2.0, speed=1.0, acceleration=0.5, lateral_acceleration=1.0)
    assert trip.arrival == pytest.approx(2.0 + 10.0 + 2.0)  # d/v + v/a, from the start
    position, _, v, _ = trip.state([0.0, 2.0, 4.0, 5.0, 13.0, 14.0, 20.0])
    np.testing.assert_allclose(position[:, 0], [0, 0, 1, 2, 9.75, 10, 10])
    np.testing.assert_allclose(v, [0, 0, 1, 1, 0.5, 0, 0])


def test_a_short_trip_never_reaches_its_speed():
    trip = timed(rounded([(0, 0), (0.5, 0)], 1.0), 0.0, speed=5.0, acceleration=0.5, lateral_acceleration=1.0)
    assert trip.arrival == pytest.approx(2.0)  # 2 √(d/a)
    assert trip.state(1.0)[2] == pytest.approx(0.5)


def test_corner_speed_is_that_of_the_lateral_limit():
    trip = timed(rounded([(0, 0), (20, 0), (20, 20)], 0.5), 0.0, speed=3.0, acceleration=1.0, lateral_acceleration=0.8)
    _, _, v, rate = trip.state(np.linspace(0, trip.arrival, 20001))
    turning = np.abs(rate) > 1e-6
    np.testing.assert_allclose(v[turning], np.sqrt(0.8 * 0.5), rtol=1e-6)


def test_doubling_back_turns_on_the_spot_at_the_way_point():
    trip = timed(rounded([(0, 0), (3, 0), (0, 0)], 0.8), 0.0, 1.0, 1.0, 1.0)
    position, heading, v, _ = trip.state(np.linspace(0, trip.arrival, 5001))
    resting = (v == 0) & (np.abs(heading) > 1e-6) & (np.abs(heading) < np.pi - 1e-6)
    assert resting.any()
    np.testing.assert_allclose(position[resting], [[3, 0]] * resting.sum(), atol=1e-12)
    assert abs(heading[-1]) == pytest.approx(np.pi)
    np.testing.assert_allclose(position[-1], [0, 0], atol=1e-12)


def test_poses_look_along_the_path():
    trip = timed(rounded([(0, 0), (0, 5)], 1.0), 0.0, 1.0, 1.0, 1.0)
    pose = trip.pose([0.0, 3.0, 100.0])
    np.testing.assert_allclose(frames.yaw_of(pose[:, 3:]), np.pi / 2)
    np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0)
    assert (pose[:, 2] == 0).all()


def test_jitter_stays_in_its_bounds_and_shifts_along_the_normal_of_the_first_leg():
    route = Route(
        waypoints_m=[(0, 0), (4, 0), (4, 4)], speed_mps=1.0, start_s=1.0, start_jitter_s=2.0, speed_jitter=0.2, lateral_jitter_m=0.3
    )
    trips = [plan(route, rng.stream(7, trial, "actors.t1.route")) for trial in range(60)]
    starts = np.array([t.t[0] for t in trips])
    aside = np.array([t.pose(0.0)[:2] for t in trips])
    fastest = np.array([t.state(np.linspace(t.t[0], t.arrival, 400))[2].max() for t in trips])
    assert starts.min() >= 1.0
    assert 1.5 < np.ptp(starts) <= 2.0
    assert (aside[:, 0] == 0).all()
    assert np.abs(aside[:, 1]).max() <= 0.3
    assert np.ptp(aside[:, 1]) > 0.45
    assert 0.8 <= fastest.min() < 0.85
    assert 1.15 < fastest.max() <= 1.2


def test_no_jitter_means_the_same_trip_whatever_is_drawn():
    route = Route(waypoints_m=[(0, 0), (4, 0), (4, 4)])
    t = np.linspace(0, 12, 50)
    assert np.array_equal(plan(route, rng.stream(1, 0, "a")).pose(t), plan(route, rng.stream(2, 5, "b")).pose(t))
