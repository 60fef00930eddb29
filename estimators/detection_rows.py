"""The rows of a method that runs through logs of counts: their particles, logs and checkpoints, brought up to date when asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.detection_cloud import FLOOR, View, normals, root
from estimators.detection_flow import GOES, PAST, SPREAD, VX, append, bounds, flow, moments, places
from estimators.detection_map import RackMap
from estimators.detection_model import DetectionModel
from estimators.detection_reports import Found
from testbed.rng import mix
from testbed.types import Array, Prior, RowRandom


@dataclass(frozen=True)
class Motion:
    """How targets are believed to move: white acceleration of `density` m²/s³; they stop and go at rates 1/s, set off at `speed` m/s."""

    density: float
    go_rate: float = 0.0
    stop_rate: float = 0.0
    speed: float = 0.0

    def row(self) -> tuple[float, float, float, float]:
        """For compiled code."""
        return self.density, self.go_rate, self.stop_rate, self.speed


@dataclass(frozen=True)
class Sizes:
    """Particles a row; checkpoints, `period` s apart; places kept of each particle's past; resampling below this effective share."""

    particles: int
    checkpoints: int
    period: float
    past: int
    threshold: float


class Rows:
    """B rows: p (B, 6, M) particles (`detection_flow`), log (B, M) their log-weights, at (B,) s their time, and the logs behind them.

    silence (B, M): the probability of the silences since their time, not yet in the weights.
    """

    def __init__(
        self, prior: Prior, sizes: Sizes, motion: Motion, model: DetectionModel, view: View, racks: RackMap | None, rng: RowRandom
    ) -> None:
        rows, m = prior.rows, sizes.particles
        self._sizes, self._motion, self._model, self._view, self._racks = sizes, motion, model, view, racks
        self._key = mix(rng.seed, (rng.uniform(1)[:, 0] * 2.0**53).astype(np.uint64))
        self.at, self.log, self.silence = np.array(prior.t), np.zeros((rows, m)), np.ones((rows, m))
        self.p = np.zeros((rows, 6, m))
        normals(self._key, self.p)
        self.p[:, SPREAD] = 0.0
        self.p[:, :4] = prior.mean[:, FLOOR, None] + root(prior.covariance[:, FLOOR[:, None], FLOOR]) @ self.p[:, :4]
        going = motion.stop_rate / (motion.stop_rate + motion.go_rate) if motion.stop_rate > 0 else 0.0
        self.p[:, GOES] = (np.arange(m) + 0.5) / m >= going
        self.p[:, VX : VX + 2] *= self.p[:, GOES, None]
        self._past, self._past_t = np.zeros((rows, sizes.past, 2, m)), np.full((rows, sizes.past), -np.inf)
        if sizes.past:
            place = np.floor(prior.t / PAST + 1e-9).astype(np.int64)
            self._past[np.arange(rows), place % sizes.past], self._past_t[np.arange(rows), place % sizes.past] = self.p[:, :2], place * PAST
        self._bound = np.empty((rows, 5))
        bounds(self.p, self._bound)
        self._log_t, self._log_what = np.empty((rows, 64)), np.empty((rows, 64, 3), dtype=np.int64)
        self._many, self._done, self._back = np.zeros(rows, dtype=np.int64), np.zeros(rows, dtype=np.int64), np.full(rows, np.inf)
        c = sizes.checkpoints
        self._check_t, self._next = np.full((rows, c), -np.inf), np.array(prior.t)
        self._kept = (np.zeros((rows, c, 6, m)), np.zeros((rows, c, m)), np.zeros((rows, c)), np.zeros((rows, c, 5)))
        self._kept_past = np.zeros((rows, c, sizes.past, 2, m)), np.full((rows, c, sizes.past), -np.inf)
        self._queries: list[int] = []
        self._tables, self._heard = np.zeros((0, 1, 2, 2), dtype=np.float32), np.zeros((0, 2, 2), dtype=np.float32)
        self._mean, self._covariance, self._stale = np.empty((rows, 4)), np.empty((rows, 4, 4)), np.ones(rows, dtype=np.bool_)
        if c:
            self._check_t[:, 0] = prior.t - 1e-9
            for kept, now in zip(self._kept, (self.p, self.log, self.at, self._bound), strict=True):
                kept[:, 0] = now
            self._kept_past[0][:, 0], self._kept_past[1][:, 0] = self._past, self._past_t

    def add(self, found: Found) -> None:
        """Put counts into the logs; they are taken when someone asks."""
        if not len(found.row):
            return
        if self._many.max(initial=0) + len(found.row) >= self._log_t.shape[1]:
            self.flush()
            if self._many.max(initial=0) + len(found.row) >= self._log_t.shape[1] // 2:
                grow = (0, self._log_t.shape[1] + len(found.row))
                self._log_t = np.pad(self._log_t, ((0, 0), grow))
                self._log_what = np.pad(self._log_what, ((0, 0), grow, (0, 0)))
        which = self._index(found.queries)
        append(self._log_t, self._log_what, self._many, self._done, self._back, found.row, found.t, found.antenna, found.n, which)
        self._stale[found.row] = True

    def _index(self, queries: Array) -> Array:
        """Which of the tables each number of queries has; made when first met."""
        fresh = [int(q) for q in np.unique(queries) if int(q) not in self._queries]
        if fresh:
            self._queries += fresh
            tables = [self._model.table(q) for q in self._queries]
            most = max(len(table) for table in tables)
            self._tables = np.stack([np.pad(table, ((0, most - len(table)), (0, 0), (0, 0))) for table in tables])
            self._heard = (-np.expm1(self._tables[:, 0].astype(np.float64))).astype(np.float32)
        return np.argmax(queries[:, None] == np.array(self._queries), axis=1)

    def flush(self) -> None:
        """Bring every row through its log."""
        rows = np.flatnonzero((self._done < self._many) | (self._back < np.inf))
        if not len(rows):
            return
        racks, none = self._racks, np.zeros((0, 0, 0), dtype=np.float32)
        level = np.zeros(len(self.at), dtype=np.int64) if racks is None else racks.level
        maps = none[None] if racks is None else racks.closed
        solid = np.zeros((0, 0), dtype=np.bool_) if racks is None else racks.solid
        origin, cell = (np.zeros(2), 1.0) if racks is None else (racks.origin, racks.cell)
        flow(
            rows, self.p, self.log, self.silence, self.at, self._bound, self._past, self._past_t, self._log_t, self._log_what, self._many,
            self._done, self._back, self._check_t, self._next, *self._kept, *self._kept_past, self._key, self._motion.row(),
            self._sizes.period, self._sizes.threshold, self._view.position, self._view.boresight, self._view.height, self._tables,
            self._heard, maps, level, solid, origin, cell,
        )  # fmt: skip
        self._stale[rows] = True

    def moments(self, now: Array) -> tuple[Array, Array]:
        """Mean (B, 4) and covariance (B, 4, 4) of (x, y, vx, vy) at `now` (B,), carried on there by the motion of those that move."""
        self.flush()
        moments(self.p, self.log, self.silence, np.flatnonzero(self._stale), self._mean, self._covariance)
        self._stale[:] = False
        dt = np.maximum(now - self.at, 0.0)
        transition = np.tile(np.eye(4), (len(dt), 1, 1))
        transition[:, 0, 2] = transition[:, 1, 3] = dt
        mean = np.einsum("bij,bj->bi", transition, self._mean)
        covariance = transition @ self._covariance @ transition.transpose(0, 2, 1)
        q = self._motion.density
        for p, v in ((0, 2), (1, 3)):
            covariance[:, p, p] += q * dt**3 / 3
            covariance[:, v, v] += q * dt
            covariance[:, p, v] += q * dt**2 / 2
            covariance[:, v, p] += q * dt**2 / 2
        return mean, (covariance + covariance.transpose(0, 2, 1)) / 2

    def places(self, t: Array) -> tuple[Array, Array]:
        """Places (B, 2, M) of the particles, or of their ancestors, at times t (B,), and their weights (B, M)."""
        self.flush()
        weight = np.exp(self.log - self.log.max(axis=1, keepdims=True)) * self.silence
        weight /= weight.sum(axis=1, keepdims=True)
        return places(self.p, self.at, self._past, self._past_t, np.asarray(t, dtype=np.float64)), weight
