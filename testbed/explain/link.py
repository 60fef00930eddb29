"""The link budget of one antenna and one tag at one instant, path by path: what the channel puts together, taken apart again.

Every number is the channel's own (`testbed.radio.channel`): the terms add up to its h, the decibels of a path to its term's, and
those of the obstacles by name to what the path loses through them. Weak links are looked at in full, where a trial leaves out what
can't be heard; `Budget.run_db` is what the trial itself goes by.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.columns import Array
from testbed.protocols import Crossings, Surroundings, Tagged
from testbed.radio.antenna import off_boresight
from testbed.radio.channel import Channel, Fixed, Parts
from testbed.radio.coupling import Coupling
from testbed.radio.materials import losses
from testbed.radio.propagation import POLARISATION_DB, direct_path, power_at_tag
from testbed.radio.reflection import ASIDE, Mirrored, mirrored_axis
from testbed.radio.setting import Radio
from testbed.radio.sight import Bundle, Obstacles, Sight, Ways, ways
from testbed.scene import WORLD, Scene
from testbed.sensors.rfid import Rfid
from testbed.units import db

TOUCH = 0.05  # m: a tag so near to a box is taken to be on it

Way = Literal["clear", "through", "round"]


@dataclass(frozen=True)
class Obstacle:
    """A box on a path: its body ("hall" for one that belongs to none), where the path enters it, how much lies inside, and its loss.

    holds_tag : the tag rides on it, or sits within TOUCH of the box
    """

    body: str
    material: str
    moving: bool
    holds_tag: bool
    at_m: float
    inside_m: float
    loss_db: float


@dataclass(frozen=True)
class Passage:
    """What a path loses in or round what stands in its way; `loss_db` is the less of both ways.

    through_db : in the obstacles, all together; shade_db : besides, by what stands beside the line; round_db : on the best way round,
    infinite where there is none; clear : share of the Fresnel zone; beside : bodies on its rim, those that take most first
    """

    obstacles: tuple[Obstacle, ...]
    beside: tuple[str, ...]
    through_db: float
    shade_db: float
    round_db: float
    detour_m: float
    clear: float
    loss_db: float

    @property
    def way(self) -> Way:
        """Which way is taken."""
        if self.round_db < self.through_db + self.shade_db:
            return "round"
        return "through" if self.loss_db > 0 else "clear"


@dataclass(frozen=True)
class Gains:
    """dB by both ends: the antenna's towards the path, the tag's best, less for how its dipole hangs, and the polarisation's share."""

    off_boresight_deg: float
    antenna_db: float
    tag_db: float
    orientation_db: float
    polarisation_db: float

    @property
    def total_db(self) -> float:
        """What the channel takes."""
        return self.antenna_db + self.tag_db + self.orientation_db + self.polarisation_db


@dataclass(frozen=True)
class Path:
    """One path: `level_db` = gains + reflection + share - spread - passage's loss, that of `term`, its part of h.

    by          : "" for the direct path, else the body that reflects it, "floor" for the floor
    incidence   : degrees off the face's normal, point (x, y, z) m on it: NaN for the direct path
    share_db    : what the diffuse part leaves to a direct path, K/(K+1)
    """

    by: str
    length_m: float
    spread_db: float
    gains: Gains
    reflection_db: float
    incidence_deg: float
    point_m: tuple[float, ...]
    passage: Passage
    share_db: float
    term: complex

    @property
    def level_db(self) -> float:
        """dB of the term."""
        return _level(self.term)


@dataclass(frozen=True)
class Budget:
    """A link at an instant. `h` is the sum of the direct term, the diffuse term and the reflections' (the strongest first).

    k_db      : Rice factor, infinite without a diffuse part; diffuse_adds_db : by how much the diffuse part changes the direct path
    forward_db, reverse_db : what the tag and the reader get above what they need
    run_db    : |h|² as the trial has it, with paths left out that are too weak to matter
    """

    sent_dbm: float
    channel: int
    carrier_hz: float
    direct: Path
    reflections: tuple[Path, ...]
    k_db: float
    diffuse: complex
    diffuse_adds_db: float
    h: complex
    tag_dbm: float
    tag_needs_dbm: float
    reader_dbm: float
    reader_needs_dbm: float
    run_db: float

    @property
    def total_db(self) -> float:
        """|h|² in dB."""
        return _level(self.h)

    @property
    def diffuse_db(self) -> float:
        """dB of the diffuse term."""
        return _level(self.diffuse)

    @property
    def forward_db(self) -> float:
        """dB that the tag gets more than wakes it."""
        return self.tag_dbm - self.tag_needs_dbm

    @property
    def reverse_db(self) -> float:
        """dB that the reader gets more than it understands."""
        return self.reader_dbm - self.reader_needs_dbm

    @property
    def unfaded_db(self) -> float:
        """dB that the direct path alone would have, no share of it diffuse."""
        return self.direct.level_db - self.direct.share_db if np.isfinite(self.direct.level_db) else -np.inf


