"""How a vehicle on wheels keeps to its trip: pure maths on plain floats, because it runs at every step of the physics.

The tracking law is that of Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous mobile
robot", ICRA 1990: follow a reference pose that moves along the trip, by its own speed and yaw rate plus feedback on the error
seen from the vehicle. Two things are added: feedback on heading at rest, for turns on the spot, and a reference that waits for
a vehicle that is held up, so that it neither winds up nor cuts the route short.
"""

from __future__ import annotations

import math

import numpy as np

from worlds.paths import Trip

ALONG = 2.0  # 1/s, feedback on the error along the heading
ACROSS = 6.0  # 1/m², on the error across it: with
HEADING = 2.0 * math.sqrt(ACROSS)  # 1/m this is critically damped in the distance travelled
AT_REST = 1.5  # 1/s, on the heading whatever the speed
WAIT = 0.25  # m: the reference stands still while the vehicle is further behind than this
FARTHEST = 0.3  # m: errors across count no more than this, so that a vehicle pushed aside comes back at an angle, not in circles
YAW_RATE = 2.5  # rad/s, the most that is ever asked for
SETTLED = 0.002  # m (and rad): near enough to stop for good

Floats = tuple[float, ...]


def twist(pose: Floats, reference: Floats) -> tuple[float, float, float]:
    """(speed m/s, yaw rate rad/s, error along m) from pose (x, y, yaw) and reference (x, y, yaw, speed, yaw rate)."""
    x, y, yaw = pose
    rx, ry, ryaw, v, w = reference
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = c * (rx - x) + s * (ry - y), c * (ry - y) - s * (rx - x)
    turn = math.remainder(ryaw - yaw, 2 * math.pi)
    if v == 0.0 and w == 0.0 and abs(along) < SETTLED and abs(turn) < SETTLED:
        return 0.0, 0.0, along
    sideways = max(-FARTHEST, min(FARTHEST, across))
    speed = v * math.cos(turn) + ALONG * max(-WAIT, min(WAIT, along))
    rate = w + v * (ACROSS * sideways + HEADING * math.sin(turn)) + AT_REST * turn
    return speed, max(-YAW_RATE, min(YAW_RATE, rate)), along


def differential(speed: float, rate: float, places: Floats) -> list[float]:
    """Speeds over ground (m/s) of fixed wheels at y = `places` m, on the axle through the body's origin."""
    return [speed - rate * y for y in places]


def steered(speed: float, rate: float, behind: float, angle: float) -> tuple[float, float]:
    """(steering angle rad, speed over ground m/s) of one wheel `behind` m behind the fixed axle, now at `angle`.

    The angle stays within ±90°, with the wheel turning backwards where need be. It drives only as far as it already points
    the right way. At rest it stays as it is.
    """
    forward, aside = speed, -rate * behind
    along = math.hypot(forward, aside)
    if along < 1e-6:
        return angle, 0.0
    wanted = math.atan2(aside, forward)
    if abs(wanted) > math.pi / 2:
        wanted, along = wanted - math.copysign(math.pi, wanted), -along
    return wanted, along * max(0.0, math.cos(wanted - angle))


class Follower:
    """Follows one trip, step by step: gives the speed and yaw rate to drive with, and moves the reference on."""

    def __init__(self, trip: Trip, step: float, duration: float) -> None:
        position, heading, speed, rate = trip.state(np.arange(math.ceil(duration / step) + 1) * step)
        self._reference: list[Floats] = list(
            zip(position[:, 0].tolist(), position[:, 1].tolist(), heading.tolist(), speed.tolist(), rate.tolist(), strict=True)
        )
        self._now = 0

    def follow(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        """Speed (m/s) and yaw rate (rad/s) for the vehicle that is now at (x, y, yaw)."""
        speed, rate, along = twist((x, y, yaw), self._reference[self._now])
        if along < WAIT and self._now < len(self._reference) - 1:
            self._now += 1
        return speed, rate
