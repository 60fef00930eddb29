"""The published particle filter that guides a person to a tag by phase, to the letter.

A. Raptopoulos, T. Yioultsis, A. G. Dimitriou, "Particle filter object tracking by a handheld UHF RFID reader", 2019. Equations by their
numbers there. Where the paper leaves a choice, it is a field of the configuration, and the default is the one that its simulations fit.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numba import njit
from pydantic import Field

from estimators.handheld_guide import Guide, GuideConfig
from estimators.resampling import multinomial, systematic
from testbed.quantity import Degrees, Metres
from testbed.types import Array

LEAST = 1e-12  # rad²: what a weight's denominator is at the least


class HandheldPaper(Guide):
    """Particles (x, y, heading) about a tag at the origin; weights 1/m² of the miss in phase; the weighted mean of the turns is advised.

    Breaks with few particles: below 50 the cloud often holds no particle near the truth, and the person is led by chance. A step whose
    phase can't be trusted moves the particles and weights none.
    """

    class Config(GuideConfig):
        """The paper's values, and the choices that it leaves.

        sign          : -1 takes the phase the wrong way round, as a control
        counted_turns : all turns since the last step make a_u (Eq. 19), or those of a search are forgotten
        first_turn    : whether the first step has a turn error as well
        mean          : of the turns: linear as Eq. 24 says, or of directions
        miss          : taken before Eq. 21's jitter or after it
        """

        particles: Annotated[int, Field(ge=2, le=100_000)] = 100
        step_std_m: Annotated[Metres, Field(ge=0, le=1)] = 0.1
        turn_std_deg: Annotated[Degrees, Field(ge=0, le=90)] = 11.5
        jitter_m: Annotated[Metres, Field(ge=0, le=2)] = 0.2
        side_m: Annotated[Metres, Field(gt=0, le=1000)] = 14.0
        resample_below: Annotated[float, Field(ge=0, le=1)] = 2 / 3
        sign: Literal[1, -1] = 1
        counted_turns: Literal["all", "not_searching"] = "all"
        first_turn: bool = True
        mean: Literal["linear", "circular"] = "linear"
        miss: Literal["before_jitter", "after_jitter"] = "before_jitter"
        resampling: Literal["multinomial", "systematic"] = "multinomial"

    config: Config

    def _begin(self) -> None:
        n = self.config.particles
        drawn = self.rng.uniform(3 * n).reshape(self.rows, 3, n)
        x, y = -self.config.side_m * drawn[:, 0], -self.config.side_m * drawn[:, 1]
        a = np.arctan2(-y, -x) + np.pi * (drawn[:, 2] - 0.5)
        self._cloud = np.stack([x, y, a], axis=1)  # (B, 3, N)
        self._weight = np.full((self.rows, n), 1 / n)
        self.turned = np.zeros(self.rows)  # a_u: what the person turned, by their own account, since the last step
        self._advised, self._was_moved = np.zeros(self.rows), np.zeros(self.rows, dtype=bool)

    def _turned(self, rows: Array, turn: Array, heard: Array, before: Array) -> None:
        counted = self.moved[rows] if self.config.counted_turns == "all" else self.moved[rows] & before
        self.turned[rows] += np.where(counted, turn, 0.0)  # before the first step the heading is anyone's guess as it is

    def _stepped(self, rows: Array, step: Array, change: Array, spread: Array, trusted: Array) -> None:
        c = self.config
        n, cloud, weight = c.particles, self._cloud[rows], self._weight[rows]
        noise = self.rng.normal(4 * n, rows).reshape(len(rows), 4, n)
        noise[:, 0] *= np.deg2rad(c.turn_std_deg)
        if not c.first_turn:
            noise[~self._was_moved[rows], 0] = 0.0
        noise[:, 1] *= c.step_std_m
        noise[:, 2:] *= c.jitter_m
        measured = np.where(trusted, c.sign * change, np.nan)
        late = c.miss == "after_jitter"
        turns = _move(cloud, weight, noise, self.turned[rows], step, measured, self.wavenumber, late, c.mean == "circular")
        self.turned[rows], self._advised[rows], self._was_moved[rows] = 0.0, turns, True
        few = np.flatnonzero(1 / (weight**2).sum(axis=1) < c.resample_below * n)
        if len(few):
            if c.resampling == "multinomial":
                chosen = multinomial(weight[few], self.rng.uniform(n, rows[few]))
            else:
                chosen = systematic(weight[few], self.rng.uniform(1, rows[few])[:, 0])
            cloud[few] = np.take_along_axis(cloud[few], chosen[:, None, :], axis=2)
            weight[few] = 1 / n
        self._cloud[rows], self._weight[rows] = cloud, weight

    def _aim(self) -> Array:
        return self._advised

    def _belief(self) -> tuple[Array, Array]:
        return _moments(self._cloud, self._weight)

    def particles(self) -> tuple[Array, Array]:
        """Places of the tag (B, N, 3) m in the person's frame, as each particle sees it, and weights (B, N)."""
        x, y, a = self._cloud[:, 0], self._cloud[:, 1], self._cloud[:, 2]
        ahead, left = -(x * np.cos(a) + y * np.sin(a)), x * np.sin(a) - y * np.cos(a)
        return np.stack([ahead, left, np.zeros_like(x)], axis=-1), self._weight.copy()


