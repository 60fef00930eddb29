"""From a route as a user writes it to a pose at any time: rounded corners, and a speed that keeps the route's limits.

Geometry: every piece of a path has a curvature that is linear in arc length (straight line, clothoid, arc). A corner is a
clothoid that tightens to 1/radius, an arc, and the clothoid back, so that the yaw rate has no steps; this is how roads and
rails are laid out. Time: on each stretch with one speed limit the body speeds up, cruises and brakes at the route's
acceleration, all in closed form, so `Trip.pose` is exact at any t.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.route import Route

CLOTHOID_SHARE = 0.5  # of a corner's turn is made in its two clothoids, the rest in the arc between them
PIVOT_RADIUS = 0.1  # m: a corner that only fits with less is turned on the spot, at rest
PIVOT_RATE = 1.2  # rad/s and
PIVOT_ACCELERATION = 1.5  # rad/s²: a person who turns round with a trolley takes some 3.4 s for half a turn

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)  # exact to rounding for pieces that turn by less than π
_NODES, _WEIGHTS = (_NODES + 1) / 2, _WEIGHTS / 2


def _advance(heading: Array, curvature: Array, sharpness: Array, s: Array) -> Array:
    """(..., 2) m: how far a piece that starts with `heading` leads in arc length s, where curvature grows by `sharpness` a metre."""
    u = s[..., None] * _NODES
    angle = heading[..., None] + u * (curvature[..., None] + u * sharpness[..., None] / 2)
    return s[..., None] * np.stack([np.cos(angle) @ _WEIGHTS, np.sin(angle) @ _WEIGHTS], axis=-1)


@dataclass(frozen=True, eq=False)
class Path:
    """A line on the floor, made of P pieces whose curvature is linear in arc length.

    start (P, 2) m, heading (P,) rad unwrapped, curvature (P,) 1/m at the piece's start, sharpness (P,) 1/m², length (P,) m.
    A piece of length 0 is a turn on the spot by `pivot` (P,) rad; `radius` (P,) m is the least radius of a piece's corner.
    """

    start: Array
    heading: Array
    curvature: Array
    sharpness: Array
    length: Array
    pivot: Array
    radius: Array

    @cached_property
    def _ends(self) -> Array:
        return np.cumsum(self.length)

    @property
    def total(self) -> float:
        """Arc length, m."""
        return float(self._ends[-1])

    def at(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Positions (..., 2) m, headings (...,) rad (unwrapped) and curvatures (...,) 1/m at arc lengths s (...,).

        At the place of a pivot, the heading after it.
        """
        s = np.clip(np.asarray(s, dtype=np.float64), 0.0, self.total)
        piece = np.minimum(np.searchsorted(self._ends, s, side="right"), len(self.length) - 1)
        return self.on_piece(piece, s - (self._ends - self.length)[piece])

    def on_piece(self, piece: Array, s: Array) -> tuple[Array, Array, Array]:
        """Like `at`, for arc lengths s (...,) counted from the start of the pieces `piece` (...,)."""
        heading, curvature, sharpness = self.heading[piece], self.curvature[piece], self.sharpness[piece]
        position = self.start[piece] + _advance(heading, curvature, sharpness, s)
        return position, heading + s * (curvature + s * sharpness / 2), curvature + s * sharpness


def _corner(turn: float) -> tuple[Array, Array, Array]:
    """Curvature, sharpness and length (3,) of the pieces that turn by `turn` rad with the least radius 1 m."""
    sign, angle = np.sign(turn), abs(turn)
    clothoid, arc = angle * CLOTHOID_SHARE, angle * (1 - CLOTHOID_SHARE)  # a clothoid turns by half its length over the radius
    curvature = sign * np.array([0.0, 1.0, 1.0])
    sharpness = sign * np.array([1.0, 0.0, -1.0]) / clothoid
    return curvature, sharpness, np.array([clothoid, arc, clothoid])


def _tangent(turn: float) -> float:
    """Length that a corner with the least radius 1 m takes of either leg: its chord leaves both legs at half the turn."""
    curvature, sharpness, length = _corner(turn)
    angles = np.concatenate([[0.0], np.cumsum(length * (curvature + length * sharpness / 2))])
    chord = _advance(angles[:-1], curvature, sharpness, length).sum(axis=0)
    return float(np.hypot(*chord) / (2 * np.cos(turn / 2)))


