"""The map-matching scenarios that ship: each can be built, and runs for a few seconds; the study's rows stand beside the paper's."""

import pytest

import testbed
from testbed.scenario import load
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
