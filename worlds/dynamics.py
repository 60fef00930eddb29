"""Vehicles in the physics engine: a hall, wheels with motors and friction, a driver for each, and the poses that come of it.

Each trial builds its world anew in a client that was reset, so that it depends on nothing that ran before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from testbed.protocols import ActorPlan
from testbed.scene import Scene
from worlds.bullet import Client, base_poses
from worlds.drive import Follower, differential, steered
from worlds.paths import Trip
from worlds.vehicles import Drivable, model

SETTLE_S = 0.25  # before t = 0, for the wheels to take the weight
HALL = "the hall"
OVERLAP = 0.005  # m: vehicles may start touching, not deeper in each other than this
REACH = 2.6  # m above the floor: what hangs higher can't be run into
FLOOR_FRICTION, WHEEL_FRICTION = 0.8, 1.0  # rubber on sealed concrete: 0.6 to 0.85


class Vehicle:
    """A vehicle in the engine with its driver. `start` (7,) is where its route begins."""

    def __init__(self, client: Client, plan: ActorPlan, trip: Trip, duration: float) -> None:
        if not isinstance(plan.actor, Drivable):
            raise ValueError(f"actor {plan.id}: a {plan.kind} has no wheels to drive on, its motion can be kinematic or parked")
        self._client, self._chassis = client, plan.actor.chassis()
        self.handle = client.load(model(plan.id, self._chassis), plan.id, trip.pose(0.0))
        client.damping(self.handle)
        client.surface(self.handle, friction=0.0)  # castors and hull slide
        for wheel in self._chassis.wheels:
            client.surface(self.handle, self.handle.links[f"wheel_{wheel.name}"], friction=WHEEL_FRICTION)
        driven = self._chassis.driven
        self._joints = [f"roll_{w.name}" for w in driven]
        self._places = tuple(w.y for w in driven)
        self._radius = driven[0].radius
        self._torque = self._chassis.force * self._radius / len(driven)
        self._steer = f"steer_{driven[0].name}" if self._chassis.steered else None
        self._angle, self._braked = 0.0, True
        self._follower = Follower(trip, client.step_s, duration)
        self.halt()

    def halt(self) -> None:
        """Brake all driven wheels."""
        self._client.drive(self.handle, self._joints, [0.0] * len(self._joints), self._torque)
        if self._steer:
            self._client.steer(self.handle, [self._steer], [self._angle], self._torque)

    def act(self) -> None:
        """One decision of the driver: look where the vehicle is, set the motors."""
        x, y, _, qw, qx, qy, qz = self._client.centre(self.handle)
        yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        ahead = self.handle.com[0]  # the engine tells the centre of mass, the driver steers the origin
        speed, rate = self._follower.follow(x - ahead * math.cos(yaw), y - ahead * math.sin(yaw), yaw)
        if self._braked and speed == rate == 0.0:
            return  # the motors hold what they were told
        self._braked = speed == rate == 0.0
        if self._steer is None:
            speeds = differential(speed, rate, self._places)
        else:
            self._angle = float(self._client.joint_states(self.handle, [self._steer])[0, 0])
            wanted, wheel = steered(speed, rate, -self._chassis.wheels[-1].x, self._angle)
            self._client.steer(self.handle, [self._steer], [wanted], 10 * self._torque)
            speeds = [wheel]
        self._client.drive(self.handle, self._joints, [v / self._radius for v in speeds], self._torque)


def drive_all(
    client: Client, scene: Scene, plans: Sequence[ActorPlan], trips: Mapping[str, Trip], duration: float, every: int
) -> dict[str, Array]:
    """Poses (K, 7) of all dynamic actors by name, one for every `every` steps of the client, from t = 0 to `duration` s.

    The client is reset first. Actors with another motion get out of nobody's way.
    """
    client.reset()
    client.load_floor(friction=FLOOR_FRICTION)
    static = scene.static_boxes()
    low = static.take(static.center[:, 2] - static.half[:, 2] < REACH)
    if len(low):
        client.load_boxes(low, HALL)
    meshes = scene.static_meshes()
    for m in range(len(meshes)):
        mesh = meshes.take(np.arange(len(meshes)) == m)
        if mesh.vertices[:, 2].min() < REACH:
            client.load_mesh(mesh, scene.bodies[meshes.body[m]].name)
    steps = round(duration / client.step_s)
    vehicles = [Vehicle(client, p, trips[p.id], duration) for p in plans if p.motion == "dynamic"]
    obstacles = [Obstacle(client, p, trips[p.id], steps) for p in plans if p.motion == "kinematic"]
    _refuse_overlaps(client, scene, static, vehicles)
    client.step(round(SETTLE_S / client.step_s))
    seen: list[list[tuple[float, ...]]] = []
    for step in range(steps + 1):
        if step % every == 0:
            seen.append([client.centre(v.handle) for v in vehicles])
        for obstacle in obstacles:
            obstacle.go(step)
        for vehicle in vehicles:
            vehicle.act()
        client.step()
    centres = np.array(seen).reshape(len(seen), len(vehicles), 7)
    return {v.handle.name: base_poses(v.handle, centres[:, i]) for i, v in enumerate(vehicles)}


def _refuse_overlaps(client: Client, scene: Scene, static: Boxes, vehicles: Sequence[Vehicle]) -> None:
    """ValueError for a vehicle whose route starts inside something: the engine would shoot it out."""
    client.refresh()
    for vehicle in vehicles:
        touching = client.contacts(vehicle.handle)
        for i in np.flatnonzero(touching.gap < -OVERLAP):
            name = client.name(int(touching.body[i, 1]))
            if name == HALL:
                local = frames.rotate(frames.conjugate(static.quaternion), touching.position[i] - static.center)
                name = scene.bodies[static.body[(np.abs(local) - static.half).max(axis=1).argmin()]].name
            raise ValueError(f"actor {vehicle.handle.name} starts {-touching.gap[i]:.2f} m inside {name}: move its first way point")


class Obstacle:
    """A kinematic actor in the engine: moved along its trip whatever it meets."""

    def __init__(self, client: Client, plan: ActorPlan, trip: Trip, steps: int) -> None:
        boxes: Boxes = plan.actor.chassis().hull if isinstance(plan.actor, Drivable) else plan.actor.boxes()[0]
        self._client = client
        self.handle = client.load_boxes(boxes, plan.id, trip.pose(0.0))
        poses = frames.compose(trip.pose(np.arange(steps + 1) * client.step_s), self.handle.com)
        self._poses: list[tuple[float, ...]] = [tuple(p) for p in poses.tolist()]

    def go(self, step: int) -> None:
        """Be where the trip is at that step."""
        self._client.put(self.handle, self._poses[step])
