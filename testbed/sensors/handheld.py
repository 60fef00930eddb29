"""A handheld reader on an open floor that asks for one tag: phases at Poisson times, wrapped, noisy, some wrong, some lost."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Config, Degrees, Metres, Seconds
from testbed.radio.regions import REGIONS
from testbed.recording import mounted
from testbed.rng import key_of, mix, stream, uniform_of
from testbed.scene import WORLD, Scene
from testbed.types import Antennas, Reads
from testbed.units import SPEED_OF_LIGHT


class HandheldConfig(Config):
    """A reader that is carried, and how well it hears one tag. There are no obstacles and no path loss: the tag answers within the beam.

    on           : the actor that carries it
    beam_deg     : the full angle within which the tag answers; None: all round
    reports      : "changes", the published shortcut of one change of phase a step with N(0, phase_std_deg), or "reads" one by one
    wrong_steps  : with this probability a change of phase is anything that a step could make ("changes" only)
    reflection   : amplitude of a wall's reflection; the wall stands wall_m behind the tag as seen from the start, turned by up to 60°
                   in each trial
    wraps_at ... : of "reads": period and sign of the phase, noise, share of wrong and of lost reads, dwell on a carrier (0: no hops)
    """

    on: str
    beam_deg: Annotated[Degrees, Field(gt=0, le=360)] | None = 180.0
    frequency_mhz: Annotated[float, Field(ge=100, le=6000)] = 865.7
    reports: Literal["changes", "reads"] = "changes"
    phase_std_deg: Annotated[Degrees, Field(ge=0, le=180)] = 5.5
    wrong_steps: Annotated[float, Field(ge=0, le=1)] = 0.0
    reflection: Annotated[float, Field(ge=0, lt=1)] = 0.0
    wall_m: Annotated[Metres, Field(gt=0, le=100)] = 1.0
    rate_hz: Annotated[float, Field(gt=0, le=10_000)] = 300.0
    wraps_at: Literal["pi", "2pi"] = "2pi"
    sign: Literal[1, -1] = 1
    wrong_reads: Annotated[float, Field(ge=0, le=1)] = 0.0
    lost: Annotated[float, Field(ge=0, le=1)] = 0.0
    hop_s: Annotated[Seconds, Field(ge=0, le=100)] = 0.0

    def carriers(self) -> Array:
        """(C,) Hz: one carrier, or the hop table of the region (ETSI) where it hops."""
        return REGIONS["etsi"].carriers if self.hop_s > 0 else np.array([self.frequency_mhz * 1e6])


class Handheld:
    """A carried reader that Select narrows down to one tag, on an open floor.

    Left out: path loss, obstacles, the body, inventory rounds; for those take an rfid sensor with its antenna in the person's hand. The
    antenna is where the person is, and looks where they look.
    """

    Config: ClassVar[type[HandheldConfig]] = HandheldConfig
    produces: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: HandheldConfig, id: str, scene: Scene) -> None:
        if config.on not in scene.moving_names:
            raise ValueError(f"on: no moving actor is called {config.on!r}; there are {', '.join(scene.moving_names) or 'none'}")
        self.config, self.id = config, id

    def antennas(self) -> Antennas:
        """One antenna in the hand."""
        c = self.config
        beam = min(np.deg2rad(c.beam_deg or 360.0), np.deg2rad(178.0))
        return Antennas(
            id=np.array([f"{c.on}.{self.id}"]), position=np.zeros((1, 3)), quaternion=frames.IDENTITY[None, 3:], gain=np.array([6.0]),
            beamwidth=np.array([beam]), front_to_back=np.array([60.0]), power=np.array([29.0]), carrier=np.array([c.on]),
        )  # fmt: skip

    def frequencies(self) -> Array:
        """(C,) Hz."""
        return self.config.carriers()

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """Reads of the targets' tags over a whole trial, each at `rate_hz` while it is within the beam."""
        parts = [self._of(around, int(tag)) for tag in around.target_tags]
        reads = Reads.concatenate(parts)
        reads = reads.with_(antenna=np.full(len(reads), first_antenna)).take(np.argsort(reads.t, kind="stable"))
        seconds = max(around.duration, 1e-9)
        return Sensed({"reads": reads}, rates={"target_reads_hz": len(reads) / seconds, "reads_hz": len(reads) / seconds})

    def _of(self, around: Surroundings, tag: int) -> Reads:
        c, truth, tagged = self.config, around.truth, around.tagged
        random = stream(around.root, around.trial, f"sensors.{self.id}.{tagged.tags.id[tag]}")
        t = np.sort(random.uniform(0.0, around.duration, random.poisson(c.rate_hz * around.duration)))
        t = t[random.uniform(size=len(t)) >= c.lost]
        pose = truth.pose(truth.index(c.on), t)
        body = int(tagged.body[tag])
        place = np.tile(tagged.pose[tag, :3], (len(t), 1)) if body == WORLD else mounted(truth, body, tagged.pose[tag], t)[:, :3]
        x, y = (place - pose[:, :3])[:, :2].T
        off = np.angle(np.exp(1j * (np.arctan2(y, x) - frames.yaw_of(pose[:, 3:]))))
        seen = np.abs(off) < np.deg2rad(c.beam_deg or 361.0) / 2
        channel = hops(c, t[seen])
        k = 2 * np.pi * c.carriers()[channel] / SPEED_OF_LIGHT
        phase = direct_phase(pose[seen, :2], place[seen, :2], k)
        return reported(c, random, t[seen], phase, channel).with_(tag=np.full(int(seen.sum()), tag))