def budget(sensor: Rfid, around: Surroundings, antenna: int, tag: int, t: float) -> Budget:
    """The budget of an antenna of the sensor and a tag of the trial (indices) at t s."""
    one = np.array([tag])
    alone = Tagged(around.tagged.tags.take(one), around.tagged.body[one], around.tagged.pose[one])
    radio = sensor.radio(around.caster, alone, limit=False)
    channel = Channel(radio, Fixed(radio), around.truth, around.root, around.trial)
    link = np.array([antenna]), np.zeros(1, dtype=np.int64), np.array([t])
    carrier = sensor.carrier(around, link[0], link[2])
    frequency = radio.frequencies[carrier]
    parts, response = channel.parts(*link), channel.respond(*link, carrier)
    direct, diffuse, over = (np.asarray(term) for term in channel.terms(parts, frequency))
    seen = _Seen(around, radio, parts, t)
    k = float(radio.rice_factor(parts.sight.clear)[0]) if radio.config.diffuse else np.inf
    line = seen.direct(antenna, direct[0], float(frequency[0]), k)
    mirrored = seen.reflected(antenna, over, float(frequency[0]))
    plain = parts.lines.gain[0] - line.spread_db - line.passage.loss_db
    received, forward, reverse = (float(x[0]) for x in sensor.margins(response, link[0], link[1], alone))
    power = float(radio.antennas.power[antenna])
    run = sensor.channel(around).respond(link[0], one, link[2], carrier)
    return Budget(
        sent_dbm=power,
        channel=int(carrier[0]),
        carrier_hz=float(frequency[0]),
        direct=line,
        reflections=tuple(sorted(mirrored, key=lambda path: -path.level_db)),
        k_db=float(db(k)) if k > 0 else -np.inf,
        diffuse=complex(diffuse[0]),
        diffuse_adds_db=_level(direct[0] + diffuse[0]) - plain,
        h=complex(response.h[0]),
        tag_dbm=float(power_at_tag(response.h, power)[0]),
        tag_needs_dbm=float(power_at_tag(response.h, power)[0]) - forward,
        reader_dbm=received,
        reader_needs_dbm=received - reverse,
        run_db=_level(run.h[0]),
    )


