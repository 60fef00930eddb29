"""UHF RFID readers with their antennas: reads with RSSI, phase and Doppler, and the rounds and counts behind them.

Works in passes over arrays, in blocks of time of bounded memory. First one margin per antenna, tag in reach and step of time says
who may answer whom; then the readers run their inventory rounds among those (`testbed.radio.inventory`); then the channel is
evaluated at the times of the reads themselves, where forward and reverse margin decide, and what is left becomes rows
(`testbed.radio.artefacts`). RSSI, phase, Doppler and margins come from the same complex h (`testbed.radio.channel`).

With `detection: logistic_beta` counts come from the published model instead, and there are no reads (`testbed.sensors.counting`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import ClassVar

import numpy as np

from testbed.columns import Array, Table, column
from testbed.protocols import Caster, Sensed, Surroundings, Tagged
from testbed.radio.artefacts import Answers, Artefacts
from testbed.radio.channel import Channel, Fixed, Response
from testbed.radio.inventory import PERSISTENCE, Interrogator, Inventory, hearing
from testbed.radio.links import Ends
from testbed.radio.propagation import phase_of, power_at_reader, power_at_tag
from testbed.radio.regions import REGIONS, hop_table
from testbed.radio.setting import Radio
from testbed.rng import Counter, keys_of, mix
from testbed.scene import WORLD, Scene
from testbed.sensors.counting import CountingConfig, Shade, counted, reader_names
from testbed.sensors.placement import place_antennas
from testbed.sensors.rfid_section import RfidConfig
from testbed.sensors.stimulus import line_of_sight, stream_figures
from testbed.types import Antennas, Counts, Reads, Rounds

CELLS = 1_000_000  # (antenna, step, tag) triples in one block: about 200 MB of temporaries at the most
SLACK = 3.0  # dB, one way: whoever is this little short of waking in the middle of a step takes part, for a fade is shorter than that
PULSE = 1e-3  # s over which the turn of the phase is called Doppler: the length of a tag's answer


class Rfid:
    """Readers of one make, a reader for each `ports` antennas, and their antennas.

    Left out: interference between readers, and between a reader's own antennas; Doppler of standing links (what passes near them
    turns their phase too; 0 is said).
    """

    Config: ClassVar[type[RfidConfig]] = RfidConfig
    produces: ClassVar[frozenset[str]] = frozenset({"reads", "rounds", "counts"})

    def __init__(self, config: RfidConfig, id: str, scene: Scene) -> None:
        self.config, self.id, self.region = config, id, REGIONS[config.region]
        antennas, self.ends = place_antennas(config, id, scene)
        self._antennas = antennas.with_(reader=self._names(antennas, scene))
        self._scene = scene
        self._fixed: tuple[Radio, Fixed] | None = None
        self._shade: Shade | None = None

    def _names(self, antennas: Antennas, scene: Scene) -> Array:
        """(A,) the reader of each antenna: the sensor where it has one, "<sensor>.<n>" where it has several."""
        if isinstance(self.config.detection, CountingConfig):
            return reader_names(scene, antennas, self.id)
        number = np.arange(len(antennas)) // (self.config.reader.ports or len(antennas))
        return np.array([f"{self.id}.{n + 1}" if number[-1] > 0 else self.id for n in number])

    def antennas(self) -> Antennas:
        """The readers' antennas where the scenario puts them."""
        return self._antennas

    def frequencies(self) -> Array:
        """(C,) Hz: its hop table."""
        return hop_table(self.config.region, self.config.carriers_mhz)

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """Reads, rounds and counts of a whole trial."""
        if not isinstance(self.config.detection, CountingConfig):
            return _Trial(self, around, first_antenna).sensed()
        if self._shade is None and self.config.detection.geometry:
            self._shade = Shade(around, self._antennas, self.ends, self.frequencies())
        made = counted(self.config.detection, self.id, self._antennas, self.ends, around, first_antenna, self._shade)
        return replace(made, streams={"reads": Reads.empty(), **made.streams})

    def radio(self, caster: Caster, tagged: Tagged, limit: bool = True) -> Radio:
        """Its links as far as no trial changes them. `limit` False: every link in full, whether it can be heard or not."""
        far = Ends(tagged.body, tagged.pose)
        return Radio(self.config.channel, self._scene, caster, self._antennas, self.ends, tagged.tags, far, self.frequencies(), limit)

    def channel(self, around: Surroundings) -> Channel:
        """The channel in one trial. What stands still is found once for all trials."""
        if self._fixed is None:
            radio = self.radio(around.caster, around.tagged)
            self._fixed = radio, Fixed(radio)
        return Channel(*self._fixed, around.truth, around.root, around.trial)

    def carrier(self, around: Surroundings, antenna: Array, t: Array) -> Array:
        """(N,) places in the hop table of antennas (N,) at times t (N,): a fresh draw each `dwell_s` of the region, for each reader."""
        draws = Counter(around.root, 0, f"sensors.{self.id}.hop")  # the table is the reader's own, the same in every trial
        bits = draws.bits(np.floor(t / self.region.dwell_s).astype(np.int64), self.reader_of(antenna))
        return (bits % np.uint64(len(self.frequencies()))).astype(np.int64)

    def reader_of(self, antenna: Array) -> Array:
        """(N,) which of the sensor's readers serves antennas (N,)."""
        return np.asarray(antenna) // (self.config.reader.ports or len(self._antennas))

    def margins(self, response: Response, antenna: Array, tag: Array, tagged: Tagged) -> tuple[Array, Array, Array]:
        """dBm at the reader (N,), and the dB by which the tag (N,) and the reader (N,) get more than they need."""
        power, profile = self._antennas.power[antenna], self.config.reader.resolved()
        received = power_at_reader(response.h, power, self.config.modulation_loss_db)
        return received, power_at_tag(response.h, power) - tagged.tags.sensitivity[tag], received - profile.sensitivity_dbm

    def able(self, around: Surroundings, channel: Channel, antenna: Array, t: Array) -> tuple[Array, Array]:
        """(place (N,), tag (N,)): who may answer antennas (K,) in steps with their middles at t (K,), or at the trial's end before that.

        Whoever is not among them takes no part in visits that begin in that step.
        """
        t = np.minimum(t, around.duration)
        place, tag = channel.candidates(antenna, t)
        antenna, t = antenna[place], t[place]
        response = channel.respond(antenna, tag, t, self.carrier(around, antenna, t))
        _, forward, reverse = self.margins(response, antenna, tag, around.tagged)
        enough = (forward >= -SLACK) & (reverse >= -2 * SLACK)
        return place[enough], tag[enough]

    def diary(self, around: Surroundings) -> Diary:
        """What its readers did in a trial, once more: the visits that `sense` makes, and what became of every answer."""
        return _Trial(self, around, 0).diary()


