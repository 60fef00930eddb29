"""What a report says of a whole run: its output folder read back, and everything computed that is shown in words and tables.

Reads files only. Where a plug-in of the scenario is no longer installed, what can't be judged without it is left out, and
`Study.gap` says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from testbed.evaluate import (
    KEYS,
    ClaimResult,
    Interval,
    Rows,
    Summary,
    check_claims,
    mean_interval,
    metric_columns,
    paired,
    per_trial,
    summarise,
)
from testbed.manifest import rebuilt
from testbed.plugins import BrokenPlugin, UnknownPlugin
from testbed.scenario import Scenario, ScenarioError, from_text
from testbed.store import LOG, RECORDINGS, read_manifest, read_rows
from testbed.worker import Failure

MAIN = "position_error_m.mean"
MOST_PAIRED = 6  # estimators: of more, only the differences from the best one are shown
GONE = (ScenarioError, UnknownPlugin, BrokenPlugin)


@dataclass(frozen=True)
class Kept:
    """A recording that the run kept: which trial of which point, and its folder."""

    point: int
    trial: int
    folder: Path


@dataclass(frozen=True)
class Pair:
    """The mean difference of two estimators on the same trials, in one column of the results."""

    point: int
    left: str
    right: str
    column: str
    interval: Interval


@dataclass(frozen=True)
class Study:
    """A run as it lies in its folder.

    sets     : by point of the sweep, what it sets
    main     : the column of the results that is drawn and compared, None where there are no results
    world    : by point, the mean over trials of each stimulus; stimuli: the table behind it
    wall     : by (point, estimator), wall time per update in s, mean over trials
    scenario : None where it can't be built any more; then there are no claims either
    """

    folder: Path
    manifest: dict[str, Any]
    sets: tuple[dict[str, Any], ...]
    estimators: tuple[str, ...]
    rows: Rows
    summaries: tuple[Summary, ...]
    world: tuple[dict[str, Interval], ...]
    wall: Mapping[tuple[int, str], Interval]
    pairs: tuple[Pair, ...]
    claims: tuple[ClaimResult, ...]
    failures: tuple[Failure, ...]
    recordings: tuple[Kept, ...]
    main: str | None
    scenario: Scenario | None
    started: str
    gap: str = ""
    stimuli: Rows = field(default_factory=dict)

    @property
    def name(self) -> str:
        return str(self.manifest["scenario"]["name"])

    @property
    def title(self) -> str:
        """The scenario's own title, else its name."""
        return str(self.manifest["scenario"]["document"].get("title") or self.name)

    def of(self, point: int) -> list[Summary]:
        """The summaries of a point, in the order of the scenario."""
        order = {id: i for i, id in enumerate(self.estimators)}
        return sorted((s for s in self.summaries if s.point == point), key=lambda s: order.get(s.estimator, len(order)))

    def label(self, point: int) -> str:
        """What a point of the sweep sets: "world.gates = 2"; "" without a sweep."""
        return ", ".join(f"{path} = {value}" for path, value in self.sets[point].items())


