"""What the physics has to know of a vehicle: masses, wheels, hull. Plain data and URDF text; no physics engine.

Every vehicle's origin lies on the floor below the middle of its fixed axle, the point that can't move sideways: it is this
point that follows the route. Wheels touch the floor as spheres, because cylinders rattle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from worlds import urdf

DRIVELINE = 0.1  # of the vehicle's mass: inertia of motor and gears as felt at the rim of each wheel. Without it a featherweight
# wheel between a strong motor and a heavy body keeps the contact solver from converging, and vehicles creep sideways by millimetres


@dataclass(frozen=True)
class Wheel:
    """A wheel that rolls: where its axle stands in the body frame (z = radius), and whether a motor can turn it to steer."""

    name: str
    x: float
    y: float
    radius: float
    steered: bool = False


@dataclass(frozen=True, eq=False)
class Chassis:
    """A vehicle on wheels. Either its two fixed wheels are driven (no wheel steered), or its one steered wheel is.

    hull    : boxes in the body frame that bump into things (also its extent for the moments of inertia)
    castors : (n, 3) x, y and radius of swivel castors, which carry weight and slide without friction
    mass (kg) and com (3,) m are those of the whole body without its wheels; wheel_mass each; force (N) is the most that the
    motors can push with in all
    """

    hull: Boxes
    wheels: tuple[Wheel, ...]
    mass: float
    com: tuple[float, float, float]
    force: float
    castors: tuple[tuple[float, float, float], ...] = ()
    wheel_mass: float = 2.0

    @property
    def steered(self) -> Wheel | None:
        """The steered wheel, if it has one."""
        return next((w for w in self.wheels if w.steered), None)

    @property
    def driven(self) -> tuple[Wheel, ...]:
        """The wheels with a motor."""
        return tuple(w for w in self.wheels if w.steered) or self.wheels

    def extent(self) -> Array:
        """(2, 3) m: lowest and highest corner of the hull."""
        return np.array([(self.hull.center - self.hull.half).min(axis=0), (self.hull.center + self.hull.half).max(axis=0)])


@runtime_checkable
class Drivable(Protocol):
    """An actor that can move by `motion: dynamic`."""

    def chassis(self) -> Chassis:
        """How it stands on its wheels."""
        ...


def model(name: str, chassis: Chassis) -> str:
    """URDF text of a vehicle. Joints: "roll_<wheel>" about the axle, and "steer_<wheel>" about the vertical for a steered wheel."""
    low, high = chassis.extent()
    shapes = urdf.box_shapes(chassis.hull) + [urdf.sphere_shape((x, y, r), r) for x, y, r in chassis.castors]
    parts = [urdf.link("base", shapes, chassis.mass, urdf.box_inertia(chassis.mass, high - low), chassis.com)]
    for wheel in chassis.wheels:
        at = np.array([wheel.x, wheel.y, wheel.radius, *frames.IDENTITY[3:]])
        inertia = np.full(3, DRIVELINE * chassis.mass * wheel.radius**2)
        carrier = "base"
        if wheel.steered:  # the fork turns about the vertical through the point of contact; light, but not nothing
            carrier = f"fork_{wheel.name}"
            parts.append(urdf.link(carrier, [], chassis.wheel_mass / 2, inertia))
            parts.append(urdf.joint(f"steer_{wheel.name}", "continuous", "base", carrier, at, (0.0, 0.0, 1.0)))
            at = frames.IDENTITY
        sphere = urdf.sphere_shape((0.0, 0.0, 0.0), wheel.radius)
        parts.append(urdf.link(f"wheel_{wheel.name}", [sphere], chassis.wheel_mass, inertia))
        parts.append(urdf.joint(f"roll_{wheel.name}", "continuous", carrier, f"wheel_{wheel.name}", at, (0.0, 1.0, 0.0)))
    return urdf.robot(name, parts)
