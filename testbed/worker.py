"""What a worker does: a block of trials of one point, from simulation to rows of figures. Nothing here knows of files or processes.

A trial that fails, fails alone, and an estimator that fails loses its own rows only. Blocks are the same whatever the number of
jobs, since the trials of a block share the estimators' calls: so every number is the same, too.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from testbed import archive
from testbed.columns import Array
from testbed.estimate import row_seeds, run
from testbed.evaluate import Rows, score
from testbed.guided.section import guided_actor
from testbed.plugins import BrokenPlugin, UnknownPlugin, load
from testbed.prior import draw_prior
from testbed.protocols import Metric
from testbed.recording import Trial
from testbed.scenario import Scenario, ScenarioError, Section
from testbed.simulate import Simulator
from testbed.types import Track

HASH_SHOWN = 16  # hex digits of a hash in a row; the manifest has the whole
PARTICLES = 100  # of each belief that recordings keep, for the report's player
BAD_INPUT = (ScenarioError, UnknownPlugin, BrokenPlugin, archive.StoreError)  # these stop the run; all else is a trial's own failure


@dataclass(frozen=True)
class Block:
    """A piece of work: some trials of one point of the sweep.

    scenario : the point's, pickled once for all of its blocks
    keep     : trials whose recording is saved under `folder`; with keep_failed also those in which an estimator fails
    only     : ids of the estimators to run, None for all; where a guide leads, all are
    versions : of what makes the rows, as it stands in them
    """

    scenario: bytes
    point: int
    trials: tuple[int, ...]
    folder: Path | None = None
    keep: tuple[int, ...] = ()
    keep_failed: bool = False
    only: tuple[str, ...] | None = None
    versions: str = ""

    def alone(self, trial: int) -> Block:
        """The same work for one trial of it."""
        return replace(self, trials=(trial,))


@dataclass(frozen=True)
class Failure:
    """What went wrong in a trial: at which stage ("simulate", "estimate", "score", "worker"), with which estimator ("" for the trial)."""

    point: int
    trial: int
    estimator: str
    stage: str
    error: str
    traceback: str


@dataclass(frozen=True)
class BlockResult:
    """What came of a block: rows as `testbed.evaluate` wants them, the world's stimuli, wall times, failures, remarks for the log."""

    point: int
    trials: tuple[int, ...]
    rows: Rows = field(default_factory=dict)
    world: Rows = field(default_factory=dict)
    timings: Rows = field(default_factory=dict)
    failures: tuple[Failure, ...] = ()
    notes: tuple[str, ...] = ()


def stack(tables: Sequence[Rows]) -> dict[str, Array]:
    """Rows under rows. A number that a table has no column for is NaN, a text is empty."""
    tables = [t for t in tables if t]
    kinds = {name: column.dtype for table in reversed(tables) for name, column in table.items()}
    order = dict.fromkeys(name for table in tables for name in table)
    lengths = [len(next(iter(t.values()))) for t in tables]

    def filled(name: str, table: Rows, n: int) -> Array:
        return table[name] if name in table else np.full(n, "" if kinds[name].kind == "U" else np.nan)

    return {name: np.concatenate([filled(name, t, n) for t, n in zip(tables, lengths, strict=True)]) for name in order}


def joined(results: Sequence[BlockResult]) -> BlockResult:
    """Results of one point as one, in the order given."""
    return BlockResult(
        point=results[0].point,
        trials=tuple(t for r in results for t in r.trials),
        rows=stack([r.rows for r in results]),
        world=stack([r.world for r in results]),
        timings=stack([r.timings for r in results]),
        failures=tuple(f for r in results for f in r.failures),
        notes=tuple(n for r in results for n in r.notes),
    )


# ---------------------------------------------------------------- a block


class _Open:
    """The simulator that this process holds: one, of the scenario that it last worked on."""

    key: bytes = b""
    scenario: Scenario | None = None
    simulator: Simulator | None = None


def close() -> None:
    """Give back what the process holds."""
    simulator, _Open.simulator = _Open.simulator, None
    if simulator is not None:
        simulator.close()


def _scenario(block: Block) -> Scenario:
    scenario = _Open.scenario
    if scenario is None or _Open.key != block.scenario:
        close()
        scenario = pickle.loads(block.scenario)
        _Open.key, _Open.scenario = block.scenario, scenario
    return scenario


