"""What an rfid reader in the hand hears of one tag on the way: the whole channel, with racks, reflections and the person's own body.

Select lets the sought tag through alone, so it is asked again and again, at Poisson times; each answer passes the channel and the
reader's artefacts like any other read. Left out: collisions, which a single tag doesn't have, and the other tags' own reflections.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.guidance import wrapped
from testbed.guided.ears import Heard
from testbed.guided.section import GuidedWalk
from testbed.guided.walkers import Walkers
from testbed.radio.artefacts import Answers, Artefacts
from testbed.radio.propagation import phase_of
from testbed.rng import keys_of, stream
from testbed.scene import Truth
from testbed.sensors.rfid import Rfid
from testbed.types import Reads

if TYPE_CHECKING:
    from testbed.simulate import Simulator


class RadioEar:
    """The reads of B people, each in a trial of its own, whose bodies move through the scene as they walk."""

    def __init__(self, sensor: Rfid, simulator: Simulator, walk: GuidedWalk, id: str, numbers: Array, people: Walkers) -> None:
        self._sensor, self._walk = sensor, walk
        root, duration = simulator.scenario.seed, simulator.scenario.duration_s
        self._around = [simulator.moved(int(n), root, duration) for n in numbers]
        truth = self._around[0].truth
        self._body, self._poses = truth.index(id), [np.array(around.truth.poses) for around in self._around]
        self._tag = int(simulator.aims.tags[0][0])
        carried = np.flatnonzero(np.asarray(sensor.antennas().carrier) == id)
        self._antenna = int(carried[0])
        before = simulator.sensors[: [s is sensor for s in simulator.sensors].index(True)]
        self._first = sum(len(s.antennas()) for s in before)  # of the sensor's antennas in the site
        self.lever = lever_of(sensor, id)
        self._now = np.concatenate([people.place, people.heading[:, None]], axis=1)
        for row in range(len(numbers)):
            self._move(row, 0.0, 0.0, self._now[row])

    def heard(self, people: Walkers, rows: Array, began: Array) -> Heard:
        found = [self._acted(people, int(r), float(b), listening=True) for r, b in zip(rows, began, strict=True)]
        return Heard(np.array([len(f) > 0 for f in found], dtype=bool), reads=found)

    def walked(self, people: Walkers, rows: Array, before: Array, began: Array) -> Heard:
        found = [self._acted(people, int(r), float(b), listening=False) for r, b in zip(rows, began, strict=True)]
        return Heard(np.array([len(f) > 0 for f in found], dtype=bool), reads=found)

    def _acted(self, people: Walkers, row: int, began: float, listening: bool) -> Reads:
        """Put the person's motion since `began` into the truth; what is read during it, or, of a turn, in the pause after it."""
        now = float(people.t[row])
        still = now - self._walk.pause_s
        self._move(row, began, still, np.array([*people.place[row], people.heading[row]]))
        return self._read(row, still if listening else began, now, f"{people.turns[row]}.{people.steps[row]}")

    def _move(self, row: int, began: float, still: float, end: Array) -> None:
        """Straight and evenly from where the person was to `end` (x, y, heading), there from `still` on for the time being."""
        t, start = np.asarray(self._around[row].truth.t), self._now[row]
        later = t > began
        share = np.clip((t[later] - began) / max(still - began, 1e-9), 0.0, 1.0)[:, None]
        place = start[:2] + share * (end[:2] - start[:2])
        heading = start[2] + share[:, 0] * wrapped(end[2] - start[2])
        self._poses[row][later, self._body] = posed(place, heading, self.lever)
        self._now[row] = end

    def truth(self, row: int) -> Truth:
        """The motion of everything in a row's trial, the person where they have gone so far."""
        return self._around[row].truth.with_(poses=self._poses[row])

    def _read(self, row: int, began: float, ended: float, action: str) -> Reads:
        sensor, around = self._sensor, replace(self._around[row], truth=self.truth(row))
        random = stream(around.root, around.trial, f"sensors.{sensor.id}.asked.{action}")
        t = np.sort(random.uniform(began, ended, random.poisson(self._walk.reads_hz * max(ended - began, 0.0))))
        n = len(t)
        antenna, tag = np.full(n, self._antenna), np.full(n, self._tag)
        carrier = sensor.carrier(around, antenna, t)
        response = sensor.channel(around).respond(antenna, tag, t, carrier)
        received, forward, reverse = sensor.margins(response, antenna, tag, around.tagged)
        answers = Answers(
            antenna=antenna, tag=tag, visit=np.full(n, int(1e3 * began)), count=np.arange(n), channel=carrier, t=t, received=received,
            phase=phase_of(response.h), doppler=np.zeros(n),
        )  # fmt: skip
        name, profile = f"sensors.{sensor.id}", sensor.config.reader.resolved()
        ids = keys_of(sensor.antennas().id), keys_of(around.tagged.tags.id)
        artefacts = Artefacts(sensor.config.artefacts, profile, around.root, around.trial, name, *ids, ports=1)
        reads = artefacts.reported(answers).take((forward >= 0) & (reverse >= 0))
        return reads.with_(antenna=reads.antenna + self._first)


def lever_of(sensor: Rfid, id: str) -> float:
    """How far before the feet of the person `id` the antenna is, m: they turn about it, so that a turn does not move it."""
    antennas = sensor.antennas()
    return float(antennas.position[np.asarray(antennas.carrier) == id][0, 0])


def posed(place: Array, heading: Array, lever: float) -> Array:
    """(K, 7): poses of bodies whose reader is at `place` (K, 2), `lever` m before them, looking along `heading` (K,)."""
    feet = place - lever * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([feet, np.zeros((len(heading), 1)), frames.from_euler(heading)], axis=1)
