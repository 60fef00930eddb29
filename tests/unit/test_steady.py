"""A point on straight legs at one speed: truth that is a formula."""

import numpy as np
import pytest
from pydantic import ValidationError

from testbed.route import Route
from testbed.scenario import ScenarioError, from_dict
from testbed.simulate import Simulator
from worlds.steady import steady

WAY = [[3.0, 1.5], [3.0, 2.5], [2.0, 3.5]]
HEIGHTS = [0.75, 1.75, 0.75]
SCENARIO = {
    "name": "point", "seed": 1, "trials": 1, "duration_s": 6.2, "step_hz": 10, "truth_hz": 10,
    "world": {"kind": "open_floor", "posts": 0},
    "actors": [
        {
            "id": "t1", "kind": "marker", "motion": "kinematic",
            "route": {"pace": "steady", "waypoints_m": WAY, "heights_m": HEIGHTS, "speed_mps": 0.5},
            "tags": [{"id": "low", "position_m": [0, 0, 0]}, {"id": "high", "position_m": [0, 0, 0.5]}],
        }
    ],
    "targets": ["t1"],
}  # fmt: skip


def trip(seed=1, **fields):
    return steady(
        Route(**{"pace": "steady", "waypoints_m": WAY, "heights_m": HEIGHTS, "speed_mps": 0.5} | fields), np.random.default_rng(seed)
    )


def test_positions_lie_at_arc_length_speed_times_time():
    points = np.column_stack([WAY, HEIGHTS])
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.array([0.0, 1.0, legs[0] / 0.5, (legs[0] + 0.5 * legs[1]) / 0.5, 1e3])
    expected = [points[0], points[0] + 0.5 / legs[0] * (points[1] - points[0]), points[1], (points[1] + points[2]) / 2, points[2]]
    np.testing.assert_allclose(trip().pose(t)[:, :3], expected, atol=1e-12)
    assert trip().arrival == pytest.approx(legs.sum() / 0.5)


def test_it_neither_turns_nor_slows_down_at_a_corner():
    t = np.arange(0, 6.0, 0.05)
    pose = trip().pose(t)
    assert (pose[:, 3:] == [1, 0, 0, 0]).all()
    steps = np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1)
    assert np.sum(np.abs(steps - 0.025) > 1e-9) == 1  # the one that cuts the corner


def test_the_truth_is_the_formula_at_the_instants_that_are_kept():
    with Simulator(from_dict(SCENARIO)) as simulator:
        trial = simulator.trial(0)
    t = np.arange(63) / 10
    np.testing.assert_allclose(trial.target_states(t)[:, 0, :3], trip().pose(t)[:, :3], atol=1e-13)
    assert [list(tags) for tags in trial.recording.target_tags] == [[0, 1]]


def test_way_points_are_drawn_anew_for_each_trial_within_their_jitter():
    drawn = np.array([trip(seed, waypoint_jitter_m=(0.5, 0.2, 0.0)).points for seed in range(200)]) - np.column_stack([WAY, HEIGHTS])
    assert np.abs(drawn).max(axis=(0, 1)) == pytest.approx([0.5, 0.2, 0.0], abs=0.02)
    assert len(np.unique(drawn[:, 0, 0])) == 200


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"pace": "driven", "heights_m": [0, 0, 0]}, "heights_m is for pace steady"),
        ({"pace": "steady", "heights_m": [0, 0]}, "heights_m has 2 heights for 3 way points"),
    ],
)
def test_what_does_not_fit_a_route_is_refused(fields, sentence):
    with pytest.raises(ValidationError, match=sentence):
        Route(waypoints_m=WAY, **fields)


def test_a_body_with_a_mass_can_not_be_steady():
    document = {**SCENARIO, "actors": [{**SCENARIO["actors"][0], "motion": "dynamic"}]}
    with pytest.raises(ScenarioError, match="pace steady is for motion kinematic"):
        from_dict(document)