@njit(cache=True)
def _move(cloud, weight, noise, turned, step, measured, wavenumber, late, circular):
    """Eq. 20 to 24 for E rows, in place; returns the advised turns (E,). measured NaN: the weights stay."""
    rows, n = weight.shape
    advised = np.empty(rows)
    for b in range(rows):
        total, weigh = 0.0, not np.isnan(measured[b])
        for i in range(n):
            x, y = cloud[b, 0, i], cloud[b, 1, i]
            a = cloud[b, 2, i] + turned[b] + noise[b, 0, i]
            before = np.sqrt(x * x + y * y)
            length = step[b] + noise[b, 1, i]
            x, y = x + length * np.cos(a), y + length * np.sin(a)
            jx, jy = x + noise[b, 2, i], y + noise[b, 3, i]
            if weigh:
                after = np.sqrt(jx * jx + jy * jy) if late else np.sqrt(x * x + y * y)
                miss = wavenumber * (after - before) - measured[b]
                weight[b, i] /= max(miss * miss, LEAST)
            total += weight[b, i]
            cloud[b, 0, i], cloud[b, 1, i], cloud[b, 2, i] = jx, jy, a
        mean, c, s = 0.0, 0.0, 0.0
        for i in range(n):
            weight[b, i] /= total
            turn = np.arctan2(-cloud[b, 1, i], -cloud[b, 0, i]) - cloud[b, 2, i]
            turn -= 2 * np.pi * np.floor(turn / (2 * np.pi) + 0.5)
            mean += weight[b, i] * turn
            if circular:
                c += weight[b, i] * np.cos(turn)
                s += weight[b, i] * np.sin(turn)
        advised[b] = np.arctan2(s, c) if circular else mean
    return advised


@njit(cache=True)
def _moments(cloud, weight):
    """Mean (B, 2) and covariance (B, 2, 2) of where the tag is in the person's frame."""
    rows, n = weight.shape
    mean, covariance = np.zeros((rows, 2)), np.zeros((rows, 2, 2))
    place = np.empty((n, 2))
    for b in range(rows):
        for i in range(n):
            x, y, a = cloud[b, 0, i], cloud[b, 1, i], cloud[b, 2, i]
            c, s = np.cos(a), np.sin(a)
            place[i, 0], place[i, 1] = -(x * c + y * s), x * s - y * c
            mean[b, 0] += weight[b, i] * place[i, 0]
            mean[b, 1] += weight[b, i] * place[i, 1]
        for i in range(n):
            u, v, w = place[i, 0] - mean[b, 0], place[i, 1] - mean[b, 1], weight[b, i]
            covariance[b, 0, 0] += w * u * u
            covariance[b, 0, 1] += w * u * v
            covariance[b, 1, 1] += w * v * v
        covariance[b, 1, 0] = covariance[b, 0, 1]
    return mean, covariance
