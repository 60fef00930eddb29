"""What a handheld reader hears on a plane without obstacles: the published shortcut, a change of phase a step, or a stream of reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from testbed.columns import Array
from testbed.guided.walkers import Draws, Walkers
from testbed.rng import stream
from testbed.sensors.handheld import HandheldConfig, direct_phase, hops, mirrored_phase, reported
from testbed.types import Reads
from testbed.units import SPEED_OF_LIGHT

FINE = 200  # points of a step along which a phase is followed: a few millimetres apart


@dataclass(frozen=True)
class Heard:
    """What an action of R rows was to the reader: whether the tag answers (R,), how far the phase turned (R,) rad, the reads of each.

    Without reads there is none, and change is what the guide gets; with reads change is left to the guide.
    """

    answers: Array
    change: Array | None = None
    reads: list[Reads] = field(default_factory=list)


class Ear(Protocol):
    """What is sensed of a walk."""

    def heard(self, people: Walkers, rows: Array, began: Array) -> Heard:
        """Rows (R,) have turned, or only listened, since `began` (R,) s."""
        ...

    def walked(self, people: Walkers, rows: Array, before: Array, began: Array) -> Heard:
        """Rows have stepped from `before` (R, 2) m since `began` (R,) s."""
        ...


class PlainEar:
    """The published shortcut: dφ = K(|E| - |S|) + N(0, phase_std), readable within the beam. No reads."""

    def __init__(self, config: HandheldConfig, root: int, trials: Array, id: str, people: Walkers) -> None:
        self._config = config
        self._draws = {what: Draws(root, trials, f"sensors.{id}.{what}") for what in ("phase", "wrong", "wall")}
        self._wavenumber = 2 * np.pi * config.frequency_mhz * 1e6 / SPEED_OF_LIGHT
        rows = np.arange(len(trials))
        x, y = (people.tag - people.place).T
        self._facing = np.arctan2(y, x) + np.pi / 3 * (2 * self._draws["wall"].uniform(rows, 0) - 1)

    def heard(self, people: Walkers, rows: Array, began: Array) -> Heard:
        return Heard(self.in_beam(people, rows))

    def in_beam(self, people: Walkers, rows: Array) -> Array:
        """(R,) whether the tag is in front of the antenna."""
        if self._config.beam_deg is None:
            return np.ones(len(rows), dtype=bool)
        return np.abs(people.bearing(rows)) < np.deg2rad(self._config.beam_deg) / 2

    def walked(self, people: Walkers, rows: Array, before: Array, began: Array) -> Heard:
        c, k = self._config, people.steps[rows] - 1
        change = self._turned(people, rows, before) + np.deg2rad(c.phase_std_deg) * self._draws["phase"].normal(rows, k)
        wrong = self._draws["wrong"].uniform(rows, k, 0) < c.wrong_steps
        reach = 2 * self._wavenumber * np.hypot(*(people.place[rows] - before).T)
        change = np.where(wrong, reach * (2 * self._draws["wrong"].uniform(rows, k, 1) - 1), change)
        return Heard(np.ones(len(rows), dtype=bool), change)

    def _turned(self, people: Walkers, rows: Array, before: Array) -> Array:
        """(R,) rad: how far the phase truly turns over the step, with the wall's reflection where there is one."""
        c, tag = self._config, people.tag[rows]
        if c.reflection == 0:
            ends = (direct_phase(place, tag, self._wavenumber) for place in (before, people.place[rows]))
        else:
            share = np.linspace(0, 1, FINE)[:, None, None]
            way = before + share * (people.place[rows] - before)
            phase = mirrored_phase(way, tag, self._wavenumber, c.reflection, c.wall_m, self._facing[rows])
            ends = np.unwrap(phase, axis=0)[[0, -1]]
        start, end = ends
        return start - end


class StreamEar(PlainEar):
    """Reads at Poisson times while the tag is in the beam, with wrapped phases, outliers, losses and hops."""

    def __init__(self, config: HandheldConfig, root: int, trials: Array, id: str, people: Walkers, pause: float) -> None:
        super().__init__(config, root, trials, id, people)
        self._root, self._trials, self._name, self._pause = root, trials, f"sensors.{id}", pause

    def heard(self, people: Walkers, rows: Array, began: Array) -> Heard:
        ok, found = self.in_beam(people, rows), []
        for i, r in enumerate(rows.tolist()):
            place, number = people.place[r], f"turn.{people.turns[r]}"
            found.append(self._read(people, r, place, place, float(people.t[r]) - self._pause, number) if ok[i] else Reads.empty())
        return Heard(np.array([len(f) > 0 for f in found], dtype=bool), reads=found)

    def walked(self, people: Walkers, rows: Array, before: Array, began: Array) -> Heard:
        found = [
            self._read(people, r, before[i], people.place[r], float(began[i]), f"step.{people.steps[r]}")
            for i, r in enumerate(rows.tolist())
        ]
        return Heard(np.array([len(f) > 0 for f in found], dtype=bool), reads=found)

    def _read(self, people: Walkers, row: int, start: Array, end: Array, began: float, name: str) -> Reads:
        """The reads of one row since `began` while it goes straight from start to end, at one speed, and then pauses."""
        c, now = self._config, float(people.t[row])
        random = stream(self._root, int(self._trials[row]), f"{self._name}.{name}")
        t = np.sort(random.uniform(began, now, random.poisson(c.rate_hz * (now - began))))
        t = t[random.uniform(size=len(t)) >= c.lost]
        share = np.clip((t - began) / max(now - began - self._pause, 1e-9), 0.0, 1.0)
        way, channel = start + share[:, None] * (end - start), hops(c, t)
        k = 2 * np.pi * c.carriers()[channel] / SPEED_OF_LIGHT
        if c.reflection == 0:
            phase = direct_phase(way, people.tag[row], k)
        else:
            phase = mirrored_phase(way, people.tag[row], k, c.reflection, c.wall_m, float(self._facing[row]))
        return reported(c, random, t, phase, channel)
