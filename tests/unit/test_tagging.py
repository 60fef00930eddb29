"""Tags, antennas and targets of a scenario in a real scene. No physics, no rays."""

import numpy as np
import pytest

from testbed import frames
from testbed.radio.coupling import dipole_axis
from testbed.scenario import ScenarioError, from_dict
from testbed.simulate import Simulator

PERSON = {"id": "anna", "kind": "person", "motion": "kinematic", "route": {"waypoints_m": [[1, 1], [6, 1]]}}
PARKED = {"id": "bert", "kind": "person", "motion": "parked", "position_m": [3, 3], "yaw_deg": 90}


def document(**changes):
    base = {"name": "t", "seed": 1, "trials": 1, "duration_s": 5, "world": {"kind": "open_floor"}, "actors": [PERSON, PARKED]}
    posts = {"id": "posts", "kind": "rfid", "antennas": {"on": "post*", "mount": "*high"}}
    return {**base, "sensors": [posts], "tags": [{"id": "floor", "position_m": [2, 2, 0]}], **changes}


def made(**changes):
    with Simulator(from_dict(document(**changes)), rays=False) as simulator:
        return simulator


def refusal(**changes):
    with pytest.raises(ScenarioError) as raised:
        made(**changes)
    return str(raised.value)


def test_a_tag_in_the_world_stays_there():
    tagged = made().tagged
    assert tagged.tags.id.tolist() == ["floor"]
    np.testing.assert_allclose(tagged.pose[0, :3], [2, 2, 0])
    assert tagged.body.tolist() == [-1]


def test_a_tag_on_a_moving_actor_is_in_its_frame_and_on_a_parked_one_in_the_world():
    moving = made(actors=[{**PERSON, "tags": [{"id": "m", "position_m": [0.5, 0, 1]}]}, PARKED], tags=[]).tagged
    assert moving.body.tolist() == [0]
    np.testing.assert_allclose(moving.pose[0, :3], [0.5, 0, 1])
    parked = made(actors=[PERSON, {**PARKED, "tags": [{"id": "p", "position_m": [0.5, 0, 1]}]}], tags=[]).tagged
    assert parked.body.tolist() == [-1]
    np.testing.assert_allclose(parked.pose[0, :3], [3, 3.5, 1], atol=1e-12)  # turned by 90°


def test_a_tag_is_level_along_its_surface_unless_it_is_rolled():
    rules = [
        {"id": "free", "position_m": [2, 2, 1], "yaw_deg": 30, "tilt_deg": 20},
        {"id": "upright", "position_m": [2, 2, 1], "yaw_deg": 30, "roll_deg": 90},
        {"on": "bert", "mount": "*", "prefix": "m"},
        {"on": "bert", "mount": "*", "prefix": "r", "roll_deg": 90},
    ]
    tagged = made(tags=rules).tagged
    normal = frames.rotate(tagged.pose[:, 3:], np.array([1.0, 0, 0]))
    dipole = dict(zip(tagged.tags.id.tolist(), dipole_axis(tagged.pose[:, 3:]), strict=True))
    np.testing.assert_allclose(dipole["free"], [-0.5, np.sqrt(0.75), 0], atol=1e-12)
    np.testing.assert_allclose(dipole["upright"], [0, 0, 1], atol=1e-12)
    half = (len(tagged.tags) - 2) // 2
    assert half > 1
    for i in range(1, half + 1):
        assert dipole[f"m-{i}"][2] == pytest.approx(0, abs=1e-12)
        assert dipole[f"m-{i}"] @ dipole[f"r-{i}"] == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(normal[2 : 2 + half], normal[2 + half :], atol=1e-12)


def test_the_pattern_of_a_tag_is_that_of_its_model():
    tags = [{"id": m, "position_m": [2, 2, 1], "model": m} for m in ("monza_4", "monza_r6", "isotropic")]
    assert made(tags=tags).tagged.tags.pattern.tolist() == ["dipole", "dipole", "isotropic"]


