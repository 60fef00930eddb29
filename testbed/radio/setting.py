"""What the links of one reader have in common in every trial: antennas, tags, hall, and how its channel is to be modelled.

Who is out of reach, or can't be heard whatever the fading, is left out before anything is cast. The bounds take every gain at its
best, one reflection as strong as the direct path, and the diffuse part at `RARE`; a tag that several reflections lift together
from beyond that is missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Constraint
from pydantic import field_validator

from testbed.columns import Array, Table, column
from testbed.protocols import Caster
from testbed.quantity import Config, Decibels
from testbed.radio.coupling import Coupling, dipole_axis, polarisation_loss
from testbed.radio.diffuse import rice_factor
from testbed.radio.links import Ends
from testbed.radio.movers import ELSEWHERE, Movers, Posed
from testbed.radio.propagation import NEAREST
from testbed.radio.reflection import LARGE, Bounces, Mirrored, Reflectors, bounces, images, mirrored_axis, permittivities, reflectors
from testbed.radio.sight import Obstacles, Sight, sight
from testbed.scene import Scene
from testbed.types import Antennas, Tags
from testbed.units import SPEED_OF_LIGHT, db, from_db

RARE = 3.0  # amplitude of the diffuse field that is beaten at one place in 8,000: exp(-3²)
IN_STEP = 6.0  # dB by which a reflection as strong as the direct path lifts it, as over a floor far away
FAINT = 20.0  # dB below what wakes a tag: a reflection weaker than that moves the level at which it wakes by less than 1 dB


class ChannelConfig(Config):
    """The `channel` of a reader. Everything on by default; `orders: 0` and no diffuse part is free space with obstacles."""

    orders: Literal[0, 1] = 1  # of reflections
    floor: str | None = "concrete"
    min_face_m2: Annotated[float, Constraint(ge=0.1, le=1e4)] = LARGE
    diffuse: bool = True
    open_k_db: Annotated[Decibels, Constraint(ge=-20, le=60)] = 10.0
    edges: bool = True  # soft line of sight; without, one straight ray

    @field_validator("floor")
    @classmethod
    def _known(cls, value: str | None) -> str | None:
        if value is not None:
            permittivities((value,))
        return value


@dataclass(frozen=True, eq=False)
class Lines(Table):
    """Straight lines of N links: ends, length, gain of antenna and tag towards each other, polarisation taken off."""

    start: Array = column("float64", ("N", 3), "m")
    looking: Array = column("float64", ("N", 4), "(w, x, y, z) of the antenna")
    end: Array = column("float64", ("N", 3), "m")
    axis: Array = column("float64", ("N", 3), "direction of the tag's dipole")
    distance: Array = column("float64", unit="m")
    gain: Array = column("float64", unit="dBi")
    margin: Array = column("float64", unit="dB above what wakes the tag, if nothing stood in the way")


@dataclass(frozen=True, eq=False)
class Paths(Bounces):
    """Reflected paths of links: as `Bounces`, with the gain of both ends, the tag's image, and the level that a free path has."""

    gain: Array = column("float64", unit="dBi")
    image: Array = column("float64", ("N", 3), "m")
    level: Array = column("float64", unit="dB above what wakes the tag")