@dataclass(frozen=True, eq=False)
class Slots(Table):
    """Slots in which one tag alone answered: in which visit of the trial, which tag, when, and whether the link carried it to be a read."""

    visit: Array = column("int64")
    tag: Array = column("int32")
    t: Array = column("float64", unit="s")
    read: Array = column("bool")


@dataclass(frozen=True)
class Diary:
    """What a sensor's readers did in a trial. Antennas and readers are numbered within the sensor.

    rounds : its visits, in the order that `slots.visit` counts; sets (S, tags) bool : whom they asked (`rounds.asked`), the first of
    them all whom Select lets through; collisions : of each visit
    """

    rounds: Rounds
    sets: Array
    slots: Slots
    collisions: Array


@dataclass(frozen=True)
class _Block:
    """What was found out in one block of time: reads, those slots that held one, and the visits behind them."""

    reads: Reads
    slots: Slots
    rounds: Rounds
    silenced: Array  # (S, 2): index of a visit, tag
    collisions: Array  # (visits,)


class _Trial:
    """One trial: the readers at work, block by block."""

    def __init__(self, sensor: Rfid, around: Surroundings, first_antenna: int) -> None:
        self._sensor, self._config, self._around, self._first = sensor, sensor.config, around, first_antenna
        self._channel, self._tags = sensor.channel(around), around.tagged.tags
        self._profile, name = sensor.config.reader.resolved(), f"sensors.{sensor.id}"
        self._antenna_key, self._tag_key = keys_of(sensor.antennas().id), keys_of(self._tags.id)
        self._artefacts = Artefacts(
            sensor.config.artefacts, self._profile, around.root, around.trial, name, self._antenna_key, self._tag_key,
            sensor.config.reader.ports,
        )  # fmt: skip
        select = sensor.config.reader.select
        self._asked = np.array([select is None or any(fnmatchcase(str(id), p) for p in select) for id in self._tags.id], dtype=bool)
        low, high = PERSISTENCE.get(self._profile.session, (0.0, 0.0))
        persistence = low + (high - low) * Counter(around.root, 0, f"{name}.persistence").uniform(self._tag_key)
        slots = Counter(around.root, around.trial, f"{name}.slots").key
        reader = sensor.reader_of(np.arange(len(self._antenna_key)))
        self._ports = np.split(np.arange(len(reader)), np.flatnonzero(np.diff(reader)) + 1)
        self._readers = [
            Interrogator(self._profile, around.duration, mix(slots), self._antenna_key[p], self._tag_key, self._asked, persistence)
            for p in self._ports
        ]

    def diary(self) -> Diary:
        return self._written([replace(block, reads=Reads.empty()) for block in self._made()])

    def sensed(self) -> Sensed:
        blocks = list(self._made())
        reads = Reads.concatenate([b.reads for b in blocks])
        diary = self._written(blocks)
        rounds, sets, visit = diary.rounds, diary.sets, diary.slots.visit[diary.slots.read]
        order = np.argsort(reads.t_arrival, kind="stable")
        counts = _counted(rounds, reads, visit)
        figures = stream_figures(reads, self._channel.radio)
        tags = self._around.target_tags
        figures["line_of_sight"] = line_of_sight(self._channel.radio, self._around.truth, self._around.duration, tags)
        seconds = max(self._around.duration, 1e-9)
        rates = {"target_reads_hz": float(np.isin(reads.tag, tags).sum() / seconds), "reads_hz": len(reads) / seconds}
        reads = reads.with_(antenna=reads.antenna + self._first).take(order)
        rounds = rounds.with_(antenna=rounds.antenna + self._first)
        counts = counts.with_(antenna=counts.antenna + self._first)
        return Sensed({"reads": reads, "rounds": rounds, "counts": counts}, figures, rates, asked_sets=sets)

    def _written(self, blocks: list[_Block]) -> Diary:
        rounds, sets = self._asked_in(Rounds.concatenate([b.rounds for b in blocks]), [b.silenced for b in blocks])
        collisions = np.concatenate([np.empty(0, dtype=np.int64), *(b.collisions for b in blocks)])
        return Diary(rounds, sets, Slots.concatenate([b.slots for b in blocks]), collisions)

    # ------------------------------------------------------------ blocks of time

    def _made(self) -> Iterator[_Block]:
        visits = 0
        for begin, end in self._blocks():
            block = self._block(begin, end, visits)
            visits += len(block.rounds)
            yield block

    def _blocks(self) -> Iterator[tuple[int, int]]:
        """(first, end) steps of blocks: long ones where a reader comes by all its ports in a few steps anyway, else a step each."""
        step, ports = self._config.reader.step_s, max(map(len, self._ports), default=0)
        steps = int(np.ceil(self._around.duration / step - 1e-9))
        width = 1
        if ports * self._readers[0].shortest_visit <= 2 * step:
            width = max(1, CELLS // max(1, len(self._antenna_key) * len(self._tags)))
        for first in range(0, steps, width):
            yield first, min(first + width, steps)

    def _block(self, begin: int, end: int, visits: int) -> _Block:
        """Steps begin to end; `visits` were made before."""
        step, number, done = self._config.reader.step_s, visits, []
        antenna, cell, tag = self._hearing(begin, end)
        for ports, reader in zip(self._ports, self._readers, strict=True):
            mine = (antenna >= ports[0]) & (antenna <= ports[-1])
            heard = hearing(len(ports), end - begin, step, antenna[mine] - ports[0], cell[mine] - begin, tag[mine], begin)
            made = reader.run(heard)
            done.append((made, ports, number))
            number += len(made.antenna)
        reads, slots = self._reads(done)
        silenced = np.concatenate([m.silenced + np.array([n, 0]) for m, _, n in done])
        return _Block(reads, slots, self._rounds(done), silenced, np.concatenate([m.collisions for m, _, _ in done]))

    def _hearing(self, begin: int, end: int) -> tuple[Array, Array, Array]:
        """(antenna, step, tag) of who may answer whom in these steps, of the ports that the readers may come by."""
        step = self._config.reader.step_s
        ports = np.concatenate([p[r.ports_before(end * step)] for p, r in zip(self._ports, self._readers, strict=True)])
        cell, antenna = (a.ravel() for a in np.meshgrid(np.arange(begin, end), ports, indexing="ij"))
        place, tag = self._sensor.able(self._around, self._channel, antenna, (cell + 0.5) * step)
        return antenna[place], cell[place], tag

    # ------------------------------------------------------------ what comes of it

    def _reads(self, done: list[tuple[Inventory, Array, int]]) -> tuple[Reads, Slots]:
        """The channel at the times of the answers; those that fail there are no reads. And all their slots."""
        visit = np.concatenate([m.visit + n for m, _, n in done])
        antenna = np.concatenate([p[m.antenna[m.visit]] for m, p, _ in done])
        number = np.concatenate([m.number[m.visit] for m, _, _ in done])
        tag, t = np.concatenate([m.tag for m, _, _ in done]), np.concatenate([m.t for m, _, _ in done])
        carrier = self._sensor.carrier(self._around, antenna, t)
        response = self._channel.respond(antenna, tag, t, carrier)
        received, forward, reverse = self._sensor.margins(response, antenna, tag, self._around.tagged)
        read = (forward >= 0) & (reverse >= 0)
        answers = Answers(
            antenna=antenna, tag=tag, visit=number, count=_repeats(visit, tag), channel=carrier, t=t, received=received,
            phase=phase_of(response.h), doppler=self._doppler(antenna, tag, t, carrier, response.h, read),
        )  # fmt: skip
        return self._artefacts.reported(answers).take(read), Slots(visit=visit, tag=tag, t=t, read=read)

    def _doppler(self, antenna: Array, tag: Array, t: Array, carrier: Array, h: Array, read: Array) -> Array:
        """(N,) Hz: turn of the phase, 2·arg h, over PULSE, divided by 4π, as readers define it; f v / c for the direct path alone."""
        radio, found = self._channel.radio, np.zeros(len(t))
        moves = np.flatnonzero(read & ((radio.near.body[antenna] != WORLD) | (radio.far.body[tag] != WORLD)))
        if len(moves):
            later = self._channel.respond(antenna[moves], tag[moves], t[moves] + PULSE, carrier[moves]).h
            found[moves] = np.angle(later * np.conj(h[moves])) / (2 * np.pi * PULSE)
        return found

    def _rounds(self, done: list[tuple[Inventory, Array, int]]) -> Rounds:
        made = [m for m, _, _ in done]
        begun = np.concatenate([m.rounds for m in made])
        t_end = np.concatenate([m.end for m in made])
        return Rounds(
            round=np.concatenate([np.arange(len(m.antenna)) + n for m, _, n in done]),
            t_start=np.concatenate([m.start for m in made]),
            t_end=t_end,
            t_arrival=t_end + self._config.artefacts.latency_s,
            antenna=np.concatenate([p[m.antenna] for m, p, _ in done]),
            reader=np.concatenate([np.full(len(m.antenna), r) for r, m in enumerate(made)]),
            queries=begun if self._profile.dual_target else np.minimum(begun, 1),  # with one target whoever was read isn't asked again
        )

    def _asked_in(self, rounds: Rounds, silenced: list[Array]) -> tuple[Rounds, Array]:
        """The rounds with whom each asked, and the sets (S, tags) that they name; the first is all whom Select lets through."""
        rows = np.concatenate([s for s in silenced if len(s)] or [np.empty((0, 2), dtype=np.int64)])
        visits, of = np.unique(rows[:, 0], return_inverse=True)
        masks = np.tile(self._asked, (len(visits), 1))
        masks[of.ravel(), rows[:, 1]] = False
        packed, which = np.unique(np.packbits(masks, axis=1), axis=0, return_inverse=True)
        sets = np.unpackbits(packed, axis=1, count=len(self._asked)).astype(bool)
        asked = np.zeros(len(rounds), dtype=np.int64)
        asked[visits] = which.ravel() + 1
        return rounds.with_(asked=asked), np.concatenate([self._asked[None, :], sets.reshape(len(sets), len(self._asked))])


def _repeats(visit: Array, tag: Array) -> Array:
    """(N,) which read of its tag in its visit each one is, for reads in order of time within a visit."""
    order = np.lexsort((tag, visit))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(visit[order]) != 0) | (np.diff(tag[order]) != 0)
    place = np.arange(len(order))
    found = np.empty(len(order), dtype=np.int64)
    found[order] = place - np.maximum.accumulate(np.where(new, place, 0))
    return found


def _counted(rounds: Rounds, reads: Reads, visit: Array) -> Counts:
    if not len(reads):
        return Counts.empty()
    cells, n = np.unique(np.stack([visit, reads.tag], axis=1), axis=0, return_counts=True)
    return Counts(round=rounds.round[cells[:, 0]], antenna=rounds.antenna[cells[:, 0]], tag=cells[:, 1], n=n)
