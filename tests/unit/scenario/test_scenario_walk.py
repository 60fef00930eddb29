"""An actor that walks along the roads, in a scenario file."""

import pytest

from testbed.scenario import ScenarioError, from_dict
from testbed.walk import RoadWalk

BASE = {"name": "w", "seed": 1, "trials": 1, "duration_s": 5, "world": {"kind": "road_hall"}}


def scenario(**actor):
    return from_dict({**BASE, "actors": [{"id": "f", "kind": "forklift", "motion": "kinematic", **actor}]})


def test_a_walk_stands_in_the_place_of_a_route():
    found = scenario(walk={"speed_mps": "7.2 km/h"}).actors[0].route
    assert isinstance(found, RoadWalk)
    assert found.speed_mps == pytest.approx(2.0)
    assert found.corner_radius_m == 0


@pytest.mark.parametrize(
    ("actor", "message"),
    [
        ({}, "needs a route, with its waypoints_m .or a walk"),
        ({"walk": {}, "route": {"waypoints_m": [[0, 0], [1, 0]]}}, "two ways to go: remove one of them"),
        ({"motion": "parked", "position_m": [0, 0], "walk": {}}, "a parked actor has no walk"),
        ({"walk": {"sped_mps": 1}}, "did you mean speed_mps"),
    ],
)
def test_mistakes_are_told(actor, message):
    with pytest.raises(ScenarioError, match=message):
        scenario(**actor)
