import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worlds.drive import SETTLED, WAIT, YAW_RATE, Follower, differential, steered, twist
from worlds.paths import rounded, timed


def test_on_its_reference_a_vehicle_drives_as_the_reference_does():
    assert twist((1.0, 2.0, 0.3), (1.0, 2.0, 0.3, 0.8, 0.2)) == pytest.approx((0.8, 0.2, 0.0))


def test_an_error_to_the_left_turns_left_and_one_ahead_speeds_up():
    speed, rate, along = twist((0.0, 0.0, 0.0), (0.1, 0.05, 0.0, 1.0, 0.0))
    assert speed > 1.0
    assert rate > 0
    assert along == pytest.approx(0.1)
    assert twist((0.0, 0.0, 0.0), (0.0, -0.05, 0.0, 1.0, 0.0))[1] < 0


def test_near_enough_to_its_end_it_stops_for_good():
    assert twist((0.0, 0.0, 0.0), (SETTLED / 2, 0.0, SETTLED / 2, 0.0, 0.0))[:2] == (0.0, 0.0)
    assert twist((0.0, 0.0, 0.0), (5 * SETTLED, 0.0, 0.0, 0.0, 0.0))[0] > 0


@given(st.tuples(*[st.floats(-50, 50)] * 3), st.tuples(*[st.floats(-50, 50)] * 3), st.floats(0, 5), st.floats(-3, 3))
def test_however_far_off_what_is_asked_for_stays_reasonable(pose, reference, v, w):
    speed, rate, _ = twist(pose, (*reference, v, w))
    assert abs(speed) <= v + 2.0 * WAIT + 1e-9
    assert abs(rate) <= YAW_RATE


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.3, 1))
def test_fixed_wheels_realise_speed_and_rate(speed, rate, half):
    left, right = differential(speed, rate, (half, -half))
    assert (left + right) / 2 == pytest.approx(speed)
    assert (right - left) / (2 * half) == pytest.approx(rate)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 2))
def test_a_steered_wheel_points_and_rolls_where_the_body_moves(speed, rate, behind):
    angle, rolled = steered(speed, rate, behind, 0.0)
    assert abs(angle) <= np.pi / 2 + 1e-12
    _, full = steered(speed, rate, behind, angle)  # once it points there, nothing is held back
    if np.hypot(speed, rate * behind) >= 1e-6:
        np.testing.assert_allclose(full * np.array([np.cos(angle), np.sin(angle)]), [speed, -rate * behind], atol=1e-9)
    assert abs(rolled) <= abs(full) + 1e-12


def test_a_steered_wheel_at_rest_keeps_its_angle():
    assert steered(0.0, 0.0, 1.3, 0.7) == (0.7, 0.0)


def simulate(trip, pose, duration, held=(0.0, 0.0), step=1 / 240):
    """An ideal vehicle that does what it is told, held up during an interval of time."""
    follower = Follower(trip, step, duration)
    x, y, yaw = pose
    track = []
    for k in range(int(duration / step)):
        track.append((x, y, yaw))
        v, w = follower.follow(x, y, yaw)
        if not held[0] <= k * step < held[1]:
            x, y, yaw = x + v * np.cos(yaw) * step, y + v * np.sin(yaw) * step, yaw + w * step
    return np.array(track)


def test_a_start_beside_the_route_is_corrected_without_overshoot():
    trip = timed(rounded([(0, 0), (30, 0)], 1.0), 0.0, 1.0, 0.5, 1.0)
    track = simulate(trip, (0.0, 0.2, 0.0), 20.0)
    assert abs(track[-1, 1]) < 1e-3
    assert track[:, 1].min() > -0.02


def test_a_vehicle_that_was_held_up_goes_on_where_it_was_and_cuts_nothing_short():
    trip = timed(rounded([(0, 0), (5, 0), (5, 5)], 0.8), 0.0, 1.0, 0.5, 1.0)
    free, held = simulate(trip, (0.0, 0.0, 0.0), 40.0), simulate(trip, (0.0, 0.0, 0.0), 40.0, held=(4.0, 14.0))
    np.testing.assert_allclose(held[-1], [5, 5, np.pi / 2], atol=0.01)
    reference, _, _, _ = trip.state(np.linspace(0, trip.arrival, 3000))
    for track in (free, held):
        distance = np.hypot(*(track[::20, None, :2] - reference).transpose(2, 0, 1)).min(axis=1)
        assert distance.max() < 0.02
