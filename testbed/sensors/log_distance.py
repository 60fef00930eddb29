"""A reader as a formula: at even instants every antenna hears every tag at once, by the logarithm of distance, with normal noise.

    RSSI = C - 10 n log10(D / 1 m) + N(0, σ)

with D the distance d or, of an antenna with a beam, d / cos θ: on spheres through the antenna, centred on its axis, the level is
the same (Nick and Götze, section 4). That is a one-way pattern cos^(n/2). With a carrier, phase is wrap(-4π f d / c) plus an offset
for each antenna and tag, drawn once a trial, plus normal noise. Left out: all that radio does in a hall. It is for
studies of estimators alone, whose truth and noise are known to the last digit.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed import frames
from testbed.columns import Array
from testbed.plugins import suggest
from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Config, DecibelMilliwatts, Decibels, Hertz, Point3
from testbed.recording import mounted
from testbed.rng import Counter, keys_of, stream
from testbed.scene import WORLD, Scene
from testbed.sensors.carrier import instants
from testbed.types import Antennas, Reads
from testbed.units import SPEED_OF_LIGHT, wrap_positive

LEAST_COSINE = 0.05  # a beam hears nothing further off its axis than this
NEAR = 1e-3  # m: nearer than this is as near
ISOTROPIC = np.pi  # rad: the beam width that stands for no pattern at all


class AntennaPlace(Config):
    """Where an antenna is, and where it looks."""

    position_m: Point3
    aim_m: Point3 | None = None

    @model_validator(mode="after")
    def _aims_elsewhere(self) -> AntennaPlace:
        if self.aim_m == self.position_m:
            raise ValueError("aim_m is where the antenna is: aim it elsewhere")
        return self


class LogDistanceConfig(Config):
    """`count` takes the first so many antennas; `tags` is a pattern over the ids of the tags that are read.

    `beams`: none (all directions alike), all, or both: then there are two antennas at each place, one of each sort, with the same noise,
    so that methods on either are compared on the same trials; `beam_tags` are those that the second sort reads.
    `carrier_mhz`: also report phase, of this one carrier, with noise of `phase_noise_rad`; left out, there is none.
    Each trial moves places and aims by `jitter_m` and `aim_jitter_m` times U(-1, 1) on each axis; the installer knows where to.
    """

    antennas: Annotated[list[AntennaPlace], Field(min_length=1, max_length=1000)]
    count: Annotated[int, Field(ge=1, le=1000)] | None = None
    tags: Annotated[str, Field(min_length=1, max_length=200)] = "*"
    rate_hz: Annotated[Hertz, Field(gt=0, le=1000)] = 10.0
    reference_dbm: DecibelMilliwatts = -40.0
    path_loss_exponent: Annotated[float, Field(gt=0, le=12)] = 4.0
    sigma_db: Annotated[Decibels, Field(ge=0, le=40)] = 1.0
    carrier_mhz: Annotated[float, Field(gt=0, le=1e5)] | None = None
    phase_noise_rad: Annotated[float, Field(ge=0, le=3)] = 0.1
    beams: Literal["none", "all", "both"] = "none"
    beam_tags: Annotated[str, Field(min_length=1, max_length=200)] = "*"
    jitter_m: Point3 = (0.0, 0.0, 0.0)
    aim_jitter_m: Point3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _fits(self) -> LogDistanceConfig:
        if self.count is not None and self.count > len(self.antennas):
            raise ValueError(f"count asks for {self.count} antennas of the {len(self.antennas)} in the list")
        blind = next((i for i, a in enumerate(self.antennas) if a.aim_m is None), None)
        if self.beams != "none" and blind is not None:
            raise ValueError(f"antennas.{blind} looks nowhere: a beam needs aim_m")
        return self


class LogDistance:
    """Reads every 1 / rate_hz s from t = 0. Antennas are `<id>.1`, ... and, with a beam, `<id>.beam1`, ..."""

    Config: ClassVar[type[LogDistanceConfig]] = LogDistanceConfig
    produces: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: LogDistanceConfig, id: str, scene: Scene) -> None:
        self._config, self._id = config, id
        self._places = config.antennas[: config.count or len(config.antennas)]
        sorts = {"none": [False], "all": [True], "both": [False, True]}[config.beams]
        self._is_beam = np.repeat(sorts, len(self._places))
        self._place = np.tile(np.arange(len(self._places)), len(sorts))

    def antennas(self) -> Antennas:
        """The antennas as the scenario lists them, before each trial's jitter."""
        return self._described(*self._listed())

    def antennas_in(self, root: int, trial: int) -> Antennas:
        """The antennas of one trial."""
        return self._described(*self._moved(root, trial))

    def frequencies(self) -> Array:
        """Its one carrier; none where it has no phase, for the law of levels has no wavelength."""
        return np.empty(0) if self._config.carrier_mhz is None else np.array([1e6 * self._config.carrier_mhz])

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """All reads of a trial, in the order of instants, antennas, tags. ValueError for a pattern that no tag fits."""
        config, tag = self._config, self._tags(around, self._config.tags)
        t = instants(around.duration, config.rate_hz)
        position, aim = self._moved(around.root, around.trial)
        apart = self._positions(around, tag, t)[:, None] - position[:, None]  # (K, places, tags, 3)
        distance = np.maximum(np.linalg.norm(apart, axis=-1), NEAR)
        axis = (aim - position) / np.linalg.norm(aim - position, axis=1, keepdims=True)
        cosine = np.einsum("kmti,mi->kmt", apart, axis)[:, self._place] / distance[:, self._place]
        read = np.isin(tag, self._tags(around, config.beam_tags)) if config.beams != "none" else np.ones(len(tag), dtype=bool)
        beam = self._is_beam[:, None]
        heard = ~beam | ((cosine > LEAST_COSINE) & read)
        phase = self._phases(around, tag, distance)[:, self._place]
        distance = distance[:, self._place] / np.where(beam & heard, cosine, 1.0)
        rssi = config.reference_dbm - 10 * config.path_loss_exponent * np.log10(distance) + self._noise(around, tag, len(t))[:, self._place]
        k, m, which = np.nonzero(heard)
        return Sensed({"reads": Reads(t[k], t[k], m + first_antenna, tag[which], rssi=rssi[heard], phase=phase[heard])})

    def _tags(self, around: Surroundings, pattern: str) -> Array:
        ids = [str(id) for id in around.tagged.tags.id]
        found = [i for i, id in enumerate(ids) if fnmatchcase(id, pattern)]
        if not found and ids:
            raise ValueError(f"sensor {self._id}: no tag is named {pattern!r}{suggest(pattern, ids[:1000])}")
        return np.array(found, dtype=np.int64)

    def _positions(self, around: Surroundings, tag: Array, t: Array) -> Array:
        """(K, tags, 3) m: where the tags are at the instants."""
        position = np.empty((len(t), len(tag), 3))
        for i, one in enumerate(tag):
            body, pose = int(around.tagged.body[one]), around.tagged.pose[one]
            position[:, i] = pose[:3] if body == WORLD else mounted(around.truth, body, pose, t)[:, :3]
        return position

    def _noise(self, around: Surroundings, tag: Array, instants: int) -> Array:
        """(K, places, tags) dB."""
        if self._config.sigma_db == 0:
            return np.zeros((instants, len(self._places), len(tag)))
        draws = Counter(around.root, around.trial, f"sensors.{self._id}.rssi")
        key = keys_of(around.tagged.tags.id[tag])
        normal = draws.normal(np.arange(instants)[:, None, None], np.arange(len(self._places))[:, None], key)
        return self._config.sigma_db * normal

    def _phases(self, around: Surroundings, tag: Array, distance: Array) -> Array:
        """(K, places, tags) rad at distances (K, places, tags) m; NaN without a carrier."""
        if self._config.carrier_mhz is None:
            return np.full(distance.shape, np.nan)
        place, key = np.arange(len(self._places))[:, None], keys_of(around.tagged.tags.id[tag])
        offset = Counter(around.root, around.trial, f"sensors.{self._id}.phase_offset").uniform(place, key)
        noise = Counter(around.root, around.trial, f"sensors.{self._id}.phase").normal(np.arange(len(distance))[:, None, None], place, key)
        turns = 2 * distance * 1e6 * self._config.carrier_mhz / SPEED_OF_LIGHT
        return wrap_positive(2 * np.pi * (offset - turns) + self._config.phase_noise_rad * noise)

    def _listed(self) -> tuple[Array, Array]:
        """(places, 3) m each: where they are, and what they look at (a metre along +x where they look nowhere)."""
        position = np.array([a.position_m for a in self._places])
        aim = np.array([(x + 1.0, y, z) if a.aim_m is None else a.aim_m for a in self._places for x, y, z in [a.position_m]])
        return position, aim

    def _moved(self, root: int, trial: int) -> tuple[Array, Array]:
        """As `_listed`, with the trial's jitter."""
        position, aim = self._listed()
        if not any((*self._config.jitter_m, *self._config.aim_jitter_m)):
            return position, aim
        random = stream(root, trial, f"sensors.{self._id}.places")
        shift = random.uniform(-1.0, 1.0, (len(self._config.antennas), 2, 3))[: len(position)]  # more antennas move no other
        return position + np.array(self._config.jitter_m) * shift[:, 0], aim + np.array(self._config.aim_jitter_m) * shift[:, 1]

    def _described(self, position: Array, aim: Array) -> Antennas:
        n, names = len(self._place), np.where(self._is_beam, "beam", "")
        half_power = 2 * np.arccos(0.5 ** (2 / self._config.path_loss_exponent))  # of cos^(n/2), one way
        return Antennas(
            id=np.array([f"{self._id}.{name}{place + 1}" for name, place in zip(names, self._place, strict=True)]),
            position=position[self._place],
            quaternion=frames.looking_at(position, aim)[self._place],
            gain=np.zeros(n),
            beamwidth=np.where(self._is_beam, half_power, ISOTROPIC),
            front_to_back=np.full(n, 200.0),
            power=np.zeros(n),
            reader=np.full(n, self._id),
        )
