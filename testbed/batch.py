"""A whole study: the points of a sweep × trials, in fixed blocks, through an executor, into figures, claims and a folder.

The same scenario gives the same tables, value by value, whatever the number of jobs and however often it was interrupted.
"""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from testbed import archive, pool, worker
from testbed.cluster import connected
from testbed.evaluate import Rows
from testbed.guided.section import guided_actor
from testbed.keep import DEFAULT, Keep, predict_size
from testbed.manifest import describe, differences, keys, packages, rebuilt, short, versions
from testbed.progress import Progress, Silent
from testbed.recording import Trial
from testbed.result import RunResult, judged
from testbed.scenario import Scenario, override
from testbed.store import Store, StoreError, read_manifest
from testbed.types import Track
from testbed.until import Until, stopped
from testbed.worker import Block, BlockResult, Failure, RunBlock, joined, run_block


class Interrupted(Exception):
    """Ctrl-C in the middle of a run: what was finished is kept. The message says how to go on."""


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
    cluster: str = "",
    shared: str = "",
    until: Until | None = None,
    work: RunBlock = run_block,
) -> RunResult:
    """Run all trials of a scenario at every point of its sweep, and judge its claims.

    out       : the output folder; without one nothing is written and no recording is kept
    jobs      : processes, "auto" for one a core. executors: another way of making some (given their number) than processes here
    keep      : "none", "all", or some of "failed", "first:N", "worst:N" with commas between them
    resume    : go on in `out`: what is there and would come out the same is not made again (`testbed.identity`)
    force     : replace the run in `out`
    command   : the words that started it, for the manifest
    cluster   : where to find workers instead, and shared, where they leave recordings if they can't see `out` (`testbed.cluster`)
    until     : run more trials than the scenario's until a figure is known well enough (`testbed.until`)

    A trial that fails is in `failures`, the rest go on. Raises ScenarioError and the like for bad input, StoreError where the
    disk refuses, Interrupted on Ctrl-C, pool.CannotStart, until.NotReached.
    """
    count = pool.cores() if jobs == "auto" else jobs
    if count < 1:
        raise ValueError(f"jobs must be at least 1, not {count}")
    rule, progress = Keep.parse(keep), progress or Silent()
    with ExitStack() as stack:
        store = None
        if out is not None:
            manifest = describe(scenario, keep, command, until.text if until else "")
            store = stack.enter_context(Store(out, manifest, resume=resume, force=force))
            _check_room(store, scenario, rule, progress)
        bring = None
        if cluster:
            there = stack.enter_context(connected(cluster, packages(scenario), shared))
            executors, count, bring = there, there.jobs, there.bring
        return _Run(scenario, store, rule, count, progress, executors, work, until, bring).result()


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
        until: Until | None = None,
        bring: Callable[[Block], None] | None = None,
    ) -> None:
        self._scenario, self._store, self._rule = scenario, store, rule
        self._jobs, self._progress, self._executors, self._work = jobs, progress, executors, work
        self._until, self._bring = until, bring
        self._trials = until.first(scenario.trials) if until else scenario.trials
        self._contents = [pickle.dumps(point.scenario) for point in scenario.points()]
        self._parts: dict[tuple[int, tuple[int, ...]], BlockResult] = {}  # what is done: all of it without a store
        self._keys = keys(scenario) if store else []
        self._total = self._done = 0  # trials, of the present look

    def result(self) -> RunResult:
        try:
            with pool.one_thread_each():
                whole, looks = self._enough()
        except KeyboardInterrupt:
            raise self._interrupted() from None
        if self._store:
            self._store.log("finished", trials=self._total, failures=len(whole.failures))
        found = self._scenario if self._trials == self._scenario.trials else override(self._scenario, {"trials": self._trials})
        end = stopped(self._until, self._trials, looks, *self._tables(whole)) if self._until else None
        return judged(found, whole, self._store.folder if self._store else None, end)

    def _enough(self) -> tuple[BlockResult, int]:
        """All trials, and after how many looks at them they were enough: one, unless a figure was to be known well."""
        looks = 1
        while True:
            blocks = self._blocks()
            whole = self._round(blocks)
            more = self._until.more(self._trials, *self._tables(whole), self._scenario.block) if self._until else self._trials
            if more == self._trials:
                self._keep_worst(blocks, whole.rows)
                return whole, looks
            self._progress.note(f"{self._trials} trials are not enough: on to {more}")
            self._trials, looks = more, looks + 1

    def _tables(self, whole: BlockResult) -> tuple[Rows, Rows, list[int]]:
        return whole.rows, whole.world, [point.index for point in self._scenario.points()]

    def _round(self, blocks: list[Block]) -> BlockResult:
        """Make what is missing of some blocks, and put all of them together."""
        if self._store:
            self._store.of_trials(self._trials)
        missing = [one for block in blocks if (one := self._missing(block)) is not None]
        self._total = sum(len(block.trials) for block in blocks)
        self._done = self._total - sum(len(block.trials) for block in missing)
        self._progress.start(self._scenario.name, self._total, self._done, self._points(missing))
        try:
            self._make(missing)
        finally:
            self._progress.finish()
        return self._whole(blocks)

    def _blocks(self) -> list[Block]:
        """All blocks, point by point."""
        first = set(self._rule.chosen(self._trials))
        folder = self._store.folder.resolve() if self._store else None
        maker = short(versions(self._scenario))
        found = []
        for point, content in enumerate(self._contents):
            for trials in blocks_of(self._trials, self._scenario.block):
                keep = tuple(sorted(first & set(trials)))
                found.append(Block(content, point, trials, folder, keep, self._rule.failed, versions=maker))
        return found

    def _points(self, missing: Sequence[Block]) -> list[tuple[str, int, int]]:
        """What progress is told of the sweep."""
        todo = Counter(block.point for block in missing for _ in block.trials)
        size = self._trials
        return [(", ".join(f"{k} = {v}" for k, v in p.set.items()), size, size - todo[p.index]) for p in self._scenario.points()]

    def _missing(self, block: Block) -> Block | None:
        """What is still to be done of a block: all of it, or some estimators only, or nothing.

        Recordings belong to the whole of what was run: where there are some, or should be, nothing is done by halves.
        """
        if self._store is None:
            return None if (block.point, block.trials) in self._parts else block
        found = self._store.find(block.point, block.trials, self._keys[block.point])
        places = [archive.place(self._store.folder, block.point, trial) for trial in block.trials]
        there = [place for place in places if place.is_dir()]
        if found.result is not None and not found.lacking:
            gone = {f.trial for f in found.result.failures if f.stage in ("simulate", "worker")}
            wanted = [t for t in block.keep if t not in gone]
            died = any(f.stage == "worker" for f in found.result.failures)  # for lack of memory, perhaps: worth another try
            if not died and all(archive.place(self._store.folder, block.point, t).is_dir() for t in wanted):
                return None
        self._store.drop(there)  # of another state of the code, or not of all estimators
        if found.result is None or not found.lacking or block.keep or there or guided_actor(self._scenario) is not None:
            return block
        return replace(block, only=found.lacking)

    def _make(self, blocks: Sequence[Block]) -> None:
        with closing(pool.results(blocks, self._work, self._jobs, self._executors)) as made:
            for group in made:
                self._brought(group)
                if self._store:
                    first = group[0][0]
                    ran = [s.id for s in self._scenario.estimators] if first.only is None else first.only
                    self._store.put([result for _, result in group], self._keys[first.point], ran)
                for block, result in group:
                    if self._store:
                        self._log(result, self._store)
                    else:
                        self._parts[block.point, block.trials] = result
                    self._done += len(block.trials)
                    self._progress.advance(len(block.trials), len(result.failures), block.point)

    def _brought(self, group: pool.Made) -> None:
        """Bring recordings home that were written elsewhere; before their block counts as done."""
        if self._bring:
            for block, _ in group:
                self._bring(block)

    def _log(self, result: BlockResult, store: Store) -> None:
        for note in result.notes:
            store.log("note", point=result.point, note=note)
            self._progress.note(note)
        for f in result.failures:
            store.log("failure", point=f.point, trial=f.trial, estimator=f.estimator, stage=f.stage, error=f.error)

    def _whole(self, blocks: Sequence[Block]) -> BlockResult:
        if self._store:
            return self._store.merge(((block.point, block.trials) for block in blocks), self._keys)
        return joined([self._parts[key] for key in sorted((block.point, block.trials) for block in blocks)])

    def _keep_worst(self, blocks: Sequence[Block], rows: Rows) -> None:
        """Make the worst trials again to keep their recordings: which they are is known only now, and they come out the same."""
        if not self._store or not self._rule.worst:
            return
        again = []
        worst = {point: self._rule.worst_of(rows, point) for point in range(len(self._contents))}
        for block in blocks:
            wanted = [t for t in worst[block.point] if t in block.trials]
            new = [t for t in wanted if not archive.place(self._store.folder, block.point, t).is_dir()]
            if new:
                again.append(replace(block, keep=tuple(sorted(new)), keep_failed=False))
        with closing(pool.results(again, self._work, self._jobs, self._executors)) as found:
            for group in found:
                self._brought(group)

    def _interrupted(self) -> Interrupted:
        if self._store is None:
            return Interrupted("interrupted; without an output folder nothing is kept")
        self._store.log("interrupted", trials=self._done)
        return Interrupted(f"interrupted: {self._done} of {self._total} trials are kept in {self._store.folder}; continue with --resume")


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
            content = pickle.dumps(points[point].scenario)
            result = work(Block(content, point, block, home, (trial,), versions=short(versions(scenario))))
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
