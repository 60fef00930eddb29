"""The most probable trajectory of a whole recording, sought from many starts: what a filter that goes forward can't have.

Levels leave several places (mirrored in the plane of a gate, on both sides of a line of antennas). A filter settles on one of them
early; here each start runs into the mode that is nearest to it, and the most probable of all is the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from estimators.heard import Heard
from estimators.measurements import Piece, Power
from estimators.trajectories import Course, step
from estimators.ukf import Ukf, UkfConfig
from testbed.types import POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo

EASIEST, HARDEST = 1e-6, 1e9  # damping below which there is none, and at which a step has failed


class BatchMapConfig(UkfConfig):
    """As for a `ukf` in dBm, which goes forward and gives one of the starts.

    The others stand still at the prior's mean and at the corners of a box `reach` standard deviations of the prior to each side.
    """

    smooth: bool = True
    reach: Annotated[float, Field(gt=0, le=100)] = 1.5
    iterations: Annotated[int, Field(ge=1, le=1000)] = 30

    @model_validator(mode="after")
    def _in_power(self) -> BatchMapConfig:
        if self.measure != "power":
            raise ValueError("a batch_map works on power: measure must be power")
        return self


class BatchMap(Ukf):
    """On the way it is a `ukf`; in the end the track is the best of ten Levenberg-Marquardt searches over all states at once.

    Covariances are those of the linearised problem at the answer: honest within the mode, silent about the others.
    Breaks where outliers are many (there is no gate), and takes memory for all that was heard.
    """

    Config = BatchMapConfig

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        super().__init__(config, site, rng)
        if not config.smooth:
            raise ValueError("batch_map: looking back is all that it adds to a ukf: smooth must be true")

    def start(self, prior: Prior) -> None:
        self._prior = prior
        self._said: list[tuple[Array, Array, Array, Array, Array, Array]] = []
        super().start(prior)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "heights":
            e = len(event)
            nobody = np.full((e, 1), -1)
            variance = np.full((e, 1), self._config.height_std_m**2)
            self._said.append((event.row, event.data.t, event.data.height[:, None], variance, nobody, nobody))
        return super().update(event)

    def _pieces(self, heard: Heard) -> list[Piece]:
        pieces = super()._pieces(heard)
        levels = pieces[0]
        if isinstance(levels, Power) and len(heard.row):
            self._said.append((heard.row, heard.t, heard.rssi, levels.variance, heard.antenna, heard.tag))
        return pieces

    def smooth(self, t: Array) -> Sequence[Estimate]:
        """The estimates at the times t (K,) of the most probable trajectory."""
        nodes, course, antenna, tag = self._problem(t)
        starts = self._starts(nodes, super().smooth(t), t)
        found = [self._search(course, antenna, tag, states) for states in starts]
        costs = np.array([cost for _, _, cost in found])
        best = np.nan_to_num(costs, nan=np.inf).argmin(axis=0)
        rows = np.arange(len(best))
        mean, covariance = (np.stack([f[i] for f in found])[best, rows] for i in range(2))
        place = np.array([[np.searchsorted(own, when - 1e-9) for own in nodes] for when in t])  # (K, B)
        status = [one.status for one in self._belief.smoothed(t)]
        return [
            Estimate(
                POSITION_VELOCITY, mean[rows, p], covariance[rows, p], np.where(np.isfinite(mean[rows, p]).all(axis=1), s, Status.LOST)
            )
            for p, s in zip(place, status, strict=True)
        ]

    # ------------------------------------------------------------ the problem

    def _problem(self, ticks: Array) -> tuple[list[Array], Course, Array, Array]:
        """Nodes of each row (all times that something was measured or is asked for), and the measurements at them."""
        rows = self._prior.rows
        row, t = (np.concatenate([said[i] for said in self._said] or [np.empty(0)]) for i in range(2))
        own = [t[row == b] for b in range(rows)]
        nodes = [np.unique(np.concatenate([ticks[ticks >= self._prior.t[b]], own[b]])) for b in range(rows)]
        k, m = max(map(len, nodes)), self._most(row, t)
        z, variance = np.full((rows, k, m), np.nan), np.ones((rows, k, m))
        antenna, tag = np.full((rows, k, m), -1), np.zeros((rows, k, m), dtype=np.int64)
        filled = np.zeros((rows, k), dtype=np.int64)
        for said in self._said:
            place = np.array([np.searchsorted(nodes[b], when) for b, when in zip(said[0], said[1], strict=True)], dtype=np.int64)
            for c in range(said[2].shape[1]):
                there = np.isfinite(said[2][:, c])
                at = (said[0][there], place[there], filled[said[0][there], place[there]])
                z[at], variance[at], antenna[at], tag[at] = (said[i][there, c] for i in (2, 3, 4, 5))
                filled[at[:2]] += 1
        dt = np.zeros((rows, k))
        for b, when in enumerate(nodes):
            dt[b, : len(when)] = np.diff(when, prepend=self._prior.t[b])
        white = self._config.process_noise == "white_acceleration"
        intensity = self._config.acceleration_density_m2ps3 if white else self._config.acceleration_std_mps2**2
        return (
            nodes,
            Course(np.array([len(own) for own in nodes]), dt, z, variance, *self._at_first(dt), max(intensity, 1e-12), white),
            antenna,
            tag,
        )

    def _most(self, row: Array, t: Array) -> int:
        """The most components that any node has."""
        if not len(row):
            return 1
        width = np.concatenate([np.full(len(said[0]), said[2].shape[1]) for said in self._said])
        _, place = np.unique(np.stack([row, t], axis=1), axis=0, return_inverse=True)
        return int(np.bincount(place.ravel(), weights=width).max())

    def _at_first(self, dt: Array) -> tuple[Array, Array]:
        """The prior brought to the first node; from there on dt[:, 0] is 0."""
        mean, covariance = np.array(self._prior.mean), np.array(self._prior.covariance)
        self._motion.advance(mean, covariance, dt[:, 0].copy())
        dt[:, 0] = 0.0
        return mean, covariance

    def _starts(self, nodes: list[Array], forward: Sequence[Estimate], ticks: Array) -> list[Array]:
        """Trajectories (B, K, 6) to begin at: what the filter made of it, and standing still at ten places."""
        rows, k = len(nodes), max(map(len, nodes))
        walked = np.empty((rows, k, 6))
        said = np.stack([one.mean for one in forward])  # (ticks, B, 6)
        for b, when in enumerate(nodes):
            for i in range(6):
                walked[b, : len(when), i] = np.interp(when, ticks, said[:, b, i])
            walked[b, len(when) :] = walked[b, len(when) - 1]
        std = np.sqrt(np.einsum("bii->bi", self._prior.covariance)[:, :3])
        corners = np.array([(0, 0, 0), *((a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1))])
        standing = []
        for corner in corners:
            states = np.zeros((rows, k, 6))
            states[:, :, :3] = (self._prior.mean[:, :3] + self._config.reach * corner * std)[:, None]
            standing.append(states)
        return [walked, *standing]

    # ------------------------------------------------------------ the search

    def _expected(self, states: Array, antenna: Array, tag: Array) -> tuple[Array, Array]:
        """h (E, K, m) and its gradient (E, K, m, 3) at trajectories; antenna -1 stands for a height."""
        e, k, m = antenna.shape
        position = np.repeat(states[:, :, None, :3], m, axis=2).reshape(-1, 3)
        level, gradient = self._model.linearised(position, np.maximum(antenna, 0).ravel(), tag.clip(0).ravel())
        up = (antenna < 0)[..., None] & np.array([False, False, True])
        expected = np.where(antenna < 0, states[:, :, None, 2], level.reshape(e, k, m))
        return expected, np.where((antenna < 0)[..., None], up.astype(np.float64), gradient.reshape(e, k, m, 3))

    def _search(self, course: Course, antenna: Array, tag: Array, states: Array) -> tuple[Array, Array, Array]:
        """The end of Levenberg and Marquardt's way down from `states`: trajectories, covariances, costs."""
        states = states.copy()
        expected, gradient = self._expected(states, antenna, tag)
        cost, damping = course.cost(states, expected), np.full(len(states), 1e-2)
        active = np.arange(len(states))
        for _ in range(self._config.iterations):
            tried, _ = step(course.take(active), states[active], expected[active], gradient[active], damping[active])
            seen, slope = self._expected(tried, antenna[active], tag[active])
            now = course.take(active).cost(tried, seen)
            better = now < cost[active]
            gained = np.where(better, cost[active] - now, np.inf)
            won = active[better]
            states[won], expected[won], gradient[won], cost[won] = tried[better], seen[better], slope[better], now[better]
            damping[active] = np.where(better, damping[active] / 10, damping[active] * 10)
            damping[damping < EASIEST] = 0.0
            damping[active] = np.where(~better & (damping[active] == 0), EASIEST, damping[active])
            active = active[(gained > 1e-6) & (damping[active] < HARDEST)]
            if not len(active):
                break
        _, covariance = step(course, states, expected, gradient, np.zeros(len(states)))
        return states, covariance, cost