def test_an_antenna_is_rolled_about_its_boresight_wherever_it_is():
    rules = [{"on": "post1", "mount": "*high", "roll_deg": 90, "polarisation": "linear"}, {"on": "post2", "mount": "*high"}]
    rules += [{"position_m": [1, 1, 2], "aim_m": [3, 2, 2], "roll_deg": 90}, {"position_m": [1, 1, 2], "aim_m": [3, 2, 2]}]
    simulator = made(sensors=[{"id": "posts", "kind": "rfid", "antennas": rules}])
    antennas, mounts = simulator.sensors[0].antennas(), simulator.scene.mounts
    assert antennas.polarisation.tolist() == ["linear", "circular", "circular", "circular"]
    ahead, up = (frames.rotate(antennas.quaternion, np.array(axis)) for axis in ([1.0, 0, 0], [0.0, 0, 1]))
    own = frames.rotate(mounts.quaternion[mounts.name == "post1.high"], np.array([1.0, 0, 0]))
    body = simulator.scene.bodies[int(mounts.body[mounts.name == "post1.high"][0])]
    np.testing.assert_allclose(ahead[0], frames.rotate(body.pose[3:], own)[0], atol=1e-12)
    np.testing.assert_allclose(ahead[2], ahead[3], atol=1e-12)
    assert abs(up[0, 2]) == pytest.approx(0, abs=1e-12)
    assert abs(up[2, 2]) == pytest.approx(0, abs=1e-12)
    assert up[3, 2] == pytest.approx(1)


def test_a_rule_makes_many_under_names_of_their_own():
    tagged = made(tags=[{"on": "bert", "mount": "*", "prefix": "b"}]).tagged
    assert len(tagged.tags) > 1
    assert tagged.tags.id.tolist() == [f"b-{i + 1}" for i in range(len(tagged.tags))]
    assert len(np.unique(tagged.pose[:, :3], axis=0)) == len(tagged.tags)


def test_without_patterns_the_tags_on_movers_are_the_targets():
    actor = {**PERSON, "tags": [{"id": "m", "position_m": [0.5, 0, 1]}]}
    assert made(actors=[actor, PARKED]).aims.targets.name.tolist() == ["m"]
    assert made().aims.targets.name.tolist() == ["floor"]  # nothing moves: every tag


def test_a_body_is_a_target_with_all_its_tags():
    actor = {**PERSON, "tags": [{"id": "a", "position_m": [0.5, 0, 1]}, {"id": "b", "position_m": [0, 0.5, 1]}]}
    aims = made(actors=[actor], tags=[{"id": "c", "position_m": [0, 0, 0]}], targets=["anna", "c"]).aims
    assert aims.targets.name.tolist() == ["anna", "c"]
    assert aims.targets.body.tolist() == ["anna", ""]
    assert [t.tolist() for t in aims.tags] == [[0, 1], [2]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tags": [{"on": "rack*", "per_group": 2}]}, "tags.0: no body is named 'rack*'; there are post1"),
        ({"tags": [{"on": "ann", "position_m": [0, 0, 0]}]}, "did you mean anna?"),
        ({"tags": [{"on": "anna", "mount": "hat", "id": "x"}]}, "tags.0: mount: nothing on 'anna' fits 'hat'"),
        ({"tags": [{"on": "post*", "position_m": [0, 0, 0]}]}, "fits 4 bodies"),
        ({"tags": [{"id": "a", "position_m": [0, 0, 0]}, {"id": "a", "position_m": [1, 0, 0]}]}, "tags.1: the id 'a' is given twice"),
        ({"tags": [{"id": "b-1", "position_m": [0, 0, 0]}, {"on": "bert", "mount": "*", "prefix": "b"}]}, "two tags with one EPC"),
        ({"tags": [{"id": "a", "position_m": [0, 0, 0], "model": "monza_5"}]}, "did you mean monza_4?"),
        ({"tags": [{"on": "bert", "per_group": 99}]}, "per_group: bert"),
        ({"targets": ["flor"]}, "targets.0: neither a tag nor a moving actor is named 'flor', did you mean floor?"),
        ({"sensors": [{"id": "s", "kind": "odometry", "on": "bert"}]}, "sensors.0: on: no moving body is named 'bert'"),
        ({"sensors": [{"id": "s", "kind": "rfid", "antennas": {"on": "gate1"}}]}, "antennas.0: no body is named 'gate1'"),
    ],
)
def test_what_the_scene_does_not_have_is_named_with_its_place(changes, message):
    assert message in refusal(**changes)


def test_two_readers_cannot_have_one_antenna_or_two_regions():
    posts = {"kind": "rfid", "antennas": {"on": "post1"}}
    assert "antenna 'post1.low' belongs to 'a' already" in refusal(sensors=[{**posts, "id": "a"}, {**posts, "id": "b"}])
    other = {"id": "b", "kind": "rfid", "antennas": {"on": "post2"}, "region": "fcc"}
    assert "one site has one region" in refusal(sensors=[{**posts, "id": "a"}, other])
