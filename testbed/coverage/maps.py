"""Where a site's readers hear a tag and where they don't: read probability, level and number of antennas on a grid over the floor.

    testbed.coverage.coverage("dock-gate", height_m=[0.5, 1.5]).shares()

Every point of the grid has a tag of the model's gain in every direction (how it hangs is nobody's to know) and is visited by every
antenna. What fades there is known but for the diffuse part, so the probability that a visit reads the tag is Marcum's Q function, not
a share of samples (`testbed.coverage.links`); it is the share of places within a wavelength or two of the point at which it is read.

A point is read by an antenna where that probability is at least `HEARD`; over all antennas, each fading by itself, it is

    1 - Π (1 - p_a)

A point inside of a thing is no floor: NaN, and not counted. Left out: tags compete for a reader's time, sessions and Select silence
some, moving bodies stand where the scenario starts them, and what a tag is stuck on detunes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import find_objects, label

from testbed import frames
from testbed.columns import Array, Columns, column
from testbed.coverage.links import Heard, heard
from testbed.plugins import suggest
from testbed.progress import Progress, Silent
from testbed.protocols import Surroundings, Tagged
from testbed.radio.tags import tag_model
from testbed.scene import WORLD, Boxes, Scene
from testbed.sensors.rfid import Rfid
from testbed.simulate import Simulator
from testbed.solid import holder, mesh_holder
from testbed.types import Antennas, Tags

if TYPE_CHECKING:
    from testbed.scenario import Scenario

HEARD = 0.5  # of visits: an antenna reads a point where it does so every other time at least
DEAD = 0.5  # of visits of all antennas: a dead zone is where fewer read the tag
MOST_POINTS = 1_000_000
MOST_LINKS = 10_000_000  # points × antennas: 400 MB
COUNTED = (1, 2, 3)  # antennas, of which shares are told


class CoverageError(ValueError):
    """A grid, a tag or a sensor that can't be: what is wrong, and what would be right, in a sentence."""


@dataclass(frozen=True)
class DeadZone:
    """Points of the floor that touch each other, none of which is read often enough; m, m², a rectangle (x, y) to (x, y) about them."""

    height_m: float
    area_m2: float
    center_m: tuple[float, float]
    bounds_m: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Coverage(Columns):
    """The grid (Z heights, Y, X) and what A antennas make of it; a value at (x, y) speaks of the square of `step_m` about it.

    probability is of a read in one visit of the antenna; rssi is the mean, in dB, over fades and carriers, NaN where no fade lets the
    antenna hear the tag. Points inside of things have NaN throughout.
    """

    x: Array = column("float64", ("X",), "m")
    y: Array = column("float64", ("Y",), "m")
    z: Array = column("float64", ("Z",), "m")
    inside: Array = column("bool", ("Z", "Y", "X"))
    probability: Array = column("float64", ("Z", "Y", "X", "A"))
    rssi: Array = column("float64", ("Z", "Y", "X", "A"), "dBm")
    distance: Array = column("float64", ("Z", "Y", "X", "A"), "m; NaN out of reach")
    loss: Array = column("float64", ("Z", "Y", "X", "A"), "dB on the direct path; NaN out of reach")
    clear: Array = column("float64", ("Z", "Y", "X", "A"), "share of the Fresnel zone; NaN out of reach")
    antenna: Array = column("str", ("A",))
    sensor: Array = column("str", ("A",))
    pose: Array = column("float64", ("A", 7), "m and (w, x, y, z) of the antennas, where they start")
    scenario: str = ""
    tag: str = ""
    step_m: float = 0.0

    @property
    def read(self) -> Array:
        """(Z, Y, X) probability that some antenna reads the tag when each comes by once; NaN inside of things."""
        return 1 - np.prod(1 - self.probability, axis=-1)

    @property
    def antennas(self) -> Array:
        """(Z, Y, X) how many antennas read the tag with probability HEARD at least; NaN inside of things."""
        return np.where(self.inside, np.nan, (self.probability >= HEARD).sum(axis=-1))

    @property
    def level(self) -> Array:
        """(Z, Y, X) dBm: mean RSSI at the antenna that has most of it; NaN where there is none."""
        best = np.where(np.isnan(self.rssi), -np.inf, self.rssi).max(axis=-1, initial=-np.inf)
        return np.where(np.isfinite(best), best, np.nan)

    @property
    def dead(self) -> Array:
        """(Z, Y, X) bool: floor on which a tag is read in fewer than DEAD of the visits."""
        return ~self.inside & ~(self.read >= DEAD)

    def shares(self) -> Array:
        """(Z, 3) share of the floor that is read by 1, 2, 3 antennas at least; NaN at a height where all is inside of things."""
        floor, many = np.sum(~self.inside, axis=(1, 2)), self.antennas
        by = np.stack([np.sum(many >= n, axis=(1, 2)) for n in COUNTED], axis=1)
        return np.where(floor[:, None] > 0, by / np.maximum(floor, 1)[:, None], np.nan)

    def dead_zones(self, height: int) -> list[DeadZone]:
        """The dead zones at one of the heights (index), the largest first."""
        number = np.zeros(self.dead[height].shape, dtype=np.int32)
        label(self.dead[height], structure=np.ones((3, 3)), output=number)
        found = []
        for i, (rows, columns) in enumerate(find_objects(number), start=1):
            j, k = np.nonzero(number == i)
            low = (float(self.x[columns.start] - self.step_m / 2), float(self.y[rows.start] - self.step_m / 2))
            high = (float(self.x[columns.stop - 1] + self.step_m / 2), float(self.y[rows.stop - 1] + self.step_m / 2))
            center = (float(self.x[k].mean()), float(self.y[j].mean()))
            found.append(DeadZone(float(self.z[height]), len(j) * self.step_m**2, center, (low, high)))
        return sorted(found, key=lambda zone: (-zone.area_m2, zone.center_m))


