"""A guided person: action, the world goes on, that segment is sensed, the guide is told, and says what to do next.

The only place that sees both the world and the guide. Each guide leads a person of its own and so makes its own data; guides are
paired by the initial world and by draws that are keyed by the number of the action (`testbed.guided.walkers`), not by a common
stream. All trials of a block walk together, a row each.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from testbed.columns import Array
from testbed.guidance import Actions, Advice
from testbed.guided.ears import Ear, Heard, PlainEar, StreamEar
from testbed.guided.ground import Ground
from testbed.guided.log import Log, actions_of, truth_of
from testbed.guided.radio import RadioEar
from testbed.guided.record import Walk
from testbed.guided.section import GuidedWalk, guided_actor
from testbed.guided.walkers import Walkers, started
from testbed.recording import Recording, Trial
from testbed.rng import Counter, RowRandom, keys_of
from testbed.scene import WORLD, Truth
from testbed.sensors.handheld import Handheld
from testbed.sensors.rfid import Rfid
from testbed.types import Event, Prior, Reads, Track, UpdateInfo

if TYPE_CHECKING:
    from testbed.scenario import Scenario, Section
    from testbed.scenario.model import ActorSection
    from testbed.simulate import Simulator


ON = 0.5  # m: of a step that nobody asked for


def check(scenario: Scenario, simulator: Simulator) -> None:
    """ScenarioError where a guided scenario can't be one: two people, not one tag, no reader, an estimator that can't guide."""
    from testbed.plugins import load

    people = [actor for actor in scenario.actors if actor.motion == "guided"]
    if len(people) > 1:
        raise scenario.problem(people[1].loc, f"{people[0].id!r} is guided already: a scenario has one guided person")
    aims = simulator.aims
    if len(aims.targets) != 1 or aims.body[0] != WORLD:
        raise scenario.problem(("targets",), "a guided person seeks one tag that stands still: name it under targets")
    _sensor(scenario, simulator)
    for section in scenario.estimators:
        if not hasattr(load("estimators", section.kind), "suggest"):
            raise scenario.problem((*section.loc, "kind"), f"{section.kind} is no guide: it can't say where to go")


def _person(scenario: Scenario) -> tuple[ActorSection, GuidedWalk]:
    """Who is guided, and how they follow. ValueError where nobody is."""
    actor = guided_actor(scenario)
    if actor is None or not isinstance(actor.route, GuidedWalk):
        raise ValueError(f"nobody is guided in {scenario.name}: give an actor motion guided")
    return actor, actor.route


def _sensor(scenario: Scenario, simulator: Simulator) -> Any:
    """The reader that the guided person carries; ScenarioError where there is none."""
    actor, _ = _person(scenario)
    for sensor in simulator.sensors:
        if isinstance(sensor, Handheld) and sensor.config.on == actor.id:
            return sensor
        if isinstance(sensor, Rfid) and actor.id in {str(c) for c in sensor.antennas().carrier}:
            return sensor
    message = f"{actor.id!r} carries no reader: add a handheld sensor, or an rfid one with an antenna on {actor.id}"
    raise scenario.problem(actor.loc, message)


def walk(
    scenario: Scenario,
    section: Section,
    method: type,
    simulator: Simulator,
    numbers: Sequence[int],
    particles: int = 0,
    keep: Sequence[int] = (),
) -> dict[int, tuple[Trial, Track]]:
    """Let the guide of `section` lead a person in each of the trials `numbers`, all of them together: what happened, and its track.

    particles : so many of each belief are kept in the tracks, of guides that have some
    keep      : trials whose motion is wanted in full; the truth of the others holds the walk alone
    """
    check(scenario, simulator)
    return _Loop(scenario, section, method, simulator, np.array(numbers, dtype=np.int64), particles).run(keep)


class _Loop:
    """One guide and the people whom it leads, B trials of them."""

    def __init__(self, scenario: Scenario, section: Section, method: Any, simulator: Simulator, numbers: Array, particles: int) -> None:
        self._scenario, self._simulator, self._numbers = scenario, simulator, numbers
        self._actor, self._config = _person(scenario)
        root = scenario.seed
        self._name = str(simulator.aims.targets.name[0])
        tags, plan = np.tile(simulator.aims.pose[0, :2], (len(numbers), 1)), simulator.plan(self._actor.id)
        start = started(self._config, root, numbers, self._actor.id, tags, plan.pose[:2], float(np.deg2rad(self._actor.yaw_deg)))
        self._people = Walkers(self._config, root, numbers, self._actor.id, tags, start)
        self._ear = self._listening()
        seeds = [Counter(root, int(n), f"estimators.{section.id}").bits(keys_of([self._name]))[0] for n in numbers]
        self._guide = method(section.config, simulator.site(root, int(numbers[0])), RowRandom(np.array(seeds, dtype=np.uint64)))
        self._log, self._ground = Log(self._people, particles), Ground(simulator.scene, self._config.room_m)
        self._side, self._walked_on = np.zeros(len(numbers), dtype=np.int64), np.zeros(len(numbers), dtype=np.int64)
        self._seconds = 0.0

    def _listening(self) -> Ear:
        sensor = _sensor(self._scenario, self._simulator)
        if isinstance(sensor, Rfid):
            return RadioEar(sensor, self._simulator, self._config, self._actor.id, self._numbers, self._people)
        arguments = (sensor.config, self._scenario.seed, self._numbers, sensor.id, self._people)
        return PlainEar(*arguments) if sensor.config.reports == "changes" else StreamEar(*arguments, self._config.pause_s)

    # ------------------------------------------------------------ the loop

    def run(self, keep: Sequence[int]) -> dict[int, tuple[Trial, Track]]:
        people, n, c = self._people, len(self._numbers), self._config
        rows, nothing = np.arange(n), np.zeros(n)
        self._guide.start(Prior(nothing, np.zeros((n, 6)), np.tile(np.eye(6), (n, 1, 1))))
        people.t[:] = c.pause_s
        hears = self._told(rows, "start", nothing, nothing, self._ear.heard(people, rows, nothing), nothing).copy()
        active = np.ones(n, dtype=bool)
        while active.any():
            advice = self._guide.suggest()
            self._log.aimed(advice)
            rows = np.flatnonzero(active)
            lost = rows[np.isnan(advice.turn[rows]) & (advice.step[rows] == 0)]  # there is no direction
            on = lost[~hears[lost] & (self._walked_on[lost] < c.walks_on)]
            ends = lost[~np.isin(lost, on)]
            active[ends] = False
            if len(ends):
                self._ended(ends, hears[ends], advice)
            if len(on):
                self._walked_on[on] += 1
                hears[on] = self._walk_on(on, advice)
            rows = np.setdiff1d(rows, lost)
            informed, round_it = self._informed(rows, advice, hears[rows] | advice.led[rows])
            turns = np.isfinite(advice.turn[rows]) | (informed != 0)
            if turns.any():
                hears[rows[turns]] = self._turned(rows[turns], informed[turns], advice)
                self._log.aimed(self._guide.suggest())
            stepping = rows[(hears[rows] | round_it | advice.led[rows]) & (advice.step[rows] > 0)]  # who goes round something sees the way
            steps = self._ground.free(people, stepping, advice.step[stepping])
            if (steps > 0).any():
                stepping, steps = stepping[steps > 0], steps[steps > 0]
                hears[stepping] = self._stepped(stepping, steps, advice)
                active[stepping[people.range(stepping) < c.found_m]] = False
            active &= (people.steps < c.most_steps) & (people.turns < c.most_turns) & (people.t < self._scenario.duration_s)
        self._log.aimed(self._guide.suggest())
        return self._result(set(keep))

    def _walk_on(self, rows: Array, advice: Advice) -> Array:
        """They walk on a little of their own accord, the freest way from where they look on, and say so. Whether the tag answers there."""
        people, step = self._people, np.full(len(rows), ON)
        turn = self._ground.round(people, rows, np.zeros(len(rows)), step, self._side)
        turning = rows[turn != 0]
        hears = np.zeros(len(rows), dtype=bool)
        if len(turning):
            hears[turn != 0] = self._turned(turning, turn[turn != 0], advice)
        free = self._ground.free(people, rows, step)
        if (free > 0).any():
            hears[free > 0] = self._stepped(rows[free > 0], free[free > 0], advice)
        return hears

    def _informed(self, rows: Array, advice: Advice, goes: Array) -> tuple[Array, Array]:
        """(R,) rad: the turns that people mean to take, and say so: what they were told, or another way where that one is not free; which.

        Whoever only turns to search turns as told, for a turn needs no room; `goes` (R,) are the others.
        """
        told = self._people.detoured(rows, np.nan_to_num(advice.turn[rows]))
        found = told.copy()
        found[goes] = self._ground.round(self._people, rows[goes], told[goes], advice.step[rows[goes]], self._side)
        return found, found != told

    def _turned(self, rows: Array, informed: Array, advice: Advice) -> Array:
        """They turn by what they say; whether they hear the tag then."""
        people, began = self._people, self._people.t[rows].copy()
        people.turn(rows, informed)
        return self._told(rows, "turn", informed, np.zeros(len(rows)), self._ear.heard(people, rows, began), began, advice)

    def _stepped(self, rows: Array, step: Array, advice: Advice) -> Array:
        """They step, shorter than they were told where something stands in the way, and say so. Whether the tag answers."""
        people = self._people
        before, began = people.place[rows].copy(), people.t[rows].copy()
        people.step(rows, step)
        self._ground.keep_out(people, rows, before)
        heard = self._ear.walked(people, rows, before, began)
        return self._told(rows, "step", np.zeros(len(rows)), step, heard, began, advice, np.hypot(*(people.place[rows] - before).T))

    def _told(
        self,
        rows: Array,
        kind: str,
        turn: Array,
        step: Array,
        heard: Heard,
        began: Array,
        advice: Advice | None = None,
        length: Array | None = None,
    ) -> Array:
        """Tell the guide of an action of some rows, with what was read during it, and write it down. Whether the tag answers (R,)."""
        t = self._people.t[rows].copy()
        change = np.full(len(rows), np.nan) if heard.change is None else heard.change
        actions = Actions(t, t, began, np.zeros(len(rows)), turn, step, heard.answers, change)
        begun = perf_counter()
        self._guide.predict(self._people.t.copy())
        if "reads" in self._guide.consumes:
            for event in in_ranks(rows, heard.reads):
                self._guide.update(event)
        info = self._guide.update(Event("actions", rows, actions))
        self._seconds += perf_counter() - begun
        length = np.zeros(len(rows)) if length is None else length
        found = (self._people.range(rows) < self._config.found_m) & (kind == "step")
        self._log.add(rows, kind, actions, heard, advice, length, found, self._guide, info)
        return np.asarray(heard.answers)

    def _ended(self, rows: Array, hears: Array, advice: Advice) -> None:
        """Their guide has no direction for them, and says why: the last thing that is written down of their walk."""
        t, zero = self._people.t[rows].copy(), np.zeros(len(rows))
        actions = Actions(t, t, t, zero, zero, zero, hears)
        nobody, info = np.zeros(len(rows), dtype=bool), UpdateInfo.accepted(len(rows))
        self._log.add(rows, "end", actions, Heard(hears), advice, zero, nobody, self._guide, info)

    # ------------------------------------------------------------ what came of it

    def _result(self, keep: set[int]) -> dict[int, tuple[Trial, Track]]:
        simulator, root, found = self._simulator, self._scenario.seed, {}
        site = simulator.site(root, int(self._numbers[0]))
        parts = self._log.split(self._numbers, self._name, self._seconds)
        for row, (number, (walked, track, reads)) in enumerate(zip(self._numbers.tolist(), parts, strict=True)):
            streams = {"actions": actions_of(walked), **({"reads": reads} if len(reads) else {})}
            recording = Recording(number, float(walked.t[-1]), site, streams, simulator.aims.targets, simulator.aims.tags)
            truth = simulator.at_rest().truth
            if number in keep:
                truth = self._truth(row, walked, recording.duration)
            stimulus = {"start_distance_m": float(walked.range[0]), "starts_readable": float(walked.heard[0])}
            found[number] = Trial(recording, truth, simulator.aims.body, simulator.aims.pose, stimulus, walked), track
        return found

    def _truth(self, row: int, walked: Walk, duration: float) -> Truth:
        """The motion of everything in a row's trial while the person walked."""
        if isinstance(self._ear, RadioEar):
            truth = self._ear.truth(row)
            last = int(np.searchsorted(truth.t, duration)) + 1
            return truth.with_(t=truth.t[:last], poses=truth.poses[:last], segment=truth.segment[:last], zone=truth.zone[:last])
        others = self._simulator.moved(int(self._numbers[row]), self._scenario.seed, duration).truth
        return truth_of(walked, others, self._actor.id, self._config.pause_s)


def in_ranks(rows: Array, reads: Sequence[Reads]) -> list[Event]:
    """The reads of some rows as events with at most one read a row: the k-th of every row together."""
    if not reads:
        return []
    row, nth = np.repeat(rows, [len(r) for r in reads]), np.concatenate([np.arange(len(r)) for r in reads])
    table = Reads.concatenate(list(reads))
    order = np.lexsort((row, nth))
    cuts = np.flatnonzero(np.diff(nth[order])) + 1
    return [Event("reads", row[part], table.take(part)) for part in np.split(order, cuts) if len(part)]