def run_block(block: Block) -> BlockResult:
    """Simulate, estimate and score the trials of a block, and save the recordings asked for.

    Raises what says that the input as a whole is bad (`BAD_INPUT`); a failure of a trial is in the result.
    """
    scenario, work = _scenario(block), Work(block)
    if guided_actor(scenario) is not None:
        return run_guided(block, scenario, work)
    trials = [trial for number in block.trials if (trial := work.simulated(scenario, number)) is not None]
    sections = [s for s in scenario.estimators if block.only is None or s.id in block.only]
    tracks = {section.id: work.estimated(scenario, section, trials) for section in sections}
    metrics: dict[str, Metric] = {s.id: load("metrics", s.kind)(s.config) for s in scenario.metrics}
    rows, worlds = [], []
    for trial in trials:
        number, seed = trial.recording.trial, scenario.seed
        world = {"point": block.point, "trial": number, "seed": seed, **trial.stimulus}
        worlds.append({name: np.array([value]) for name, value in world.items()})
        for section in sections:
            if number in tracks[section.id]:
                rows.append(work.scored(scenario, section, tracks[section.id][number], trial, metrics))
        failed = any(f.trial == number for f in work.failures)
        if block.folder is not None and (number in block.keep or (failed and block.keep_failed)):
            found = {id: by_trial[number] for id, by_trial in tracks.items() if number in by_trial}
            simulator = work.simulator(scenario)
            archive.save(archive.place(block.folder, block.point, number), trial, found, simulator.scene, simulator.tagged)
    order = {section.id: i for i, section in enumerate(scenario.estimators)}
    failures = sorted(work.failures, key=lambda f: (f.trial, order.get(f.estimator, -1)))
    return BlockResult(block.point, block.trials, stack(rows), stack(worlds), stack(work.timings), tuple(failures), tuple(work.notes))


def run_guided(block: Block, scenario: Scenario, work: Work) -> BlockResult:
    """Let every guide lead a person in the trials of a block, and score and keep what came of it: each guide has trials of its own."""
    own = {section.id: work.walked(scenario, section, block.trials, block.keep) for section in scenario.estimators}
    metrics: dict[str, Metric] = {s.id: load("metrics", s.kind)(s.config) for s in scenario.metrics}
    rows, worlds = [], []
    for number in block.trials:
        there = {id: found[number] for id, found in own.items() if number in found}
        if not there:
            continue
        first = next(iter(there.values()))[0]
        world = {"point": block.point, "trial": number, "seed": scenario.seed, **first.stimulus}
        worlds.append({name: np.array([value]) for name, value in world.items()})
        rows += [work.scored(scenario, s, there[s.id][1], there[s.id][0], metrics) for s in scenario.estimators if s.id in there]
        failed = any(f.trial == number for f in work.failures)
        if block.folder is not None and (number in block.keep or (failed and block.keep_failed)):
            id, simulator = next(iter(there)), work.simulator(scenario)
            others = {other: found for other, found in there.items() if other != id}
            place = archive.place(block.folder, block.point, number)
            archive.save(place, first, {id: there[id][1]}, simulator.scene, simulator.tagged, others)
    return BlockResult(block.point, block.trials, stack(rows), stack(worlds), stack(work.timings), tuple(work.failures), tuple(work.notes))


