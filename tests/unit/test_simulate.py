"""A trial as a function of (scenario, seed, number): what may change a stream, and what may not."""

import numpy as np
import pytest

from testbed.prior import draw_prior
from testbed.scenario import PriorModel, from_dict
from testbed.simulate import Simulator

TROLLEY = {
    "id": "t1",
    "kind": "trolley",
    "motion": "kinematic",
    "route": {"waypoints_m": [[1, 1], [6, 1], [6, 4]], "start_jitter_s": 0.5, "speed_jitter": 0.2},
    "tags": [{"id": "lid", "mount": "top"}, {"id": "side", "mount": "left"}],
}
POSTS = {"id": "posts", "kind": "rfid", "antennas": {"on": "post[12]"}}


def document(**changes):
    base = {"name": "t", "seed": 5, "trials": 3, "duration_s": 6, "world": {"kind": "open_floor"}}
    return {**base, "actors": [TROLLEY], "sensors": [POSTS], **changes}


def trials(count=1, seed=None, **changes):
    with Simulator(from_dict(document(**changes))) as simulator:
        return [simulator.trial(i, seed) for i in range(count)]


def streams(**changes):
    return trials(**changes)[0].recording.streams


def same(a, b):
    return all(a[kind].equals(b[kind]) for kind in a)


def test_a_trial_does_not_depend_on_those_before_it():
    three = trials(3)
    with Simulator(from_dict(document())) as simulator:
        last = simulator.trial(2)
    assert same(three[2].recording.streams, last.recording.streams)
    assert np.array_equal(three[2].truth.poses, last.truth.poses)
    assert not same(three[1].recording.streams, last.recording.streams)


def test_another_sensor_changes_no_other_stream():
    wheel = {"id": "wheel", "kind": "odometry", "on": "t1"}
    compass = {"id": "north", "kind": "compass", "on": "t1"}
    alone, among = streams(), streams(sensors=[compass, POSTS, wheel])
    assert same(alone, {kind: among[kind] for kind in alone})
    assert {"odometry", "heading"} <= set(among)
    assert streams(sensors=[wheel])["odometry"].equals(among["odometry"])


def test_another_actor_moves_no_draw_of_the_first():
    other = {"id": "p", "kind": "person", "motion": "kinematic", "route": {"waypoints_m": [[7, 5], [7.5, 5.5]], "start_jitter_s": 1}}
    alone, both = trials()[0].truth, trials(actors=[other, TROLLEY])[0].truth
    assert np.array_equal(alone.poses[:, 0], both.poses[:, both.bodies.index("t1")])


def test_a_tag_out_of_reach_changes_no_read():
    far = [{"id": "far", "position_m": [1000, 0, 1]}]
    alone, more = streams()["reads"], streams(tags=far)["reads"]
    assert alone.equals(more)


def test_two_readers_keep_their_rounds_apart():
    other = {"id": "others", "kind": "rfid", "antennas": {"on": "post[34]"}, "reader": "r420"}
    both = streams(sensors=[POSTS, other])
    rounds, counts = both["rounds"], both["counts"]
    assert len(np.unique(rounds.round)) == len(rounds)
    assert set(rounds.reader) == {0, 1}
    assert rounds.antenna[rounds.reader == 1].min() == 4  # the second reader's antennas come after the first's
    place = {r: i for i, r in enumerate(rounds.round.tolist())}
    assert all(rounds.antenna[place[r]] == a for r, a in zip(counts.round.tolist(), counts.antenna.tolist(), strict=True))
    assert np.all(np.diff(both["reads"].t_arrival) >= 0)


def test_readers_that_ask_some_tags_only_keep_their_populations_apart():
    tags = [{"id": "near1", "position_m": [3, 2, 1]}, {"id": "near2", "position_m": [4, 3, 1]}]
    other = {"id": "others", "kind": "rfid", "antennas": {"on": "post[34]"}, "reader": {"select": "near*"}}
    wheel = {"id": "wheel", "kind": "odometry", "on": "t1"}
    recording = trials(sensors=[wheel, {**POSTS, "antennas": {"on": "post[12]"}}, other], tags=tags)[0].recording
    rounds, ids = recording.streams["rounds"], [str(id) for id in recording.site.tags.id]
    asked = recording.asked_sets[rounds.asked]
    assert asked[rounds.reader == 0].all()
    assert np.array_equal(asked[rounds.reader == 1].any(axis=0), [id.startswith("near") for id in ids])


def test_the_seed_of_a_trial_can_be_given():
    assert same(trials(seed=5)[0].recording.streams, streams())
    assert not same(trials(seed=6)[0].recording.streams, streams())


def test_survey_error_is_the_installers_and_not_the_radios():
    surveyed = trials(2, survey={"antenna_position_std_m": 0.1, "antenna_yaw_std_deg": 5})
    exact = trials()[0]
    assert same(surveyed[0].recording.streams, exact.recording.streams)
    off = [t.recording.site.antennas.position - exact.recording.site.antennas.position for t in surveyed]
    assert 0.01 < np.abs(off[0]).mean() < 0.3
    assert not np.array_equal(off[0], off[1])


def test_the_stimulus_is_told_by_sensor_and_over_all():
    found = trials(sensors=[POSTS, {"id": "others", "kind": "rfid", "antennas": {"on": "post[34]"}}])[0].stimulus
    assert found["target_reads_hz"] == pytest.approx(found["posts.target_reads_hz"] + found["others.target_reads_hz"])
    low, high = sorted([found["posts.line_of_sight"], found["others.line_of_sight"]])
    assert 0 <= low <= found["line_of_sight"] <= high <= 1


def test_a_prior_is_drawn_round_the_truth_or_given():
    made = trials(3)
    model = PriorModel(position_std_m=(0.5, 0.5, 0.1), velocity_std_mps=(0.1, 0.1, 0.1))
    prior = draw_prior(model, made, 5)
    assert prior.rows == 6  # three trials of two targets
    truth = np.concatenate([t.target_states(np.zeros(1))[0] for t in made])
    pulls = (prior.mean - truth) / [0.5, 0.5, 0.1, 0.1, 0.1, 0.1]
    assert np.abs(pulls).max() < 5  # 36 standard normals: false alarm 2e-5, at a fixed seed
    assert np.abs(pulls).std() > 0.3
    np.testing.assert_allclose(prior.covariance[0], np.diag([0.25, 0.25, 0.01, 0.01, 0.01, 0.01]))
    given = draw_prior(PriorModel(position_m=(1, 2, 3)), made, 5)
    np.testing.assert_array_equal(given.mean[:, :3], [[1, 2, 3]] * 6)


def test_estimators_of_a_trial_start_from_one_prior_whatever_the_company():
    made = trials(3)
    model = PriorModel()
    np.testing.assert_array_equal(draw_prior(model, made[2:], 5).mean, draw_prior(model, made, 5).mean[4:])
