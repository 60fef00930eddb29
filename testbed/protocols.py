"""What a plug-in must offer. Structural: nothing has to be inherited, `SingleTarget` aside.

Every plug-in is a class named like its file (`estimators/ekf_filterpy.py` holds `EkfFilterpy`) with a pydantic model
`Config`, its section in a scenario file. Conformance is checked by `testbed.check`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from pydantic import BaseModel

from testbed.columns import Array, Columns, Table, column
from testbed.geometry import Boxes, Mounts
from testbed.guidance import Advice
from testbed.rng import RowRandom
from testbed.types import Antennas, Estimate, Event, Prior, Site, Status, Tags, Track, UpdateInfo
from testbed.view import Camera, Image

if TYPE_CHECKING:  # only to annotate: whoever imports this module for `Estimator` can't reach the truth through it
    from testbed.recording import Trial
    from testbed.scene import Scene, Truth

# ---------------------------------------------------------------- worlds


class Actor(Protocol):
    """A kind of moving thing (trolley, forklift, person): its body as plain data. How it moves is the world's business."""

    Config: type[BaseModel]

    def __init__(self, config: Any) -> None: ...

    def boxes(self) -> tuple[Boxes, tuple[str, ...]]:
        """Boxes in the body frame (origin on the floor, +x forward), and the names that their `material` indexes."""
        ...

    def mounts(self) -> Mounts:
        """Places for tags and antennas in the body frame; names without the body's."""
        ...


@dataclass(frozen=True)
class ActorPlan:
    """One actor of a scenario: who, how it moves ("dynamic", "kinematic", "parked" or "guided") and along which route.

    route is a `testbed.scenario.Route`, or None for an actor that stays where it stands. One that is guided stands at its pose, until
    the closed loop (`testbed.closed_loop`) moves it.
    """

    id: str
    kind: str
    motion: str
    actor: Actor
    route: Any
    pose: Array  # (7,) where it stands before its route starts


@dataclass(frozen=True, eq=False)
class Obstruction(Columns):
    """What stands on each of N segments: how many boxes, and the dB that they take in all."""

    count: Array = column("int32", ("N",))
    loss: Array = column("float64", ("N",), "dB")


@dataclass(frozen=True, eq=False)
class Crossings(Table):
    """Every obstacle on every segment: which segment, which piece of the scene (a box, or beyond their number a mesh), where it is
    entered, how much lies inside: nothing of an open mesh."""

    segment: Array = column("int64")
    box: Array = column("int32")
    enter: Array = column("float64", unit="m from the segment's start")
    length: Array = column("float64", unit="m inside the box")


