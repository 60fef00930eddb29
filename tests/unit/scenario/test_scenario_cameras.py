"""Cameras in a scenario: judged with the file and, what only the hall can tell, with the scene."""

import pytest

from testbed.scenario import ScenarioError, from_dict, json_schema
from testbed.simulate import Simulator

DOCUMENT = {
    "name": "t",
    "seed": 1,
    "trials": 1,
    "duration_s": 5,
    "world": {"kind": "open_floor"},
    "tags": [{"id": "a", "position_m": [1, 1, 1]}],
}


def made(*cameras):
    return from_dict({**DOCUMENT, "cameras": list(cameras)})


def test_cameras_are_kept_and_change_no_number():
    scenario = made({"id": "hall"}, {"id": "corner", "position_m": [0, 0, 3], "at_s": [1, 2]})
    assert [camera.id for camera in scenario.cameras] == ["hall", "corner"]
    assert scenario.hash == made().hash


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ([{"id": "a"}, {"id": "a"}], "cameras.1.id: the id 'a' is used twice"),
        ([{"id": "a", "positon_m": [0, 0, 1]}], "did you mean position_m?"),
        ([{"id": "a", "at": "midle"}], "did you mean middle?"),
        ([{"id": "a", "at_s": -1}], "cameras.0.at_s"),
        ([{"id": "a", "shoulder": "x", "follow": "y"}], "shoulder already says where the camera stands"),
    ],
)
def test_a_mistake_is_told_with_its_place(cameras, message):
    with pytest.raises(ScenarioError) as raised:
        made(*cameras)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"id": "a", "follow": "post9"}, "cameras.0.follow: no body is called 'post9', did you mean post"),
        ({"id": "a", "at": "enter:flor"}, "cameras.0.at: no zone is called 'flor', did you mean floor?"),
        ({"id": "a", "at_s": [1, 6]}, "cameras.0.at_s: 6 s is after the end"),
    ],
)
def test_what_only_the_hall_can_tell_is_told_with_its_place(camera, message):
    with pytest.raises(ScenarioError) as raised, Simulator(made(camera), rays=False):
        pass
    assert message in str(raised.value)


def test_the_schema_knows_cameras():
    schema = json_schema()
    assert schema["properties"]["cameras"]["items"] == {"$ref": "#/$defs/camera"}
    assert "azimuth_deg" in schema["$defs"]["camera"]["properties"]
