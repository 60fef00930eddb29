"""A Rao-Blackwellised filter that guides a person to a tag by phase, and a rule that asks for turns that tell it something.

The phase gives the change of range to millimetres, so range is no state to be sampled: a particle is (range, bearing), the range goes on
by what was measured, and what is sampled is the error of a turn and the lateral slip of a step. The step that a particle then
implies is judged by the density of such steps. Whether the tag answers is data, too.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from pydantic import Field
from scipy.special import ndtri

from estimators.handheld_guide import Guide, GuideConfig
from estimators.resampling import systematic
from testbed.quantity import Degrees, Metres
from testbed.types import Array

SWEEP_AFTER, GOLDEN = 3, np.pi * (3 - np.sqrt(5))  # silent turns, rad
DIRECTIONS = 72  # that the rule of control compares
STEEPEST = 5.0  # of the change of a step with the range: without a limit a tag abeam would have infinite density
OUT_OF_REACH = 1e-4  # weight of a particle whose tag can't be where the phase puts it, relative to others: it may be the phase that errs


class HandheldRb(Guide):
    """Particles (range, bearing); both branches, the tag still ahead after a step or passed, are kept; turns are chosen to explore.

    Straight steps never tell a tag to the left from one to the right. The turn advised is the one with the greatest mean of the cosine
    to the tag plus `explore` times its standard deviation over the particles. Near the tag shorter steps are asked for.

    Breaks where the phase is wrong more often than `wrong_steps` says, and where the beam is much wider or narrower than beam_deg.
    """

    class Config(GuideConfig):
        """The person's errors and the beam as the guide assumes them.

        farthest_m  : how far away the tag may be at the start
        phase_std_deg : of a change of phase over a step
        wrong_steps : how often that is something else altogether
        answers     : how often a tag within the beam answers at all: below 1 silence says less, as where racks stand
        blind_steps : so many steps the person goes on without an answer, by what was heard before
        edge_deg    : over how much of an angle the beam's edge is soft; beam_deg None: the tag answers all round
        fresh       : share of particles that begin anew whenever there is a choice among them
        explore     : weight of the spread in the rule of control; 0 goes straight for the mean
        shortest_m  : of the steps near the tag; step_m for steps of one length
        """

        particles: Annotated[int, Field(ge=2, le=100_000)] = 300
        step_std_m: Annotated[Metres, Field(gt=0, le=1)] = 0.1
        turn_std_deg: Annotated[Degrees, Field(gt=0, le=90)] = 11.5
        farthest_m: Annotated[Metres, Field(gt=0.5, le=1000)] = 20.0
        phase_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 5.5
        wrong_steps: Annotated[float, Field(ge=0, lt=1)] = 0.02
        beam_deg: Annotated[Degrees, Field(gt=0, le=360)] | None = 180.0
        edge_deg: Annotated[Degrees, Field(gt=0, le=90)] = 10.0
        answers: Annotated[float, Field(gt=0, le=0.99)] = 0.99
        blind_steps: Annotated[int, Field(ge=0, le=1000)] = 0
        fresh: Annotated[float, Field(ge=0, lt=1)] = 0.02
        explore: Annotated[float, Field(ge=0, le=10)] = 1.0
        shortest_m: Annotated[Metres, Field(gt=0, le=2)] = 0.15
        resample_below: Annotated[float, Field(ge=0, le=1)] = 0.6

    config: Config

    def _begin(self) -> None:
        n = self.config.particles
        drawn = self.rng.uniform(2 * n).reshape(self.rows, 2, n)
        self._range = 0.5 + (self.config.farthest_m - 0.5) * drawn[:, 0]
        self._bearing = np.pi * (2 * drawn[:, 1] - 1)
        self._weight, self._told = np.full((self.rows, n), 1 / n), np.zeros(self.rows)
        self._rule(np.arange(self.rows))

    # ------------------------------------------------------------ what is done

    def _turned(self, rows: Array, turn: Array, heard: Array, before: Array) -> None:
        c = self.config
        drawn = self.rng.uniform(3 * c.particles + 1, rows)  # one call for all: it costs more than its numbers
        errors = np.deg2rad(c.turn_std_deg) * ndtri(drawn[:, : c.particles])
        half = np.inf if c.beam_deg is None else np.deg2rad(c.beam_deg) / 2
        bearing, weight = self._bearing[rows], self._weight[rows]
        _turn(bearing, weight, turn, errors, heard, half, np.deg2rad(c.edge_deg) / 4, c.answers)
        self._bearing[rows], self._weight[rows] = bearing, weight
        self._choose(rows, drawn[:, c.particles :])

    def _stepped(self, rows: Array, step: Array, change: Array, spread: Array, trusted: Array) -> None:
        c, n = self.config, self.config.particles
        drawn = self.rng.uniform(5 * n + 1, rows)
        normal = ndtri(drawn[:, n : 3 * n]).reshape(len(rows), 2, n)
        further = np.where(trusted, change, np.nan) / self.wavenumber
        noise = np.hypot(np.deg2rad(c.phase_std_deg), spread) / self.wavenumber
        place, bearing, weight = self._range[rows], self._bearing[rows], self._weight[rows]
        _go(place, bearing, weight, drawn, normal, step, further, noise, c.step_std_m / np.sqrt(2), c.wrong_steps)
        self._range[rows], self._bearing[rows], self._weight[rows] = place, bearing, weight
        self._choose(rows, drawn[:, 3 * n :])

    def _choose(self, rows: Array, drawn: Array) -> None:
        """Normalise; where few particles carry the weight draw them anew by `drawn` (R, 1 + 2 N), some of them from scratch."""
        c, n = self.config, self.config.particles
        weight = self._weight[rows]
        few = np.flatnonzero(_settled(weight) < c.resample_below * n)
        self._weight[rows] = weight
        if len(few):
            some, drawn = rows[few], drawn[few]
            chosen = systematic(weight[few], drawn[:, 0])
            self._range[some], self._bearing[some] = _anew(self._range[some], self._bearing[some], chosen, drawn, c.fresh, c.farthest_m)
            self._weight[some] = 1 / n
        self._rule(rows)

    # ------------------------------------------------------------ what is advised

    def _rule(self, rows: Array) -> None:
        """The turn that maximises E[cos(β - u)] + explore · std[cos(β - u)] over the directions u."""
        c1, s1, c2, s2 = _moments(self._weight[rows], self._bearing[rows])[:, :, None]
        mean = c1 * _COS[0] + s1 * _SIN[0]
        square = 0.5 + 0.5 * (c2 * _COS[1] + s2 * _SIN[1])
        value = mean + self.config.explore * np.sqrt(np.maximum(square - mean**2, 0.0))
        self._told[rows] = _U[np.argmax(np.round(value, 9), axis=1)]

    def _aim(self) -> Array:
        return self._told

    def _search(self) -> Array:
        """Who hears nothing turns to where the tag may be now; before the first step there is only the other side.

        Silent again and again the belief is wrong, and angles by the golden section come by all directions.
        """
        lost = (self._silent >= SWEEP_AFTER) & ~self._led()
        return np.where(lost, GOLDEN, np.where(self.moved, self._told, super()._search()))

    def _led(self) -> Array:
        """Where something hides the tag, its place is remembered for some steps."""
        return self.moved & ~self._heard & (self._blind < self.config.blind_steps)

    def _length(self) -> Array:
        """Shorter steps where the tag may be nearer than a step."""
        near = (self._weight * np.minimum(self._range, 2.0)).sum(axis=1)
        return np.clip(near, min(self.config.shortest_m, self.config.step_m), self.config.step_m)

    def _belief(self) -> tuple[Array, Array]:
        place, weight = self.particles()
        flat = place[..., :2]
        mean = (weight[..., None] * flat).sum(axis=1)
        off = flat - mean[:, None]
        return mean, np.einsum("bn,bni,bnj->bij", weight, off, off)

    def particles(self) -> tuple[Array, Array]:
        """Places of the tag (B, N, 3) m in the person's frame, and weights (B, N)."""
        x, y = self._range * np.cos(self._bearing), self._range * np.sin(self._bearing)
        return np.stack([x, y, np.zeros_like(x)], axis=-1), self._weight.copy()


