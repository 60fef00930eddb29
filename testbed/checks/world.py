"""Do a world and its actors keep the contract of `testbed.protocols.World` and `Actor`?"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from testbed import frames, plugins
from testbed.checks.common import ConformanceError, configured, require, same, untouched_globals
from testbed.columns import Array
from testbed.geometry import Boxes, Mounts
from testbed.protocols import ActorPlan, World
from testbed.route import Route
from testbed.scene import WORLD, Scene, Truth

DURATION = 1.5  # s
TOLERANCE = 1e-3  # m: a mount may touch a surface, not lie under it


def check_world(cls: type, config: Any = None, *, actors: Sequence[ActorPlan] | None = None) -> None:
    """Make a world's scene, move actors through it and cast rays; ConformanceError for the first rule that is broken.

    Without `actors` a registered one walks a metre where the floor is free (nobody does, where no kind of actor is registered).
    """
    config = configured(cls, config)
    with untouched_globals(cls.__name__):
        with _without_pybullet(cls):
            bare = _made(cls, config).scene([])
        _scene_is_sound(cls.__name__, bare)
        plans = list(actors) if actors is not None else _someone(bare)
        with _open(cls, config) as world, _open(cls, config) as other:
            scene = world.scene(plans)
            _scene_is_sound(cls.__name__, scene)
            require(_same_scene(scene, other.scene(plans)), cls.__name__, "two objects of one config make different scenes")
            wanted = {p.id for p in plans if p.motion != "parked"}
            require(set(scene.moving_names) == wanted, cls.__name__, f"moving bodies are {scene.moving_names}, the actors {sorted(wanted)}")
            _motion_is_sound(cls.__name__, world, other, scene, plans)
            _rays_are_sound(cls.__name__, world, scene)


def check_actor(cls: type, config: Any = None) -> None:
    """An actor is boxes on the floor, of named materials, with mounts outside of them; ConformanceError where it is not."""
    who, actor = cls.__name__, cls(configured(cls, config))
    boxes, materials = actor.boxes()
    require(len(boxes), who, "has no boxes")
    require((boxes.half > 0).all(), who, "has a box without extent")
    named = (boxes.material >= 0).all() and boxes.material.max() < len(materials)
    require(named, who, f"a box is of material {boxes.material.max()}, there are {len(materials)}")
    corners = np.abs(frames.matrix(boxes.quaternion)) @ boxes.half[..., None]
    lowest = float((boxes.center[:, 2] - corners[:, 2, 0]).min())
    require(abs(lowest) <= 0.01, who, f"its lowest point is at {lowest:g} m, not on the floor")
    mounts = actor.mounts()
    _mounts_are_sound(who, mounts)
    _outside(who, mounts, mounts.position, boxes.center, boxes.quaternion, boxes.half)
    again = cls(configured(cls, config))
    require(again.boxes()[0].equals(boxes) and again.mounts().equals(mounts), who, "two objects of one config differ")


def _made(cls: type, config: Any) -> World:
    make: Callable[[Any], World] = cls
    return make(config)


@contextmanager
def _open(cls: type, config: Any) -> Iterator[World]:
    world = _made(cls, config)
    try:
        yield world
    finally:
        world.close()


@contextmanager
def _without_pybullet(cls: type) -> Iterator[None]:
    """What happens inside can't import pybullet; nor may the class's module have imported it at its top."""
    module = sys.modules.get(cls.__module__)
    holds = any(getattr(value, "__name__", "") == "pybullet" for value in vars(module).values()) if module else False
    require(not holds, cls.__name__, "its module imports pybullet at the top: a scene must be had without a physics engine")
    before = sys.modules.get("pybullet")
    sys.modules["pybullet"] = None  # pyright: ignore[reportArgumentType]  makes any import of it fail
    try:
        yield
    except ImportError as error:
        raise ConformanceError(f"{cls.__name__}: scene() wants a physics engine ({error})") from error
    finally:
        del sys.modules["pybullet"]
        if before is not None:
            sys.modules["pybullet"] = before
        importlib.invalidate_caches()


# ---------------------------------------------------------------- scenes


def _scene_is_sound(who: str, scene: Scene) -> None:
    names = [b.name for b in scene.bodies]
    require(len(set(names)) == len(names), who, f"two bodies have one name: {_twice(names)}")
    for table, what in ((scene.boxes, "box"), (scene.mounts, "mount")):
        inside = (table.body >= WORLD).all() and table.body.max(initial=WORLD) < len(names)
        require(inside, who, f"a {what} belongs to a body that is not there")
    known = (scene.boxes.material >= 0).all() and scene.boxes.material.max(initial=0) < max(1, len(scene.materials))
    require(known, who, "a box is made of a material that is not listed")
    require((scene.boxes.half > 0).all(), who, "a box has no extent")
    _meshes_are_sound(who, scene)
    require(np.isfinite(scene.bounds).all() and (scene.bounds[1] > scene.bounds[0]).all(), who, "the bounds are not a room")
    poses = scene.rest_poses()
    require(np.isfinite(poses).all() and _unit(poses[:, 3:]) and _unit(scene.boxes.quaternion), who, "a pose is not finite, or no rotation")
    _mounts_are_sound(who, scene.mounts)
    boxes, mounts = scene.boxes, scene.mounts
    center, quaternion = _in_world(poses, boxes.body, boxes.center, boxes.quaternion)
    position, _ = _in_world(poses, mounts.body, mounts.position, mounts.quaternion)
    _outside(who, mounts, position, center, quaternion, boxes.half)


def _meshes_are_sound(who: str, scene: Scene) -> None:
    meshes = scene.meshes
    inside = (meshes.body >= WORLD).all() and meshes.body.max(initial=WORLD) < len(scene.bodies)
    require(inside, who, "a mesh belongs to a body that is not there")
    require(not np.isin(meshes.body, scene.moving).any(), who, "a body with a mesh moves: what moves is made of boxes")
    known = (meshes.material >= 0).all() and meshes.material.max(initial=0) < max(1, len(scene.materials))
    require(known, who, "a mesh is made of a material that is not listed")
    there = meshes.triangles.min(initial=0) >= 0 and meshes.triangles.max(initial=-1) < len(meshes.vertices)
    require(there and np.isfinite(meshes.vertices).all(), who, "a mesh has a corner that is not there, or not finite")
    require(set(meshes.mesh.tolist()) == set(range(len(meshes))), who, "a mesh has no triangles")


def _mounts_are_sound(who: str, mounts: Mounts) -> None:
    require(len(set(mounts.name.tolist())) == len(mounts), who, f"two mounts have one name: {_twice(mounts.name.tolist())}")
    require(set(mounts.use.tolist()) <= {"tag", "antenna"}, who, "a mount is neither for a tag nor for an antenna")
    require(_unit(mounts.quaternion), who, "a mount's quaternion is not of length 1")


def _outside(who: str, mounts: Mounts, position: Array, center: Array, quaternion: Array, half: Array) -> None:
    for name, place in zip(mounts.name, position, strict=True):
        depth = half - np.abs(frames.rotate(frames.conjugate(quaternion), place - center))
        buried = (depth > TOLERANCE).all(axis=1)
        require(not buried.any(), who, f"the mount {name} lies inside a box")


def _in_world(poses: Array, body: Array, position: Array, quaternion: Array) -> tuple[Array, Array]:
    frame = np.concatenate([poses.reshape(-1, 7), frames.IDENTITY[None]])[body]  # -1, the world, is the last
    return frames.to_world(frame, position), frames.multiply(frame[:, 3:], quaternion)


def _same_scene(a: Scene, b: Scene) -> bool:
    poses = same(a.rest_poses(), b.rest_poses()) and [x.name for x in a.bodies] == [x.name for x in b.bodies]
    return poses and a.boxes.equals(b.boxes) and a.meshes.equals(b.meshes) and a.mounts.equals(b.mounts) and a.materials == b.materials


def _unit(quaternion: Array) -> bool:
    return bool(np.allclose(np.linalg.norm(quaternion, axis=-1), 1.0, atol=1e-6))


def _twice(names: list[str]) -> str:
    return ", ".join(sorted({n for n in names if names.count(n) > 1}))


# ---------------------------------------------------------------- motion and rays


def _someone(scene: Scene) -> list[ActorPlan]:
    """A registered actor on a straight metre of free floor; nobody where there is no such actor or place."""
    kinds = plugins.names("actors")
    route = _free_metre(scene.static_boxes(), scene.bounds)
    if not kinds or route is None:
        return []
    kind = "person" if "person" in kinds else kinds[0]
    cls = plugins.load("actors", kind)
    pose = np.array([*route.waypoints_m[0], 0.0, 1.0, 0.0, 0.0, 0.0])
    make: Callable[[Any], Any] = cls
    return [ActorPlan("somebody", kind, "kinematic", make(configured(cls, None)), route, pose)]


def _free_metre(boxes: Boxes, bounds: Array, room: float = 0.6) -> Route | None:
    """A route of 1 m along x with `room` on all sides, below the height of a person."""
    reach = (np.abs(frames.matrix(boxes.quaternion)) @ boxes.half[..., None])[..., 0]
    low, high = boxes.center - reach, boxes.center + reach
    standing = (low[:, 2] < 2.2) & (high[:, 2] > 0.05)
    low, high = low[standing, :2] - room, high[standing, :2] + room
    (x0, y0), (x1, y1) = bounds[:, :2] + [[room + 0.2], [-room - 0.2]]
    for y in np.arange(y0, y1, 0.25):
        for x in np.arange(x0, x1 - 1.0, 0.25):
            met = (low[:, 0] < x + 1.0) & (high[:, 0] > x) & (low[:, 1] < y) & (high[:, 1] > y)
            if not met.any():
                return Route(waypoints_m=[(float(x), float(y)), (float(x) + 1.0, float(y))], speed_jitter=0.1)
    return None


def _motion_is_sound(who: str, world: World, other: World, scene: Scene, plans: Sequence[ActorPlan]) -> None:
    first = world.move(scene, plans, DURATION, 3, 0)
    _truth_is_sound(who, first, scene)
    world.move(scene, plans, DURATION, 3, 1)
    for again, whose in ((world.move(scene, plans, DURATION, 3, 0), "after another trial"), (other.move(scene, plans, DURATION, 3, 0), "")):
        rule = f"move() is not a function of its arguments: the same trial comes out otherwise {whose or 'of another object'}"
        require(same(first.poses, again.poses) and same(first.t, again.t), who, rule)


def _truth_is_sound(who: str, truth: Truth, scene: Scene) -> None:
    bodies = len(scene.moving)
    require(truth.bodies == scene.moving_names, who, f"the truth is of {truth.bodies}, the scene's moving bodies are {scene.moving_names}")
    require(truth.poses.shape == (len(truth.t), bodies, 7), who, f"the truth's poses have shape {truth.poses.shape}")
    require(truth.t[0] == 0 and truth.t[-1] >= DURATION - 1e-9, who, f"the truth runs from {truth.t[0]:g} to {truth.t[-1]:g} s")
    require(np.allclose(np.diff(truth.t), truth.t[1] - truth.t[0]), who, "the truth's times are not evenly spaced")
    require(np.isfinite(truth.poses).all() and _unit(truth.poses[..., 3:]), who, "a true pose is not finite, or no rotation")


def _rays_are_sound(who: str, world: World, scene: Scene) -> None:
    count = max(1, len(scene.materials))
    caster = world.caster(scene, "boxes", np.full(count, 3.0), np.full(count, 1.0))
    ends = np.random.default_rng(1).uniform(scene.bounds[0], scene.bounds[1], (2, 50, 3))
    poses = scene.rest_poses()[scene.moving][None]
    found = (caster.static(ends[0], ends[1]), caster.moving(ends[0], ends[1], poses, np.zeros(50, dtype=np.int64)))
    for obstruction in found:
        require(obstruction.count.shape == (50,) == obstruction.loss.shape, who, "the caster does not answer for every segment")
        right = (obstruction.count >= 0).all() and np.isfinite(obstruction.loss).all() and (obstruction.loss >= 0).all()
        require(right, who, "the caster counts or loses less than nothing")
        require(
            ((obstruction.loss > 0) == (obstruction.count > 0)).all(), who, "the caster loses power without an obstacle, or none in one"
        )
