"""What stands in a walker's way, and the way round it: the person sees the hall, though not the tag.

The obstacle is walked round on one side until the way that was told is free again, like the "bug" planners of Lumelsky and Stepanov
(1987); every such turn is told to the guide.
"""

from __future__ import annotations

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.guided.walkers import Walkers
from testbed.scene import Scene

OVERHEAD, KERB = 1.9, 0.05  # m: what begins higher up is walked under, what is lower is stepped over
FINE = 0.05  # m between the points of a way that are looked at
SHORT = 0.25  # m: who can go so far the way that was told does
FARTHEST = 30  # steps that people look ahead when they choose a side
OFFSETS = np.deg2rad(np.arange(5.0, 176.0, 5.0))  # of other directions, in the order in which they are tried


class Ground:
    """The floor of a scene with all that stands still on it, for people who want `room` m round the point that they carry about."""

    def __init__(self, scene: Scene, room: float) -> None:
        boxes = scene.static_boxes()
        tall = np.abs(frames.matrix(boxes.quaternion)[:, 2] * boxes.half).sum(axis=1)
        boxes = boxes.take((boxes.center[:, 2] - tall < OVERHEAD) & (boxes.center[:, 2] + tall > KERB))
        axes = frames.matrix(boxes.quaternion)
        self._yaw = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
        self._middle, self._half, self._room = boxes.center[:, :2], boxes.half[:, :2], room

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands on it."""
        return not len(self._middle)

    def blocked(self, place: Array, room: float | None = None) -> Array:
        """(...,) whether something is within `room` m (the person's own, where left out) of places (..., 2)."""
        place = np.asarray(place)
        if self.is_empty:
            return np.zeros(place.shape[:-1], dtype=bool)
        off = place[..., None, :] - self._middle
        c, s = np.cos(self._yaw), np.sin(self._yaw)
        x, y = off[..., 0] * c + off[..., 1] * s, off[..., 1] * c - off[..., 0] * s
        beyond_x, beyond_y = np.maximum(np.abs(x) - self._half[:, 0], 0), np.maximum(np.abs(y) - self._half[:, 1], 0)
        near = np.hypot(beyond_x, beyond_y) < (self._room if room is None else room)
        return np.asarray(near.any(axis=-1))

    def reach(self, place: Array, heading: float, most: float) -> float:
        """How far one can go from `place` (2,) along `heading`, m, at most `most`. Who stands too near already may go away from it."""
        along = np.arange(FINE, most + FINE / 2, FINE)
        way = place + along[:, None] * np.array([np.cos(heading), np.sin(heading)])
        room = self._room
        while room > 0.01 and bool(self.blocked(place, room)):
            room *= 0.7
        hits = np.flatnonzero(self.blocked(way, room))
        return most if not len(hits) else float(along[hits[0]] - FINE)

    def round(self, people: Walkers, rows: Array, turn: Array, step: Array, side: Array) -> Array:
        """(R,) rad: the turns that people take who were told `turn` (R,) and see that a step of `step` (R,) m that way is not free.

        side (B,) : on which side each one goes round, 1 or -1, 0 for nobody in the way; kept up to date.
        """
        found = np.array(turn)
        if self.is_empty:
            return found
        for i, row in enumerate(rows.tolist()):
            place, wanted = people.place[row], float(people.heading[row] + turn[i])
            if self.reach(place, wanted, step[i]) >= min(step[i], SHORT) - 1e-9:  # a shorter step will do
                side[row] = 0
                continue
            side[row] = side[row] or self._nearer(place, wanted, step[i])
            for own in (side[row], -side[row]):
                off = self._off(place, wanted, step[i], int(own))
                if off is not None:
                    found[i] += off
                    side[row] = own
                    break
        return found

    def _off(self, place: Array, wanted: float, step: float, side: int) -> float | None:
        """rad: by how much one has to turn to a side, 1 or -1, for a free step; None where no way is free there."""
        return next((side * off for off in OFFSETS if self.reach(place, wanted + side * off, step) >= step - 1e-9), None)

    def _nearer(self, place: Array, wanted: float, step: float) -> int:
        """The side, 1 or -1, on which it takes fewer steps until the way that was wanted is free: what people see at a glance."""
        needed = []
        for side in (1, -1):
            here, steps = np.array(place), 0
            while steps < FARTHEST and self.reach(here, wanted, 2 * step) < 2 * step - 1e-9:
                off = self._off(here, wanted, step, side)
                if off is None:
                    steps = FARTHEST
                    break
                here, steps = here + step * np.array([np.cos(wanted + off), np.sin(wanted + off)]), steps + 1
            needed.append(steps)
        return 1 if needed[0] <= needed[1] else -1

    def free(self, people: Walkers, rows: Array, step: Array) -> Array:
        """(R,) m: the steps that people take who were told `step` (R,): shorter ones before an obstacle, none where it is too near."""
        if self.is_empty:
            return np.array(step)
        reach = [self.reach(people.place[r], float(people.heading[r]), float(s)) for r, s in zip(rows.tolist(), step, strict=True)]
        return np.where(np.array(reach) >= np.minimum(step, 2 * FINE) - 1e-9, reach, 0.0)

    def keep_out(self, people: Walkers, rows: Array, before: Array) -> None:
        """People whose step went wrong and would end in something stop before it."""
        if self.is_empty:
            return
        for i, row in enumerate(rows.tolist()):
            apart = people.place[row] - before[i]
            length = float(np.hypot(*apart))
            if length > 0:
                short = self.reach(before[i], float(np.arctan2(apart[1], apart[0])), length)
                if short < length:
                    people.place[row] = before[i] + apart * (short / length)
                    people.distance[row] -= length - short