_U = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS - np.pi
_COS, _SIN = (np.stack([of(_U), of(2 * _U)]) for of in (np.cos, np.sin))


@njit(cache=True)
def _turn(bearing, weight, turn, errors, heard, half, soft, answers):
    """A turn of E rows, in place: bearings go the other way, and weights by how likely what was heard is for a tag there.

    half : of the beam, rad, infinite for all round; soft : how soft its edge is, rad
    """
    rows, n = weight.shape
    for b in range(rows):
        stood = turn[b] == 0.0  # who only listened, or was told to go on, did not turn
        for i in range(n):
            a = bearing[b, i] - turn[b] - (0.0 if stood else errors[b, i])
            a -= 2 * np.pi * np.floor(a / (2 * np.pi) + 0.5)
            bearing[b, i] = a
            if np.isinf(half):
                continue
            off = min(max((abs(a) - half) / soft, -40.0), 40.0)
            inside = 0.01 + (answers - 0.01) / (1 + np.exp(off))
            weight[b, i] *= inside if heard[b] else 1 - inside


@njit(cache=True)
def _settled(weight):
    """Normalise E rows of weights in place; the effective numbers of particles (E,)."""
    rows, n = weight.shape
    number = np.empty(rows)
    for b in range(rows):
        total, square = 0.0, 0.0
        for i in range(n):
            total += weight[b, i]
        for i in range(n):
            weight[b, i] = weight[b, i] / total if total > 0 else 1 / n
            square += weight[b, i] ** 2
        number[b] = 1 / square
    return number


