"""Rows of particles that are a function of their ordered log of counts alone: run forward, back to a checkpoint, and forward again.

All numbers that a row draws are keyed by its own key and by the time to which it moves, so what it believes does not depend on when it
was asked, nor on the order in which reports came. One compiled pass takes a row through its log.

A particle is a place, and of its velocity a mean and a variance given the places (Rao-Blackwell): under white acceleration the
displacement over τ is N(v τ, s τ² + q τ³/3), and the velocity follows from it as in a Kalman filter. With stops, a particle is in one of
two modes and changes at exponential times, exactly: it stands, or it sets off with a given speed in any direction.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimators.detection_cloud import normal_of
from estimators.detection_model import degrees_off, look_up

X, Y, VX, VY, SPREAD, GOES = range(6)  # of a particle: place, mean velocity, its variance on each axis, 1 if it moves and 0 if it stands
SETTLE = 0.5  # s: a silence may concern particles that are so much older, and is weighed where their velocity takes them by then
PAST = 0.5  # s between the places that are kept of a particle's past
SILENT = 1e-3  # a silence whose probability is nowhere more than this below 1 is no news
WALL = 30.0  # what a particle inside a rack loses, of the logarithm of its weight: others take its place, if there are any


@njit(cache=True)
def append(log_t, log_what, many, done, back, row, t, antenna, n, queries):
    """Put entries (E,) into their rows' ordered logs; `back` is the time of the oldest that is older than what is done already."""
    for e in range(len(row)):
        b = row[e]
        k = many[b]
        while k > 0 and log_t[b, k - 1] > t[e]:
            log_t[b, k] = log_t[b, k - 1]
            log_what[b, k] = log_what[b, k - 1]
            k -= 1
        log_t[b, k] = t[e]
        log_what[b, k, 0], log_what[b, k, 1], log_what[b, k, 2] = antenna[e], n[e], queries[e]
        many[b] += 1
        if k < done[b]:
            back[b] = min(back[b], t[e])
            done[b] += 1


@njit(cache=True)
def _keyed(key, t, what):
    """A 64-bit key for what a row draws at time t (to the microsecond)."""
    z = key + np.uint64(np.int64(round(t * 1e6))) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(what) * np.uint64(0xD1B54A32D192ED03)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
def _uniform(key, index):
    z = _keyed(key, 0.0, index + 1)
    return (np.float64(z >> np.uint64(11)) + 0.5) * 1.1102230246251565e-16


@njit(cache=True, error_model="numpy")
def _glide(p, i, h, density, key, k):
    """Particle i moves for h s with white acceleration."""
    s = p[SPREAD, i]
    added = density * h * h * h / 3
    spread = s * h * h + added
    if spread <= 0.0:
        p[X, i] += h * p[VX, i]
        p[Y, i] += h * p[VY, i]
        return
    tied = s * h + density * h * h / 2
    gain, scale = tied / spread, math.sqrt(spread)
    for axis in range(2):
        z = scale * normal_of(key, 2 * k + axis)
        p[X + axis, i] += h * p[VX + axis, i] + z
        p[VX + axis, i] += gain * z
    p[SPREAD, i] = max(s + density * h - gain * tied, 0.0)


@njit(cache=True, error_model="numpy")
def _jump(p, i, h, density, key, m, go_rate, stop_rate, speed):
    """Particle i moves for h s, and changes between moving and standing at exponential times. Up to 16 changes."""
    left, k = h, 0
    while left > 0.0 and k < 16:
        goes = p[GOES, i] > 0.5
        rate = stop_rate if goes else go_rate
        index = (k * m + i) * 4
        step = left if rate <= 0.0 else min(left, -math.log(_uniform(key, index)) / rate)
        if goes:
            _glide(p, i, step, density, key, (k + 1) * m + i)
        left -= step
        if left > 0.0:
            if goes:
                p[GOES, i], p[VX, i], p[VY, i], p[SPREAD, i] = 0.0, 0.0, 0.0, 0.0
            else:
                angle = 2 * math.pi * _uniform(key, index + 1)
                p[GOES, i], p[VX, i], p[VY, i], p[SPREAD, i] = 1.0, speed * math.cos(angle), speed * math.sin(angle), 0.0
        k += 1


