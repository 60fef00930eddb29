"""Whole trajectories by their most probable course: damped Gauss-Newton steps, each one a Kalman smoother.

S. Särkkä, L. Svensson, "Levenberg-Marquardt and line-search extended Kalman smoothers", ICASSP 2020: a damped step on all states at
once is a smoother that also "measures" each state where the trajectory is now, with variance 1 / λ. It costs what a smoother costs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from testbed.types import Array


@dataclass(frozen=True, eq=False)
class Course:
    """E problems of K nodes each: when, what was measured there, how the state gets from one to the next, and where it begins.

    nodes (E,) of the K are a problem's own, the rest fills up and says nothing. dt (E, K) s before each node (0 before the first);
    z (E, K, m) with NaN for none, variance (E, K, m); white: the process noise is white acceleration of `intensity` (m²/s³), else
    piecewise constant of variance `intensity` (m²/s⁴).
    """

    nodes: Array
    dt: Array
    z: Array
    variance: Array
    mean: Array  # (E, 6) before the first node
    covariance: Array  # (E, 6, 6)
    intensity: float
    white: bool

    def take(self, index: Array) -> Course:
        """Some of the problems."""
        return replace(self, **{name: getattr(self, name)[index] for name in ("nodes", "dt", "z", "variance", "mean", "covariance")})

    def noise(self) -> Array:
        """(E, K, 3): variances added on the way to each node, of position, between position and velocity, and of velocity."""
        q, dt = self.intensity, self.dt
        if self.white:
            return np.stack([q * dt**3 / 3, q * dt**2 / 2, q * dt], axis=-1)
        return np.stack([q * dt**4 / 4, q * dt**3 / 2, q * dt**2], axis=-1)

    def cost(self, states: Array, expected: Array) -> Array:
        """(E,) minus the logarithm of the posterior density of trajectories (E, K, 6), constants aside; expected (E, K, m) is h there."""
        with np.errstate(invalid="ignore"):
            residual = np.nansum((self.z - expected) ** 2 / self.variance, axis=(1, 2))
        start = states[:, 0] - self.mean
        prior = np.einsum("ei,ei->e", start, np.linalg.solve(self.covariance, start[..., None])[..., 0])
        return (residual + prior + self._process(states)) / 2

    def _process(self, states: Array) -> Array:
        dt = self.dt[:, 1:, None]
        moved = dt > 0
        step = np.where(moved, dt, 1.0)
        dv = np.where(moved, states[:, 1:, 3:] - states[:, :-1, 3:], 0.0)
        if not self.white:  # the change of velocity says it all: position follows from it
            return (dv**2 / step**2).sum(axis=(1, 2)) / self.intensity
        dp = np.where(moved, states[:, 1:, :3] - states[:, :-1, :3] - step * states[:, :-1, 3:], 0.0)
        return ((12 * dp**2 / step**3) - (12 * dp * dv / step**2) + 4 * dv**2 / step).sum(axis=(1, 2)) / self.intensity


def step(course: Course, states: Array, expected: Array, gradient: Array, damping: Array) -> tuple[Array, Array]:
    """Trajectories (E, K, 6) after one damped step from `states`, and covariances (E, K, 6, 6) of the linearised, damped problem.

    expected (E, K, m) and gradient (E, K, m, 3 or 6) with respect to position, or to all of the state, at `states`; damping (E,) is λ.
    """
    e, k = states.shape[:2]
    found, covariance = np.empty((e, k, 6)), np.empty((e, k, 6, 6))
    _smooth(
        course.nodes, course.dt, course.z, course.variance, course.mean, course.covariance, course.noise(),
        states, expected, gradient, damping, found, covariance,
    )  # fmt: skip
    return found, covariance


@njit(cache=True, error_model="numpy")
def _predict(x, p, dt, q):
    """Constant velocity over dt, in place; q: the three variances added."""
    if dt == 0.0:
        return
    for i in range(3):
        x[i] += dt * x[i + 3]
        for c in range(6):
            p[i, c] += dt * p[i + 3, c]
    for i in range(3):
        for r in range(6):
            p[r, i] += dt * p[r, i + 3]
    for i in range(3):
        p[i, i] += q[0]
        p[i, i + 3] += q[1]
        p[i + 3, i] += q[1]
        p[i + 3, i + 3] += q[2]


@njit(cache=True, error_model="numpy")
def _take(x, p, h, y, r, w):
    """One scalar measurement with innovation y, gradient h (6,), variance r; in place, p kept symmetric."""
    s = r
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += p[i, j] * h[j]
        w[i] = total
        s += h[i] * total
    for i in range(6):
        x[i] += w[i] * y / s
    for i in range(6):
        for j in range(6):
            p[i, j] -= w[i] * w[j] / s


@njit(cache=True, error_model="numpy")
def _solve(a, b, work, out):
    """out = b a⁻¹ for symmetric positive definite a (6, 6), by Cholesky of the scaled matrix; False where there is none."""
    for i in range(6):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= work[i, k] * work[j, k]
            if i == j:
                if not s > 1e-18 * a[i, i]:
                    return False
                work[i, i] = np.sqrt(s)
            else:
                work[i, j] = s / work[j, j]
    for r in range(6):
        for i in range(6):
            s = b[r, i]
            for k in range(i):
                s -= work[i, k] * out[r, k]
            out[r, i] = s / work[i, i]
        for back in range(6):
            i = 5 - back
            s = out[r, i]
            for k in range(i + 1, 6):
                s -= work[k, i] * out[r, k]
            out[r, i] = s / work[i, i]
    return True


@njit(cache=True, error_model="numpy")
def _smooth(own, dt, z, variance, mean, covariance, noise, states, expected, gradient, damping, found, found_covariance):
    nodes, m = dt.shape[1], z.shape[2]
    x, p, h, w = np.empty(6), np.empty((6, 6)), np.zeros(6), np.empty(6)
    xs, ps = np.empty((nodes, 6)), np.empty((nodes, 6, 6))
    xp, pp = np.empty((nodes, 6)), np.empty((nodes, 6, 6))
    cross, gain, work = np.empty((6, 6)), np.empty((6, 6)), np.zeros((6, 6))
    for e in range(len(dt)):
        x[:] = mean[e]
        p[:, :] = covariance[e]
        for k in range(nodes):
            _predict(x, p, dt[e, k], noise[e, k])
            xp[k], pp[k] = x, p
            for c in range(m):
                if not np.isfinite(z[e, k, c]):
                    continue
                y = z[e, k, c] - expected[e, k, c]
                for i in range(gradient.shape[3]):
                    h[i] = gradient[e, k, c, i]
                    y -= h[i] * (x[i] - states[e, k, i])
                _take(x, p, h, y, variance[e, k, c], w)
            h[:] = 0.0
            if damping[e] > 0.0 and k < own[e]:
                for i in range(6):
                    h[i] = 1.0
                    _take(x, p, h, states[e, k, i] - x[i], 1.0 / damping[e], w)
                    h[i] = 0.0
            xs[k], ps[k] = x, p
        found[e, nodes - 1], found_covariance[e, nodes - 1] = x, p
        for back in range(1, nodes):
            k = nodes - 1 - back
            _go_back(e, k, dt[e, k + 1], xs[k], ps[k], xp[k + 1], pp[k + 1], cross, gain, work, found, found_covariance)


@njit(cache=True, error_model="numpy")
def _go_back(e, k, dt, x, p, to_x, to_p, cross, gain, work, found, found_covariance):
    """The smoothed state of node k from that of node k + 1 (Rauch, Tung and Striebel 1965)."""
    for i in range(6):
        for j in range(6):
            cross[i, j] = p[i, j]  # P Fᵀ
        for j in range(3):
            cross[i, j] += dt * p[i, j + 3]
    if dt == 0.0 or not _solve(to_p, cross, work, gain):
        for i in range(6):
            for j in range(6):
                gain[i, j] = 1.0 if i == j and dt == 0.0 else 0.0
    for i in range(6):
        total = x[i]
        for j in range(6):
            total += gain[i, j] * (found[e, k + 1, j] - to_x[j])
        found[e, k, i] = total
    for i in range(6):
        for j in range(6):
            total = 0.0
            for a in range(6):
                total += gain[j, a] * (found_covariance[e, k + 1, i, a] - to_p[i, a])
            cross[i, j] = total
    for i in range(6):
        for j in range(6):
            total = p[i, j]
            for a in range(6):
                total += gain[i, a] * cross[a, j]
            found_covariance[e, k, i, j] = total
    for i in range(6):
        for j in range(i):
            middle = 0.5 * (found_covariance[e, k, i, j] + found_covariance[e, k, j, i])
            found_covariance[e, k, i, j] = found_covariance[e, k, j, i] = middle
