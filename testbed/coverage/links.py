"""How well each antenna of a sensor hears a tag at each of many places: probabilities in closed form, no fade is drawn.

With `detection: link` a tag is read while both margins hold, that is while |h|² is above what the more demanding one wants:

    least = max( S_tag - P,  (S_reader - P + L_mod) / 2 )          dB of |h|²

h is Rician about a mean that the channel knows (`testbed.radio.channel.mean_and_spread`, `testbed.radio.rice`). Probability and level are
averaged over the carriers of the hop table. With `detection: logistic_beta` it is the probability that a slot's count is not 0,

    (1 - g) (1 - E[r]) (1 - E[(1 - λ)^N]),      E[(1 - λ)^N] = B(α, β + N) / B(α, β)

and there is no level. Left out: the time that tags and antennas take from each other, sessions and Select, measurement noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import betaln

from testbed.columns import Array, Table, column
from testbed.protocols import Surroundings
from testbed.radio import logistic_beta
from testbed.radio.antenna import off_boresight
from testbed.radio.channel import look, mean_and_spread
from testbed.radio.links import Ends
from testbed.radio.rice import exceeding, mean_db
from testbed.radio.setting import Radio
from testbed.sensors.counting import CountingConfig, Shade
from testbed.sensors.rfid import Rfid

CHUNK = 8192  # links at a time: with their reflections some 60 MB of temporaries

Told = Callable[[int], None]  # that so many more links are done


@dataclass(frozen=True, eq=False)
class Heard(Table):
    """Links between antennas and places that are within reach of each other; the others are never heard."""

    antenna: Array = column("int64")
    place: Array = column("int64")
    probability: Array = column("float64", unit="of a read in one visit of the antenna")
    rssi: Array = column("float64", unit="dBm, mean over fades and carriers; NaN where no fade lets it be heard")
    distance: Array = column("float64", unit="m")
    loss: Array = column("float64", unit="dB on the direct path; NaN where a published model tells the counts")
    clear: Array = column("float64", unit="share of the Fresnel zone, 0 to 1")


def heard(sensor: Rfid, around: Surroundings, told: Told = lambda _: None) -> Heard:
    """All links of a sensor with the tags of `around`, at time 0. `told` gets the number of links done, those out of reach included."""
    detection = sensor.config.detection
    parts = _by_link(sensor, around) if detection == "link" else _by_count(sensor, around, detection)
    everything, done, found = len(sensor.antennas()) * len(around.tagged.tags), 0, []
    for part, seen in parts:
        found.append(part)
        told(seen)
        done += seen
    told(everything - done)
    return Heard.concatenate(found)


def least_gain(sensor: Rfid, antenna: Array, sensitivity: Array) -> Array:
    """(N,) the |h|², linear, that antennas (N,) need to read tags that wake at `sensitivity` (N,) dBm."""
    power, profile = sensor.antennas().power[antenna], sensor.config.reader.resolved()
    forward, reverse = sensitivity - power, (profile.sensitivity_dbm - power + sensor.config.modulation_loss_db) / 2
    return 10 ** (np.maximum(forward, reverse) / 10)


def _by_link(sensor: Rfid, around: Surroundings) -> Iterator[tuple[Heard, int]]:
    radio = sensor.radio(around.caster, around.tagged)
    for antenna, place in _within(radio.near, radio.far, around, radio.reach):
        yield _link(sensor, radio, around, antenna, place), len(antenna)


def _link(sensor: Rfid, radio: Radio, around: Surroundings, antenna: Array, place: Array) -> Heard:
    posed = radio.movers.at(around.truth, np.zeros(len(antenna)))
    lines, seen, paths, mirrored = look(radio, posed, np.arange(len(antenna)), antenna, place)
    least = least_gain(sensor, antenna, radio.tags.sensitivity[place])
    probability, level = np.zeros(len(antenna)), np.zeros(len(antenna))
    for frequency in radio.frequencies:
        mean, spread = mean_and_spread(radio, lines, seen, paths, mirrored, np.full(len(antenna), frequency))
        probability += exceeding(mean, spread, least) / len(radio.frequencies)
        level += mean_db(mean, spread) / len(radio.frequencies)
    audible = radio.audible(lines, seen.loss, seen.clear, paths, mirrored.loss)
    rssi = radio.antennas.power[antenna] + 2 * level - sensor.config.modulation_loss_db
    return Heard(
        antenna=antenna, place=place, probability=np.where(audible, probability, 0.0), rssi=np.where(audible, rssi, np.nan),
        distance=lines.distance, loss=seen.loss, clear=seen.clear,
    )  # fmt: skip


def _by_count(sensor: Rfid, around: Surroundings, config: CountingConfig) -> Iterator[tuple[Heard, int]]:
    antennas, near, far = sensor.antennas(), sensor.ends, Ends(around.tagged.body, around.tagged.pose)
    shade = Shade(around, antennas, near, sensor.frequencies()) if config.geometry else None
    reach = np.full(len(antennas), logistic_beta.NEVER)
    for antenna, place in _within(near, far, around, reach):
        looking = near.at(around.truth, antenna, np.zeros(len(antenna)))
        cosine, distance = off_boresight(looking[:, 3:], far.pose[place, :3] - looking[:, :3])
        g = np.zeros(len(antenna)) if shade is None else shade.of(around, antenna, place, np.zeros(len(antenna)))
        rest = config.dead_zone.beta / (config.dead_zone.alpha + config.dead_zone.beta)
        probability = (1 - g) * rest * answering(distance, np.arccos(cosine), config.queries)
        unknown = np.full(len(antenna), np.nan)
        yield Heard(antenna, place, probability, unknown, distance, unknown, 1 - g), len(antenna)


def answering(distance: Array, angle: Array, queries: int) -> Array:
    """(N,) probability that one of `queries` is answered over distances (m) at angles (rad) off boresight, dead zones aside."""
    m, v = logistic_beta.mean(distance, angle), logistic_beta.variance(distance, angle)
    alpha, beta = logistic_beta.beta_of(m, np.where(v > 0, v, 1.0))
    alpha, beta = np.where(v > 0, alpha, 1.0), np.where(v > 0, beta, 1.0)
    return 1 - np.where(v > 0, np.exp(betaln(alpha, beta + queries) - betaln(alpha, beta)), (1 - m) ** queries)


def _within(near: Ends, far: Ends, around: Surroundings, reach: Array) -> Iterator[tuple[Array, Array]]:
    """Pairs (antenna, place) no farther apart than the antenna's reach, by antenna and place, CHUNK at a time."""
    count = len(reach)
    at = near.at(around.truth, np.arange(count), np.zeros(count))[:, :3]
    for antenna in range(count):
        close = np.flatnonzero(np.linalg.norm(far.pose[:, :3] - at[antenna], axis=1) <= reach[antenna])
        for i in range(0, len(close), CHUNK):
            place = close[i : i + CHUNK]
            yield np.full(len(place), antenna), place