@njit(cache=True, error_model="numpy")
def _inside(solid, origin, cell, x, y):
    i, j = int((x - origin[0]) / cell + 0.5), int((y - origin[1]) / cell + 0.5)
    return 0 <= i < solid.shape[0] and 0 <= j < solid.shape[1] and solid[i, j]


@njit(cache=True, error_model="numpy")
def _move(p, log, t0, t1, motion, key, solid, origin, cell, past, past_t, bound):
    """Bring a row's particles from t0 to t1: those that end, or pass half-way, inside a rack lose their weight."""
    density, go_rate, stop_rate, speed = motion
    m, h, own = p.shape[1], t1 - t0, _keyed(key, t1, 1)
    first = math.floor(t0 / PAST + 1e-9) + 1
    last = math.floor(t1 / PAST + 1e-9)
    low_x, low_y, high_x, high_y, fast = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for g in range(first, last + 1):
        if len(past_t):
            past_t[g % len(past_t)] = g * PAST
    for i in range(m):
        x, y = p[X, i], p[Y, i]
        if stop_rate > 0.0 or p[GOES, i] < 0.5:
            _jump(p, i, h, density, own, m, go_rate, stop_rate, speed)
        else:
            _glide(p, i, h, density, own, i)
        if solid.size and (
            _inside(solid, origin, cell, p[X, i], p[Y, i]) or _inside(solid, origin, cell, (x + p[X, i]) / 2, (y + p[Y, i]) / 2)
        ):
            log[i] -= WALL
        if len(past_t):
            for g in range(first, last + 1):
                share = (g * PAST - t0) / h
                past[g % len(past_t), 0, i] = x + share * (p[X, i] - x)
                past[g % len(past_t), 1, i] = y + share * (p[Y, i] - y)
        low_x, high_x = min(low_x, p[X, i]), max(high_x, p[X, i])
        low_y, high_y = min(low_y, p[Y, i]), max(high_y, p[Y, i])
        fast = max(fast, abs(p[VX, i]) + abs(p[VY, i]))
    bound[0], bound[1], bound[2], bound[3], bound[4] = low_x, low_y, high_x, high_y, fast


@njit(cache=True, error_model="numpy")
def _resample(p, log, t, key, past, threshold):
    """Systematic resampling where the effective number of particles is below `threshold` of them all."""
    m = p.shape[1]
    top, total, square = log.max(), 0.0, 0.0
    w = np.empty(m)
    for i in range(m):
        w[i] = math.exp(log[i] - top)
        total += w[i]
        square += w[i] * w[i]
    if total * total >= threshold * m * square:
        return
    chosen = np.empty(m, dtype=np.int64)
    step, reached, i = total / m, w[0], 0
    u = _uniform(_keyed(key, t, 2), 0)
    for k in range(m):
        while i < m - 1 and (k + u) * step >= reached:
            i += 1
            reached += w[i]
        chosen[k] = i
    for axis in range(p.shape[0]):
        p[axis] = p[axis][chosen]
    for g in range(len(past)):
        past[g, 0], past[g, 1] = past[g, 0][chosen], past[g, 1][chosen]
    log[:] = 0.0


@njit(cache=True, error_model="numpy")
def _no_news(bound, lag, position, boresight, height, heard):
    """Whether no particle of a row would have been heard by the antenna, as far as a ball round them all can tell."""
    cx, cy = (bound[0] + bound[2]) / 2 - position[0], (bound[1] + bound[3]) / 2 - position[1]
    radius = math.hypot(bound[2] - bound[0], bound[3] - bound[1]) / 2 + abs(lag) * (bound[4] + 1.0)
    dz = height - position[2]
    level = math.hypot(cx, cy)
    d = math.sqrt(max(level - radius, 0.0) ** 2 + dz * dz)
    far = math.sqrt(level * level + dz * dz)
    angle = 0.0
    if far > radius:
        angle = degrees_off((cx * boresight[0] + cy * boresight[1] + dz * boresight[2]) / far) - math.degrees(math.asin(radius / far))
    return look_up(heard, d, max(angle, 0.0)) < SILENT


