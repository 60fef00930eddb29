"""The studies of tracking by counts as scenarios: every figure within its band, every difference by its confidence limit."""

import numpy as np
import pytest

import testbed
from testbed import frames
from testbed.scenario import load
from testbed.simulate import Simulator

NAMES = ["asynchrony", "antennas", "separation", "dead-zone", "geometry", "beyond", "late", "stops"]


@pytest.mark.parametrize("name", NAMES)
def test_every_study_says_what_it_shows_and_what_it_does_not(name):
    scenario = load(f"detection-{name}")
    assert scenario.published
    assert all(table.figures for part in scenario.published for table in part.tables)
    assert all(len(part.note) > 80 for part in scenario.published)


def test_nobody_drives_through_a_rack():
    """Corners of trolleys and forklifts, twice a second in three trials, against the footprints of the racks."""
    corners, t = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T, np.arange(0.0, 24.0, 0.5)
    with Simulator(load("detection-geometry")) as simulator:
        scene = simulator.scene
        racks = [i for i, body in enumerate(scene.bodies) if body.kind == "rack"]
        assert len(racks) == 32
        own = {i: scene.boxes.take(scene.boxes.body == i) for i in (*racks, *scene.moving)}
        for trial in range(3):
            truth = simulator.moved(trial).truth
            for place, body in enumerate(scene.moving):
                shape = (own[body].center[:, None] + corners * own[body].half[:, None]).reshape(-1, 3)
                driven = frames.to_world(truth.pose(np.full(len(t), place), t)[:, None], shape[None])
                for rack in racks:
                    pose, reach = scene.bodies[rack].pose, (np.abs(own[rack].center) + own[rack].half).max(axis=0)
                    beside = np.abs(frames.rotate(frames.conjugate(pose[3:]), driven - pose[:3]))[..., :2]
                    assert (beside > reach[:2]).any(axis=-1).all(), (trial, scene.bodies[body].name, scene.bodies[rack].name)


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_the_figures_of_the_studies_hold(name):
    verdicts = testbed.check_scenario(f"detection-{name}", jobs="auto")
    assert [str(v) for v in verdicts if not v.ok] == []
