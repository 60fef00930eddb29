"""From a scenario and a trial's number to what happened and what was heard: move first, sense after. No estimator in here."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from testbed import frames
from testbed.columns import Array, Table
from testbed.known_tags import references
from testbed.plugins import load
from testbed.protocols import ActorPlan, PlacesAnew, PlaysBack, Remarks, Sensed, Sensor, Surroundings, World
from testbed.quantity import FileMissing, Misplaced, UnusableFile
from testbed.radio.materials import MATERIALS, losses
from testbed.recording import Recording, Trial
from testbed.report.cameras import mistakes
from testbed.rng import Counter, keys_of
from testbed.route import Route
from testbed.scenario.problems import DataMissing
from testbed.scenario.reporting import mistakes as unfit
from testbed.scene import WORLD, Scene, Truth
from testbed.tagging import choose_targets, place_tags
from testbed.types import Antennas, Site

if TYPE_CHECKING:
    from testbed.scenario import Scenario


class Simulator:
    """Makes the trials of one scenario. Holds the world, so use it as a context manager; one a process.

    Raises ScenarioError where the scenario asks for something that its world does not have (a tag on a body that isn't
    there, an antenna on a mount that isn't there). With `rays` false no caster is made: enough to check a scenario, not to run it.
    """

    def __init__(self, scenario: Scenario, rays: bool = True) -> None:
        self.scenario = scenario
        self._actors = [_plan(section) for section in scenario.actors]
        self._world: World = load("worlds", scenario.world.kind)(scenario.world.config)
        try:
            self.scene: Scene = self._furnished()
            if isinstance(self._world, PlaysBack):
                self.tagged, self.aims = self._world.tagged()
            else:
                self.tagged, on = place_tags(scenario, self.scene)
                self.aims = choose_targets(scenario, self.scene, self.tagged, on)
            self.sensors = [self._sensor(section) for section in scenario.sensors]
            self._references = references(scenario, self.tagged)
            self._check_radios()
            self._check_cameras()
            self._check_report()
            materials = self._losses()
            self._caster = self._world.caster(self.scene, scenario.rays, *materials) if rays else None
        except BaseException:
            self._world.close()
            raise

    @property
    def notes(self) -> tuple[str, ...]:
        """What the world has to say of the file that it was made of."""
        return tuple(self._world.notes()) if isinstance(self._world, Remarks) else ()

    def _furnished(self) -> Scene:
        """The world's scene. ScenarioError for a file that it can't be made of; DataMissing where that isn't on this machine."""
        try:
            return self._world.scene(self._actors)
        except FileMissing as error:
            raise DataMissing([self.scenario.source.problem(self.scenario.world.loc, str(error))]) from None
        except UnusableFile as error:
            raise self.scenario.problem(self.scenario.world.loc, str(error)) from None

    def _sensor(self, section: Any) -> Sensor:
        try:
            return load("sensors", section.kind)(section.config, section.id, self.scene)
        except ValueError as error:
            beneath = error.place if isinstance(error, Misplaced) else ()
            raise self.scenario.problem((*section.loc, *beneath), str(error)) from None

    def _losses(self) -> tuple[Array, Array]:
        """What the scene's materials take; for one that nobody knows the blame is on the actor that is made of it, or the world."""
        try:
            return losses(self.scene.materials)
        except ValueError as error:
            known = np.array([name in MATERIALS for name in self.scene.materials])
            bodies = self.scene.boxes.body[~known[self.scene.boxes.material]]
            made_of = {self.scene.bodies[body].name for body in bodies if body != WORLD}
            loc = next((actor.loc for actor in self.scenario.actors if actor.id in made_of), self.scenario.world.loc)
            raise self.scenario.problem(loc, str(error)) from None

    def _check_radios(self) -> None:
        """One hop table for the site, and every antenna under a name of its own."""
        taken: dict[str, str] = {}
        table: Array | None = None
        for section, sensor in zip(self.scenario.sensors, self.sensors, strict=True):
            for id in sensor.antennas().id:
                if id in taken:
                    raise self.scenario.problem(section.loc, f"antenna {str(id)!r} belongs to {taken[id]!r} already")
                taken[id] = section.id
            frequencies = sensor.frequencies()
            if len(frequencies):
                if table is not None and not np.array_equal(table, frequencies):
                    raise self.scenario.problem(section.loc, "its carriers differ from another reader's: one site has one region")
                table = frequencies

    def _check_report(self) -> None:
        asked = self.scenario.report.coverage
        readers = [section.id for section in self.scenario.sensors if section.kind == "rfid"]
        for field, message in unfit(asked, self.scene.bounds, readers) if asked else ():
            raise self.scenario.problem(("report", "coverage", field), message)

    def _check_cameras(self) -> None:
        for i, camera in enumerate(self.scenario.cameras):
            for field, message in mistakes(camera, self.scene, self.scenario.duration_s):
                raise self.scenario.problem(("cameras", i, field), message)

    def plan(self, id: str) -> ActorPlan:
        """The plan of the actor with this id. KeyError where there is none."""
        return {plan.id: plan for plan in self._actors}[id]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Give back the physics client, if there is one."""
        self._world.close()

    def trial(self, index: int, seed: int | None = None) -> Trial:
        """One trial, a function of (scenario, seed, index) alone. `seed` is the scenario's where left out."""
        if isinstance(self._world, PlaysBack):
            return self._world.played(index)
        return self._sensed(self.moved(index, seed))

    def moved(self, index: int, seed: int | None = None, duration: float | None = None) -> Surroundings:
        """A trial before anything senses it: what its sensors are given. `duration` (s) is the scenario's where left out."""
        scenario, root = self.scenario, self.scenario.seed if seed is None else seed
        truth = self._world.move(
            self.scene, self._actors, duration or scenario.duration_s, root, index, step_hz=scenario.step_hz, truth_hz=scenario.truth_hz
        )
        return self._surroundings(truth, root, index)

    def at_rest(self) -> Surroundings:
        """The hall before any trial: every body where the scenario puts it, nothing drawn, nothing moved; time is 0."""
        poses = self.scene.rest_poses()[self.scene.moving]
        return self._surroundings(Truth(t=np.zeros(1), poses=poses[None], bodies=self.scene.moving_names), self.scenario.seed, 0)

    def _sensed(self, around: Surroundings) -> Trial:
        scenario, sensed, first = self.scenario, [], 0
        for sensor in self.sensors:
            sensed.append(sensor.sense(around, first))
            first += len(sensor.antennas())
        recording = Recording(
            trial=around.trial,
            duration=scenario.duration_s,
            site=self.site(around.root, around.trial),
            streams=_merged(sensed),
            targets=self.aims.targets,
            target_tags=self.aims.tags,
            asked_sets=_asked_sets(sensed, len(self.tagged.tags)),
        )
        stimulus = _stimulus([s.id for s in scenario.sensors], sensed)
        return Trial(recording, around.truth, self.aims.body, self.aims.pose, stimulus)

    def _surroundings(self, truth: Truth, root: int, index: int) -> Surroundings:
        if self._caster is None:
            raise RuntimeError("this simulator was made without rays: it can check a scenario, not run it")
        target_tags = np.unique(np.concatenate([*self.aims.tags, np.empty(0, dtype=np.int32)]))
        return Surroundings(
            scene=self.scene,
            truth=truth,
            tagged=self.tagged,
            target_bodies=[str(body) for body in self.aims.targets.body],
            target_tags=target_tags,
            duration=self.scenario.duration_s,
            caster=self._caster,
            root=root,
            trial=index,
        )

    def site(self, root: int, index: int) -> Site:
        """What an installer would know, with this trial's survey error."""
        antennas = Antennas.concatenate([_antennas(sensor, root, index) for sensor in self.sensors])
        radios = [f for f in (sensor.frequencies() for sensor in self.sensors) if len(f)]
        return Site(
            antennas=_surveyed(antennas, self.scenario.survey, root, index),
            tags=self.tagged.tags,
            frequencies=radios[0] if radios else np.empty(0),
            references=self._references,
            obstacles=self.scene.static_boxes(),
            roads=self.scene.roads,
        )


def _antennas(sensor: Sensor, root: int, trial: int) -> Antennas:
    return sensor.antennas_in(root, trial) if isinstance(sensor, PlacesAnew) else sensor.antennas()


def _plan(section: Any) -> ActorPlan:
    x, y = section.position_m or (section.route.waypoints_m[0] if isinstance(section.route, Route) else (0.0, 0.0))
    pose = np.concatenate([[x, y, 0.0], frames.from_euler(np.deg2rad(section.yaw_deg))])
    actor = load("actors", section.kind)(section.config)
    return ActorPlan(section.id, section.kind, section.motion, actor, section.route, pose)


def _surveyed(antennas: Antennas, survey: Any, root: int, index: int) -> Antennas:
    """Antennas as a survey finds them: each place and yaw off by a draw keyed by the antenna's own id."""
    if not len(antennas) or (survey.antenna_position_std_m == 0 and survey.antenna_yaw_std_deg == 0):
        return antennas
    draws, keys = Counter(root, index, "survey.antennas"), keys_of(antennas.id)
    off = survey.antenna_position_std_m * draws.normal(keys[:, None], np.arange(3))
    turn = frames.from_euler(np.deg2rad(survey.antenna_yaw_std_deg) * draws.normal(keys, np.int64(3)))
    return antennas.with_(position=antennas.position + off, quaternion=frames.multiply(turn, antennas.quaternion))


def _merged(sensed: list[Sensed]) -> dict[str, Table]:
    """Streams of all sensors by kind, in order of arrival. Rounds keep their numbers apart from one sensor to the next."""
    kinds = list(dict.fromkeys(kind for s in sensed for kind in s.streams))
    merged: dict[str, Table] = {}
    apart = _apart(sensed)
    for kind in kinds:
        parts: list[Any] = [streams[kind] for streams in apart if kind in streams]
        table = type(parts[0]).concatenate(parts)
        arrival: Array | None = getattr(table, "t_arrival", None)
        merged[kind] = table if arrival is None else table.take(np.argsort(arrival, kind="stable"))
    return merged


def _apart(sensed: list[Sensed]) -> list[dict[str, Any]]:
    """Streams of each sensor, with numbers of rounds, readers and asked sets that mean one thing over all sensors.

    Round k of the r-th of R sensors that have rounds becomes k·R + r.
    """
    found, sets, readers, place = [], 0, 0, 0
    with_rounds = sum("rounds" in s.streams for s in sensed)
    for s in sensed:
        streams: dict[str, Any] = dict(s.streams)
        if "rounds" in streams:
            rounds: Any = streams["rounds"]
            for kind in ("rounds", "counts"):
                if kind in streams:
                    streams[kind] = streams[kind].with_(round=streams[kind].round * with_rounds + place)
            streams["rounds"] = streams["rounds"].with_(asked=rounds.asked + sets, reader=rounds.reader + readers)
            readers, place = readers + int(rounds.reader.max(initial=-1)) + 1, place + 1
            sets += len(_sets_of(s, 1))
        found.append(streams)
    return found


def _asked_sets(sensed: list[Sensed], tags: int) -> Array:
    """(sets, tags) bool: the populations of all sensors that have rounds, one after another."""
    return np.concatenate([np.ones((0, tags), dtype=bool), *(_sets_of(s, tags) for s in sensed if "rounds" in s.streams)])


def _sets_of(sensed: Sensed, tags: int) -> Array:
    return np.ones((1, tags), dtype=bool) if sensed.asked_sets is None else sensed.asked_sets


def _stimulus(ids: list[str], sensed: list[Sensed]) -> dict[str, float]:
    """Each sensor's figures as "<sensor>.<name>", and of all sensors together as "<name>": shares averaged by weight, rates added."""
    found: dict[str, float] = {}
    for id, s in zip(ids, sensed, strict=True):
        found |= {f"{id}.{name}": float(value) for name, (value, _) in s.shares.items()}
        found |= {f"{id}.{name}": float(value) for name, value in s.rates.items()}
    for name in dict.fromkeys(name for s in sensed for name in s.shares):
        pairs = [s.shares[name] for s in sensed if name in s.shares and s.shares[name][1] > 0]
        weight = sum(w for _, w in pairs)
        found[name] = float(sum(v * w for v, w in pairs) / weight) if weight else float("nan")
    for name in dict.fromkeys(name for s in sensed for name in s.rates):
        found[name] = float(sum(s.rates.get(name, 0.0) for s in sensed))
    return found
