"""Rounds and counts of readers whose detections follow the published logistic-beta model (`testbed.radio.logistic_beta`).

Every reader asks each tag `queries` times a slot of `period_s`; its block of slot k ends at (k + τ) period, τ drawn for each slot and
reader, and the tag is where it is at that moment. All antennas of a body are one reader and share τ; antennas that stand by themselves are
one reader together. Nothing of the link budget enters, and what stands in the way sets the dead zone alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed.columns import Array
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Config, Seconds
from testbed.radio import logistic_beta
from testbed.radio.antenna import off_boresight
from testbed.radio.diffraction import CLEAR_OF_ZONE, clearance
from testbed.radio.links import Ends
from testbed.radio.logistic_beta import DeadZoneConfig
from testbed.radio.setting import ChannelConfig, Radio
from testbed.radio.sight import BULGE, CHUNK, Bundle, Obstacles
from testbed.rng import Counter, keys_of
from testbed.scene import WORLD, Scene
from testbed.types import Antennas, Counts, Rounds

CELLS = 1_000_000  # antenna × slot × tag in one chunk: about 200 MB of temporaries at the most

Share = Annotated[float, Field(ge=0, le=1)]


class CountingConfig(Config):
    """`detection: {kind: logistic_beta}`. The defaults are the paper's where it says them, and those of its study where it does not.

    offset_s: the ends of blocks within their slot are drawn from this window. geometry: whether what stands in the way makes dead
    zones (`g`); without, only the residual one is left; averaged: every count has the mean g of its trial, so that as many die, but
    anywhere. late_share: of the blocks of a reader so many are reported `late_periods` (a whole number between the two) slots after
    their end; stamped: the time that a report bears, that of its end or of its arrival.
    """

    kind: Literal["logistic_beta"] = "logistic_beta"
    queries: Annotated[int, Field(ge=1, le=1000)] = 10
    period_s: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0
    offset_s: tuple[Annotated[Seconds, Field(ge=0)], Annotated[Seconds, Field(ge=0)]] = (0.2, 0.8)
    dead_zone: DeadZoneConfig = DeadZoneConfig()
    geometry: bool | Literal["averaged"] = True
    late_share: Share = 0.0
    late_periods: tuple[Annotated[int, Field(ge=0, le=100)], Annotated[int, Field(ge=0, le=100)]] = (1, 2)
    stamped: Literal["end", "arrival"] = "end"

    @model_validator(mode="after")
    def _in_order(self) -> CountingConfig:
        if not self.offset_s[0] <= self.offset_s[1] <= self.period_s:
            raise ValueError(f"offset_s {list(self.offset_s)} must ascend and end within period_s, {self.period_s:g} s")
        if self.late_periods[0] > self.late_periods[1]:
            raise ValueError(f"late_periods {list(self.late_periods)} must ascend")
        return self


def reader_names(scene: Scene, antennas: Antennas, sensor: str) -> Array:
    """(N,) the reader of each antenna: the body that it is mounted on or carried by, `sensor` for those that stand by themselves."""
    owner = {str(name): scene.bodies[body].name for name, body in zip(scene.mounts.name, scene.mounts.body, strict=True) if body != WORLD}
    names = [owner.get(str(id), str(carrier)) or sensor for id, carrier in zip(antennas.id, antennas.carrier, strict=True)]
    return np.array(names, dtype=np.str_)


class Shade:
    """g of links: the share of their Fresnel zone that geometry closes. What stands still between two that do is found once."""

    def __init__(self, around: Surroundings, antennas: Antennas, ends: Ends, frequencies: Array) -> None:
        far = Ends(around.tagged.body, around.tagged.pose)
        direct = ChannelConfig(orders=0, diffuse=False)
        self._radio = Radio(direct, around.scene, around.caster, antennas, ends, around.tagged.tags, far, frequencies, limit=False)
        self._known = np.full((len(antennas), len(far.body)), np.nan)
        self._still = (ends.body == WORLD)[:, None] & (far.body == WORLD)

    def of(self, around: Surroundings, antenna: Array, tag: Array, t: Array) -> Array:
        """(N,) g in [0, 1] between antennas (N,) and tags (N,) at times t (N,)."""
        parts = [self._chunk(around, antenna[i : i + CHUNK], tag[i : i + CHUNK], t[i : i + CHUNK]) for i in range(0, len(t), CHUNK)]
        return np.concatenate([np.empty(0), *parts])

    def _chunk(self, around: Surroundings, antenna: Array, tag: Array, t: Array) -> Array:
        radio = self._radio
        posed = radio.movers.at(around.truth, t)
        lines = radio.lines(antenna, tag, posed, np.arange(len(t)))
        margin = BULGE * clearance(CLEAR_OF_ZONE, lines.distance / 2, lines.distance, radio.wavelength)
        near = posed.near(np.arange(len(t)), lines.start, lines.end, margin)
        lasting = self._still[antenna, tag] & ~near
        clear = np.where(lasting, self._known[antenna, tag], np.nan)
        rows = np.flatnonzero(np.isnan(clear))
        if len(rows):
            obstacles = Obstacles(radio.caster, posed.poses, posed.instant, near)
            loss = obstacles.on(rows, lines.start[rows], lines.end[rows]).loss
            bundle = Bundle(rows, lines.start[rows], lines.end[rows], radio.wavelength, obstacles, loss)
            clear[rows] = bundle.zone(np.arange(len(rows)))[0]
            kept = rows[lasting[rows]]
            self._known[antenna[kept], tag[kept]] = clear[kept]
        return np.clip(1 - clear, 0.0, 1.0)


@dataclass(frozen=True)
class Blocks:
    """B blocks of one antenna each: slot, antenna and when they end, s."""

    slot: Array
    antenna: Array
    end: Array


def blocks_of(config: CountingConfig, sensor: str, antennas: Antennas, around: Surroundings) -> Blocks:
    """All blocks of a trial, slot by slot."""
    names, reader = np.unique(reader_names(around.scene, antennas, sensor), return_inverse=True)
    slots = int(np.floor(around.duration / config.period_s + 1e-9))
    offset = _draws(around, sensor, "offset").uniform(keys_of(names)[:, None], np.arange(slots))
    low, high = config.offset_s
    end = np.arange(slots) * config.period_s + low + (high - low) * offset
    slot, antenna = (a.ravel() for a in np.meshgrid(np.arange(slots), np.arange(len(antennas)), indexing="ij"))
    return Blocks(slot, antenna, end[reader[antenna], slot])


def counted(
    config: CountingConfig,
    sensor: str,
    antennas: Antennas,
    ends: Ends,
    around: Surroundings,
    first_antenna: int,
    shade: Shade | None = None,
) -> Sensed:
    """Rounds and counts of a whole trial. `shade` says what geometry closes; left out (or `geometry: false`) it closes nothing.

    Draws are keyed by the ids of sensor, reader, antenna and tag and by the slot, so another antenna or tag moves no other count.
    Shares: "blocked", mean g over the counts of target tags that are not 0 but for dead zones, and "line_of_sight", what is left.
    """
    names, reader = np.unique(reader_names(around.scene, antennas, sensor), return_inverse=True)
    blocks = blocks_of(config, sensor, antennas, around)
    block, tag, n, shut = but_for_dead_zones(config, sensor, antennas, ends, around, shade, blocks)
    n = np.where(Model(config, sensor, antennas, ends, around).dead(blocks, block, tag, shut)[0], 0, n)
    rounds = _rounds(config, _draws(around, sensor, "late"), keys_of(names), blocks, reader, len(names), first_antenna)
    alive = n > 0
    counts = Counts(
        round=rounds.round[block[alive]],
        antenna=blocks.antenna[block[alive]] + first_antenna,
        tag=tag[alive],
        n=n[alive],
    )
    about = np.isin(tag, around.target_tags)
    blocked = float(shut[about].mean()) if about.any() else np.nan
    shares = {"blocked": (blocked, int(about.sum())), "line_of_sight": (1 - blocked, int(about.sum()))}
    rates = {"target_reads_hz": float(n[about].sum() / max(around.duration, 1e-9))}
    return Sensed({"rounds": rounds, "counts": counts}, shares, rates)


def _draws(around: Surroundings, sensor: str, what: str) -> Counter:
    return Counter(around.root, around.trial, f"sensors.{sensor}.{what}")


def but_for_dead_zones(
    config: CountingConfig, sensor: str, antennas: Antennas, ends: Ends, around: Surroundings, shade: Shade | None, blocks: Blocks
) -> tuple[Array, Array, Array, Array]:
    """(block, tag, n, g) of all counts of a trial that are not 0 but for dead zones, and how far geometry closes their ways."""
    step = max(1, CELLS // max(1, len(around.tagged.tags)))
    shade = shade if config.geometry else None
    parts = [_counts(config, sensor, antennas, ends, around, shade, blocks, np.arange(i, min(i + step, len(blocks.slot))))
             for i in range(0, len(blocks.slot), step)]  # fmt: skip
    block, tag, n = (np.concatenate([np.empty(0, dtype=np.int64), *(p[i] for p in parts)]) for i in range(3))
    g = np.concatenate([np.empty(0), *(p[3] for p in parts)])
    return block, tag, n, np.full(len(g), g.mean()) if config.geometry == "averaged" and len(g) else g


def _counts(
    config: CountingConfig,
    sensor: str,
    antennas: Antennas,
    ends: Ends,
    around: Surroundings,
    shade: Shade | None,
    blocks: Blocks,
    which: Array,
) -> tuple[Array, Array, Array, Array]:
    """(block, tag, n, g) of those of the blocks `which` that are not 0 but for dead zones."""
    everyone = np.arange(len(around.tagged.tags))
    block, tag = np.repeat(which, len(everyone)), np.tile(everyone, len(which))
    n = Model(config, sensor, antennas, ends, around).alive(blocks, block, tag)[0]
    found = np.flatnonzero(n)
    block, tag, n = block[found], tag[found], n[found]
    g = np.zeros(len(found)) if shade is None else shade.of(around, blocks.antenna[block], tag, blocks.end[block])
    return block, tag, n, g


class Model:
    """The published model in a trial; `block` (N,) and `tag` (N,) are places in `blocks` and among the trial's tags."""

    def __init__(self, config: CountingConfig, sensor: str, antennas: Antennas, ends: Ends, around: Surroundings) -> None:
        self._config, self._ends, self._around = config, ends, around
        self._draws = _draws(around, sensor, "counts")
        self._antenna_key, self._tag_key = keys_of(antennas.id), keys_of(around.tagged.tags.id)

    def alive(self, blocks: Blocks, block: Array, tag: Array) -> tuple[Array, Array, Array]:
        """Counts (N,) dead zones aside, over which distance (N,) m and at which angle (N,) rad off boresight."""
        around, t = self._around, blocks.end[block]
        looking = self._ends.at(around.truth, blocks.antenna[block], t)
        place = Ends(around.tagged.body, around.tagged.pose).at(around.truth, tag, t)
        cosine, distance = off_boresight(looking[:, 3:], place[:, :3] - looking[:, :3])
        angle = np.arccos(cosine)
        return logistic_beta.alive(distance, angle, self._config.queries, self._draws, self._keys(blocks, block, tag)), distance, angle

    def dead(self, blocks: Blocks, block: Array, tag: Array, g: Array) -> tuple[Array, Array]:
        """Whether a dead zone holds (N,), for the shares g (N,) that geometry closes; and the residual ones r (N,)."""
        keys = self._keys(blocks, block, tag)
        residual = logistic_beta.residual(self._config.dead_zone, self._draws, *keys)
        return logistic_beta.dead(g, residual, self._draws, keys), residual

    def _keys(self, blocks: Blocks, block: Array, tag: Array) -> tuple[Array, Array, Array]:
        return self._antenna_key[blocks.antenna[block]], blocks.slot[block], self._tag_key[tag]


def _rounds(
    config: CountingConfig, draws: Counter, reader_keys: Array, blocks: Blocks, reader: Array, readers: int, first_antenna: int
) -> Rounds:
    of = reader[blocks.antenna]
    key = reader_keys[of]
    least, most = config.late_periods
    slots_late = least + np.floor((most - least + 1) * draws.uniform(key, blocks.slot, np.int64(1)))
    late = np.where(draws.uniform(key, blocks.slot, np.int64(0)) < config.late_share, slots_late * config.period_s, 0.0)
    arrival = blocks.end + late
    return Rounds(
        round=blocks.slot * readers + of,
        t_start=blocks.slot * config.period_s,
        t_end=arrival if config.stamped == "arrival" else blocks.end,
        t_arrival=arrival,
        antenna=blocks.antenna + first_antenna,
        reader=of,
        queries=np.full(len(of), config.queries),
    )
