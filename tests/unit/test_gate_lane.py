"""The lane with roll cages: what they hide from which antennas."""

import numpy as np
import pytest

from testbed import frames, plugins
from worlds.gate_lane import GATE
from worlds.raycast import BoxCaster


def crossed(cages, height=0.6):
    """(antennas,) share of places along the lane, 1 to 3 m from the gate on either side, that something hides; and their names."""
    world = plugins.load("worlds", "gate_lane")
    scene = world(world.Config(cages=cages)).scene([])
    caster = BoxCaster(scene, np.zeros(len(scene.materials)), np.zeros(len(scene.materials)))
    mounts = [i for i, name in enumerate(scene.mounts.name) if name.startswith("gate1.") and name.endswith(("_low", "_high"))]
    rest = scene.rest_poses()[scene.mounts.body[mounts]]
    antennas = frames.to_world(rest, scene.mounts.position[mounts])
    along = np.concatenate([-np.linspace(1, 3, 9), np.linspace(1, 3, 9)])
    tags = np.stack([GATE[0] + along, np.full(18, GATE[1]), np.full(18, height)], axis=1)
    start, end = np.repeat(antennas, 18, axis=0), np.tile(tags, (len(antennas), 1))
    hidden = caster.static(start, end).count.reshape(len(antennas), 18) > 0
    return dict(zip([str(scene.mounts.name[i]).split(".")[1] for i in mounts], hidden.mean(axis=1), strict=True))


def test_without_cages_the_whole_lane_is_in_sight():
    assert set(crossed(0).values()) == {0.0}


def test_two_cages_hide_the_lane_from_the_left_side_alone_and_four_from_both():
    left = crossed(2)
    assert left["left_low"] > 0.5
    assert left["left_high"] > 0.1  # it looks in over the cage's load, between its bars
    assert max(left["right_low"], left["right_high"]) == 0.0
    both = crossed(4)
    assert both["right_low"] == both["left_low"] == left["left_low"]
    assert min(both.values()) > 0.1


def test_more_cages_than_there_is_room_for_are_refused():
    world = plugins.load("worlds", "gate_lane")
    with pytest.raises(ValueError, match="cages"):
        world.Config(cages=5)