def coverage(
    scenario: Scenario | Mapping[str, Any] | str | Path,
    *,
    step_m: float = 0.25,
    height_m: Sequence[float] = (1.0,),
    tag: str = "monza_4",
    sensors: Sequence[str] = (),
    set: Mapping[str, Any] | Sequence[str] = (),
    progress: Progress | None = None,
) -> Coverage:
    """Coverage of a scenario by its rfid sensors (those named by `sensors`, all where left out), without running a trial.

    scenario : a file, the name of one that ships, a mapping, or a Scenario; of one with a sweep, what it is without
    tag      : a tag model; height_m : above the floor, inside the hall

    ScenarioError for mistakes in the scenario, CoverageError for a grid, a tag or sensors that can't be.
    """
    from testbed.api import scenario_of

    with Simulator(scenario_of(scenario, sets=set)) as simulator:
        return covered(simulator, step_m=step_m, height_m=height_m, tag=tag, sensors=sensors, progress=progress)


def covered(
    simulator: Simulator,
    *,
    step_m: float = 0.25,
    height_m: Sequence[float] = (1.0,),
    tag: str = "monza_4",
    sensors: Sequence[str] = (),
    progress: Progress | None = None,
) -> Coverage:
    """As `coverage`, in a world that is there already."""
    readers = _readers(simulator, sensors)
    around, antennas = simulator.at_rest(), Antennas.concatenate([sensor.antennas() for _, sensor in readers])
    x, y, z = _grid(np.asarray(simulator.scene.bounds), step_m, height_m, len(antennas))
    points = np.stack(np.broadcast_arrays(x, y[:, None], z[:, None, None]), axis=-1)
    flat, scene = points.reshape(-1, 3), simulator.scene
    inside = ((holder(flat, _solid(scene)) >= 0) | (mesh_holder(flat, scene.static_meshes()) >= 0)).reshape(points.shape[:3])
    around = _asked(around, points[~inside], tag)
    shown = progress or Silent()
    shown.start(f"{simulator.scenario.name}, coverage", int((~inside).sum()) * len(antennas), 0)
    parts = [heard(sensor, around, lambda links: shown.advance(links, 0)) for _, sensor in readers]
    shown.finish()
    return Coverage(
        x=x, y=y, z=z, inside=inside, **_fields(parts, [len(s.antennas()) for _, s in readers], inside), antenna=antennas.id,
        sensor=np.repeat([id for id, _ in readers], [len(s.antennas()) for _, s in readers]),
        pose=np.concatenate([s.ends.at(around.truth, np.arange(len(s.antennas())), np.zeros(len(s.antennas()))) for _, s in readers]),
        scenario=simulator.scenario.name, tag=tag, step_m=float(step_m),
    )  # fmt: skip


