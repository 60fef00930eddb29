"""A point that follows way points in space at one speed: for studies of estimators whose truth is a formula."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.columns import Array
from testbed.route import Route


@dataclass(frozen=True, eq=False)
class SteadyTrip:
    """Straight legs between `points` (N, 3) m, from `start` s at `speed` m/s all the way; at rest before and after. It does not turn."""

    points: Array
    start: float
    speed: float

    @property
    def arrival(self) -> float:
        """When the last way point is reached, s."""
        return self.start + float(self._reached()[-1]) / self.speed

    def _reached(self) -> Array:
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    def pose(self, t: ArrayLike) -> Array:
        """Poses (..., 7) at times t (...,) s: the point at arc length (t - start) · speed, looking along +x."""
        reached = self._reached()
        along = np.clip((np.asarray(t, dtype=np.float64) - self.start) * self.speed, 0.0, reached[-1])
        position = [np.interp(along, reached, self.points[:, i]) for i in range(3)]
        level = [np.ones_like(along), *(np.zeros_like(along) for _ in range(3))]
        return np.stack([*position, *level], axis=-1)


def steady(route: Route, random: np.random.Generator) -> SteadyTrip:
    """A trial's trip along a route with `pace: steady`: start, speed and way points drawn from `random`, in this order.

    ValueError where the draw brings two way points to one place.
    """
    late, faster = random.uniform(0.0, 1.0), random.uniform(-1.0, 1.0)
    heights = [0.0] * len(route.waypoints_m) if route.heights_m is None else route.heights_m
    points = np.column_stack([np.array(route.waypoints_m, dtype=np.float64), heights])
    points = points + np.array(route.waypoint_jitter_m) * random.uniform(-1.0, 1.0, points.shape)
    if (np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9).any():
        raise ValueError("two way points in a row are drawn at one place: move them apart")
    return SteadyTrip(points, route.start_s + route.start_jitter_s * late, route.speed_mps * (1 + route.speed_jitter * faster))
