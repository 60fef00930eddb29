"""A UHF RFID reader with its antennas: reads with RSSI and phase, and the rounds and counts behind them.

Works in two passes over arrays, in chunks of bounded memory. First one margin per (dwell, antenna, tag) in range says which
tags can answer and how the reader's time is shared; then the channel is evaluated at the times of the reads themselves,
where forward and reverse margin decide again. RSSI, phase and margins come from the same complex h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.columns import Array, Table
from testbed.protocols import Sensed, Surroundings
from testbed.radio.channel import Channel, Fixed
from testbed.radio.links import Ends, Links, StaticObstruction
from testbed.radio.propagation import POLARISATION_DB, direct_path, phase_of, power_at_reader, power_at_tag
from testbed.radio.reader import Schedule, expand, schedule, shared_reads
from testbed.radio.regions import REGIONS
from testbed.radio.setting import Radio
from testbed.rng import Counter, keys_of
from testbed.scene import Scene
from testbed.sensors.placement import place_antennas
from testbed.sensors.rfid_section import RfidConfig
from testbed.types import Antennas, Counts, Reads, Rounds
from testbed.units import SPEED_OF_LIGHT

CELLS = 1_000_000  # dwell × tag pairs in one chunk: about 200 MB of temporaries at the most


@dataclass(frozen=True)
class _Channel:
    """h of N links, the obstacles on them, and whether forward and reverse margin both hold."""

    h: Array
    obstacles: Array
    received: Array  # dBm at the reader
    heard: Array  # bool


class Rfid:
    """One reader and its antennas. Left out: sessions and Select, Doppler (NaN).

    Without a `channel` section the wave goes straight through obstacles and fades from dwell to dwell; with one it bends round edges,
    is reflected and has a diffuse part (`testbed.radio.channel`).
    """

    Config: ClassVar[type[RfidConfig]] = RfidConfig
    produces: ClassVar[frozenset[str]] = frozenset({"reads", "rounds", "counts"})

    def __init__(self, config: RfidConfig, id: str, scene: Scene) -> None:
        self._config, self._id, self._region = config, id, REGIONS[config.region]
        self._antennas, self._ends = place_antennas(config, id, scene)
        self._scene = scene
        self._static: StaticObstruction | None = None
        self._fixed: tuple[Radio, Fixed] | None = None

    def antennas(self) -> Antennas:
        """The reader's antennas where the scenario puts them."""
        return self._antennas

    def frequencies(self) -> Array:
        """(C,) Hz: the hop table of its region."""
        return self._region.carriers

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """Reads, rounds and counts of a whole trial."""
        return _Trial(self, around, first_antenna).run()

    def _links(self, around: Surroundings) -> Links:
        if self._static is None:
            self._static = StaticObstruction(len(self._antennas), len(around.tagged.tags))
        far = Ends(around.tagged.body, around.tagged.pose)
        return Links(self._antennas, self._ends, far, around.truth, around.caster, self._static)

    def _channel_of(self, around: Surroundings) -> Channel | None:
        """The full channel in this trial, if the scenario has one. What stands still is found once for all trials."""
        config = self._config.channel
        if config is None:
            return None
        if self._fixed is None:
            tagged = around.tagged
            far = Ends(tagged.body, tagged.pose)
            radio = Radio(config, self._scene, around.caster, self._antennas, self._ends, tagged.tags, far, self.frequencies())
            self._fixed = radio, Fixed(radio)
        return Channel(*self._fixed, around.truth, around.root, around.trial)