@njit(cache=True, error_model="numpy")
def _weigh(p, log, silence, lag, a, n, position, boresight, height, table, heard, closed, origin, cell):
    """Weigh a row's particles by one count. A silence goes into the product `silence`, whose logarithm is taken later."""
    bx, by, dz = boresight[0], boresight[1], height - position[2]
    up = boresight[2] * dz
    mapped = closed.size > 0
    g = 0.0
    for i in range(p.shape[1]):
        x, y = p[X, i] + lag * p[VX, i], p[Y, i] + lag * p[VY, i]
        dx, dy = x - position[0], y - position[1]
        d = math.sqrt(dx * dx + dy * dy + dz * dz)
        angle = degrees_off((dx * bx + dy * by + up) / d if d > 0.0 else 1.0)
        if mapped:
            u, v = (x - origin[0]) / cell, (y - origin[1]) / cell
            u, v = min(max(u, 0.0), closed.shape[1] - 1.001), min(max(v, 0.0), closed.shape[2] - 1.001)
            j, k = int(u), int(v)
            u, v = u - j, v - k
            low = closed[a, j, k] + v * (closed[a, j, k + 1] - closed[a, j, k])
            g = low + u * (closed[a, j + 1, k] + v * (closed[a, j + 1, k + 1] - closed[a, j + 1, k]) - low)
        if n > 0:
            log[i] += look_up(table, d, angle) + (math.log(1.0 - g) if g > 0.0 else 0.0)
        else:
            silence[i] *= 1.0 - (1.0 - g) * look_up(heard, d, angle)


@njit(cache=True)
def _settle(log, silence):
    for i in range(len(log)):
        if silence[i] != 1.0:
            log[i] += math.log(max(silence[i], 1e-300))
            silence[i] = 1.0


@njit(cache=True, error_model="numpy")
def flow(
    rows, p, log, silence, at, bound, past, past_t, log_t, log_what, many, done, back, check_t, next_, kept_p, kept_log, kept_at,
    kept_bound, kept_past, kept_past_t, keys, motion, period, threshold, position, boresight, height, tables, heard, maps, level,
    solid, origin, cell,
):  # fmt: skip
    """Bring `rows` through their logs: from a checkpoint before `back`, where something older came in, else from where they are."""
    checks = check_t.shape[1]
    for b in rows:
        if back[b] < np.inf:
            c = -1
            for i in range(checks):  # the last checkpoint before what came late; those after it are void
                if check_t[b, i] >= back[b]:
                    check_t[b, i] = -np.inf
                elif check_t[b, i] > -np.inf and (c < 0 or check_t[b, i] > check_t[b, c]):
                    c = i
            if c >= 0:
                p[b], log[b], at[b], bound[b] = kept_p[b, c], kept_log[b, c], kept_at[b, c], kept_bound[b, c]
                past[b], past_t[b], silence[b] = kept_past[b, c], kept_past_t[b, c], 1.0
                next_[b], done[b] = check_t[b, c] + 1e-9, 0
                while done[b] < many[b] and log_t[b, done[b]] <= check_t[b, c]:
                    done[b] += 1
            back[b] = np.inf
        for k in range(done[b], many[b]):
            t, a, n, q = log_t[b, k], log_what[b, k, 0], log_what[b, k, 1], log_what[b, k, 2]
            if checks and t > next_[b]:
                _settle(log[b], silence[b])
                c = np.argmin(check_t[b])
                check_t[b, c] = next_[b]
                kept_p[b, c], kept_log[b, c], kept_at[b, c], kept_bound[b, c] = p[b], log[b], at[b], bound[b]
                kept_past[b, c], kept_past_t[b, c] = past[b], past_t[b]
                next_[b] = math.ceil(t / period) * period
            if n == 0 and _no_news(bound[b], t - at[b], position[a], boresight[a], height[b], heard[q]):
                continue
            if t > at[b] and (n > 0 or t - at[b] > SETTLE):
                _settle(log[b], silence[b])
                _resample(p[b], log[b], t, keys[b], past[b], threshold)
                _move(p[b], log[b], at[b], t, motion, keys[b], solid, origin, cell, past[b], past_t[b], bound[b])
                at[b] = t
            closed = maps[level[b]]
            _weigh(
                p[b],
                log[b],
                silence[b],
                t - at[b],
                a,
                n,
                position[a],
                boresight[a],
                height[b],
                tables[q, n],
                heard[q],
                closed,
                origin,
                cell,
            )
        oldest, gone = np.inf, 0
        for i in range(checks):
            if check_t[b, i] > -np.inf:
                oldest = min(oldest, check_t[b, i])
        while gone < many[b] and (not checks or log_t[b, gone] <= oldest):
            gone += 1
        if gone:
            for k in range(many[b] - gone):
                log_t[b, k] = log_t[b, k + gone]
                log_what[b, k] = log_what[b, k + gone]
            many[b] -= gone
        done[b] = many[b]


