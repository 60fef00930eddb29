"""Reference tags: those of a scenario whose place the installer knows, by pattern over their ids."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np

from testbed.plugins import suggest
from testbed.protocols import Tagged
from testbed.scene import WORLD
from testbed.types import References

if TYPE_CHECKING:
    from testbed.scenario import Scenario


def references(scenario: Scenario, tagged: Tagged) -> References:
    """The tags that `references` names, where they truly are.

    Raises ScenarioError for a pattern that fits nothing, or a tag that moves: nobody knows where that is.
    """
    ids = [str(id) for id in tagged.tags.id]
    chosen: list[int] = []
    for i, pattern in enumerate(scenario.references):
        fitting = [k for k, id in enumerate(ids) if fnmatchcase(id, pattern)]
        if not fitting:
            raise scenario.problem(("references", i), f"no tag is named {pattern!r}{suggest(pattern, ids[:1000])}")
        moving = [ids[k] for k in fitting if tagged.body[k] != WORLD]
        if moving:
            raise scenario.problem(("references", i), f"{moving[0]!r} is on a body that moves: nobody knows its place")
        chosen += [k for k in fitting if k not in chosen]
    return References(tag=np.array(chosen, dtype=np.int32), position=tagged.pose[chosen, :3].reshape(-1, 3))
