"""A square hall with a grid of readers, as in studies of tracking by detections: a reader in each cell, its antennas on the cell's corners.

Layout and motion follow L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering",
Fig. 1 and Eq. 1; what the text leaves open is said at each field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed import quantity, rng
from testbed.columns import Array
from testbed.geometry import Boxes, Mounts, Zones
from testbed.protocols import ActorPlan
from testbed.quantity import Metres, MetresPerSecond, Seconds
from testbed.scene import Scene, Truth
from worlds.hall import BaseHall
from worlds.parts import MATERIALS, Builder, Part, RackSize, floor_pose, rack

ATTEMPTS = 20_000  # at a track that stays inside
BAY, DEPTH = 2.7, 1.1  # m, of racks


class ReaderGrid(BaseHall):
    """A floor over (0, 0) to (side, side) in cells x cells square cells.

    Bodies: reader1, reader2, ... in the middles of the cells, along x first, each with antenna mounts a0 ... a3 on the corners of its cell,
    anticlockwise from the lower left, that face its middle; with 3 antennas corner (ix + 2 iy) mod 4 is left out. rack1, ... in
    rack_rows rows, evenly over each cell, unless rack_bays is 0. walker1, ...: points without a body that move at random, each with a
    tag mount "tag".
    """

    class Config(quantity.Config):
        """The hall, its readers, and what walks in it.

        A walker starts in the middle of the floor (start_margin_m from the walls) with speed_mps in any direction, and then moves with
        continuous white-noise acceleration; a track that comes within margin_m of the walls, or rack_margin_m of a rack, is drawn again,
        as a whole. With stop_s
        above 0 it stops at random, for stop_s on average, after go_s on average, and sets off again with speed_mps in any direction.
        """

        side_m: Annotated[Metres, Field(ge=4, le=400)] = 40.0
        cells: Annotated[int, Field(ge=1, le=20)] = 4
        antennas: Literal[3, 4] = 4
        antenna_height_m: Annotated[Metres, Field(ge=0.2, le=12)] = 1.5
        height_m: Annotated[Metres, Field(ge=3, le=30)] = 6.0
        rack_bays: Annotated[int, Field(ge=0, le=20)] = 0
        rack_rows: Annotated[int, Field(ge=1, le=6)] = 1
        rack_levels: Annotated[int, Field(ge=1, le=4)] = 3
        rack_yaw_deg: Annotated[quantity.Degrees, Field(ge=-180, le=180)] = 0.0
        fill: Annotated[float, Field(ge=0, le=1)] = 1.0
        liquid: Annotated[float, Field(ge=0, le=1)] = 0.5
        layout_seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1
        walkers: Annotated[int, Field(ge=0, le=2000)] = 0
        walker_height_m: Annotated[Metres, Field(ge=0, le=6)] = 1.5
        speed_mps: Annotated[MetresPerSecond, Field(ge=0, le=20)] = 1.5
        acceleration_density_m2ps3: Annotated[float, Field(ge=0, le=10)] = 0.1
        start_margin_m: Annotated[Metres, Field(ge=0)] = 8.0
        margin_m: Annotated[Metres, Field(ge=0)] = 1.0
        rack_margin_m: Annotated[Metres, Field(ge=0, le=5)] = 0.4
        stop_s: Annotated[Seconds, Field(ge=0, le=3600)] = 0.0
        go_s: Annotated[Seconds, Field(gt=0, le=3600)] = 10.0

        @model_validator(mode="after")
        def _fits(self) -> ReaderGrid.Config:
            if not self.margin_m <= self.start_margin_m < self.side_m / 2:
                raise ValueError(f"start_margin_m {self.start_margin_m:g} must lie between margin_m and half of side_m {self.side_m:g}")
            if self.antenna_height_m >= self.height_m - 0.2:
                raise ValueError(f"antennas at {self.antenna_height_m:g} m don't fit under height_m {self.height_m:g}")
            if max(self.rack_bays * (BAY + 0.1) + 1.0, self.rack_rows * (DEPTH + 1.0) * (self.rack_bays > 0)) > self.side_m / self.cells:
                raise ValueError(
                    f"{self.rack_rows} racks of {self.rack_bays} bays leave no way round them in a cell of {self.side_m / self.cells:g} m"
                )
            return self

    config: Config
    _routed: tuple[Scene, Scene] | None = None

    def parts(self) -> list[Part]:
        c, size = self.config, self.config.side_m / self.config.cells
        middles = [((ix + 0.5) * size, (iy + 0.5) * size, (ix + 2 * iy) % 4) for iy in range(c.cells) for ix in range(c.cells)]
        readers = [self._reader(f"reader{i}", x, y, left_out) for i, (x, y, left_out) in enumerate(middles, start=1)]
        if not c.rack_bays:
            return readers
        shape, yaw = RackSize(c.rack_bays, c.rack_levels, BAY, DEPTH), np.deg2rad(c.rack_yaw_deg)
        places = [(x - np.sin(yaw) * off, y + np.cos(yaw) * off) for x, y, _ in middles for off in _rows(c)]
        racks = [
            rack(f"rack{i}", floor_pose(x, y, yaw), shape, c.fill, c.liquid, rng.stream(c.layout_seed, 0, f"rack{i}"))
            for i, (x, y) in enumerate(places, start=1)
        ]
        return [*readers, *racks]

    def _reader(self, name: str, x: float, y: float, left_out: int) -> Part:
        """A cabinet under the roof, with cables to the corners of its cell."""
        c, half = self.config, self.config.side_m / self.config.cells / 2
        built = Builder()
        built.box("plastic", (-0.2, -0.15, c.height_m - 0.15), (0.2, 0.15, c.height_m - 0.05))
        for corner, (sx, sy) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
            if c.antennas == 4 or corner != left_out:
                built.mount(f"a{corner}", (sx * half, sy * half, c.antenna_height_m), np.arctan2(-sy, -sx), use="antenna", group="antennas")
        return built.part(name, "reader", floor_pose(x, y))

    def bounds(self) -> Array:
        return np.array([[0.0, 0.0, 0.0], [self.config.side_m, self.config.side_m, self.config.height_m]])

    def zones(self) -> Zones:
        return Zones(np.array(["floor"]), np.array([[0.0, 0.0, self.config.side_m, self.config.side_m]]))

    # ------------------------------------------------------------ walkers

    def _walkers(self) -> list[ActorPlan]:
        walker: Any = _Walker(self.config.walker_height_m)
        names = [f"walker{i}" for i in range(1, self.config.walkers + 1)]
        return [
            ActorPlan(name, "walker", "kinematic", walker, None, floor_pose(self.config.side_m / 2, self.config.side_m / 2))
            for name in names
        ]

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The hall with its actors and walkers at rest. ValueError where two things share a name."""
        return super().scene([*actors, *self._walkers()])

    def move(
        self,
        scene: Scene,
        actors: Sequence[ActorPlan],
        duration: float,
        root: int,
        trial: int,
        step_hz: int = 240,
        truth_hz: int = 120,
    ) -> Truth:
        """Actors along their routes, walkers at random: each from its own stream, "world.<name>"."""
        if self._routed is None or self._routed[0] is not scene:  # the hall without its walkers, made once
            self._routed = scene, super().scene(actors)
        routed = super().move(self._routed[1], actors, duration, root, trial, step_hz, truth_hz)
        poses = {name: routed.poses[:, i] for i, name in enumerate(routed.bodies)}
        for plan in self._walkers():
            place = track(self.config, routed.t, rng.stream(root, trial, f"world.{plan.id}"))
            poses[plan.id] = np.concatenate([place, np.zeros((len(place), 1)), np.tile([1.0, 0, 0, 0], (len(place), 1))], axis=1)
        names = scene.moving_names
        stacked = np.stack([poses[name] for name in names], axis=1) if names else np.zeros((len(routed.t), 0, 7))
        return Truth(routed.t, stacked, names, zone=scene.zones.locate(stacked[..., :3]))


