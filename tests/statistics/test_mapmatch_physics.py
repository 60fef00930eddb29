"""A forklift driven by the physics engine between racks, located by its roads: four runs, one seed.

The claims at full size are in the scenario; here are its own figures with room for four runs (three standard errors of a run's mean).
"""

import pytest

import testbed

pytestmark = pytest.mark.study


def test_a_driven_forklift_is_located_by_its_roads():
    pytest.importorskip("pybullet")
    document = testbed.run("papers/mapmatch-forklift", trials=4, jobs=2, set={"block": 2}).document()
    assert document["failures"] == []
    found = document["points"][0]["estimators"]
    assert found["grid"]["position_error_m"]["mean"] < 3.0
    assert found["grid"]["segment"]["identified"] > 0.74
    assert found["grid"]["lost_runs"]["mean"] == 0
    assert found["grid"]["segment"]["off_network"] == 0
    assert found["paper"]["position_error_m"]["mean"] > found["grid"]["position_error_m"]["mean"]
