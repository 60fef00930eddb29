"""Moving the actors of a scene through a trial: what is left is `Truth`, poses over time.

Kinematic actors take their poses straight from their route's trip (numpy alone). As soon as one actor is dynamic the hall is
built in the physics engine, where kinematic actors are moved along as obstacles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from testbed import rng
from testbed.columns import Array
from testbed.errand import Errand
from testbed.protocols import ActorPlan
from testbed.roads import nearest_segment
from testbed.scene import Scene, Truth
from testbed.walk import RoadWalk
from worlds.errands import errand_trip, gate_pose
from worlds.paths import Trip, plan
from worlds.roads import PointTrip, walk
from worlds.steady import SteadyTrip, steady

if TYPE_CHECKING:
    from worlds.bullet import Client

SOLVER_ITERATIONS = 20  # of the contact solver: straight runs are true to 0.01 mm. PyBullet's 50 are truer still, and cost a third more


class Mover:
    """Moves actors; holds the physics client that dynamic ones need, made when first wanted and kept for the next trial."""

    def __init__(self) -> None:
        self._client: Client | None = None

    def move(self, scene: Scene, actors: Sequence[ActorPlan], duration: float, root: int, trial: int, step_hz: int, truth_hz: int) -> Truth:
        """Poses at `truth_hz` from 0 to `duration` s, or up to one instant later where that is no whole number of instants.

        A function of the arguments alone, bit for bit. Each actor's jitter is drawn from its own stream, "actors.<id>.route".
        ValueError where truth_hz does not divide step_hz.
        """
        if step_hz % truth_hz:
            raise ValueError(f"truth_hz {truth_hz} does not divide step_hz {step_hz}: every truth has to fall on a step")
        trips: dict[str, Any] = {
            a.id: _trip(a, scene, duration, rng.stream(root, trial, f"actors.{a.id}.route"))
            for a in actors
            if a.motion in ("kinematic", "dynamic")
        }
        t = np.arange(int(np.ceil(duration * truth_hz - 1e-9)) + 1) / truth_hz
        poses = {a.id: trips[a.id].pose(t) for a in actors if a.motion == "kinematic"}
        poses |= {a.id: np.tile(a.pose, (len(t), 1)) for a in actors if a.motion == "guided"}  # nobody has told them yet where to go
        if any(a.motion == "dynamic" for a in actors):
            poses |= self._drive(scene, actors, trips, (len(t) - 1) / truth_hz, step_hz, truth_hz)
        names = scene.moving_names
        stacked = np.stack([poses[n] for n in names], axis=1) if names else np.zeros((len(t), 0, 7))
        segment = nearest_segment(scene.roads, stacked[..., :2])
        return Truth(t, stacked, names, segment, scene.zones.locate(stacked[..., :3]))

    def _drive(
        self, scene: Scene, actors: Sequence[ActorPlan], trips: Mapping[str, Trip], duration: float, step_hz: int, truth_hz: int
    ) -> dict[str, Array]:
        from worlds.bullet import Client  # only here: scenes and kinematic motion work where there is no pybullet
        from worlds.dynamics import drive_all

        if self._client is None or self._client.step_s != 1 / step_hz:
            self.close()
            self._client = Client(1 / step_hz, solver_iterations=SOLVER_ITERATIONS)
        return drive_all(self._client, scene, actors, trips, duration, step_hz // truth_hz)

    def close(self) -> None:
        """Disconnect from the physics engine."""
        if self._client is not None:
            self._client.close()
            self._client = None


def _trip(actor: ActorPlan, scene: Scene, duration: float, random: np.random.Generator) -> Trip | PointTrip | SteadyTrip:
    """A trial's trip along a route, on an errand at a gate, or along the roads for an actor that wanders."""
    route, roads = actor.route, scene.roads
    if isinstance(route, Errand):
        return errand_trip(route, gate_pose(scene, actor.id, route.gate), random)
    if not isinstance(route, RoadWalk):
        return steady(route, random) if route.pace == "steady" else plan(route, random)
    if roads is None:
        raise ValueError("a walk wants roads, and this scene has none")
    return walk(route, roads, duration, random)
