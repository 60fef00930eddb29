"""The beliefs of many tags about their gates, stepped and weighed in compiled loops: see `estimators.gate_cells` for one row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from estimators.gate_cells import begin, crossed, go, hush, switch, turn_page, weigh
from testbed.types import Array


class Cells(NamedTuple):
    """The area about a gate in the gate's frame: x (nx,), y (ny,) m; where the plane is open (ny,) and what is near it (nx, ny)."""

    x: Array
    y: Array
    near: Array
    opening: Array
    middle: int


class Rates(NamedTuple):
    """Probabilities of one step, and what decides: see `GateDetectorConfig`."""

    start: float
    stop: float
    turn: float
    rest: float
    jump_x: float
    jump_y: float
    moving: float
    band: float
    odds: float
    hints: Array
    cool_steps: int
    close_steps: int
    lull: float
    step: float


class Noise(NamedTuple):
    """How reads scatter: see `GateDetectorConfig`."""

    sigma: float
    tau: float
    temper: float
    k: float
    phase_sigma: float
    speed: float
    speed_sigma: float
    outlier: float
    phase_weight: float
    longest: float


class Rows(NamedTuple):
    """State of B rows.

    p : beliefs; step (B,) they are at; heard (B,) step of the last read, -1 before the first; cool (B,) step until which all is silent
    flux (B, 5) : ways that ended since the last episode; told (B,) bool : a crossing was announced in this episode
    hint (B,) : how many of the lower odds the row has passed in this episode
    last (B, antennas, 3) : time, phase and channel of each antenna's last read of the row, NaN before
    """

    p: Array
    step: Array
    heard: Array
    cool: Array
    flux: Array
    told: Array
    hint: Array
    last: Array


@njit(cache=True, error_model="numpy")
def step_to(rows, cells, rates, who, goal, gate, missed, said, probability):
    """Bring the rows `who` to the steps `goal` (E,).

    gate (B,): where each row is; missed (gates, antennas, nx, ny): see `hush`. said (E,) and probability (E,) are set where an episode
    ends in PASS or UTURN.
    """
    factor = np.empty((1, len(cells.x), len(cells.y)))
    for e in range(len(who)):
        b = who[e]
        if rows.heard[b] < 0:
            rows.step[b] = goal[e]
            continue
        p, flux = rows.p[b], rows.flux[b]
        while rows.step[b] < goal[e]:
            rows.step[b] += 1
            switch(p, cells.x, rates.start, rates.stop, rates.turn, rates.rest, rates.band, flux)
            go(p, cells.near, cells.opening, cells.middle, rates.jump_x, rates.jump_y)
            if (rows.step[b] - rows.heard[b]) * rates.step < rates.lull:  # some antenna hears it, so that it is there to be heard
                hush(p, missed[gate[b]], rows.last[b, :, 0], rows.step[b] * rates.step, rates.lull, factor)
            silent = rows.step[b] - rows.heard[b] >= rates.close_steps
            if silent:
                _break_off(p, cells.x, flux)
            if silent or p[0].sum() > 0.95:
                best = 3 if flux[3] >= flux[4] else 4
                whole = flux.sum()
                if whole > 0.5 and not rows.told[b] and flux[best] > 0.5 * whole:
                    said[e], probability[e] = best, min(flux[best], flux[best] / whole)
                flux[:] = 0.0
                rows.told[b] = False
                rows.hint[b] = 0
            if silent:
                rows.heard[b] = -1
                rows.step[b] = goal[e]


@njit(cache=True, error_model="numpy")
def _break_off(p, x, flux):
    """A tag that is not heard any more has gone: ways that are under way end where they are."""
    for i in range(p.shape[2]):
        side = x[i] < 0
        for h in range(1, 5):
            mass = p[h, :, i, :].sum()
            if h <= 2:
                flux[(3 if h == 1 else 4) if side else 1] += mass
            else:
                flux[2 if side else (3 if h == 3 else 4)] += mass


@njit(cache=True, error_model="numpy")
def take(rows, cells, rates, noise, who, t, antenna, rssi, phase, channel, expected, toward, said, probability, log_likelihood):
    """A read for each row `who` (E,), already stepped to its time: Bayes' rule, and whether the row has crossed the plane.

    antenna (E,): within the gate; expected (E, nx, ny) dBm, toward (E, nx, ny, 2): of that antenna
    """
    factor = np.empty((5, len(cells.x), len(cells.y)))
    for e in range(len(who)):
        b, a = who[e], antenna[e]
        p = rows.p[b]
        if rows.heard[b] < 0:
            begin(p, cells.x, rates.moving)
            rows.flux[b] = 0.0
            rows.told[b] = False
            rows.hint[b] = 0
            rows.last[b] = np.nan
        rows.heard[b] = rows.step[b]
        last = rows.last[b, a]
        dt = t[e] - last[0]
        weight = noise.temper
        turn = np.nan
        if not np.isnan(dt):
            weight *= np.tanh(max(dt, 1e-4 * noise.tau) / (2 * noise.tau))
            if last[2] == channel[e] and 1e-4 < dt <= noise.longest:
                turn = phase[e] - last[1]
        log_likelihood[e] = weigh(
            p,
            expected[e],
            rssi[e],
            weight,
            noise.sigma,
            turn,
            dt,
            toward[e],
            noise.k,
            noise.phase_sigma,
            noise.speed,
            noise.speed_sigma,
            noise.outlier,
            noise.phase_weight,
            factor,
        )
        last[0], last[1], last[2] = t[e], phase[e], channel[e]
        if rows.step[b] < rows.cool[b]:
            continue
        came, went = crossed(p, cells.x, rates.band)
        best = max(came, went)
        while rows.hint[b] < len(rates.hints) and best > rates.hints[rows.hint[b]] * (1 - best):
            rows.hint[b] += 1
            said[e], probability[e] = 5 if came > went else 6, best
        if best > rates.odds * (1 - best):
            said[e], probability[e] = 1 if came > went else 2, best
            rows.cool[b] = rows.step[b] + rates.cool_steps
            rows.told[b] = True
            turn_page(p, cells.x)


@njit(cache=True, error_model="numpy")
def moments(p, x, y, mean, covariance):
    """(B, 2) m and (B, 2, 2) m² of the beliefs p (B, 5, 5, nx, ny)."""
    for b in range(len(p)):
        s, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(x)):
            for j in range(len(y)):
                w = p[b, :, :, i, j].sum()
                s += w
                sx += w * x[i]
                sy += w * y[j]
                sxx += w * x[i] * x[i]
                sxy += w * x[i] * y[j]
                syy += w * y[j] * y[j]
        if s > 0:
            mx, my = sx / s, sy / s
            mean[b, 0], mean[b, 1] = mx, my
            covariance[b, 0, 0], covariance[b, 1, 1] = max(sxx / s - mx * mx, 0.0), max(syy / s - my * my, 0.0)
            covariance[b, 0, 1] = covariance[b, 1, 0] = sxy / s - mx * my
