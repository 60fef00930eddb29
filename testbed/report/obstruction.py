"""Which antennas see a target's tags, made again from a kept recording: rays through the scene as it was, and nothing drawn at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.plugins import BrokenPlugin, UnknownPlugin, load
from testbed.protocols import Caster, Tagged
from testbed.radio.links import Ends
from testbed.scenario import Scenario
from testbed.scene import WORLD, Scene, Truth
from testbed.types import Antennas, Site

RATE, MOST = 20.0, 1200  # Hz, instants: what a strip some 500 px wide can show


@dataclass(frozen=True, eq=False)
class Sight:
    """Which straight lines from antennas to a target's tags cross nothing.

    t     : (M,) s
    clear : (M, A) bool, of the antennas asked for: whether the line to any of the tags is clear
    """

    t: Array
    clear: Array


def antennas_of(scenario: Scenario | None, scene: Scene, site: Site) -> Antennas:
    """The antennas where they truly are: as the sensors place them in the scene. As surveyed where those can't be had any more."""
    if scenario is None:
        return site.antennas
    try:
        parts = [load("sensors", s.kind)(s.config, s.id, scene).antennas() for s in scenario.sensors]
    except (UnknownPlugin, BrokenPlugin, ValueError):
        return site.antennas
    found = Antennas.concatenate(parts)
    return found if np.array_equal(found.id, site.antennas.id) else site.antennas


def antenna_ends(antennas: Antennas, scene: Scene) -> Ends:
    """One end of the links: which moving body carries each antenna (WORLD for none), and its pose there."""
    moving = {name: i for i, name in enumerate(scene.moving_names)}
    body = np.array([moving.get(str(c), WORLD) for c in antennas.carrier], dtype=np.int64)
    return Ends(body, np.concatenate([antennas.position, antennas.quaternion], axis=1))


class Seer:
    """Casts rays in one scene with its world's own caster. Close it, or use it as a context manager."""

    def __init__(self, scenario: Scenario | None, scene: Scene) -> None:
        self._world, self._caster = None, None
        if scenario is None:
            return
        try:
            self._world = load("worlds", scenario.world.kind)(scenario.world.config)
            nothing = np.zeros(len(scene.materials))  # only whether something stands there is asked, not what it takes
            self._caster: Caster | None = self._world.caster(scene, "boxes", nothing, nothing)
        except (UnknownPlugin, BrokenPlugin, ValueError, ImportError):
            self.close()

    def __enter__(self) -> Seer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        if self._world is not None:
            self._world.close()
        self._world = self._caster = None

    def look(self, truth: Truth, near: Ends, tagged: Tagged, antennas: Array, tags: Sequence[int], duration: float) -> Sight | None:
        """What the `antennas` (A,) see of the `tags` during the recording; None without a caster, a tag or an antenna."""
        if self._caster is None or not len(antennas) or not len(tags):
            return None
        t = np.linspace(0.0, duration, int(min(MOST, max(2, round(duration * RATE) + 1))))
        far = Ends(np.asarray(tagged.body), tagged.pose)
        instant, antenna, tag = (a.ravel() for a in np.meshgrid(np.arange(len(t)), antennas, np.asarray(tags), indexing="ij"))
        start = near.at(truth, antenna, t[instant])[:, :3]
        end = far.at(truth, tag, t[instant])[:, :3]
        count = self._caster.static(start, end).count
        if truth.bodies:
            poses = truth.pose(np.arange(len(truth.bodies)), t[:, None])
            count = count + self._caster.moving(start, end, poses, instant).count
        return Sight(t, (count == 0).reshape(len(t), len(antennas), len(tags)).any(axis=2))
