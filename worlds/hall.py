"""What all halls share: a scene put together from parts and actors, motion, ray casters. A world is a list of parts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np

from testbed import quantity
from testbed.columns import Array
from testbed.errand import Errand
from testbed.geometry import Boxes, Meshes, Mounts, Roads, Zones
from testbed.protocols import ActorPlan, Caster, Renderer
from testbed.scene import Body, Scene, Truth
from worlds.errands import gate_pose
from worlds.motion import Mover
from worlds.parts import MATERIALS, Part
from worlds.roads import check_walk


class BaseHall(ABC):
    """A hall furnished with parts. A world says what stands where (`parts`, `bounds`) and names its zones and roads.

    Making the scene, and moving actors kinematically, needs no physics engine.
    """

    Config: ClassVar[type[quantity.Config]]

    def __init__(self, config: Any) -> None:
        self.config = config
        self._mover = Mover()

    @abstractmethod
    def parts(self) -> list[Part]:
        """Everything that stands in the hall, actors aside; names are unique."""

    @abstractmethod
    def bounds(self) -> Array:
        """(2, 3) m: lowest and highest corner of the hall."""

    def zones(self) -> Zones:
        """Named areas of the floor."""
        return Zones.empty()

    def roads(self) -> Roads | None:
        """The road network, if the hall has one."""
        return None

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The hall with its actors at rest. ValueError where two things share a name, or an actor can't walk here as it should."""
        for plan in actors:
            check_walk(plan.id, plan.route, plan.motion, self.roads())
        scene = assemble([*self.parts(), *map(_actor_part, actors)], actors, self.bounds(), self.zones(), self.roads())
        for plan in actors:
            if isinstance(plan.route, Errand):
                gate_pose(scene, plan.id, plan.route.gate)
        return scene

    def move(
        self,
        scene: Scene,
        actors: Sequence[ActorPlan],
        duration: float,
        root: int,
        trial: int,
        step_hz: int = 240,
        truth_hz: int = 120,
    ) -> Truth:
        """Move the actors along their routes for `duration` s: see `worlds.motion.Mover.move`."""
        return self._mover.move(scene, actors, duration, root, trial, step_hz, truth_hz)

    def caster(self, scene: Scene, engine: str, entry_db: Array, per_metre_db: Array) -> Caster:
        """The ray caster `engine` over the scene. ValueError for an engine that is neither "boxes" nor "bullet", or can't do meshes."""
        if engine == "boxes":
            from worlds.raycast import BoxCaster  # here, so that making a scene does not compile kernels

            return BoxCaster(scene, entry_db, per_metre_db)
        if engine == "bullet":
            if len(scene.meshes):
                raise ValueError("rays: bullet knows boxes alone, and this world has meshes: take rays: boxes, which knows both")
            from worlds.bullet_rays import BulletCaster

            return BulletCaster(scene, entry_db, per_metre_db)
        raise ValueError(f'no ray engine {engine!r}: "boxes" or "bullet"')

    def renderer(self, scene: Scene) -> Renderer:
        """Takes pictures of the scene; PybulletMissing (an ImportError) where there is no PyBullet."""
        from worlds.camera import SceneRenderer

        return SceneRenderer(scene)

    def close(self) -> None:
        """Give back the physics client, if one was needed."""
        self._mover.close()


def _actor_part(plan: ActorPlan) -> Part:
    boxes, names = plan.actor.boxes()
    strangers = sorted(set(names) - set(MATERIALS))
    if strangers:
        raise ValueError(f"actor {plan.id} is made of {strangers[0]!r}, a material nobody knows; there are {', '.join(MATERIALS)}")
    material = np.array([MATERIALS.index(n) for n in names], dtype=np.int16)[boxes.material]
    return Part(plan.id, plan.kind, np.asarray(plan.pose, dtype=np.float64), boxes.with_(material=material), plan.actor.mounts())


def assemble(parts: Sequence[Part], actors: Sequence[ActorPlan], bounds: Array, zones: Zones, roads: Roads | None) -> Scene:
    """One scene of all parts; those that belong to an actor that is not parked move. Mounts get their body's name in front."""
    for name, times in Counter(p.name for p in parts).items():
        if times > 1:
            raise ValueError(f"{times} things in the hall are called {name!r}: give the actor another id")
    moving = {plan.id for plan in actors if plan.motion != "parked"}
    bodies = tuple(Body(p.name, p.kind, p.pose, p.name in moving) for p in parts)
    boxes = Boxes.concatenate([p.boxes.with_(body=np.full(len(p.boxes), i)) for i, p in enumerate(parts)])
    meshes = Meshes.concatenate([p.meshes.with_(body=np.full(len(p.meshes), i)) for i, p in enumerate(parts)])
    return Scene(bodies, boxes, MATERIALS, bounds, Mounts.concatenate(list(_named(parts))), zones, roads, meshes)


def _named(parts: Sequence[Part]) -> Iterator[Mounts]:
    for i, part in enumerate(parts):
        mounts = part.mounts
        yield mounts.with_(
            name=np.array([f"{part.name}.{n}" for n in mounts.name], dtype=np.str_),
            group=np.array([f"{part.name}.{g}" if g else part.name for g in mounts.group], dtype=np.str_),
            body=np.full(len(mounts), i),
        )
