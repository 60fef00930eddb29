"""A route as a user writes it: way points, speed and limits. How a body follows it is the business of the worlds."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from testbed.quantity import Config, Metres, MetresPerSecond, MetresPerSecond2, Point2, Point3, Seconds


class Route(Config):
    """Way points on the floor, joined by straight legs whose corners are rounded, driven within limits.

    The body waits at the first point until `start_s` (plus a draw from U(0, start_jitter_s)), speeds up, slows down for corners so that
    neither limit is passed, stops at the last point. Each trial's speed is `speed_mps` times 1 + speed_jitter * U(-1, 1);
    the whole route is shifted sideways by lateral_jitter_m * U(-1, 1), along the normal of its first leg.

    With `pace: steady` the body is a point of mathematics instead: from the first instant it goes along the straight legs, sharp corners
    included, at one speed, without turning, and may go up and down (`heights_m`, one a way point). Each way point is moved on each axis
    by waypoint_jitter_m * U(-1, 1), new in each trial. Only kinematic actors can do that, and acceleration, corners and sideways
    shift say nothing then.
    """

    waypoints_m: Annotated[list[Point2], Field(min_length=2, max_length=1000)]
    speed_mps: Annotated[MetresPerSecond, Field(gt=0, le=20)] = 1.0
    acceleration_mps2: Annotated[MetresPerSecond2, Field(gt=0, le=50)] = 0.5
    lateral_acceleration_mps2: Annotated[MetresPerSecond2, Field(gt=0, le=50)] = 1.0
    corner_radius_m: Annotated[Metres, Field(gt=0, le=100)] = 0.8
    start_s: Annotated[Seconds, Field(ge=0, le=86_400)] = 0.0
    start_jitter_s: Annotated[Seconds, Field(ge=0, le=3_600)] = 0.0
    speed_jitter: Annotated[float, Field(ge=0, lt=1)] = 0.0
    lateral_jitter_m: Annotated[Metres, Field(ge=0, le=10)] = 0.0
    pace: Literal["driven", "steady"] = "driven"
    heights_m: list[Metres] | None = None
    waypoint_jitter_m: Point3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _points_apart(self) -> Route:
        for i, (a, b) in enumerate(zip(self.waypoints_m[:-1], self.waypoints_m[1:], strict=True)):
            if math.dist(a, b) < 1e-6:
                raise ValueError(f"way points {i} and {i + 1} are the same place {a}: leave one out")
        return self

    @model_validator(mode="after")
    def _steady_alone(self) -> Route:
        if self.pace == "driven":
            only = {"heights_m", "waypoint_jitter_m"} & self.model_fields_set
            if only:
                raise ValueError(f"{min(only)} is for pace steady: what is driven stays on the floor")
        elif self.heights_m is not None and len(self.heights_m) != len(self.waypoints_m):
            raise ValueError(f"heights_m has {len(self.heights_m)} heights for {len(self.waypoints_m)} way points: one each is wanted")
        return self
