"""What a reader makes of a wave: noise, offsets, flips, coarse numbers, late rows. Each can be switched off; all off is the truth.

| effect | model |
|---|---|
| phase noise | normal, wrapped; σ = `phase_noise_rad` · 10^((-55 - rssi)/40): 0.02 rad at -55 dBm, 0.07 at -76, 0.1 at -84 |
| phase offset | uniform, constant for each port and carrier, and for each tag; the sum of both |
| π flips | `flip_probability` a read; by default 0 on one strong port, 0.02 more near the floor, 0.07 more on four ports |
| wrap | the phase is reported modulo 2π, or modulo π, with the reader's sign |
| RSSI | `rssi_noise_db` from read to read, and a constant of each port and carrier of spread `rssi_channel_db` |
| Doppler | normal noise, `doppler_noise_hz` when strong, 2.5 times that at the floor |
| steps | phase, RSSI, Doppler and time in the reader's own |
| rows | `latency_s` late, and a share `late_probability` of them later by up to `late_s`, so that they arrive out of order |

Figures: the specification's, from public logs of an R420 and an FX7500 (static tags: circular standard deviation of the phase
0.005-0.1 rad; RSSI spread 0.2-0.5 dB within a carrier, 0.4-1.9 dB between carriers, the channel's own part included; Doppler 7-18 Hz).

Left out: offsets that drift with temperature or change when the reader restarts, saturation near by, errors that depend on the
tag's own modulation, correlation of noise from read to read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.quantity import Config, Decibels, Hertz, Seconds
from testbed.radio.profiles import Profile
from testbed.rng import Counter
from testbed.types import Reads

# engineering values, so that the figures above come out over the range of levels that logs have, -45 to -80 dBm
STRONG = -55.0  # dBm at which the configured noise holds
NOISE_SLOPE = 40.0  # dB for a factor of ten: the root of what thermal noise alone would have, for part of it is the oscillator's
LEAST_NOISE = 0.25  # of the configured noise, however strong the signal
WEAK = 12.0  # dB above the reader's sensitivity: below, phases flip more often
FLIPS_PER_PORT, FLIPS_WEAK = 0.07 / 3, 0.02
DOPPLER_AT_FLOOR = 2.5


class ArtefactsConfig(Config):
    """The `artefacts` of a reader. A step of None is the profile's own; 0 switches an effect off."""

    phase_noise_rad: Annotated[float, Field(ge=0, le=4)] = 0.02
    phase_offsets: bool = True
    flip_probability: Annotated[float, Field(ge=0, le=1)] | None = None
    phase_wrapped: bool = True  # as the reader reports it; off: modulo 2π, positive sign
    phase_steps: Annotated[int, Field(ge=0, le=1 << 20)] | None = None
    rssi_noise_db: Annotated[Decibels, Field(ge=0, le=20)] = 0.3
    rssi_channel_db: Annotated[Decibels, Field(ge=0, le=20)] = 0.5
    rssi_step_db: Annotated[Decibels, Field(ge=0, le=10)] | None = None
    doppler_noise_hz: Annotated[Hertz, Field(ge=0, le=1000)] = 7.0
    doppler_step_hz: Annotated[Hertz, Field(ge=0, le=100)] | None = None
    time_step_s: Annotated[Seconds, Field(ge=0, le=1)] | None = None
    latency_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.0
    late_probability: Annotated[float, Field(ge=0, le=1)] = 0.02
    late_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.2


OFF = ArtefactsConfig(
    phase_noise_rad=0.0,
    phase_offsets=False,
    flip_probability=0.0,
    phase_wrapped=False,
    phase_steps=0,
    rssi_noise_db=0.0,
    rssi_channel_db=0.0,
    rssi_step_db=0.0,
    doppler_noise_hz=0.0,
    doppler_step_hz=0.0,
    time_step_s=0.0,
    late_probability=0.0,
)


@dataclass(frozen=True)
class Answers:
    """N reads as they truly are. antenna, tag (N,): indices; visit, count (N,): which of the antenna's visits, and which read of that
    tag in it; channel (N,): place in the hop table; t s; received dBm; phase rad; doppler Hz.
    """

    antenna: Array
    tag: Array
    visit: Array
    count: Array
    channel: Array
    t: Array
    received: Array
    phase: Array
    doppler: Array