class _Seen:
    """The paths of one link at one instant, and what stands on them by name."""

    def __init__(self, around: Surroundings, radio: Radio, parts: Parts, t: float) -> None:
        self._scene, self._radio, self._parts = around.scene, radio, parts
        bodies = np.arange(len(around.truth.bodies))
        self._poses = around.truth.pose(bodies, t)[None] if len(bodies) else np.empty((1, 0, 7))
        self._loss = losses(around.scene.materials)
        rides = int(radio.far.body[0])
        self._carrier = WORLD if rides == WORLD else int(around.scene.moving[rides])

    def direct(self, antenna: int, term: complex, frequency: float, k: float) -> Path:
        lines = self._parts.lines
        ends = lines.start, lines.end
        return Path(
            by="",
            length_m=float(lines.distance[0]),
            spread_db=_spread(lines.distance[0], frequency),
            gains=self._gains(antenna, lines.axis, lines.end - lines.start, lines.gain)[0],
            reflection_db=0.0,
            incidence_deg=np.nan,
            point_m=(np.nan,) * 3,
            passage=self._passages(self._parts.sight, self._ways(*ends, None), self._named([ends]), self._rim())[0],
            share_db=0.0 if np.isinf(k) else float(db(k / (k + 1))) if k > 0 else -np.inf,
            term=complex(term),
        )

    def reflected(self, antenna: int, terms: Array, frequency: float) -> list[Path]:
        paths, lines, faces = self._parts.paths, self._parts.lines, self._radio.faces
        start, end, normal = lines.start[paths.link], lines.end[paths.link], faces.normal[paths.reflector]
        turn = paths.point + ASIDE * normal  # where the legs end, so that they don't meet the face itself
        gains = self._gains(antenna, mirrored_axis(lines.axis[paths.link], paths, faces), paths.point - start, paths.gain)
        both = self._ways(start, paths.image, paths)
        passages = self._passages(self._parts.mirrored, both, self._named([(start, turn), (turn, end)]))
        way = start - paths.point
        incidence = np.rad2deg(np.arccos(np.clip(np.einsum("ij,ij->i", way, normal) / np.linalg.norm(way, axis=1), -1, 1)))
        return [
            Path(
                by=self._face(int(faces.box[paths.reflector[i]])),
                length_m=float(paths.length[i]),
                spread_db=_spread(paths.length[i], frequency),
                gains=gains[i],
                reflection_db=_level(paths.coefficient[i]),
                incidence_deg=float(incidence[i]),
                point_m=tuple(float(x) for x in paths.point[i]),
                passage=passages[i],
                share_db=0.0,
                term=complex(terms[i]),
            )
            for i in range(len(paths))
        ]

    def _gains(self, antenna: int, axis: Array, towards: Array, gain: Array) -> list[Gains]:
        """The channel's own gain (M,) dBi, split by asking for it again of a tag without a direction, and of a circular wave."""
        radio, n = self._radio, len(towards)
        looking = np.broadcast_to(self._parts.lines.looking[0], (n, 4))
        link = np.full(n, antenna), np.zeros(n, dtype=np.int64), looking
        isotropic = radio.tags.with_(pattern=np.array(["isotropic"]))
        circular = radio.antennas.with_(polarisation=np.full(len(radio.antennas), "circular"))
        tag = float(radio.tags.gain[0])
        plain = Coupling(circular, isotropic).at(*link, axis, towards)[0]
        turned = Coupling(circular, radio.tags).at(*link, axis, towards)[0]
        angle = np.rad2deg(np.arccos(off_boresight(looking, towards)[0]))
        return [
            Gains(float(angle[i]), float(plain[i] + POLARISATION_DB - tag), tag, float(turned[i] - plain[i]),
                  float(gain[i] - turned[i] - POLARISATION_DB))
            for i in range(n)
        ]  # fmt: skip

    def _ways(self, start: Array, end: Array, paths: object | None) -> Ways | None:
        """Both ways of paths that are straight, or mirrored; None where the channel knows no edges."""
        if not self._radio.config.edges or not len(start):
            return None
        n = len(start)
        obstacles = Obstacles(self._radio.caster, self._poses, np.zeros(n, dtype=np.int64), np.full(n, self._poses.shape[1] > 0))
        if paths is not None:
            obstacles = Mirrored(obstacles, self._parts.paths, self._radio.faces)
        return ways(start, end, self._radio.wavelength, obstacles)

    def _rim(self) -> tuple[str, ...]:
        """Bodies on rays along the rim of the direct path's zone, by the most that they take on one."""
        if not self._radio.config.edges:
            return ()
        lines = self._parts.lines
        points = Bundle(
            np.zeros(1, dtype=np.int64), lines.start, lines.end, self._radio.wavelength, Obstacles(self._radio.caster), np.zeros(1)
        )
        rays = points.rim_points(np.zeros(1, dtype=np.int64))[0]
        taken: dict[str, float] = {}
        for ray in self._named([(rays[:, leg], rays[:, leg + 1]) for leg in range(rays.shape[1] - 1)]):
            for body in {obstacle.body for obstacle in ray}:
                taken[body] = max(taken.get(body, 0.0), sum(o.loss_db for o in ray if o.body == body))
        return tuple(sorted(taken, key=lambda body: (-taken[body], body)))

    def _passages(
        self, seen: Sight, both: Ways | None, obstacles: list[tuple[Obstacle, ...]], beside: tuple[str, ...] = ()
    ) -> list[Passage]:
        return [
            Passage(
                obstacles=obstacles[i],
                beside=beside,
                through_db=float(seen.through[i]),
                shade_db=0.0 if both is None else float(both.shade[i]),
                round_db=np.inf if both is None else float(both.round[i]),
                detour_m=float(seen.detour[i]),
                clear=float(seen.clear[i]),
                loss_db=float(seen.loss[i]),
            )
            for i in range(len(seen))
        ]

    def _named(self, legs: list[tuple[Array, Array]]) -> list[tuple[Obstacle, ...]]:
        """What stands on each of N paths, by name, leg after leg."""
        found: list[list[Obstacle]] = [[] for _ in legs[0][0]]
        behind, length = np.zeros(len(found)), np.sum([np.linalg.norm(end - start, axis=1) for start, end in legs], axis=0)
        for start, end in legs:
            crossed = self._radio.caster.crossings(start, end, self._poses, np.zeros(len(start), dtype=np.int64))
            for i in range(len(crossed)):
                path = int(crossed.segment[i])
                found[path].append(self._obstacle(crossed, i, behind[path], length[path]))
            behind += np.linalg.norm(end - start, axis=1)
        return [tuple(one) for one in found]

    def _obstacle(self, crossed: Crossings, i: int, behind: float, length: float) -> Obstacle:
        (entry, per_metre), inside, piece = self._loss, float(crossed.length[i]), int(crossed.box[i])
        body, material = int(self._scene.piece_body[piece]), int(self._scene.piece_material[piece])
        at = float(crossed.enter[i] + behind)
        return Obstacle(
            body=_body(self._scene, body),
            material=self._scene.materials[material],
            moving=body != WORLD and self._scene.bodies[body].moving,
            holds_tag=body == self._carrier if self._carrier != WORLD else at + inside > length - TOUCH,
            at_m=at,
            inside_m=inside,
            loss_db=float(entry[material] + per_metre[material] * inside),
        )

    def _face(self, box: int) -> str:
        return "floor" if box < 0 else _body(self._scene, int(self._scene.piece_body[box]))


def _body(scene: Scene, body: int) -> str:
    return "hall" if body == WORLD else scene.bodies[body].name


def _spread(distance: float, frequency: float) -> float:
    """dB that free space takes, as the channel has it."""
    return -_level(complex(direct_path(distance, frequency, 0.0, 0.0)))


def _level(term: complex) -> float:
    """dB; minus infinity for nothing."""
    return float(db(np.abs(term) ** 2))
