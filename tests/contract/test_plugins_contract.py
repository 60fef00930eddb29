"""Every registered plug-in keeps its contract."""

from pathlib import Path

import pytest

from testbed import plugins
from testbed.check import check_actor, check_estimator, check_metric, check_sensor, check_world

WORLDS = Path(__file__).parents[1] / "files" / "worlds"
CHECKS = {
    "estimators": check_estimator,
    "worlds": check_world,
    "actors": check_actor,
    "sensors": check_sensor,
    "metrics": check_metric,
}
CONFIGS = {  # of plug-ins that can't do without being told something
    "rfid": {"antennas": [{"position_m": (3.0, 0.0, 1.0), "aim_m": (3.0, 2.0, 0.5)}, {"on": "post"}, {"on": "cart"}]},
    "odometry": {"on": "cart"},
    "compass": {"on": "cart"},
    "height": {"on": "cart"},
    "handheld": {"on": "cart"},
    "sdf": {"path": f"{WORLDS}/hall.sdf"},
    "building_map": {"path": f"{WORLDS}/house.building.yaml"},
    "occupancy": {"path": f"{WORLDS}/map.yaml"},
    "grid": {"path": f"{WORLDS}/arena.map", "cell_m": 0.5},
    "log_distance": {"antennas": [{"position_m": (3.0, 0.0, 1.0)}, {"position_m": (1.0, 4.0, 2.0)}]},
}


# a world that plays logs moves nothing: tests/unit/test_log_replay.py looks at it
MADE = [(group, name) for group in plugins.GROUPS for name in plugins.names(group) if not hasattr(plugins.load(group, name), "played")]


@pytest.mark.parametrize(("group", "name"), MADE)
def test_registered_plug_in_keeps_its_contract(group, name):
    cls = plugins.load(group, name)
    config = cls.Config(**CONFIGS[name]) if name in CONFIGS else None
    CHECKS[group](cls, config)


def test_every_kind_of_plug_in_is_checked_and_there_are_some_of_each():
    assert set(CHECKS) == set(plugins.GROUPS)
    assert all(plugins.names(group) for group in plugins.GROUPS)
