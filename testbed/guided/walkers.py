"""B people who walk as they are told, and not quite: the truth of a guided walk.

Every draw is a function of (seed, trial, number of the turn or of the step): two guides lead the same person, who errs alike in their
k-th turn, whatever was done before.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from testbed.columns import Array
from testbed.guidance import wrapped
from testbed.guided.section import GuidedWalk
from testbed.rng import Counter, mix, uniform_of


class Draws:
    """Counter-based draws of one name in each of B trials."""

    def __init__(self, root: int, trials: Array, name: str) -> None:
        self._key = np.array([Counter(root, int(t), name).key for t in trials], dtype=np.uint64)

    def uniform(self, rows: Array, *counters: Array | int) -> Array:
        """(R,) in (0, 1) for the rows (R,) by their counters."""
        return uniform_of(mix(self._key[rows], *counters))

    def normal(self, rows: Array, *counters: Array | int) -> Array:
        """(R,) standard normal."""
        return ndtri(self.uniform(rows, *counters))


class Walkers:
    """Where B people are (x, y m; heading rad; t s), and how many turns and steps they took. The tag of row b is at tag[b]."""

    def __init__(self, config: GuidedWalk, root: int, trials: Array, id: str, tag: Array, start: Array) -> None:
        """`tag` (B, 2) m; `start` (B, 3) x, y, heading: where they begin."""
        n = len(trials)
        self._config, self.tag = config, tag
        self.place, self.heading = np.array(start[:, :2]), np.array(start[:, 2])
        self.t, self.turns, self.steps, self.distance = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n)
        self._draws = {what: Draws(root, trials, f"actors.{id}.{what}") for what in ("turn", "step", "detour")}

    def range(self, rows: Array) -> Array:
        """(R,) m on the floor to the tag."""
        return np.hypot(*(self.tag[rows] - self.place[rows]).T)

    def bearing(self, rows: Array) -> Array:
        """(R,) rad: where the tag is, counter-clockwise from where they look."""
        x, y = (self.tag[rows] - self.place[rows]).T
        return wrapped(np.arctan2(y, x) - self.heading[rows])

    def detoured(self, rows: Array, turn: Array) -> Array:
        """(R,) rad: the turns that people mean to take who were told to take `turn`: some take another."""
        c, k = self._config, self.turns[rows]
        if c.detour_probability == 0:
            return turn
        off = np.deg2rad(c.detour_deg) * (2 * self._draws["detour"].uniform(rows, k, 1) - 1)
        return np.where(self._draws["detour"].uniform(rows, k, 0) < c.detour_probability, turn + off, turn)

    def turn(self, rows: Array, turn: Array) -> None:
        """They turn by about `turn` (R,) rad."""
        c = self._config
        true = turn + np.deg2rad(c.turn_std_deg) * self._draws["turn"].normal(rows, self.turns[rows])
        self.heading[rows] = wrapped(self.heading[rows] + true)
        self.turns[rows] += 1
        self.t[rows] += np.abs(true) / np.deg2rad(c.turn_rate_dps) + c.pause_s

    def step(self, rows: Array, step: Array) -> None:
        """They walk about `step` (R,) m straight ahead: Eq. 1-2."""
        c, draws, k = self._config, self._draws["step"], self.steps[rows]
        a = self.heading[rows]
        if c.step_error == "ring":
            r, angle = c.step_std_m * draws.normal(rows, k, 0), 2 * np.pi * draws.uniform(rows, k, 1)
            off = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)
        else:
            off = c.step_std_m * np.stack([draws.normal(rows, k, 0), draws.normal(rows, k, 1)], axis=1)
        ahead, left = step + off[:, 0], off[:, 1]  # errors as the person makes them, so that they do not depend on where they look
        moved = np.stack([ahead * np.cos(a) - left * np.sin(a), ahead * np.sin(a) + left * np.cos(a)], axis=1)
        self.place[rows] += moved
        length = np.hypot(*moved.T)
        self.distance[rows] += length
        self.steps[rows] += 1
        self.t[rows] += length / c.speed_mps + c.pause_s


def started(config: GuidedWalk, root: int, trials: Array, id: str, tag: Array, position: Array, yaw: float) -> Array:
    """(B, 3) x, y, heading at the start: at a distance from the tag in any direction, or where the scenario says."""
    n = len(trials)
    if config.start_distance_m is None:
        return np.tile([position[0], position[1], yaw], (n, 1))
    rows, draws = np.arange(n), Draws(root, trials, f"actors.{id}.start")
    angle, heading = 2 * np.pi * draws.uniform(rows, 0), 2 * np.pi * draws.uniform(rows, 1) - np.pi
    x, y = (tag + config.start_distance_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)).T
    return np.stack([x, y, heading], axis=1)
