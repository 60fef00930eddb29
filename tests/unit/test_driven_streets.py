"""A vehicle's log on a street network about its way, played as trials."""

import numpy as np
import pytest
from car_logs import circle

import testbed
from testbed.scenario import DataMissing, ScenarioError, from_dict
from testbed.simulate import Simulator


def document(folder, **world):
    odometer, truth = circle(folder)
    world = {"kind": "driven_streets", "odometer": str(odometer), "truth": str(truth), "protocol": "nothing is fitted"} | world
    return {
        "name": "streets", "seed": 1, "trials": 2, "duration_s": 20, "report_hz": 5, "world": world, "targets": ["vehicle"],
        "prior": {"position_std_m": [1, 1, 0.1], "velocity_std_mps": [0.05, 0.05, 0.01]},
        "estimators": [{"kind": "mapmatch_grid", "start": "prior", "kappa": 20}],
        "metrics": [{"kind": "position_error", "dims": 2}],
    }  # fmt: skip


def test_a_car_on_a_circle_stays_on_its_streets(tmp_path):
    result = testbed.run(document(tmp_path))
    assert len(result.failures) == 0
    assert result.rows["position_error_m.mean"].max() < 4.0  # nodes are moved by 1.5 m, and the circle is drawn with corners


def test_what_is_played_is_the_log_and_its_true_path(tmp_path):
    with Simulator(from_dict(document(tmp_path))) as simulator:
        trial = simulator.trial(1)
        np.testing.assert_array_equal(trial.recording.site.roads.nodes, simulator.scene.roads.nodes)
    t = np.array([0.0, 7.3, 20.0])
    way = 50 * np.stack([np.sin(0.1 * t), 1 - np.cos(0.1 * t)], axis=1)
    np.testing.assert_allclose(trial.target_states(t)[:, 0, :2], way, atol=0.05)
    assert len(trial.recording.streams["odometry"]) == 101
    assert trial.stimulus["wrong_streets"] >= 2


def test_another_number_is_another_network_and_none_is_wrong_without_branches(tmp_path):
    with Simulator(from_dict(document(tmp_path))) as one, Simulator(from_dict(document(tmp_path, network=1))) as other:
        assert not np.array_equal(one.scene.roads.nodes[:4], other.scene.roads.nodes[:4])
    with Simulator(from_dict(document(tmp_path, branches=0))) as bare:
        assert bare.trial(0).stimulus["wrong_streets"] == 0


def test_a_log_that_is_not_there_is_missing_and_one_that_cannot_be_read_is_wrong(tmp_path):
    given = document(tmp_path)
    with pytest.raises(DataMissing, match=r"gone\.txt are not on this machine"):
        Simulator(from_dict(given | {"world": given["world"] | {"truth": str(tmp_path / "gone.txt")}}))
    (tmp_path / "bad.txt").write_text("odom3 0 fast\n")
    with pytest.raises(ScenarioError, match=r"bad\.txt:1: a number is wanted after odom3"):
        Simulator(from_dict(given | {"world": given["world"] | {"odometer": str(tmp_path / "bad.txt")}}))