def _readers(simulator: Simulator, wanted: Sequence[str]) -> list[tuple[str, Rfid]]:
    found = {
        section.id: sensor
        for section, sensor in zip(simulator.scenario.sensors, simulator.sensors, strict=True)
        if isinstance(sensor, Rfid)
    }
    if not found:
        raise CoverageError(f"{simulator.scenario.name} has no sensor of kind rfid, so there is nothing that covers its floor")
    for id in wanted:
        if id not in found:
            raise CoverageError(f"no rfid sensor is called {id!r}{suggest(id, list(found))}")
    return [(id, sensor) for id, sensor in found.items() if id in wanted or not wanted]


def _grid(bounds: Array, step: float, heights: Sequence[float], antennas: int) -> tuple[Array, Array, Array]:
    """x (X,), y (Y,), z (Z,) m: as many whole steps as there is room for, in the middle of the hall; heights as they are given."""
    low, high = bounds
    if not (np.isfinite(step) and step > 0):
        raise CoverageError(f"the step must be more than 0 m, and is {step:g}")
    if not len(heights):
        raise CoverageError("a height above the floor is wanted, at least one")
    for height in heights:
        if not low[2] <= height <= high[2]:
            raise CoverageError(f"a height of {height:g} m is not in the hall, which goes from {low[2]:g} to {high[2]:g} m")
    count = np.maximum(np.floor((high[:2] - low[:2]) / step + 1e-9), 1)
    points = float(count[0] * count[1] * len(heights))
    if points > MOST_POINTS or points * antennas > MOST_LINKS:
        raise CoverageError(
            f"a step of {step:g} m makes {points:,.0f} points for {antennas} antennas; {MOST_POINTS:,} points and {MOST_LINKS:,} pairs "
            "of both are the limit: take a larger step"
        )
    x, y = (low[i] + (high[i] - low[i] - step * count[i]) / 2 + step * (np.arange(int(count[i])) + 0.5) for i in (0, 1))
    return x, y, np.array(list(dict.fromkeys(float(h) for h in heights)))


def _solid(scene: Scene) -> Boxes:
    """All boxes in the world's frame, those of moving bodies where they start."""
    pose = np.concatenate([scene.rest_poses(), [frames.IDENTITY]])[scene.boxes.body]  # the last one is the world's, for index -1
    center = frames.to_world(pose, scene.boxes.center)
    return scene.boxes.with_(center=center, quaternion=frames.multiply(pose[:, 3:], scene.boxes.quaternion))


def _asked(around: Surroundings, points: Array, tag: str) -> Surroundings:
    """The hall with a tag at each of the points (N, 3) in place of its own."""
    try:
        model = tag_model(tag)
    except ValueError as error:
        raise CoverageError(str(error)) from None
    n = len(points)
    tags = Tags(
        id=np.arange(n).astype(np.str_), gain=np.full(n, model.gain_dbi), sensitivity=np.full(n, model.sensitivity_dbm),
        pattern=np.full(n, "isotropic"),
    )  # fmt: skip
    pose = np.concatenate([points, np.tile(frames.IDENTITY[3:], (n, 1))], axis=1)
    return Surroundings(
        around.scene, around.truth, Tagged(tags, np.full(n, WORLD), pose), around.target_bodies, np.arange(0), around.duration,
        around.caster, around.root, around.trial,
    )  # fmt: skip


def _fields(parts: list[Heard], antennas: list[int], inside: Array) -> dict[str, Array]:
    """(Z, Y, X, A) of each field: 0 for the probability of pairs out of reach, NaN for the rest of them and inside of things."""
    first = np.concatenate([[0], np.cumsum(antennas)[:-1]])
    made = {}
    for name in ("probability", "rssi", "distance", "loss", "clear"):
        floor = np.full((int((~inside).sum()), sum(antennas)), 0.0 if name == "probability" else np.nan)
        for part, before in zip(parts, first, strict=True):
            floor[part.place, before + part.antenna] = getattr(part, name)
        made[name] = np.full((*inside.shape, sum(antennas)), np.nan)
        made[name][~inside] = floor
    return made