def hops(config: HandheldConfig, t: Array) -> Array:
    """(N,) places in the hop table at times t (N,) s."""
    if config.hop_s == 0:
        return np.zeros(len(t), dtype=np.int64)
    dwell = np.floor(np.asarray(t) / config.hop_s).astype(np.int64)
    return (mix(np.uint64(key_of("handheld.hops")), dwell) % np.uint64(len(config.carriers()))).astype(np.int64)


def direct_phase(place: Array, tag: Array, k: Array | float) -> Array:
    """(...,) rad: -2kd, unwrapped, of a reader at `place` (..., 2) and a tag (..., 2), by the one-way wave number k."""
    return -2 * np.asarray(k) * np.hypot(*np.moveaxis(place - tag, -1, 0))


def mirrored_phase(place: Array, tag: Array, k: Array | float, amplitude: float, behind: float, facing: Array | float) -> Array:
    """(...,) rad, modulo 2π: the phase of direct and reflected wave together, both ways.

    The wall stands `behind` m from the tag in the direction `facing` (rad) and has a reflection of `amplitude`; who is behind it gets none.
    """
    towards = np.stack([np.cos(facing), np.sin(facing)], axis=-1)
    d = np.maximum(np.hypot(*np.moveaxis(place - tag, -1, 0)), 1e-3)
    image = np.hypot(*np.moveaxis(place - (tag + 2 * behind * towards), -1, 0))
    before = ((place - tag) * towards).sum(axis=-1) < behind
    h = np.exp(-1j * k * d) / d - np.where(before, amplitude / image, 0.0) * np.exp(-1j * k * image)
    return 2 * np.angle(h)


def reported(config: HandheldConfig, random: np.random.Generator, t: Array, phase: Array, channel: Array) -> Reads:
    """Reads as the reader gives them: noise, offsets of the carriers, wrong ones, sign and wrap. Antenna and tag are 0."""
    offset = 2 * np.pi * uniform_of(mix(np.uint64(key_of("handheld.offsets")), channel))
    noisy = config.sign * (phase + offset) + np.deg2rad(config.phase_std_deg) * random.normal(size=len(t))
    wrong = random.uniform(size=len(t)) < config.wrong_reads
    period = np.pi if config.wraps_at == "pi" else 2 * np.pi
    wrapped = np.mod(np.where(wrong, 2 * np.pi * random.uniform(size=len(t)), noisy), period)
    wrapped = np.where(wrapped >= period, 0.0, wrapped)
    zero = np.zeros(len(t), dtype=np.int32)
    return Reads(t=t, t_arrival=t, antenna=zero, tag=zero, channel=channel, phase=wrapped)