def _fitting_radii(turns: Array, legs: Array, radius: float) -> tuple[Array, Array]:
    """Radius and length taken of either leg, for each of the C corners between C + 1 legs.

    Where two corners together want more of a leg than it has, both shrink in proportion; so no corner ever takes more than
    its legs have, whatever the radius asked for.
    """
    unit = np.array([_tangent(a) if 0 < abs(a) < np.pi - 1e-6 else np.inf if a else 0.0 for a in turns])
    wanted = radius * np.where(np.isfinite(unit), unit, 0.0)
    claimed = np.concatenate([wanted, [0.0]]) + np.concatenate([[0.0], wanted])
    share = np.minimum(1.0, legs / np.maximum(claimed, 1e-300))
    radii = np.where(np.isfinite(unit), radius * np.minimum(share[:-1], share[1:]), 0.0)
    return radii, np.where(radii >= PIVOT_RADIUS, radii * np.where(np.isfinite(unit), unit, 0.0), 0.0)


def rounded(waypoints: ArrayLike, radius: float) -> Path:
    """The path along straight legs between `waypoints` (N, 2) m, whose corners are rounded with `radius` m or less.

    The radius shrinks where the legs are too short for it. A corner left with less than PIVOT_RADIUS (a leg that doubles
    back, above all) is a turn on the spot at the way point.
    """
    points = np.asarray(waypoints, dtype=np.float64)
    legs = np.diff(points, axis=0)
    lengths, headings = np.hypot(*legs.T), np.arctan2(legs[:, 1], legs[:, 0])
    turns = (np.diff(headings) + np.pi) % (2 * np.pi) - np.pi
    turns[np.abs(turns) < 1e-9] = 0.0  # way points on one line
    radii, taken = _fitting_radii(turns, lengths, radius)
    before, after = np.concatenate([[0.0], taken]), np.concatenate([taken, [0.0]])

    pieces: list[tuple[float, float, float, float, float]] = []  # curvature, sharpness, length, pivot, radius
    for i, length in enumerate(lengths):
        pieces.append((0.0, 0.0, max(0.0, length - before[i] - after[i]), 0.0, np.inf))
        if i < len(turns) and taken[i] > 0:
            for k, c, s in zip(*_corner(turns[i]), strict=True):
                pieces.append((k / radii[i], c / radii[i] ** 2, s * radii[i], 0.0, radii[i]))
        elif i < len(turns) and turns[i]:
            pieces.append((0.0, 0.0, 0.0, turns[i], np.inf))
    kept = [p for p in pieces if p[2] > 1e-12 or p[3]]
    curvature, sharpness, length, pivot, least = np.array(kept).T
    turned = pivot + length * (curvature + length * sharpness / 2)
    heading = headings[0] + np.concatenate([[0.0], np.cumsum(turned)[:-1]])
    steps = _advance(heading, curvature, sharpness, length)
    start = points[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    return Path(start, heading, curvature, sharpness, length, pivot, least)


@dataclass(frozen=True, eq=False)
class Trip:
    """A path driven in time: F phases, each with a constant acceleration (of travel, or of turning on the spot).

    t (F,) s when a phase starts, piece (F,), distance (F,) m or rad from the piece's start, rate (F,) m/s or rad/s,
    acceleration (F,). The body waits at the start before `t[0]` and at the end after `arrival`.
    """

    path: Path
    t: Array
    piece: Array
    distance: Array
    rate: Array
    acceleration: Array
    arrival: float  # s

    def state(self, t: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Position (..., 2) m, heading (...,) rad unwrapped, speed (...,) m/s and yaw rate (...,) rad/s at times t (...,)."""
        t = np.asarray(t, dtype=np.float64)
        phase = np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)
        dt = np.clip(t, self.t[0], self.arrival) - self.t[phase]
        going = (t >= self.t[0]) & (t < self.arrival)
        distance = self.distance[phase] + dt * (self.rate[phase] + dt * self.acceleration[phase] / 2)
        rate = np.where(going, self.rate[phase] + dt * self.acceleration[phase], 0.0)
        piece = self.piece[phase]
        pivots = self.path.length[piece] == 0
        position, heading, curvature = self.path.on_piece(piece, np.where(pivots, 0.0, distance))
        turning = np.sign(self.path.pivot[piece])
        heading = np.where(pivots, heading + turning * distance, heading)
        return position, heading, np.where(pivots, 0.0, rate), np.where(pivots, turning * rate, rate * curvature)

    def pose(self, t: ArrayLike) -> Array:
        """Poses (..., 7) on the floor at times t (...,) s, looking along the path."""
        position, heading, _, _ = self.state(t)
        height = np.zeros((*heading.shape, 1))
        return np.concatenate([position, height, frames.from_euler(heading)], axis=-1)


def _phases(length: float, v0: float, v1: float, limit: float, acceleration: float) -> list[tuple[float, float, float]]:
    """(duration, rate, acceleration) of speeding up from v0, cruising and braking to v1 over `length`, never above `limit`."""
    peak = min(limit, np.sqrt((v0 * v0 + v1 * v1) / 2 + acceleration * length))
    peak = max(peak, v0, v1)  # rounding only: the node speeds were made to be reachable
    up, down = (peak * peak - v0 * v0) / (2 * acceleration), (peak * peak - v1 * v1) / (2 * acceleration)
    cruise = max(0.0, length - up - down) / peak
    parts = [((peak - v0) / acceleration, v0, acceleration), (cruise, peak, 0.0), ((peak - v1) / acceleration, peak, -acceleration)]
    return [p for p in parts if p[0] > 1e-12]


def timed(path: Path, start: float, speed: float, acceleration: float, lateral_acceleration: float) -> Trip:
    """The fastest trip along `path` from rest at `start` s to rest at its end, within the limits given (m/s, m/s²).

    A corner is driven at no more than √(lateral_acceleration · radius) all through, its clothoids included. Speeds at the
    ends of pieces come from one pass forward and one backward.
    """
    limit = np.minimum(speed, np.sqrt(lateral_acceleration * path.radius))
    limit[path.length == 0] = 0.0
    node = np.concatenate([[0.0], np.minimum(limit[:-1], limit[1:]), [0.0]])
    for i in range(1, len(node)):
        node[i] = min(node[i], np.sqrt(node[i - 1] ** 2 + 2 * acceleration * path.length[i - 1]))
    for i in range(len(node) - 2, -1, -1):
        node[i] = min(node[i], np.sqrt(node[i + 1] ** 2 + 2 * acceleration * path.length[i]))
    rows: list[tuple[float, int, float, float, float]] = []
    t = start
    for i, length in enumerate(path.length):
        if path.pivot[i]:
            parts = _phases(abs(path.pivot[i]), 0.0, 0.0, PIVOT_RATE, PIVOT_ACCELERATION)
        else:
            parts = _phases(length, node[i], node[i + 1], limit[i], acceleration)
        distance = 0.0
        for duration, rate, a in parts:
            rows.append((t, i, distance, rate, a))
            t += duration
            distance += duration * (rate + duration * a / 2)
    times, pieces, distances, rates, accelerations = zip(*rows, strict=True)
    columns = (np.array(times), np.array(pieces), np.array(distances), np.array(rates), np.array(accelerations))
    return Trip(path, *columns, arrival=t)


def plan(route: Route, random: np.random.Generator) -> Trip:
    """A trial's trip along a route: the start, the speed and the sideways shift drawn from `random`, in this order."""
    late, faster, aside = random.uniform(0.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)
    points = np.array(route.waypoints_m, dtype=np.float64)
    leg = (points[1] - points[0]) / np.hypot(*(points[1] - points[0]))
    points = points + route.lateral_jitter_m * aside * np.array([-leg[1], leg[0]])
    return timed(
        rounded(points, route.corner_radius_m),
        start=route.start_s + route.start_jitter_s * late,
        speed=route.speed_mps * (1 + route.speed_jitter * faster),
        acceleration=route.acceleration_mps2,
        lateral_acceleration=route.lateral_acceleration_mps2,
    )
