"""The map-matching scenarios that ship: each can be built, and runs for a few seconds; the study's rows stand beside the paper's."""

from pathlib import Path

import pytest

import testbed
from testbed.roads import project
from testbed.scenario import ScenarioError, from_text, load
from testbed.simulate import Simulator

NAMES = ["mapmatch", "mapmatch-beyond", "mapmatch-forklift", "mapmatch-wander", "mapmatch-steel", "mapmatch-gates", "mapmatch-landmarks"]


@pytest.mark.parametrize("name", NAMES)
def test_a_scenario_builds_with_its_hall_and_sensors(name):
    with Simulator(load(f"papers/{name}").points()[0].scenario, rays=False) as simulator:
        assert simulator.scene.roads is not None
        assert simulator.scene.moving_names == ("forklift",)


def test_the_study_runs_and_sets_the_paper_beside_it():
    result = testbed.run("papers/mapmatch", trials=2, set={"duration_s": 12})
    document = result.document()
    assert document["failures"] == []
    tables = document["published"][0]["tables"]
    assert [cell["paper"] for cell in tables[0]["cells"]] == [13.4, 9.1, 3.3, 3.4, 7.2]
    assert [cell["paper"] for cell in tables[1]["cells"]] == [0.16, 0.41, 0.73, 0.72, 0.35]
    assert all(cell["ours"] is not None for table in tables for cell in table["cells"])
    assert len(document["points"]) == 5


def test_a_driven_forklift_is_located_among_surveyed_tags():
    pytest.importorskip("pybullet")
    result = testbed.run("papers/mapmatch-landmarks", trials=1, set={"duration_s": 6})
    document = result.document()
    assert document["failures"] == []
    found = document["points"][0]["estimators"]
    assert found["fused"]["events"]["used"] > 115  # odometer and compass ten times a second, and some tags
    assert found["tags-alone"]["position_error_m"]["mean"] < 6.0


HALL = """name: hall
seed: 1
trials: 1
duration_s: 5
world: {kind: road_hall, racks: false, nodes_m: NODES, segments: SEGMENTS}
actors: [{id: f, kind: forklift, motion: kinematic, WAY}]
sensors: [{id: odometer, kind: odometry, on: f}]
targets: [f]
estimators: [{kind: mapmatch_grid}]
"""


@pytest.mark.parametrize(
    ("nodes", "segments", "way", "message"),
    [
        (
            "[[0, 0], [4, 0], [9, 9], [12, 9]]",
            "[[0, 1], [2, 3]]",
            "walk: {}",
            r"hall.yaml:5:\d+ world: .* to node 2 at \(9, 9\): join the parts",
        ),
        ("[[0, 0], [4, 0]]", "[[0, 1], [1, 0]]", "walk: {}", r"hall.yaml:5:\d+ world: .* between \(4, 0\) and \(0, 0\) is there already"),
        ("[[0, 0], [4, 0], [4, 0]]", "[[0, 1], [1, 2]]", "walk: {}", r"hall.yaml:5:\d+ world: .* at \(4, 0\) has no length"),
        ("[[0, 0], [4, 0]]", "[[0, 1]]", "route: {waypoints_m: [[0, 0], [0, 4]]}", r"actor f: way point 1 at \(0, 4\) is off the roads"),
    ],
)
def test_what_no_forklift_can_drive_on_is_named_in_the_file(nodes, segments, way, message):
    text = HALL.replace("NODES", nodes).replace("SEGMENTS", segments).replace("WAY", way)
    with pytest.raises(ValueError, match=message) as refused:
        Simulator(from_text(text, path="hall.yaml").points()[0].scenario)
    assert isinstance(refused.value, ScenarioError) or way.startswith("route")


def test_a_scenario_s_own_roads_are_driven_and_known_to_the_estimators():
    nodes, segments = "[[0, 0], [9, 0], [9, 6], [0, 6]]", "[[0, 1], [1, 2], [2, 3], [3, 0]]"
    text = HALL.replace("NODES", nodes).replace("SEGMENTS", f"{segments}, one_way: [0, 1, 2, 3]").replace("WAY", "walk: {speed_mps: 2}")
    with Simulator(from_text(text, path="hall.yaml").points()[0].scenario) as simulator:
        trial = simulator.trial(0)
    roads = trial.recording.site.roads
    assert roads is not None
    assert roads.one_way.all()
    place = trial.truth.poses[:, 0, :2]
    assert project(roads, place)[2].max() < 1e-6
    about = place - [4.5, 3.0]  # round and round against the clock, as the arrows say
    assert (about[:-1, 0] * about[1:, 1] - about[:-1, 1] * about[1:, 0] > 0).all()


def test_the_lanes_of_a_building_map_are_driven_and_matched():
    place = Path(__file__).parents[1] / "files" / "worlds" / "house.building.yaml"
    document = {
        "name": "house",
        "seed": 1,
        "trials": 1,
        "duration_s": 30,
        "world": {"kind": "building_map", "path": str(place)},
        "actors": [{"id": "t", "kind": "trolley", "motion": "kinematic", "walk": {"speed_mps": 1}}],
        "sensors": [{"id": "odometer", "kind": "odometry", "on": "t"}, {"id": "compass", "kind": "compass", "on": "t"}],
        "targets": ["t"],
        "estimators": [{"id": "grid", "kind": "mapmatch_grid", "cell_m": 0.2, "noise_mps": 0.1, "bias_range_mps": 0.1}],
        "metrics": [{"kind": "settle_time"}],
    }
    result = testbed.run(document).document()
    assert result["failures"] == []
    found = result["points"][0]["estimators"]["grid"]
    assert found["lost_runs"]["mean"] == 0
    assert found["tracking"]["right"] > 0.9