class _Walker:
    """A point with a tag on it."""

    def __init__(self, height: float) -> None:
        self._height = height

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """None."""
        return Boxes.empty(), MATERIALS

    def mounts(self) -> Mounts:
        """The tag's place."""
        built = Builder()
        built.mount("tag", (0.0, 0.0, self._height))
        return built.mounts()


def track(config: ReaderGrid.Config, t: Array, random: np.random.Generator) -> Array:
    """(K, 2) m: where a walker is at the evenly spaced times t (K,). ValueError where no track stays inside."""
    low, high = config.margin_m, config.side_m - config.margin_m
    for _ in range(ATTEMPTS):
        start = random.uniform(config.start_margin_m, config.side_m - config.start_margin_m, 2)
        found = start + (_stop_and_go if config.stop_s > 0 else _steady)(config, t, random)
        if (found >= low).all() and (found <= high).all() and not _in_rack(config, found).any():
            return found
    raise ValueError(f"no track of {t[-1]:g} s at {config.speed_mps:g} m/s stays clear of walls and racks: shorten duration_s or slow down")


def _in_rack(config: ReaderGrid.Config, place: Array) -> Array:
    """(K,) bool: whether places (K, 2) are within rack_margin_m of a rack of their cell."""
    if not config.rack_bays:
        return np.zeros(len(place), dtype=bool)
    size, yaw = config.side_m / config.cells, np.deg2rad(config.rack_yaw_deg)
    x, y = (place % size - size / 2).T
    along, across = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    shape = RackSize(config.rack_bays, config.rack_levels, BAY, DEPTH)
    apart = np.abs(across - _rows(config)[:, None]).min(axis=0)
    return (np.abs(along) <= shape.length / 2 + config.rack_margin_m) & (apart <= DEPTH / 2 + config.rack_margin_m)


