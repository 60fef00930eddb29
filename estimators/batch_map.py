"""The most probable trajectory of a whole recording, sought from many starts: what a filter that goes forward can't have.

Levels leave several places (mirrored in the plane of a gate, on both sides of a line of antennas). A filter settles on one of them
early; here each start runs into the mode that is nearest to it, and the most probable of all is the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from estimators.heard import Heard
from estimators.measurements import Piece, Power
from estimators.phase_changes import PhaseChanges, change, one_carrier
from estimators.trajectories import Course, step
from estimators.ukf import Ukf, UkfConfig
from testbed.quantity import Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo

HEIGHT, CHANGE = -1, -2  # in place of an antenna's index: a height; and CHANGE - i, a change of distance to antenna i
EASIEST, HARDEST = 1e-6, 1e9  # damping below which there is none, and at which a step has failed


@dataclass(frozen=True, eq=False)
class _Links:
    """What the measurements (E, K, m) of E problems are of: antenna (or HEIGHT, CHANGE), tag, and the s that a change took."""

    antenna: Array
    tag: Array
    span: Array

    def take(self, index: Array) -> _Links:
        """Some of the problems."""
        return _Links(self.antenna[index], self.tag[index], self.span[index])


class BatchMapConfig(UkfConfig):
    """As for a `ukf` in dBm, which goes forward and gives one of the starts.

    The others stand still at the prior's mean and at the corners of a box `reach` standard deviations of the prior to each side.
    `phase_noise_rad`: take the changes of phase from read to read as well, with this deviation a read, where no more than
    `longest_s` lie between; for a reader that stays on one carrier. Their errors count as independent, which those of neighbours are not.
    """

    smooth: bool = True
    reach: Annotated[float, Field(gt=0, le=100)] = 1.5
    iterations: Annotated[int, Field(ge=1, le=1000)] = 30
    phase_noise_rad: Annotated[float, Field(gt=0, le=3)] | None = None
    longest_s: Annotated[Seconds, Field(gt=0, le=10)] = 0.15

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
        self._metres = None if config.phase_noise_rad is None else one_carrier(site, "batch_map")
        if config.phase_noise_rad is not None and not config.together:
            raise ValueError("batch_map: changes of phase are taken from snapshots: together must be true")

    def start(self, prior: Prior) -> None:
        self._prior = prior
        self._said: list[tuple[Array, ...]] = []  # row, t (E,); value, variance, antenna, tag, span (E, c)
        if self._metres is not None:
            self._phases = PhaseChanges(prior.rows, len(self._site.antennas), self._metres, self._config.longest_s)
        super().start(prior)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "heights":
            e = len(event)
            variance = np.full((e, 1), self._config.height_std_m**2)
            what = np.full((e, 1), HEIGHT), np.zeros((e, 1), dtype=np.int64), np.zeros((e, 1))
            self._said.append((event.row, event.data.t, event.data.height[:, None], variance, *what))
        if event.kind == "snapshots" and self._metres is not None:
            self._changes(event, self._metres)
        return super().update(event)

    def _changes(self, event: Event, metres: float) -> None:
        """Note how distances changed since each link's last read."""
        shots = event.data
        came, span = self._phases.take(event.row, shots, self._hearing.counts(shots))
        e = len(event)
        tag, antenna = (np.broadcast_to(a, came.shape).reshape(e, -1) for a in (shots.tag[:, :, None], np.arange(came.shape[2])))
        pushed = self._config.acceleration_std_mps2 * span**2 / 2
        variance = 2 * (self._config.phase_noise_rad * metres) ** 2 + pushed**2
        self._said.append((event.row, shots.t, came.reshape(e, -1), variance.reshape(e, -1), CHANGE - antenna, tag, span.reshape(e, -1)))

    def _pieces(self, heard: Heard) -> list[Piece]:
        pieces = super()._pieces(heard)
        levels = pieces[0]
        if isinstance(levels, Power) and len(heard.row):
            self._said.append((heard.row, heard.t, heard.rssi, levels.variance, heard.antenna, heard.tag, np.zeros(heard.rssi.shape)))
        return pieces

    def smooth(self, t: Array) -> Sequence[Estimate]:
        """The estimates at the times t (K,) of the most probable trajectory."""
        nodes, course, links = self._problem(t)
        starts = self._starts(nodes, super().smooth(t), t)
        found = [self._search(course, links, states) for states in starts]
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

    def _problem(self, ticks: Array) -> tuple[list[Array], Course, _Links]:
        """Nodes of each row (all times that something was measured or is asked for), and the measurements at them."""
        rows = self._prior.rows
        row, t = (np.concatenate([said[i] for said in self._said] or [np.empty(0)]) for i in range(2))
        own = [t[row == b] for b in range(rows)]
        nodes = [np.unique(np.concatenate([ticks[ticks >= self._prior.t[b]], own[b]])) for b in range(rows)]
        k, m = max(map(len, nodes)), self._most(row, t)
        z, variance = np.full((rows, k, m), np.nan), np.ones((rows, k, m))
        links = _Links(np.full((rows, k, m), HEIGHT), np.zeros((rows, k, m), dtype=np.int64), np.zeros((rows, k, m)))
        filled = np.zeros((rows, k), dtype=np.int64)
        for said in self._said:
            place = np.array([np.searchsorted(nodes[b], when) for b, when in zip(said[0], said[1], strict=True)], dtype=np.int64)
            for c in range(said[2].shape[1]):
                there = np.isfinite(said[2][:, c])
                at = (said[0][there], place[there], filled[said[0][there], place[there]])
                z[at], variance[at], links.antenna[at], links.tag[at], links.span[at] = (said[i][there, c] for i in range(2, 7))
                filled[at[:2]] += 1
        dt = np.zeros((rows, k))
        for b, when in enumerate(nodes):
            dt[b, : len(when)] = np.diff(when, prepend=self._prior.t[b])
        white = self._config.process_noise == "white_acceleration"
        intensity = self._config.acceleration_density_m2ps3 if white else self._config.acceleration_std_mps2**2
        count = np.array([len(own) for own in nodes])
        return nodes, Course(count, dt, z, variance, *self._at_first(dt), max(intensity, 1e-12), white), links

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

    def _expected(self, states: Array, links: _Links) -> tuple[Array, Array]:
        """h (E, K, m) and its gradient (E, K, m, 6) at trajectories (E, K, 6)."""
        here = np.repeat(states[:, :, None], links.antenna.shape[2], axis=2)
        expected, gradient = here[..., 2].copy(), np.zeros(here.shape)
        gradient[..., 2] = 1.0  # heights; the others are put over them
        heard, changed = links.antenna >= 0, links.antenna <= CHANGE
        expected[heard], gradient[heard, :3] = self._model.linearised(here[heard][:, :3], links.antenna[heard], links.tag[heard])
        gradient[heard, 3:] = 0.0
        if changed.any():
            place = self._site.antennas.position[CHANGE - links.antenna[changed]]
            expected[changed], gradient[changed] = change(here[changed], place, links.span[changed])
        return expected, gradient

    def _search(self, course: Course, links: _Links, states: Array) -> tuple[Array, Array, Array]:
        """The end of Levenberg and Marquardt's way down from `states`: trajectories, covariances, costs."""
        states = states.copy()
        expected, gradient = self._expected(states, links)
        cost, damping = course.cost(states, expected), np.full(len(states), 1e-2)
        active = np.arange(len(states))
        for _ in range(self._config.iterations):
            tried, _ = step(course.take(active), states[active], expected[active], gradient[active], damping[active])
            seen, slope = self._expected(tried, links.take(active))
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