class _Trial:
    """One trial of one reader: the keys of its draws, and the two passes."""

    def __init__(self, reader: Rfid, around: Surroundings, first_antenna: int) -> None:
        self._config, self._region, self._around, self._first = reader._config, reader._region, around, first_antenna
        self._antennas, self._links, self._full = reader._antennas, reader._links(around), reader._channel_of(around)
        self._tags = around.tagged.tags
        self._antenna_key, self._tag_key = keys_of(self._antennas.id), keys_of(self._tags.id)
        self._name = f"sensors.{reader._id}"
        self._draws = {
            what: Counter(around.root, around.trial, f"{self._name}.{what}") for what in ("fade", "share", "time", "rssi", "phase")
        }
        # what belongs to the hardware is the same in every trial
        self._hop, self._offset = (Counter(around.root, 0, f"{self._name}.{what}") for what in ("hop", "offset"))
        gain = self._antennas.gain.max(initial=-np.inf) + (self._tags.gain - self._tags.sensitivity).max(initial=-np.inf)
        budget = self._config.power_dbm + gain - POLARISATION_DB + 4 * self._config.fade_db
        wavelength = SPEED_OF_LIGHT / self._region.carriers.min()
        self._reach = wavelength / (4 * np.pi) * 10 ** (budget / 20)  # m: beyond it no tag wakes, fading four sigma up included

    def run(self) -> Sensed:
        config = self._config
        dwells = schedule(len(self._antennas), self._around.duration, config.dwell_s, config.switch_s)
        step = max(1, CELLS // max(1, len(self._tags)))
        parts = [self._chunk(dwells, np.arange(i, min(i + step, len(dwells)))) for i in range(0, len(dwells), step)]
        reads = Reads.concatenate([p[0] for p in parts])
        dwell = np.concatenate([p[1] for p in parts]) if parts else np.empty(0, dtype=np.int64)
        seen, clear = sum(p[2] for p in parts), sum(p[3] for p in parts)
        order = np.argsort(reads.t, kind="stable")
        streams = {"reads": reads.take(order), "rounds": self._rounds(dwells), "counts": self._counts(reads, dwell)}
        wanted = np.isin(reads.tag, self._around.target_tags).sum()
        seconds = max(self._around.duration, 1e-9)
        return Sensed(streams, {"line_of_sight": (clear / seen if seen else np.nan, seen)}, {"target_reads_hz": float(wanted / seconds)})

    def _chunk(self, dwells: Schedule, k: Array) -> tuple[Reads, Array, int, int]:
        """Reads of the dwells k and the dwell of each; how many target links were in reach, and how many of them were clear."""
        middle = (dwells.start[k] + dwells.end[k]) / 2
        everyone = np.arange(len(self._tags))
        place, tag = self._in_reach(dwells.antenna[k], middle)
        channel = self._evaluate(dwells.antenna[k][place], dwells.visit[k][place], tag, middle[place])
        can_answer = np.zeros((len(k), len(everyone)), dtype=bool)
        can_answer[place, tag] = channel.heard
        keys = (self._antenna_key[dwells.antenna[k]][:, None], dwells.visit[k][:, None], self._tag_key[None, :])
        n = shared_reads(can_answer, self._config.read_rate_hz * self._config.dwell_s, self._draws["share"], keys)
        about = np.isin(tag, self._around.target_tags)
        reads, dwell = self._reads(dwells, k, n)
        return reads, dwell, int(about.sum()), int((channel.obstacles[about] == 0).sum())

    def _in_reach(self, antenna: Array, t: Array) -> tuple[Array, Array]:
        """(dwell, tag) of the links of antennas (K,) at times t (K,) that may be heard at all."""
        if self._full is not None:
            return self._full.candidates(antenna, t)
        place, tag = (a.ravel() for a in np.meshgrid(np.arange(len(antenna)), np.arange(len(self._tags)), indexing="ij"))
        near = self._links.geometry(antenna[place], tag, t[place]).distance <= self._reach
        return place[near], tag[near]

    def _reads(self, dwells: Schedule, k: Array, n: Array) -> tuple[Reads, Array]:
        """The second pass: the channel at the times of n (dwells, tags) reads; those that fail there are no reads."""
        cell, number = expand(n)
        dwell, tag = k[cell // n.shape[1]], cell % n.shape[1]
        antenna, visit = dwells.antenna[dwell], dwells.visit[dwell]
        keys = (self._antenna_key[antenna], visit, self._tag_key[tag], number)
        t = dwells.start[dwell] + (dwells.end[dwell] - dwells.start[dwell]) * self._draws["time"].uniform(*keys)
        channel = self._evaluate(antenna, visit, tag, t)
        config, hop = self._config, self._channel_index(t)
        rssi = channel.received + config.rssi_noise_db * self._draws["rssi"].normal(*keys)
        if config.rssi_step_db > 0:
            rssi = np.round(rssi / config.rssi_step_db) * config.rssi_step_db
        offset = 2 * np.pi * self._offset.uniform(self._antenna_key[antenna], self._tag_key[tag], hop) if config.phase_offsets else 0.0
        phase = phase_of(channel.h, offset + config.phase_noise_rad * self._draws["phase"].normal(*keys))
        reads = Reads(t=t, t_arrival=t + config.latency_s, antenna=antenna + self._first, tag=tag, channel=hop, rssi=rssi, phase=phase)
        return reads.take(channel.heard), dwell[channel.heard]

    def _evaluate(self, antenna: Array, visit: Array, tag: Array, t: Array) -> _Channel:
        """The complex channel of links at their instants, and whether a read would succeed."""
        fade = self._config.fade_db * self._draws["fade"].normal(self._antenna_key[antenna], visit, self._tag_key[tag])
        carrier = self._channel_index(t)
        if self._full is not None:
            response = self._full.respond(antenna, tag, t, carrier)
            h, obstacles = response.h * 10 ** (fade / 20), response.count
        else:
            geometry = self._links.geometry(antenna, tag, t)
            obstruction = self._links.obstruction(antenna, tag, t, geometry)
            gain = geometry.gain + self._tags.gain[tag] - POLARISATION_DB
            h = direct_path(geometry.distance, self._region.carriers[carrier], gain + fade, obstruction.loss)
            obstacles = obstruction.count
        received = power_at_reader(h, self._antennas.power[antenna], self._config.modulation_loss_db)
        wakes = power_at_tag(h, self._antennas.power[antenna]) >= self._tags.sensitivity[tag]
        return _Channel(h, obstacles, received, wakes & (received >= self._config.sensitivity_dbm))

    def _channel_index(self, t: Array) -> Array:
        """(N,) places in the hop table: a fresh draw each `dwell_s` of the region."""
        number = np.floor(t / self._region.dwell_s).astype(np.int64)
        return (self._hop.bits(number) % np.uint64(len(self._region.carriers))).astype(np.int64)

    def _rounds(self, dwells: Schedule) -> Table:
        queries = int(np.ceil(self._config.read_rate_hz * self._config.dwell_s))
        n = len(dwells)
        return Rounds(
            round=np.arange(n),
            t_start=dwells.start,
            t_end=dwells.end,
            t_arrival=dwells.end + self._config.latency_s,
            antenna=dwells.antenna + self._first,
            reader=np.zeros(n),
            queries=np.full(n, queries),
        )

    def _counts(self, reads: Reads, dwell: Array) -> Table:
        if not len(reads):
            return Counts.empty()
        cells, n = np.unique(np.stack([dwell, reads.antenna, reads.tag], axis=1), axis=0, return_counts=True)
        return Counts(round=cells[:, 0], antenna=cells[:, 1], tag=cells[:, 2], n=n)
