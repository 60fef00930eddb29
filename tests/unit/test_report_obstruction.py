"""Lines of sight made again from a recording, against slabs cut by hand and against what the sensor said."""

import numpy as np
import pytest
import report_fakes as fakes

from testbed import archive, frames
from testbed.geometry import Boxes
from testbed.report import cases, obstruction, study
from testbed.report.sight import crossed
from testbed.types import Antennas

HALL = {
    "duration_s": 6,
    "world": {"kind": "dock_gate", "gates": 1, "parked_trolleys": 2, "racks": 2},
    "actors": [
        {
            "id": "t1",
            "kind": "trolley",
            "motion": "kinematic",
            "route": {"waypoints_m": [[7.8, 6.0], [12.0, 6.0]], "speed_mps": 1.0},
            "tags": [{"id": "lid", "mount": "left"}],
        },
        {"id": "f1", "kind": "forklift", "motion": "kinematic", "route": {"waypoints_m": [[6.6, 10.0], [6.6, 2.2]], "speed_mps": 2.0}},
    ],
    "sensors": [{"id": "portal", "kind": "rfid", "antennas": {"on": "gate*"}}],
    "tags": None,
}


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    return study.read(fakes.quick(tmp_path_factory.mktemp("hall") / "out", HALL, trials=1))


@pytest.fixture(scope="module")
def case(read):
    return cases.load(read, read.recordings[0])


def boxes_at(scene, truth, t):
    """All boxes in the world frame at one instant."""
    poses = scene.rest_poses()
    for i, body in enumerate(scene.moving):
        poses[body] = truth.pose(i, t)
    pose = np.concatenate([poses, [frames.IDENTITY]])[scene.boxes.body]
    return Boxes(
        center=frames.to_world(pose, scene.boxes.center),
        quaternion=frames.multiply(pose[:, 3:], scene.boxes.quaternion),
        half=scene.boxes.half,
        body=scene.boxes.body,
        material=scene.boxes.material,
    )


def test_a_line_is_clear_where_no_box_cuts_it(case):
    aim, truth = case.aims[0], case.trial.truth
    assert 0.1 < aim.sight.clear.mean() < 0.95
    for k in range(0, len(aim.sight.t), 8):
        t = aim.sight.t[k]
        antennas = case.near.at(truth, aim.antennas, np.full(len(aim.antennas), t))[:, :3]
        tag = case.far.at(truth, np.array(aim.tags[:1]), np.array([t]))[:, :3]
        cut = crossed(antennas, np.repeat(tag, len(antennas), axis=0), boxes_at(case.scene, truth, t)).any(axis=1)
        assert (aim.sight.clear[k] == ~cut).all(), t


def test_the_forklift_takes_some_lines_away(case, read):
    """Without the moving bodies more would be clear: they are where the truth says, and they count."""
    aim = case.aims[0]
    still = case.trial.truth.with_(poses=np.tile(case.trial.truth.poses[:1], (len(case.trial.truth.t), 1, 1)))
    with obstruction.Seer(case.scenario, case.scene) as seer:
        again = seer.look(still, case.near, case.tagged, aim.antennas, aim.tags, case.duration)
    assert (again.clear[0] == aim.sight.clear[0]).all()
    assert (again.clear != aim.sight.clear).any()


def test_without_a_scenario_antennas_or_tags_nothing_is_said(case):
    with obstruction.Seer(None, case.scene) as seer:
        assert seer.look(case.trial.truth, case.near, case.tagged, np.array([0]), [0], 1.0) is None
    with obstruction.Seer(case.scenario, case.scene) as seer:
        assert seer.look(case.trial.truth, case.near, case.tagged, np.empty(0, dtype=int), [0], 1.0) is None
        assert seer.look(case.trial.truth, case.near, case.tagged, np.array([0]), [], 1.0) is None


def test_antennas_are_where_they_truly_are_not_where_a_survey_found_them(tmp_path):
    folder = fakes.quick(tmp_path / "off", {"survey": {"antenna_position_std_m": 0.4}}, trials=1)
    read = study.read(folder)
    case = cases.load(read, read.recordings[0])
    surveyed = archive.load_trial(case.kept.folder).recording.site.antennas
    assert np.abs(case.antennas.position - surveyed.position).max() > 0.05
    exact = fakes.quick(tmp_path / "exact", trials=1)
    assert case.antennas.position == pytest.approx(archive.load_trial(fakes.place(exact)).recording.site.antennas.position)


def test_an_antenna_on_a_moving_body_is_carried(case):
    antennas = Antennas.concatenate([case.antennas.take(slice(0, 1)), case.antennas.take(slice(1, 2))])
    antennas = antennas.with_(carrier=np.array(["", "f1"]), position=np.array([[1.0, 2, 3], [0.5, 0, 2.0]]))
    ends = obstruction.antenna_ends(antennas, case.scene)
    assert ends.body.tolist() == [-1, case.scene.moving_names.index("f1")]
    truth = case.trial.truth
    place = ends.at(truth, np.array([1]), np.array([2.0]))[0, :3]
    assert place == pytest.approx(frames.to_world(truth.pose(truth.index("f1"), 2.0), np.array([0.5, 0, 2.0])))
