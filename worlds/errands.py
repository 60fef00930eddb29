"""From an errand at a gate to a trip: way points drawn in the gate's frame, driven like any route."""

from __future__ import annotations

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.errand import Errand
from testbed.route import Route
from testbed.scene import Scene
from worlds.paths import Trip, plan

THROAT = 1.3  # m before and behind the plane: between them one walks straight through the gate


def gate_pose(scene: Scene, actor: str, gate: str) -> Array:
    """(7,) of the gate that an errand is at. ValueError, naming the gates there are, where the hall has no such gate."""
    gates = {body.name: body.pose for body in scene.bodies if body.kind == "gate"}
    if gate not in gates:
        raise ValueError(f"actor {actor}: its errand is at {gate!r}, and the hall's gates are {', '.join(gates) or 'none'}")
    return np.asarray(gates[gate])


def drawn(errand: Errand, random: np.random.Generator) -> tuple[str, Array]:
    """The kind of a trial's event and its way points (N, 2) m in the gate's frame, from nine draws, whatever the kind."""
    u = random.uniform(0.0, 1.0, 9)
    kind = errand.kinds[int(u[0] * len(errand.kinds))]
    sideways = errand.lateral_jitter_m * (2 * u[1:3] - 1)
    outside, inside = np.array(errand.outside_m), np.array(errand.inside_m)
    if kind in ("in", "out"):
        way = np.array([outside, [-THROAT, sideways[0]], [THROAT, sideways[1]], inside])
        return kind, way if kind == "in" else way[::-1]
    if kind == "pass":
        depth = errand.pass_m[0] + (errand.pass_m[1] - errand.pass_m[0]) * u[3:5]
        way = np.column_stack([depth, [-errand.pass_reach_m, errand.pass_reach_m]])
        return kind, way if u[5] < 0.5 else way[::-1]
    place, side = (outside, -1.0) if u[6] < 0.5 else (inside, 1.0)
    turn = errand.turn_m[0] + (errand.turn_m[1] - errand.turn_m[0]) * u[7]
    return kind, np.array([place, [side * turn, sideways[0]], place + np.array([0.0, 0.3 * (u[8] - 0.5)])])


def errand_trip(errand: Errand, gate: Array, random: np.random.Generator) -> Trip:
    """A trial's trip: the event drawn from `random`, then start and speed as for a route; `gate` (7,) is the gate's pose."""
    _, way = drawn(errand, random)
    flat = np.column_stack([way, np.zeros(len(way))])
    points = frames.to_world(np.broadcast_to(gate, (len(way), 7)), flat)[:, :2]
    route = Route(
        waypoints_m=[(float(x), float(y)) for x, y in points],
        speed_mps=errand.speed_mps,
        speed_jitter=errand.speed_jitter,
        acceleration_mps2=errand.acceleration_mps2,
        start_s=errand.start_s,
        start_jitter_s=errand.start_jitter_s,
    )
    return plan(route, random)
