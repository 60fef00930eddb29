"""Where a tag may be about a gate and what it may be doing: probabilities over cells, ways of going, and what it has done so far.

p[h, m, i, j] of a row: history h, motion m, cell (i, j) in the gate's frame (x inward, y to the left).

    h   0 has stood ever since; 1, 2 set out outside; 3, 4 set out inside: 2 and 4 have been near the gate on the way
    m   0 stands, 1 goes in (+x), 2 out (-x), 3 left (+y), 4 right (-y)

So the classes are sums over p, and each sum is a likelihood with the way there integrated out: "in" is h in {1, 2} beyond the band
behind the plane, and so on. A hidden Markov model, stepped at equal times; the plane is only crossed through the opening.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

HISTORIES, MOTIONS = 5, 5
STOOD, OUTSIDE, OUTSIDE_NEAR, INSIDE, INSIDE_NEAR = range(HISTORIES)
NOTHING, IN, OUT, PASS, UTURN = range(5)


@njit(cache=True, error_model="numpy")
def begin(p, x, moving):
    """A tag heard for the first time: it is anywhere; it stands, or has set out on the side where it is (in place)."""
    nx, ny = p.shape[2], p.shape[3]
    p[:] = 0.0
    each = 1.0 / (nx * ny)
    for i in range(nx):
        for j in range(ny):
            p[0, 0, i, j] = (1.0 - moving) * each
            for m in range(1, 5):
                p[1 if x[i] < 0 else 3, m, i, j] = 0.25 * moving * each


@njit(cache=True, error_model="numpy")
def switch(p, x, start, stop, turn, rest, band, flux):
    """Setting out, stopping, turning in one step, each with its probability, and coming to rest: h becomes 0 once it has stood.

    flux (5,) gathers what the ways ended as that came to rest: IN, OUT, PASS, UTURN (in place).
    """
    nx, ny = p.shape[2], p.shape[3]
    for h in range(5):
        for i in range(nx):
            out = x[i] < 0
            for j in range(ny):
                stand, total = p[h, 0, i, j], 0.0
                for m in range(1, 5):
                    total += p[h, m, i, j]
                if stand + total < 1e-15:
                    continue
                for m in range(1, 5):
                    p[h, m, i, j] = p[h, m, i, j] * (1.0 - stop - turn - turn / 3) + total * turn / 3
                to = h
                if h == 0:
                    to = 1 if out else 3
                for m in range(1, 5):
                    p[to, m, i, j] += 0.25 * start * stand
                left = stand * (1.0 - start) + stop * total
                if h > 0 and abs(x[i]) >= band:
                    gone = rest * left
                    left -= gone
                    p[0, 0, i, j] += gone
                    flux[ended(h, out)] += gone
                p[h, 0, i, j] = left


@njit(cache=True, error_model="numpy")
def ended(h, out):
    """What a way was that set out as h says and ended outside (`out`) or inside."""
    if h <= 2:
        return (3 if h == 1 else 4) if out else 1
    return 2 if out else (3 if h == 3 else 4)


@njit(cache=True, error_model="numpy")
def go(p, near, open_, middle, jump_x, jump_y):
    """One step of those who go: to the next cell with probability `jump`; not out of the area, nor through a wall (in place).

    open_ (ny,): whether the plane, between cells middle - 1 and middle along x, can be crossed there; near (nx, ny): by the gate
    """
    nx, ny = p.shape[2], p.shape[3]
    for h in range(1, 5):
        for j in range(ny):
            way = open_[j]
            for i in range(nx - 2, -1, -1):
                if way or i + 1 != middle:
                    moved = jump_x * p[h, 1, i, j]
                    p[h, 1, i, j] -= moved
                    p[h, 1, i + 1, j] += moved
            for i in range(1, nx):
                if way or i != middle:
                    moved = jump_x * p[h, 2, i, j]
                    p[h, 2, i, j] -= moved
                    p[h, 2, i - 1, j] += moved
        for i in range(nx):
            for j in range(ny - 2, -1, -1):
                moved = jump_y * p[h, 3, i, j]
                p[h, 3, i, j] -= moved
                p[h, 3, i, j + 1] += moved
            for j in range(1, ny):
                moved = jump_y * p[h, 4, i, j]
                p[h, 4, i, j] -= moved
                p[h, 4, i, j - 1] += moved
    for h in (1, 3):
        for m in range(5):
            for i in range(nx):
                for j in range(ny):
                    if near[i, j]:
                        p[h + 1, m, i, j] += p[h, m, i, j]
                        p[h, m, i, j] = 0.0


@njit(cache=True, error_model="numpy")
def weigh(p, expected, rssi, weight, sigma, turn, dt, toward, k, phase_sigma, speed, speed_sigma, outlier, phase_weight, factor):
    """Bayes' rule for one read, and the logarithm of its likelihood (in place; p sums to 1 before and after).

    expected (nx, ny) dBm; turn: how far the phase turned, modulo π, since the antenna's last read `dt` s ago (NaN for none);
    toward (nx, ny, 2): unit vector to the antenna, over the floor; k: rad a metre; factor (5, nx, ny): room for work
    """
    nx, ny = p.shape[2], p.shape[3]
    heard = not np.isnan(turn)
    still, blur = 1.0, 1.0
    if heard:
        still = ring(turn, phase_sigma, outlier) ** phase_weight
        blur = np.sqrt(phase_sigma**2 + (k * speed_sigma * dt) ** 2)
    for i in range(nx):
        for j in range(ny):
            off = (rssi - expected[i, j]) / sigma
            level = np.exp(-0.5 * weight * min(off * off, 9.0))
            factor[0, i, j] = level * still
            for m in range(1, 5):
                factor[m, i, j] = level
            if heard:
                fx, fy = k * dt * speed * toward[i, j, 0], k * dt * speed * toward[i, j, 1]
                factor[1, i, j] *= ring(turn - fx, blur, outlier) ** phase_weight
                factor[2, i, j] *= ring(turn + fx, blur, outlier) ** phase_weight
                factor[3, i, j] *= ring(turn - fy, blur, outlier) ** phase_weight
                factor[4, i, j] *= ring(turn + fy, blur, outlier) ** phase_weight
    total = 0.0
    for h in range(5):
        for m in range(5):
            for i in range(nx):
                for j in range(ny):
                    p[h, m, i, j] *= factor[m, i, j]
                    total += p[h, m, i, j]
    p /= total
    return np.log(total)


@njit(cache=True, error_model="numpy")
def hush(p, missed, last, now, lull, factor):
    """Bayes' rule for one step of silence: what antennas that come by all the time did not hear, while others did (in place).

    missed (antennas, nx, ny): log-probability that an antenna hears nothing of a tag there in a step; last (antennas,) s: its last read
    """
    nx, ny = p.shape[2], p.shape[3]
    factor[0] = 0.0
    for a in range(len(missed)):
        if not now - last[a] < lull:  # NaN: never heard
            factor[0] += missed[a]
    total = 0.0
    for i in range(nx):
        for j in range(ny):
            f = np.exp(factor[0, i, j])
            for h in range(5):
                for m in range(5):
                    p[h, m, i, j] *= f
                    total += p[h, m, i, j]
    p /= total


@njit(cache=True, error_model="numpy")
def ring(turn, sigma, outlier):
    """Density on a ring of length π of a normal about 0, mixed with a share `outlier` of the uniform one; uniform where sigma is wide."""
    if sigma > 1.2:
        return 1.0 / np.pi
    u = turn - np.pi * np.round(turn / np.pi)
    u2, s2 = abs(u) - np.pi, sigma * sigma
    normal = (np.exp(-0.5 * u * u / s2) + np.exp(-0.5 * u2 * u2 / s2)) / (np.sqrt(2 * np.pi) * sigma)
    return (1.0 - outlier) * normal + outlier / np.pi


@njit(cache=True, error_model="numpy")
def crossed(p, x, band):
    """(in, out): how likely the row has set out on one side and is now beyond the band on the other."""
    came, went = 0.0, 0.0
    for h in range(1, 5):
        for i in range(p.shape[2]):
            if h <= 2 and x[i] >= band:
                came += p[h, :, i, :].sum()
            elif h > 2 and x[i] <= -band:
                went += p[h, :, i, :].sum()
    return came, went


@njit(cache=True, error_model="numpy")
def turn_page(p, x):
    """After a crossing was announced: whoever has set out on the other side has set out on the one where it is, by the gate (in place)."""
    for i in range(p.shape[2]):
        own, other = (2, 4) if x[i] < 0 else (4, 2)
        for m in range(5):
            for j in range(p.shape[3]):
                p[own, m, i, j] += p[other, m, i, j] + p[1 if own == 4 else 3, m, i, j]
                p[other, m, i, j] = 0.0
                p[1 if own == 4 else 3, m, i, j] = 0.0


def room(rows: int, nx: int, ny: int) -> Any:
    """(rows, 5, 5, nx, ny) float32: beliefs of rows that nothing is known of yet."""
    return np.zeros((rows, HISTORIES, MOTIONS, nx, ny), dtype=np.float32)