def _rows(config: ReaderGrid.Config) -> Array:
    """(rack_rows,) m: how far the rows of racks of a cell are from its middle."""
    return config.side_m / config.cells * ((np.arange(config.rack_rows) + 0.5) / config.rack_rows - 0.5)


def _heading(config: ReaderGrid.Config, random: np.random.Generator) -> Array:
    angle = random.uniform(0.0, 2 * np.pi)
    return config.speed_mps * np.array([np.cos(angle), np.sin(angle)])


def _steady(config: ReaderGrid.Config, t: Array, random: np.random.Generator) -> Array:
    """(K, 2) m from the start: white-noise acceleration, exact at every instant."""
    return _integrated(config, _heading(config, random), np.diff(t), random)


def _integrated(config: ReaderGrid.Config, velocity: Array, dt: Array, random: np.random.Generator) -> Array:
    q, z = config.acceleration_density_m2ps3, random.standard_normal((2, len(dt), 2))
    step = dt[:, None]
    along = np.sqrt(q * step**3 / 3) * z[0]
    gained = 1.5 * along / np.maximum(step, 1e-12) + 0.5 * np.sqrt(q * step) * z[1]
    before = velocity + np.concatenate([np.zeros((1, 2)), np.cumsum(gained, axis=0)])[:-1]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(before * step + along, axis=0)])


def _stop_and_go(config: ReaderGrid.Config, t: Array, random: np.random.Generator) -> Array:
    """(K, 2) m from the start: stretches of the steady motion, and stands between them; changes fall on instants."""
    place, found, k, goes = np.zeros(2), np.zeros((len(t), 2)), 0, True
    while k < len(t) - 1:
        lasts = random.exponential(config.go_s if goes else config.stop_s)
        end = min(max(int(np.searchsorted(t, t[k] + lasts)), k + 1), len(t) - 1)
        if goes:
            found[k : end + 1] = place + _integrated(config, _heading(config, random), np.diff(t[k : end + 1]), random)
        else:
            found[k : end + 1] = place
        place, k, goes = found[end], end, not goes
    return found