@njit(cache=True, error_model="numpy")
def moments(p, log, silence, rows, mean, covariance):
    """Weighted mean (B, 4) and covariance (B, 4, 4) of place and velocity, of some rows."""
    m = p.shape[2]
    w = np.empty(m)
    for b in rows:
        top, total, spread = log[b].max(), 0.0, 0.0
        for i in range(m):
            w[i] = math.exp(log[b, i] - top) * silence[b, i]
            total += w[i]
            spread += w[i] * p[b, SPREAD, i]
        for j in range(4):
            s = 0.0
            for i in range(m):
                s += w[i] * p[b, j, i]
            mean[b, j] = s / total
        for j in range(4):
            for k in range(j + 1):
                s, mj, mk = 0.0, mean[b, j], mean[b, k]
                for i in range(m):
                    s += w[i] * (p[b, j, i] - mj) * (p[b, k, i] - mk)
                covariance[b, j, k] = covariance[b, k, j] = s / total
        covariance[b, 2, 2] += spread / total
        covariance[b, 3, 3] += spread / total


@njit(cache=True, error_model="numpy")
def places(p, at, past, past_t, t):
    """(B, 2, M): where particles are at t (B,), or where their ancestors were: straight lines between what is kept of the past."""
    found = np.empty((p.shape[0], 2, p.shape[2]))
    for b in range(len(t)):
        before, after = -1, -1
        for g in range(past.shape[1]):
            if past_t[b, g] <= t[b] and (before < 0 or past_t[b, g] > past_t[b, before]):
                before = g
            if past_t[b, g] > t[b] and (after < 0 or past_t[b, g] < past_t[b, after]):
                after = g
        for axis in range(2):
            if t[b] >= at[b] or before < 0 or not np.isfinite(past_t[b, before]):
                found[b, axis] = p[b, axis] + max(t[b] - at[b], 0.0) * p[b, VX + axis]
            elif after >= 0:
                share = (t[b] - past_t[b, before]) / (past_t[b, after] - past_t[b, before])
                found[b, axis] = past[b, before, axis] + share * (past[b, after, axis] - past[b, before, axis])
            else:
                share = (t[b] - past_t[b, before]) / (at[b] - past_t[b, before])
                found[b, axis] = past[b, before, axis] + share * (p[b, axis] - past[b, before, axis])
    return found


@njit(cache=True, error_model="numpy")
def bounds(p, bound):
    """For each row the corners of a box round its particles, and their greatest speed |vx| + |vy|."""
    for b in range(len(p)):
        bound[b, 0], bound[b, 1], bound[b, 2], bound[b, 3] = p[b, X].min(), p[b, Y].min(), p[b, X].max(), p[b, Y].max()
        bound[b, 4] = np.abs(p[b, VX]).max() + np.abs(p[b, VY]).max()