def read(folder: Path) -> Study:
    """The run in an output folder. StoreError where there is none, or none that is finished."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    tables = {name: read_rows(folder, name) for name in ("trials", "world", "timings", "failures")}
    rows, world = tables["trials"] or _nothing(), tables["world"] or _nothing()
    sets = tuple(dict(point["set"]) for point in manifest["points"])
    scenario, gap = _scenario(manifest)
    summaries = tuple(summarise(rows))
    estimators = tuple(e["id"] for e in manifest["estimators"])
    main = _main(rows)
    return Study(
        folder=folder,
        manifest=manifest,
        sets=sets,
        estimators=estimators,
        rows=rows,
        summaries=summaries,
        world=tuple(_stimulus(world, point) for point in range(len(sets))),
        wall=_wall(tables["timings"]),
        pairs=tuple(_pairs(rows, summaries, main)),
        claims=_claims(manifest, scenario, rows, world),
        failures=_failures(tables["failures"]),
        recordings=tuple(_recordings(folder)),
        main=main,
        scenario=scenario,
        started=_started(folder),
        gap=gap,
        stimuli=world,
    )


def _nothing() -> dict[str, Any]:
    return {name: np.empty(0, dtype=np.int64 if name in ("point", "trial", "seed") else np.str_) for name in KEYS}


def _scenario(manifest: dict[str, Any]) -> tuple[Scenario | None, str]:
    try:
        return rebuilt(manifest), ""
    except GONE as error:
        return None, f"The scenario can't be built on this machine any more, so its claims are not judged again: {error}"


def _main(rows: Rows) -> str | None:
    columns = metric_columns(rows)
    return MAIN if MAIN in columns else columns[0] if columns else None


def _stimulus(world: Rows, point: int) -> dict[str, Interval]:
    here = world["point"] == point
    return {name: mean_interval(world[name][here].astype(np.float64)) for name in metric_columns(world)}


def _wall(timings: Rows) -> dict[tuple[int, str], Interval]:
    """Wall time per update by point and estimator: the mean over trials of each trial's own."""
    found: dict[tuple[int, str], Interval] = {}
    if not timings:
        return found
    for point, estimator in dict.fromkeys(zip(timings["point"].tolist(), timings["estimator"].tolist(), strict=True)):
        here = (timings["point"] == point) & (timings["estimator"] == estimator) & (timings["stage"] == "update")
        if here.any():
            found[point, estimator] = mean_interval(per_trial(timings["trial"][here], timings["seconds_per_update"][here])[1])
    return found


def _pairs(rows: Rows, summaries: tuple[Summary, ...], main: str | None) -> list[Pair]:
    """Differences of all pairs of estimators at each point; of many estimators, those from the best one."""
    found: list[Pair] = []
    if main is None:
        return found
    p95 = main.rpartition(".")[0] + ".p95"
    columns = [main, p95] if p95 in metric_columns(rows) else [main]
    for point in dict.fromkeys(s.point for s in summaries):
        here = [s for s in summaries if s.point == point]
        couples = list(combinations([s.estimator for s in here], 2))
        if len(here) > MOST_PAIRED:
            best = min(here, key=lambda s: np.nan_to_num(s.statistics[main].mean, nan=np.inf)).estimator
            couples = [(best, s.estimator) for s in here if s.estimator != best]
        found += [Pair(point, a, b, column, paired(rows, point, a, b, column)) for column in columns for a, b in couples]
    return found


def _claims(manifest: dict[str, Any], scenario: Scenario | None, rows: Rows, world: Rows) -> tuple[ClaimResult, ...]:
    """The claims judged again from the tables, each with its line in the scenario's text where it stands there."""
    if scenario is None:
        return ()
    try:
        lines = {claim.text: claim.line for claim in from_text(manifest["scenario"]["text"]).expect}
    except GONE:  # its tables lay beside the file
        lines = {}
    judged = check_claims(scenario.expect, rows, world, range(len(manifest["points"])))
    return tuple(ClaimResult(c.point, c.text, lines.get(c.text), c.value, c.interval, c.ok, c.note) for c in judged)


def _failures(table: Rows) -> tuple[Failure, ...]:
    names = ("point", "trial", "estimator", "stage", "error", "traceback")
    return tuple(Failure(*row) for row in zip(*(table[name].tolist() for name in names), strict=True))


def _recordings(folder: Path) -> list[Kept]:
    found = sorted((folder / RECORDINGS).glob("point-*/trial-*"))
    return [Kept(int(f.parent.name.removeprefix("point-")), int(f.name.removeprefix("trial-")), f) for f in found if f.is_dir()]


def _started(folder: Path) -> str:
    """When the run was started, as its log says: "2025-11-23 06:38 UTC"; "" where there is no log."""
    try:
        first = (folder / LOG).read_text(encoding="utf-8").splitlines()[0]
        return str(json.loads(first)["time"])[:16].replace("T", " ") + " UTC"
    except (OSError, ValueError, KeyError, IndexError):
        return ""