class Work:
    """One block on its way: its failures, wall times and remarks so far."""

    def __init__(self, block: Block) -> None:
        self._point, self._versions = block.point, block.versions
        self._particles = PARTICLES if block.keep else 0
        self.failures: list[Failure] = []
        self.timings: list[Rows] = []
        self.notes: list[str] = []

    def simulator(self, scenario: Scenario) -> Simulator:
        if _Open.simulator is None:
            _Open.simulator = Simulator(scenario)
        return _Open.simulator

    def simulated(self, scenario: Scenario, number: int) -> Trial | None:
        begun = perf_counter()
        try:
            trial = self.simulator(scenario).trial(number, scenario.seed)
        except BAD_INPUT:
            raise
        except Exception as error:
            self._fail(number, "", "simulate", error)
            close()  # whatever state the world is in now, the next trial begins with a new one
            return None
        self._time(number, "", [""], "simulate", np.array([perf_counter() - begun]), np.zeros(1))
        return trial

    def walked(self, scenario: Scenario, section: Section, numbers: Sequence[int], keep: Sequence[int]) -> dict[int, tuple[Trial, Track]]:
        """The trials under one guide, and its tracks: all together, or, where that fails, one by one."""
        from testbed.closed_loop import walk  # it stands on the simulator and on what scores, as this module does

        try:
            simulator = self.simulator(scenario)
            found = walk(scenario, section, load("estimators", section.kind), simulator, numbers, self._particles, keep)
        except BAD_INPUT:
            raise
        except Exception as error:
            together = error
        else:
            for number, (_, track) in found.items():
                self._time(number, section.id, track.target, "update", track.update_seconds, track.used + track.refused)
            return found
        if len(numbers) == 1:
            self._fail(numbers[0], section.id, "estimate", together)
            return {}
        alone = [self.walked(scenario, section, [number], keep) for number in numbers]
        return {number: one for found in alone for number, one in found.items()}

    def estimated(self, scenario: Scenario, section: Section, trials: list[Trial]) -> dict[int, Track]:
        """The tracks by trial: of all together, or, where that fails, one by one, so that only the guilty ones are lost."""
        if not trials:
            return {}
        numbers = [trial.recording.trial for trial in trials]
        try:
            return self._tracks(scenario, section, trials)
        except BAD_INPUT:
            raise
        except Exception as error:
            together = error
        # outside of the handler, so that a trial's own traceback does not carry that of all together
        if len(trials) == 1:
            self._fail(numbers[0], section.id, "estimate", together)
            return {}
        before = len(self.failures)
        alone = [self.estimated(scenario, section, [trial]) for trial in trials]
        if len(self.failures) == before:
            self.notes.append(f"{section.id} fails on trials {numbers[0]} to {numbers[-1]} together and on none alone: {_said(together)}")
        return {number: track for found in alone for number, track in found.items()}

    def _tracks(self, scenario: Scenario, section: Section, trials: list[Trial]) -> dict[int, Track]:
        recordings = [trial.recording for trial in trials]
        together = run(
            recordings,
            load("estimators", section.kind),
            section.config,
            draw_prior(scenario.prior, trials, scenario.seed),
            row_seeds(scenario.seed, recordings, section.id),
            report_hz=scenario.report_hz,
            hold_s=scenario.hold_s,
            particles=self._particles,
        )
        tracks = {r.trial: together.take(np.flatnonzero(together.trial == r.trial)) for r in recordings}
        for number, track in tracks.items():
            self._time(number, section.id, track.target, "update", track.update_seconds, track.used + track.refused)
        return tracks

    def scored(self, scenario: Scenario, section: Section, track: Track, trial: Trial, metrics: dict[str, Metric]) -> Rows:
        number = trial.recording.trial
        try:
            columns = score(track, trial, metrics)
        except Exception as error:
            self._fail(number, section.id, "score", error)
            return {}
        keys: dict[str, Any] = {"point": self._point, "trial": number, "estimator": section.id, "target": columns.pop("target")}
        keys |= {
            "seed": scenario.seed,
            "kind": section.kind,
            "config": config_hash(section)[:HASH_SHOWN],
            "scenario": scenario.hash[:HASH_SHOWN],
            "versions": self._versions,
        }
        return {**{name: np.broadcast_to(value, len(track.target)) for name, value in keys.items()}, **columns}

    def _fail(self, trial: int, estimator: str, stage: str, error: Exception) -> None:
        trace = "".join(traceback.format_exception(error))
        self.failures.append(Failure(self._point, trial, estimator, stage, _said(error), trace))

    def _time(self, trial: int, estimator: str, targets: Any, stage: str, seconds: Array, updates: Array) -> None:
        per_update = np.divide(seconds, updates, out=np.full(len(seconds), np.nan), where=updates > 0)
        keys = {"point": self._point, "trial": trial, "estimator": estimator, "target": np.asarray(targets), "stage": stage}
        columns = {"seconds": seconds, "updates": updates.astype(np.int64), "seconds_per_update": per_update}
        self.timings.append({**{name: np.broadcast_to(value, len(seconds)) for name, value in keys.items()}, **columns})


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0]


def config_hash(section: Section) -> str:
    """sha256 (hex) of a section's whole configuration, defaults included."""
    content = json.dumps(section.config.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


RunBlock = Callable[[Block], BlockResult]