class Caster(Protocol):
    """Finds the obstacles on segments. `entry_db` and `per_metre_db` (materials,) are given when it is made.

    Moving bodies are posed per instant: segment i meets them as `poses[instant[i]]`, poses (Q, moving bodies, 7).
    """

    def static(self, start: Array, end: Array) -> Obstruction:
        """Obstruction of segments (N, 3) to (N, 3) by all that never moves."""
        ...

    def moving(self, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        """Obstruction of segments by the moving bodies alone."""
        ...

    def crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        """Every obstacle on every segment, sorted by segment and by where it is entered."""
        ...


class World(Protocol):
    """A hall: geometry as plain data, and motion through it. Sensing never moves anything.

    `scene` must not need a physics engine. One world object serves all trials of a worker and is closed at the end.
    """

    Config: type[BaseModel]

    def __init__(self, config: Any) -> None: ...

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The hall with its actors at rest; the same for every trial."""
        ...

    def move(
        self, scene: Scene, actors: Sequence[ActorPlan], duration: float, root: int, trial: int, step_hz: int = 240, truth_hz: int = 120
    ) -> Truth:
        """Move the actors along their routes for `duration` s, physics at `step_hz`, poses kept at `truth_hz` (a divisor of it).

        A function of its arguments alone, bit for bit.
        """
        ...

    def caster(self, scene: Scene, engine: str, entry_db: Array, per_metre_db: Array) -> Caster:
        """The ray caster `engine` ("boxes" or "bullet") over the scene."""
        ...

    def close(self) -> None:
        """Give back what the world holds (a physics client)."""
        ...


class Renderer(Protocol):
    """Takes pictures of one scene."""

    def render(self, camera: Camera, poses: Array, cut: Collection[int] = (), smooth: int = 2) -> Image:
        """The scene with its moving bodies at `poses` (moving bodies, 7), in the order of `scene.moving`.

        Of the bodies `cut` (indices) only a stub on the floor is drawn. Colours are averaged over smooth x smooth samples a pixel.
        """
        ...

    def close(self) -> None:
        """Give back what it holds."""
        ...


@runtime_checkable
class PlaysBack(Protocol):
    """A world that was recorded: its trials are logs of real readers, and nothing in them is simulated."""

    def tagged(self) -> tuple[Tagged, Any]:
        """The tags that the logs speak of, and what is to be located (`testbed.tagging.Aims`)."""
        ...

    def played(self, trial: int) -> Trial:
        """One trial: a log, and the truth beside it."""
        ...


@runtime_checkable
class Renders(Protocol):
    """A world that can show its scenes."""

    def renderer(self, scene: Scene) -> Renderer:
        """ImportError, saying what to install, where nothing can be drawn on this machine."""
        ...


@runtime_checkable
class Remarks(Protocol):
    """A world made of somebody else's file, which says what became of it."""

    def notes(self) -> Sequence[str]:
        """Sentences: how many bodies, boxes and meshes there are, which of them are not what they should be, what was left out."""
        ...


@runtime_checkable
class MadeOfFiles(Protocol):
    """A world made of files: what they hold is part of what its figures depend on (`testbed.identity`)."""

    def files(self) -> Sequence[Path]:
        """Every file that it reads, those that others name among them. ValueError where one can't be used."""
        ...


# ---------------------------------------------------------------- sensors


@dataclass(frozen=True)
class Tagged:
    """The tags of a scene: what a data sheet says, and where each one truly is.

    body : (tags,) int, moving body in the truth, -1 for the world; pose : (tags, 7) in that body's frame
    """

    tags: Tags
    body: Array
    pose: Array


@dataclass(frozen=True)
class Surroundings:
    """What a sensor senses with: the scene, the motion, the tags, a ray caster, and the key of its random numbers.

    target_bodies : name of each target's body ("" for one that stands still); its place is `Odometry.carrier`
    target_tags   : indices of the tags that some target has: those that the stimulus speaks of
    """

    scene: Scene
    truth: Truth
    tagged: Tagged
    target_bodies: Sequence[str]
    target_tags: Array
    duration: float  # s
    caster: Caster
    root: int
    trial: int


@dataclass(frozen=True)
class Sensed:
    """What a sensor made of a trial: streams by kind, and what the world offered it, by name.

    shares : (value, weight) of things that are averaged over sensors ("line_of_sight"); rates : of things that add up
    asked_sets : (sets, tags) bool, the populations that its rounds name by `asked`; None where all tags are asked always
    """

    streams: Mapping[str, Table]
    shares: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    asked_sets: Array | None = None


class Sensor(Protocol):
    """A source of streams. Draws randomness only by name and counter from (root, trial, "sensors.<id>...")."""

    Config: type[BaseModel]
    produces: frozenset[str]

    def __init__(self, config: Any, id: str, scene: Scene) -> None: ...

    def antennas(self) -> Antennas:
        """The antennas this sensor brings to the site (none for odometry). Ids are unique over the scenario."""
        ...

    def frequencies(self) -> Array:
        """(C,) Hz: its hop table; empty where it has no radio."""
        ...

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """Streams of a whole trial. `first_antenna` is the index of this sensor's first antenna in the site."""
        ...


@runtime_checkable
class PlacesAnew(Protocol):
    """A sensor whose antennas stand elsewhere in each trial, as many as `antennas` lists and under the same ids."""

    def antennas_in(self, root: int, trial: int) -> Antennas:
        """Where they stand in one trial: a function of its arguments alone. The installer knows it."""
        ...


# ---------------------------------------------------------------- estimators


@runtime_checkable
class Estimator(Protocol):
    """Turns events into estimates for B rows (trial, target) at once.

    consumes : kinds of stream it wants ("reads", "odometry", ...); of the class, or of the object where its configuration decides.
    """

    Config: ClassVar[type[BaseModel]]
    consumes: frozenset[str]

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        """ValueError, with one clear sentence, for a site that the method can't work with."""
        ...

    def start(self, prior: Prior) -> None:
        """Forget everything; begin at the prior's rows, means and covariances."""
        ...

    def predict(self, t: Array) -> None:
        """Bring every row b to time t[b] >= its present time; idempotent at equal t."""
        ...

    def update(self, event: Event) -> UpdateInfo:
        """Take one entry for each row in `event.row`; called after `predict` to the entries' times."""
        ...

    def estimate(self) -> Estimate:
        """What each row believes now. Pure: calling it changes nothing."""
        ...


@runtime_checkable
class AcceptsLate(Protocol):
    """An estimator that takes events older than its rows' present time (by replay, or by a lagged state)."""

    accepts_late: ClassVar[bool]


@runtime_checkable
class HasParticles(Protocol):
    """An estimator that can show its particles."""

    def particles(self) -> tuple[Array, Array]:
        """Positions (B, N, 3) and normalised weights (B, N)."""
        ...


@runtime_checkable
class Decides(Protocol):
    """An estimator that announces events (in, out) of its rows."""

    def decisions(self) -> list[tuple[int, float, str, float]]:
        """(row, t, what, probability), in order, since `start`."""
        ...


@runtime_checkable
class Guide(Protocol):
    """An estimator that tells a person where to go next. It consumes "actions" (`testbed.guidance.Actions`), and reads if it likes."""

    def suggest(self) -> Advice:
        """What each row should do now, and in words why there is no direction where there is none. Pure."""
        ...


@runtime_checkable
class Smoother(Protocol):
    """An estimator that improves the past when the recording is over.

    smooths : whether it does under its configuration; then its track is what `smooth` says, not what it said on the way.
    """

    @property
    def smooths(self) -> bool: ...

    def smooth(self, t: Array) -> Sequence[Estimate]:
        """One estimate for each of the times t (K,) s, which are those that it was predicted to for its reports. Pure."""
        ...


class SingleTarget(ABC):
    """Base for a method written for one target: plain numbers in, plain arrays out; an adapter lifts it over rows.

    The driver makes one object a row. `self.rng` is the row's own numpy Generator.
    """

    Config: ClassVar[type[BaseModel]]
    consumes: ClassVar[frozenset[str]]
    components: ClassVar[tuple[str, ...]]

    def __init__(self, config: Any, site: Site, rng: np.random.Generator) -> None:
        self.config, self.site, self.rng = config, site, rng

    @classmethod
    def consumed(cls, config: Any) -> frozenset[str]:
        """What it consumes under a configuration: `consumes`, unless a method lets its configuration decide."""
        return cls.consumes

    @abstractmethod
    def start(self, t: float, mean: Array, covariance: Array) -> None:
        """Begin at time t (s) with the prior's mean (6,) and covariance (6, 6) over position and velocity."""

    @abstractmethod
    def predict(self, t: float) -> None:
        """Bring the state to time t; idempotent at equal t."""

    @abstractmethod
    def update(self, kind: str, data: Any) -> tuple[bool, float, float, int] | None:
        """Take one entry of a stream (scalars by the stream's field names).

        Returns (used, log-likelihood, NIS, degrees of freedom), or None for "used, nothing to say".
        """

    @abstractmethod
    def estimate(self) -> tuple[Array, Array, Status]:
        """Mean (n,), covariance (n, n) of `components`, and status. Pure."""


# ---------------------------------------------------------------- metrics


class Metric(Protocol):
    """A figure of merit of one row of a track against the truth."""

    Config: type[BaseModel]

    def __init__(self, config: Any) -> None: ...

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns by name ("position_error_m.mean"), each (B,), for a track whose rows all belong to `trial`.

        truth : (K, B, 6) true position and velocity at the track's times. NaN where a figure is undefined for a row.
        """
        ...