@njit(cache=True)
def _anew(place, bearing, chosen, drawn, fresh, farthest):
    """(ranges, bearings) of the heirs `chosen` (E, N), a share `fresh` of them begun from scratch."""
    rows, n = chosen.shape
    r, a = np.empty((rows, n)), np.empty((rows, n))
    for b in range(rows):
        for i in range(n):
            if drawn[b, 1 + i] < fresh:
                r[b, i] = 0.2 + (farthest - 0.2) * drawn[b, 1 + i] / fresh
                a[b, i] = np.pi * (2 * drawn[b, 1 + n + i] - 1)
            else:
                r[b, i], a[b, i] = place[b, chosen[b, i]], bearing[b, chosen[b, i]]
    return r, a


@njit(cache=True)
def _moments(weight, bearing):
    """(4, E): the means of cos β, sin β, cos 2β and sin 2β."""
    rows, n = weight.shape
    found = np.zeros((4, rows))
    for b in range(rows):
        for i in range(n):
            w, c, s = weight[b, i], np.cos(bearing[b, i]), np.sin(bearing[b, i])
            found[0, b] += w * c
            found[1, b] += w * s
            found[2, b] += w * (c * c - s * s)
            found[3, b] += 2 * w * c * s
    return found


@njit(cache=True)
def _go(place, bearing, weight, drawn, normal, step, further, noise, slip, wrong):
    """A step of E rows, in place.

    Of each particle the lateral slip is drawn and the range goes on by what was measured; so the length of the step follows, for the
    tag ahead of the person afterwards and for the tag passed, and either is taken by its density. A share `wrong` of particles does
    not believe the phase and moves by the step alone; without a phase (NaN) all do.
    """
    rows, n = weight.shape
    for b in range(rows):
        blind = np.isnan(further[b])
        for i in range(n):
            r, a = place[b, i], bearing[b, i]
            x, y = r * np.cos(a), r * np.sin(a) - slip * normal[b, 0, i]
            if blind or drawn[b, i] < wrong:
                x -= step[b] + slip * normal[b, 1, i]
                place[b, i], bearing[b, i] = np.sqrt(x * x + y * y), np.arctan2(y, x)
                if not blind:  # any change that a step can make
                    weight[b, i] *= 1.0 / (2 * step[b])
                continue
            new = r + further[b] + noise[b] * normal[b, 1, i]
            if new <= 0.02:
                weight[b, i] *= OUT_OF_REACH
                place[b, i], bearing[b, i] = 0.02, a
                continue
            square = new * new - y * y
            if square <= 0:
                gap = (abs(y) - new) / slip
                weight[b, i] *= max(OUT_OF_REACH, _density((x - step[b]) / slip) / slip * np.exp(-0.5 * gap * gap))
                place[b, i], bearing[b, i] = new, np.arctan2(y, 0.0)
                continue
            ahead = np.sqrt(square)
            steep = min(new / max(ahead, 1e-9), STEEPEST)
            before, passed = _density((x - ahead - step[b]) / slip), _density((x + ahead - step[b]) / slip)
            weight[b, i] *= steep * (before + passed) / slip
            if (drawn[b, i] - wrong) / (1 - wrong) * (before + passed) >= before:
                ahead = -ahead
            place[b, i], bearing[b, i] = new, np.arctan2(y, ahead)


@njit(cache=True)
def _density(z):
    """Of Student's t with four degrees of freedom."""
    return 0.375 / (1 + 0.25 * z * z) ** 2.5
