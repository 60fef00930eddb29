"""A wandering along a road network as a user writes it. How a body follows it is the business of the worlds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from testbed.quantity import Config, Metres, MetresPerSecond, MetresPerSecond2


class RoadWalk(Config):
    """A random way along the hall's roads: it starts anywhere, and at each node takes any road but the one that it came by.

    The start is uniform over the network's directed length. With corner_radius_m 0 the body is a point: at full speed from the
    start, turned at once where a road ends. Otherwise it is driven like a route (`testbed.route.Route`): from rest, with rounded
    corners, within its accelerations. Each trial's speed is speed_mps times 1 + speed_jitter * U(-1, 1).
    """

    speed_mps: Annotated[MetresPerSecond, Field(gt=0, le=20)] = 2.0
    speed_jitter: Annotated[float, Field(ge=0, lt=1)] = 0.0
    corner_radius_m: Annotated[Metres, Field(ge=0, le=100)] = 0.0
    acceleration_mps2: Annotated[MetresPerSecond2, Field(gt=0, le=50)] = 0.5
    lateral_acceleration_mps2: Annotated[MetresPerSecond2, Field(gt=0, le=50)] = 1.0
