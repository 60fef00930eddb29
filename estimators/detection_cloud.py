"""Clouds of particles over (x, y, vx, vy) on the floor, B rows at once: moved, weighed by detection counts, resampled, summed up.

Motion is continuous white-noise acceleration: after τ1 and then τ2 a cloud is distributed as after τ1 + τ2, so it may be brought to the
time of whatever concerns it. Each row's numbers come from its own key and a counter of its draws (`testbed.rng`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimators.detection_model import degrees_off, look_up
from estimators.resampling import systematic
from testbed import frames
from testbed.rng import mix, uniform_of
from testbed.types import Antennas, Array, Prior, RowRandom

FLOOR = np.array([0, 1, 3, 4])  # of (x, y, z, vx, vy, vz): what a cloud is over


class Cloud:
    """M particles for each of B rows, each row at its own time.

    x (B, 4, M): x, y, vx, vy; log_weight (B, M); at (B,) s: the time that the particles of a row are at; box (B, 4): no particle is
    outside (x_min, y_min, x_max, y_max), particles without weight included.
    """

    def __init__(self, prior: Prior, particles: int, density: float, rng: RowRandom) -> None:
        self.density, self.at = density, np.array(prior.t)
        self._key, self._drawn = mix(rng.seed, (rng.uniform(1)[:, 0] * 2.0**53).astype(np.uint64)), np.zeros(prior.rows, dtype=np.uint64)
        self.log_weight = np.zeros((prior.rows, particles))
        self._weighed = np.zeros(prior.rows, dtype=bool)
        everyone = np.arange(prior.rows)
        z = np.empty((prior.rows, 4, particles))
        normals(self._draw(everyone), z)
        covariance = prior.covariance[:, FLOOR[:, None], FLOOR]
        self.x = prior.mean[:, FLOOR, None] + root(covariance) @ z
        self.box = np.empty((prior.rows, 4))
        _boxes(self.x, everyone, self.box)
        self._stale = np.ones(prior.rows, dtype=bool)
        self._mean, self._covariance = np.empty((prior.rows, 4)), np.empty((prior.rows, 4, 4))

    def _draw(self, rows: Array) -> Array:
        """(R,) uint64 keys of the next draw of each row: (row's key, number of the draw)."""
        self._drawn[rows] += np.uint64(1)
        return mix(self._key[rows], self._drawn[rows])

    def advance(self, rows: Array, t: Array) -> None:
        """Bring distinct `rows` (R,) to t (R,) s, resampling first what was weighed. Rows that are there already stay, bit for bit."""
        ahead = t > self.at[rows]
        rows, t = rows[ahead], t[ahead]
        if not len(rows):
            return
        self.resample(rows[self._weighed[rows]])
        self.move(rows, t - self.at[rows])
        self.at[rows] = t

    def move(self, rows: Array, dt: Array) -> None:
        """Draw where particles are `dt` (R,) s later."""
        _move(self.x, rows, dt, self.density, self._draw(rows), self.box)
        self._stale[rows] = True

    def resample(self, rows: Array) -> None:
        """Systematic resampling of distinct rows: all weights are equal afterwards."""
        if not len(rows):
            return
        log = self.log_weight[rows]
        chosen = systematic(np.exp(log - log.max(axis=1, keepdims=True)), uniform_of(self._draw(rows)))
        self.inherit(rows, chosen)
        self.log_weight[rows] = 0.0
        self._weighed[rows] = False
        self._stale[rows] = True

    def inherit(self, rows: Array, chosen: Array) -> None:
        """Particles of rows become copies of those chosen (R, M)."""
        self.x[rows] = np.take_along_axis(self.x[rows], chosen[:, None, :], axis=2)

    def weigh(self, rows: Array, antenna: Array, n: Array, lag: Array, table: Array, view: View) -> None:
        """Counts n (E,) of antennas (E,), which concern `rows` (E,; a row may come often) `lag` (E,) s after the row's time."""
        _weigh(self.x, self.log_weight, rows, antenna, n, lag, table, view.position, view.boresight, view.height)
        self._weighed[rows] = True
        self._stale[rows] = True

    def nearest(self, rows: Array, view: View, antenna: Array) -> Array:
        """(E,) m: no particle of the row is nearer than this to the antenna."""
        box, at = self.box[rows], view.position[antenna]
        aside = np.maximum(np.maximum(box[:, :2] - at[:, :2], at[:, :2] - box[:, 2:]), 0.0)
        return np.sqrt((aside**2).sum(axis=1) + (at[:, 2] - view.height[rows]) ** 2)

    def moments(self, now: Array) -> tuple[Array, Array]:
        """Mean (B, 4) and covariance (B, 4, 4) at times `now` (B,): those of the particles, carried on (or back) by the motion model."""
        rows = np.flatnonzero(self._stale)
        _moments(self.x, self.log_weight, rows, self._mean, self._covariance)
        self._stale[:] = False
        dt = now - self.at
        transition = np.tile(np.eye(4), (len(dt), 1, 1))
        transition[:, 0, 2] = transition[:, 1, 3] = dt
        noise, q, ahead = np.zeros((len(dt), 4, 4)), self.density, np.maximum(dt, 0.0)
        for p, v in ((0, 2), (1, 3)):
            noise[:, p, p], noise[:, v, v] = q * ahead**3 / 3, q * ahead
            noise[:, p, v] = noise[:, v, p] = q * ahead**2 / 2
        mean = np.einsum("bij,bj->bi", transition, self._mean)
        covariance = transition @ self._covariance @ transition.transpose(0, 2, 1) + noise
        return mean, (covariance + covariance.transpose(0, 2, 1)) / 2

    def shown(self, now: Array) -> tuple[Array, Array]:
        """Positions (B, M, 2) at times `now` (B,), carried on without noise, and normalised weights (B, M)."""
        position = self.x[:, :2] + (now - self.at)[:, None, None] * self.x[:, 2:]
        weight = np.exp(self.log_weight - self.log_weight.max(axis=1, keepdims=True))
        return position.transpose(0, 2, 1), weight / weight.sum(axis=1, keepdims=True)


class View:
    """How antennas look: position and boresight (A, 3), and the height (B,) m of each row's tag."""

    def __init__(self, antennas: Antennas, height: Array) -> None:
        self.position = np.array(antennas.position)
        self.boresight = frames.rotate(antennas.quaternion, np.array([1.0, 0.0, 0.0])).reshape(-1, 3)
        self.height = np.array(height)


def root(covariance: Array) -> Array:
    """(..., n, n) a square root of covariances, singular ones included."""
    value, vector = np.linalg.eigh(covariance)
    return vector * np.sqrt(np.maximum(value, 0.0))[..., None, :]


# ---------------------------------------------------------------- kernels


@njit(cache=True, error_model="numpy")
def normal_of(key, index):
    """A standard normal as a function of a 64-bit key and an index: SplitMix64, then Wichura's inversion PPND7 (AS 241, 1e-7)."""
    z = key + np.uint64(index + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    u = (np.float64(z >> np.uint64(11)) + 0.5) * 1.1102230246251565e-16
    q = u - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        over = ((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179
        under = ((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0
        return q * over / under
    r = math.sqrt(-math.log(u if q < 0.0 else 1.0 - u))
    if r <= 5.0:
        r -= 1.6
        over = ((0.17023821103 * r + 1.3067284816) * r + 2.7568153900) * r + 1.4234372777
        under = (0.12021132975 * r + 0.73700164250) * r + 1.0
    else:
        r -= 5.0
        over = ((0.017337203997 * r + 0.42868294337) * r + 3.0812263860) * r + 6.6579051150
        under = (0.012258202635 * r + 0.24197894225) * r + 1.0
    return -over / under if q < 0.0 else over / under


@njit(cache=True)
def normals(keys, z):
    rows, axes, m = z.shape
    for b in range(rows):
        for k in range(axes):
            for i in range(m):
                z[b, k, i] = normal_of(keys[b], k * m + i)


@njit(cache=True)
def _boxes(x, rows, box):
    for b in rows:
        for axis in range(2):
            box[b, axis], box[b, 2 + axis] = x[b, axis].min(), x[b, axis].max()


@njit(cache=True, error_model="numpy")
def _move(x, rows, dt, density, keys, box):
    m = x.shape[2]
    for k in range(len(rows)):
        b, h = rows[k], dt[k]
        along = math.sqrt(density * h**3 / 3)  # the Cholesky factor of what white acceleration adds to position and velocity
        tied = 1.5 * along / h if h > 0.0 else 0.0
        free = 0.5 * math.sqrt(density * h)
        for axis in range(2):
            p, v = x[b, axis], x[b, 2 + axis]
            low, high = np.inf, -np.inf
            for i in range(m):
                first, second = normal_of(keys[k], (2 * axis) * m + i), normal_of(keys[k], (2 * axis + 1) * m + i)
                p[i] += h * v[i] + along * first
                v[i] += tied * first + free * second
                low, high = min(low, p[i]), max(high, p[i])
            box[b, axis], box[b, 2 + axis] = low, high


@njit(cache=True, error_model="numpy")
def _weigh(x, log_weight, rows, antenna, n, lag, table, position, boresight, height):
    for e in range(len(rows)):
        b, a, h, plane = rows[e], antenna[e], lag[e], table[n[e]]
        ax, ay, dz = position[a, 0], position[a, 1], height[b] - position[a, 2]
        bx, by, up = boresight[a, 0], boresight[a, 1], boresight[a, 2] * dz
        px, py, vx, vy, log = x[b, 0], x[b, 1], x[b, 2], x[b, 3], log_weight[b]
        for i in range(x.shape[2]):
            dx, dy = px[i] + h * vx[i] - ax, py[i] + h * vy[i] - ay
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            cosine = (dx * bx + dy * by + up) / d if d > 0.0 else 1.0
            log[i] += look_up(plane, d, degrees_off(cosine))


@njit(cache=True, error_model="numpy")
def _moments(x, log_weight, rows, mean, covariance):
    m = x.shape[2]
    w = np.empty(m)
    for b in rows:
        top, total = log_weight[b].max(), 0.0
        for i in range(m):
            w[i] = math.exp(log_weight[b, i] - top)
            total += w[i]
        for j in range(4):
            s = 0.0
            for i in range(m):
                s += w[i] * x[b, j, i]
            mean[b, j] = s / total
        for j in range(4):
            for k in range(j + 1):
                s, mj, mk = 0.0, mean[b, j], mean[b, k]
                for i in range(m):
                    s += w[i] * (x[b, j, i] - mj) * (x[b, k, i] - mk)
                covariance[b, j, k] = covariance[b, k, j] = s / total
