"""A testbed for finding things in a warehouse by radio.

    import testbed
    result = testbed.run("dock-gate", trials=8)
    print(result)

Names are imported when they are first used: `import testbed` alone costs nothing, and needs no pybullet.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.api import replay as replay
    from testbed.api import run as run
    from testbed.check import check_estimator as check_estimator
    from testbed.check import check_sensor as check_sensor
    from testbed.check import check_world as check_world
    from testbed.expectations import check_scenario as check_scenario
    from testbed.scenario import Scenario as Scenario
    from testbed.scenario import ScenarioError as ScenarioError
    from testbed.scenario import from_dict as from_dict
    from testbed.scenario import load as load

_HOMES = {
    "run": "testbed.api",
    "replay": "testbed.api",
    "check_estimator": "testbed.check",
    "check_sensor": "testbed.check",
    "check_world": "testbed.check",
    "check_scenario": "testbed.expectations",
    "Scenario": "testbed.scenario",
    "ScenarioError": "testbed.scenario",
    "from_dict": "testbed.scenario",
    "load": "testbed.scenario",
}
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'testbed' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