class Artefacts:
    """One reader's way of reporting, in one trial. What belongs to the hardware is the same in every trial.

    antenna_key (A,), tag_key (T,) : uint64; name keys the draws; ports : how many antennas one reader serves, A where left out
    """

    def __init__(
        self,
        config: ArtefactsConfig,
        profile: Profile,
        root: int,
        trial: int,
        name: str,
        antenna_key: Array,
        tag_key: Array,
        ports: int | None = None,
    ) -> None:
        self._config, self._profile, self._antenna_key, self._tag_key = config, profile, antenna_key, tag_key
        self._ports = min(ports or len(antenna_key), len(antenna_key))
        self._draws = {w: Counter(root, trial, f"{name}.{w}") for w in ("phase", "flip", "rssi", "doppler", "late", "later")}
        self._hardware = {w: Counter(root, 0, f"{name}.{w}") for w in ("port_phase", "tag_phase", "channel_rssi")}

    def reported(self, a: Answers) -> Reads:
        """What the reader says of them: N rows in the order given, times of arrival included."""
        config, profile = self._config, self._profile
        keys = self._antenna_key[a.antenna], a.visit, self._tag_key[a.tag], a.count
        rssi = a.received + config.rssi_channel_db * self._hardware["channel_rssi"].normal(keys[0], a.channel)
        rssi = rssi + config.rssi_noise_db * self._draws["rssi"].normal(*keys)
        weak = np.clip((STRONG - a.received) / (STRONG - profile.sensitivity_dbm), 0.0, 1.0)
        doppler = a.doppler + config.doppler_noise_hz * DOPPLER_AT_FLOOR**weak * self._draws["doppler"].normal(*keys)
        t = _stepped(a.t, _or(config.time_step_s, profile.time_step))
        late = self._draws["late"].uniform(*keys) < config.late_probability
        return Reads(
            t=t,
            t_arrival=t + config.latency_s + np.where(late, config.late_s * self._draws["later"].uniform(*keys), 0.0),
            antenna=a.antenna,
            tag=a.tag,
            channel=a.channel,
            rssi=_stepped(rssi, _or(config.rssi_step_db, profile.rssi_step_db)),
            phase=self._phase(a, keys),
            doppler=_stepped(doppler, _or(config.doppler_step_hz, profile.doppler_step_hz)),
        )

    def _phase(self, a: Answers, keys: tuple[Array, ...]) -> Array:
        config, profile = self._config, self._profile
        phase = a.phase + phase_noise(config.phase_noise_rad, a.received) * self._draws["phase"].normal(*keys)
        if config.phase_offsets:
            port, tag = self._hardware["port_phase"].uniform(keys[0], a.channel), self._hardware["tag_phase"].uniform(keys[2])
            phase = phase + 2 * np.pi * (port + tag)
        phase = phase + np.pi * (self._draws["flip"].uniform(*keys) < self._flips(a.received))
        turns, sign = (profile.phase_turns, profile.phase_sign) if config.phase_wrapped else (1.0, 1)
        steps = _or(config.phase_steps, profile.phase_steps)
        modulus = 2 * np.pi * turns
        if not steps:
            wrapped = np.mod(sign * phase, modulus)
            return np.where(wrapped >= modulus, 0.0, wrapped)  # mod of a tiny negative number rounds up to the modulus
        step = 2 * np.pi / steps
        return np.mod(np.round(sign * phase / step), round(steps * turns)) * step

    def _flips(self, received: Array) -> Array:
        """(N,) probability that a read's phase is off by π."""
        if self._config.flip_probability is not None:
            return np.full(len(received), self._config.flip_probability)
        return FLIPS_PER_PORT * (min(self._ports, 4) - 1) + FLIPS_WEAK * (received < self._profile.sensitivity_dbm + WEAK)


def phase_noise(strong: float, received: Array) -> Array:
    """σ, rad, of reads at `received` dBm, for `strong` rad at -55 dBm."""
    return strong * np.maximum(10 ** ((STRONG - received) / NOISE_SLOPE), LEAST_NOISE)


def _or(given: float | None, otherwise: float) -> float:
    return otherwise if given is None else given


def _stepped(value: Array, step: float) -> Array:
    return np.round(value / step) * step if step > 0 else value
