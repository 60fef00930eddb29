"""A whole study: the points of a sweep × trials, in fixed blocks, through an executor, into figures, claims and a folder.

The same scenario gives the same tables, value by value, whatever the number of jobs and however often it was interrupted.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from testbed import archive, pool, worker
from testbed.evaluate import KEYS, ClaimResult, Interval, Rows, Summary, check_claims, mean_interval, metric_columns, plain, summarise
from testbed.keep import DEFAULT, Keep, predict_size
from testbed.manifest import describe, differences, rebuilt
from testbed.progress import Progress, Silent
from testbed.published import compare
from testbed.published import document as published_document
from testbed.recording import Trial
from testbed.scenario import Scenario
from testbed.store import Store, StoreError, read_manifest
from testbed.types import Track
from testbed.worker import Block, BlockResult, Failure, RunBlock, joined, run_block


class Interrupted(Exception):
    """Ctrl-C in the middle of a run: what was finished is kept. The message says how to go on."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """What a run found.

    rows, world, timings : the tables of the output folder, by column (`testbed.evaluate.Rows`)
    world_means          : by point and stimulus, the mean over trials
    folder               : where it is written, None where it is not
    """

    scenario: Scenario
    rows: Rows
    world: Rows
    timings: Rows
    failures: tuple[Failure, ...]
    summaries: tuple[Summary, ...]
    world_means: dict[int, dict[str, Interval]]
    claims: tuple[ClaimResult, ...]
    folder: Path | None = None

    def __str__(self) -> str:
        """What `testbed run` prints."""
        from testbed.console import text  # rich, only where somebody looks

        return text(self)

    def __repr__(self) -> str:
        found = {s.estimator: s.statistics.get("position_error_m.mean") for s in self.summaries if s.point == 0}
        errors = ", ".join(f"{id} {i.mean:.3g} m" for id, i in found.items() if i is not None)
        held = f"{sum(claim.ok for claim in self.claims)} of {len(self.claims)} claims hold"
        return f"<RunResult {self.scenario.name}: {self.scenario.trials} trials, {len(self.failures)} failures, {held}; {errors}>"

    @property
    def ok(self) -> bool:
        """Every claim holds, and no trial failed."""
        return not self.failures and all(claim.ok for claim in self.claims)

    def document(self) -> dict[str, Any]:
        """What `testbed run --json` prints. Failures are listed without their tracebacks, which failures.parquet holds."""
        points = [
            {
                "set": point.set,
                "estimators": {s.estimator: s.document() for s in self.summaries if s.point == point.index},
                "world": {name: plain(mean.mean) for name, mean in self.world_means[point.index].items()},
            }
            for point in self.scenario.points()
        ]
        return {
            "scenario": self.scenario.name,
            "hash": self.scenario.hash,
            "seed": self.scenario.seed,
            "trials": self.scenario.trials,
            "points": points,
            "expect": [claim.document() for claim in self.claims],
            "published": published_document(compare(self.scenario.published, self.rows, self.world), [point["set"] for point in points]),
            "failures": [
                {"point": f.point, "trial": f.trial, "estimator": f.estimator, "stage": f.stage, "error": f.error} for f in self.failures
            ],
            "ok": self.ok,
        }


@dataclass(frozen=True)
class Rerun:
    """One trial made again: its rows, what happened in it, and each estimator's track. trial is None where it can't be simulated.

    changed says in what the code or the libraries differ from the run's own: then the numbers may, too.
    """

    rows: Rows
    trial: Trial | None
    tracks: dict[str, Track]
    failures: tuple[Failure, ...]
    changed: str


def run(
    scenario: Scenario,
    *,
    out: Path | None = None,
    jobs: int | Literal["auto"] = 1,
    keep: str = DEFAULT,
    resume: bool = False,
    force: bool = False,
    command: Sequence[str] = (),
    progress: Progress | None = None,
    executors: pool.ExecutorFactory | None = None,
    work: RunBlock = run_block,
) -> RunResult:
    """Run all trials of a scenario at every point of its sweep, and judge its claims.

    out       : the output folder; without one nothing is written and no recording is kept
    jobs      : processes, "auto" for one a core. executors: another way of making some (given their number) than processes here
    keep      : "none", "all", or some of "failed", "first:N", "worst:N" with commas between them
    resume    : go on in `out` where an earlier run of the same scenario stopped, with more trials if wanted
    force     : replace the run in `out`
    command   : the words that started it, for the manifest

    A trial that fails is in `failures`, the rest go on. Raises ScenarioError and the like for bad input, StoreError where the
    disk refuses, Interrupted on Ctrl-C, pool.CannotStart.
    """
    count = pool.cores() if jobs == "auto" else jobs
    if count < 1:
        raise ValueError(f"jobs must be at least 1, not {count}")
    rule, progress = Keep.parse(keep), progress or Silent()
    if out is None:
        return _Run(scenario, None, rule, count, progress, executors, work).result()
    with Store(out, describe(scenario, keep, command), resume=resume, force=force) as store:
        _check_room(store, scenario, rule, progress)
        return _Run(scenario, store, rule, count, progress, executors, work).result()


def blocks_of(trials: int, size: int = 4) -> list[tuple[int, ...]]:
    """Trials 0 to `trials` - 1 in blocks of `size`: the same ones for any number of jobs."""
    return [tuple(range(a, min(a + size, trials))) for a in range(0, trials, size)]


def _check_room(store: Store, scenario: Scenario, rule: Keep, progress: Progress) -> None:
    size, free = predict_size(scenario, rule), store.free_bytes()
    store.log("start", trials=scenario.trials, points=len(scenario.points()), recordings_bytes_about=size, free_bytes=free)
    if size > free:
        raise StoreError(f"the recordings to keep need about {size / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: keep fewer with --keep")
    if size > 1e8:
        progress.note(f"the recordings kept will take about {size / 1e9:.1f} GB")


class _Run:
    """One call of `run` on its way."""

    def __init__(
        self,
        scenario: Scenario,
        store: Store | None,
        rule: Keep,
        jobs: int,
        progress: Progress,
        executors: pool.ExecutorFactory | None,
        work: RunBlock,
    ) -> None:
        self._scenario, self._store, self._rule = scenario, store, rule
        self._jobs, self._progress, self._executors, self._work = jobs, progress, executors, work
        self._parts: dict[tuple[int, tuple[int, ...]], BlockResult] = {}  # what is done: all of it without a store

    def result(self) -> RunResult:
        blocks = self._blocks()
        missing = [block for block in blocks if not self._have(block)]
        total = sum(len(block.trials) for block in blocks)
        self._done = total - sum(len(block.trials) for block in missing)
        self._progress.start(self._scenario.name, total, self._done)
        try:
            with pool.one_thread_each():
                self._make(missing)
                whole = self._whole(blocks)
                self._keep_worst(blocks, whole.rows)
        except KeyboardInterrupt:
            raise self._interrupted(total) from None
        finally:
            self._progress.finish()
        if self._store:
            self._store.log("finished", trials=total, failures=len(whole.failures))
        return _judged(self._scenario, whole, self._store.folder if self._store else None)

    def _blocks(self) -> list[Block]:
        """All blocks, point by point."""
        first = set(self._rule.chosen(self._scenario.trials))
        folder = self._store.folder.resolve() if self._store else None
        found = []
        for point in self._scenario.points():
            content = pickle.dumps(point.scenario)
            for trials in blocks_of(self._scenario.trials, self._scenario.block):
                keep = tuple(sorted(first & set(trials)))
                found.append(Block(content, point.index, trials, folder, keep, self._rule.failed))
        return found

    def _have(self, block: Block) -> bool:
        """Whether a block is done already, the recordings asked for included (of trials that could be simulated)."""
        result = self._store.get(block.point, block.trials) if self._store else None
        if self._store is None or result is None:
            return False
        gone = {f.trial for f in result.failures if f.stage in ("simulate", "worker")}
        return all(archive.place(self._store.folder, block.point, trial).is_dir() for trial in block.keep if trial not in gone)

    def _make(self, blocks: Sequence[Block]) -> None:
        with closing(pool.results(blocks, self._work, self._jobs, self._executors)) as found:
            for block, result in found:
                if self._store:
                    self._store.put(result)
                    self._log(result, self._store)
                else:
                    self._parts[block.point, block.trials] = result
                self._done += len(block.trials)
                self._progress.advance(len(block.trials), len(result.failures))

    def _log(self, result: BlockResult, store: Store) -> None:
        for note in result.notes:
            store.log("note", point=result.point, note=note)
            self._progress.note(note)
        for f in result.failures:
            store.log("failure", point=f.point, trial=f.trial, estimator=f.estimator, stage=f.stage, error=f.error)

    def _whole(self, blocks: Sequence[Block]) -> BlockResult:
        if self._store:
            return self._store.merge((block.point, block.trials) for block in blocks)
        return joined([self._parts[key] for key in sorted(self._parts)])

    def _keep_worst(self, blocks: Sequence[Block], rows: Rows) -> None:
        """Make the worst trials again to keep their recordings: which they are is known only now, and they come out the same."""
        if not self._store or not self._rule.worst:
            return
        again = []
        for block in blocks:
            wanted = [t for t in self._rule.worst_of(rows, block.point) if t in block.trials]
            new = [t for t in wanted if not archive.place(self._store.folder, block.point, t).is_dir()]
            if new:
                again.append(replace(block, keep=tuple(sorted(new)), keep_failed=False))
        with closing(pool.results(again, self._work, self._jobs, self._executors)) as found:
            for _ in found:
                pass

    def _interrupted(self, total: int) -> Interrupted:
        if self._store is None:
            return Interrupted("interrupted; without an output folder nothing is kept")
        self._store.log("interrupted", trials=self._done)
        return Interrupted(f"interrupted: {self._done} of {total} trials are kept in {self._store.folder}; continue with --resume")


def _judged(scenario: Scenario, whole: BlockResult, folder: Path | None) -> RunResult:
    points = [point.index for point in scenario.points()]
    nothing = {name: np.empty(0, dtype=np.int64 if name in ("point", "trial", "seed") else np.str_) for name in KEYS}
    rows, world = whole.rows or nothing, whole.world or nothing
    means = {
        point: {name: mean_interval(world[name][world["point"] == point].astype(np.float64)) for name in metric_columns(world)}
        for point in points
    }
    summaries = tuple(summarise(rows))
    claims = tuple(check_claims(scenario.expect, rows, world, points))
    return RunResult(scenario, rows, world, whole.timings, whole.failures, summaries, means, claims, folder)


# ---------------------------------------------------------------- one trial again


def rerun(folder: Path, point: int, trial: int, *, into: Path | None = None, work: RunBlock = run_block) -> Rerun:
    """Make one trial of a finished or unfinished run again, from its manifest alone: the same numbers, bit for bit.

    Its whole block is run, since trials of a block share the estimators' calls. `into` keeps the recording under that folder as
    a run would. StoreError for a folder without a run; ValueError for a trial that it doesn't have.
    """
    manifest = read_manifest(folder)
    scenario = rebuilt(manifest)
    points, trials = scenario.points(), manifest["trials"]
    if not 0 <= point < len(points):
        raise ValueError(f"the run has {len(points)} points, counted from 0: there is no point {point}")
    if not 0 <= trial < trials:
        raise ValueError(f"the run has {trials} trials, counted from 0: there is no trial {trial}")
    block = next(b for b in blocks_of(trials, manifest["block"]) if trial in b)
    with TemporaryDirectory() as rough, pool.one_thread_each():
        home = Path(into or rough)
        try:
            result = work(Block(pickle.dumps(points[point].scenario), point, block, home, (trial,)))
        finally:
            worker.close()
        place = archive.place(home, point, trial)
        failures = tuple(f for f in result.failures if f.trial == trial)
        rows = {name: column[result.rows["trial"] == trial] for name, column in result.rows.items()}
        there = not any(f.stage == "simulate" for f in failures)
        return Rerun(
            rows=rows,
            trial=archive.load_trial(place) if there else None,
            tracks=archive.load_tracks(place) if there else {},
            failures=failures,
            changed=differences(manifest, describe(scenario, manifest["keep"])),
        )