class Radio:
    """A reader's links as far as no trial changes them. `limit` False evaluates every link in full, whether it can be heard or not.

    antennas, tags : what they are; near, far : where they are mounted; frequencies (C,) Hz the hop table
    """

    def __init__(
        self,
        config: ChannelConfig,
        scene: Scene,
        caster: Caster,
        antennas: Antennas,
        near: Ends,
        tags: Tags,
        far: Ends,
        frequencies: Array,
        limit: bool = True,
    ) -> None:
        self.config, self.caster, self.antennas, self.near, self.tags, self.far = config, caster, antennas, near, tags, far
        self.frequencies, self.limit = np.asarray(frequencies, dtype=np.float64), limit
        self.wavelength = SPEED_OF_LIGHT / float(self.frequencies.mean())  # of obstacles: they don't change over a band
        self.movers = Movers(scene)
        self.faces = reflectors(scene, config.min_face_m2, config.floor) if config.orders else Reflectors.empty()
        self.coupling = Coupling(antennas, tags)
        gain = (tags.gain - tags.sensitivity).max(initial=-np.inf) - polarisation_loss(antennas) + (IN_STEP if config.orders else 0.0)
        gain += float(self.lift(np.ones(1))[0])
        self.reach = self._heard_at(antennas.power + antennas.gain + gain) if limit else np.full(len(antennas), np.inf)

    def _heard_at(self, budget: Array) -> Array:
        """m at which free space has taken `budget` dB, at the lowest carrier."""
        return SPEED_OF_LIGHT / self.frequencies.min(initial=np.inf) / (4 * np.pi) * 10 ** (budget / 20)

    def lines(self, antenna: Array, tag: Array, posed: Posed | None = None, links: Array | None = None) -> Lines:
        """The straight lines of `links` (N,) of `posed`, at their instants; without, of pairs that never move."""
        looking, hanging = self.near.pose[antenna], self.far.pose[tag]
        if posed is not None and links is not None:
            looking = posed.carried(self.near.body[antenna], looking, links)
            hanging = posed.carried(self.far.body[tag], hanging, links)
        start, quaternion, end, axis = looking[:, :3], looking[:, 3:], hanging[:, :3], dipole_axis(hanging[:, 3:])
        gain, distance = self.coupling.at(antenna, tag, quaternion, axis, end - start)
        margin = self.budget(antenna, tag) + gain - self.spread(distance)
        return Lines(start=start, looking=quaternion, end=end, axis=axis, distance=distance, gain=gain, margin=margin)

    def budget(self, antenna: Array, tag: Array) -> Array:
        """dB between what is sent and what wakes the tag, antennas aside."""
        return self.antennas.power[antenna] - self.tags.sensitivity[tag]

    def rice_factor(self, clear: Array) -> Array:
        """(N,) K, linear, of paths by the share of their zone that is clear."""
        return rice_factor(clear, float(from_db(self.config.open_k_db)))

    def lift(self, clear: Array) -> Array:
        """(N,) dB by which the diffuse part lifts a path at the most, by the share of its zone that is clear."""
        if not self.config.diffuse:
            return np.zeros(len(clear))
        k = self.rice_factor(clear)
        return 20 * np.log10((np.sqrt(k) + RARE) / np.sqrt(k + 1))

    def standing(self, links: int) -> Obstacles:
        """All that never moves, for so many links; every moving body is far away."""
        away = np.broadcast_to(ELSEWHERE, (1, len(self.movers), 7))
        return Obstacles(self.caster, away, np.zeros(links, dtype=np.int64), np.zeros(links, dtype=bool))

    def spread(self, distance: Array) -> Array:
        """dB that free space takes over so many metres."""
        return db(np.square(4 * np.pi * np.maximum(distance, NEAREST) / self.wavelength))

    def sight(self, lines: Lines, obstacles: Obstacles) -> Sight:
        """Sight along straight lines."""
        worth = lines.margin + self.lift(np.zeros(len(lines))) if self.limit else np.full(len(lines), np.inf)
        return self._look(lines.start, lines.end, obstacles, worth)

    def sight_mirrored(self, paths: Paths, lines: Lines, obstacles: Obstacles) -> Sight:
        """Sight along reflected paths of `lines`; `obstacles` know the paths as their links."""
        worth = paths.level + FAINT if self.limit else np.full(len(paths), np.inf)
        return self._look(lines.start[paths.link], paths.image, Mirrored(obstacles, paths, self.faces), worth)

    def _look(self, start: Array, end: Array, obstacles: Obstacles, worth: Array) -> Sight:
        if self.config.edges:
            return sight(start, end, self.wavelength, obstacles, worth)
        found = obstacles.on(np.arange(len(start)), start, end)
        still = np.zeros(len(start))
        return Sight(clear=10 ** (-found.loss / 10), loss=found.loss, detour=still, count=found.count, through=found.loss)

    def reflections(self, lines: Lines, antenna: Array, tag: Array) -> Paths:
        """First-order reflections of lines that would be strong enough to matter with nothing in their way."""
        found = bounces(lines.start, lines.end, self.faces)
        link, axis = found.link, mirrored_axis(lines.axis[found.link], found, self.faces)
        gain, _ = self.coupling.at(antenna[link], tag[link], lines.looking[link], axis, found.point - lines.start[link])
        level = self.budget(antenna[link], tag[link]) + gain + db(np.abs(found.coefficient) ** 2) - self.spread(found.length)
        columns = {name: getattr(found, name) for name in found.column_names()}
        paths = Paths(**columns, gain=gain, image=images(found, lines.end, self.faces), level=level)
        return paths.take(level > -FAINT) if self.limit else paths

    def audible(self, lines: Lines, loss: Array, clear: Array, paths: Paths, lost: Array) -> Array:
        """(N,) bool: whether a tag may wake if all paths arrive in step and the diffuse part helps as much as it ever does.

        loss (N,) dB on the lines, of which a share `clear` (N,) is open; lost (M,) dB on the paths.
        """
        if not self.limit:
            return np.ones(len(lines), dtype=bool)
        amplitude = 10 ** ((lines.margin - loss + self.lift(clear)) / 20)
        return amplitude + np.bincount(paths.link, 10 ** ((paths.level - lost) / 20), len(lines)) >= 1
