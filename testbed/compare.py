"""Two runs, or the estimators of one, compared on the same trials: differences, how large they are, and how sure that is.

A trial is the unit of independence, and what is compared is a figure of the same trial (and target) on both sides: trial 7 of two runs
of one seed is the same draw, and of two seeds any pairing is as good as another. Of each pair of sides:

* the mean difference with its 95 % interval by Student's t, and its p by the same (two-sided)
* p after S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979), over all
  pairs of one comparison: with it, a difference that is not there is claimed in 5 % of comparisons at most, however many pairs they have
* two sizes of the effect: Cohen's d of the differences (mean by standard deviation), and the share of trials in which the left is above

Trials that crashed, and rows without a value, are counted for each side and are no errors of any size: a method that gives up on
what is hard must not look better for it. Breaks where few trials are far off all others: Student's t then knows little; the share of
trials does not suffer from it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import stdtr

from testbed.columns import Array
from testbed.evaluate import Interval, Rows, mean_interval, metric_columns, per_trial, plain
from testbed.plugins import suggest
from testbed.store import read_manifest, read_rows

MAIN = "position_error_m.mean"
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
SURE = 0.05  # a p by Holm below it is a difference shown
By = Literal["run", "estimator"]


class CompareError(ValueError):
    """Runs that can't be compared as asked, in one sentence."""


@dataclass(frozen=True)
class Run:
    """A finished run in a folder, under the name that it has here. sets: by point, what the sweep sets."""

    label: str
    folder: Path
    manifest: dict[str, Any]
    rows: Rows
    failures: Rows
    sets: tuple[dict[str, Any], ...]

    @property
    def name(self) -> str:
        return str(self.manifest["scenario"]["name"])

    @property
    def estimators(self) -> list[str]:
        return [e["id"] for e in self.manifest["estimators"]]

    def values(self, point: int, estimator: str, column: str) -> dict[tuple[int, str], float]:
        """By (trial, target), NaN included."""
        if column not in self.rows:
            return {}
        mask = (self.rows["point"] == point) & (self.rows["estimator"] == estimator)
        keys = zip(self.rows["trial"][mask].tolist(), self.rows["target"][mask].tolist(), strict=True)
        return dict(zip(keys, self.rows[column][mask].tolist(), strict=True))

    def failed(self, point: int, estimator: str) -> int:
        """Trials in which the estimator, or the trial itself, crashed."""
        if not len(self.failures.get("trial", ())):
            return 0
        mask = (self.failures["point"] == point) & np.isin(self.failures["estimator"], ["", estimator])
        return len(np.unique(self.failures["trial"][mask]))


@dataclass(frozen=True)
class Side:
    """One side of a comparison: over its own trials, the mean; quantiles of the trials' values; and what is not among them.

    failed : trials that crashed; empty : rows (trial, target) without a value; values : (trials,) sorted, one a trial
    """

    label: str
    mean: Interval
    quantiles: tuple[float, ...]
    failed: int
    empty: int
    values: Array

    def document(self) -> dict[str, Any]:
        shown = {f"p{100 * q:g}" if q < 1 else "max": plain(v) for q, v in zip(QUANTILES, self.quantiles, strict=True)}
        return {"of": self.label, "mean": plain(self.mean.mean), "se": plain(self.mean.se), "n": self.mean.n, **shown} | {
            "failed_trials": self.failed,
            "rows_without_value": self.empty,
        }


@dataclass(frozen=True)
class Pair:
    """Left minus right, at one point, in one column. apart: (n,) the differences, one a trial; d is Cohen's of these."""

    at: str
    column: str
    left: Side
    right: Side
    difference: Interval
    d: float
    above: Interval
    p: float
    p_holm: float
    apart: Array

    @property
    def verdict(self) -> str:
        """What may be said of it, all pairs considered."""
        if not np.isfinite(self.p_holm):
            return "too few trials in common"
        if self.p_holm >= SURE:
            return "no difference shown"
        return f"{self.right.label if self.difference.mean > 0 else self.left.label} is lower"

    def document(self) -> dict[str, Any]:
        """For `testbed compare --json`."""
        i = self.difference
        found: dict[str, Any] = {"at": self.at, "metric": self.column, "left": self.left.document(), "right": self.right.document()}
        found["difference"] = {"mean": plain(i.mean), "se": plain(i.se), "interval_95": [plain(i.low), plain(i.high)], "n": i.n}
        found |= {"effect_d": plain(self.d), "share_left_above": plain(self.above.mean), "p": plain(self.p), "p_holm": plain(self.p_holm)}
        return {**found, "verdict": self.verdict}


# ---------------------------------------------------------------- reading


def read_run(folder: Path, label: str = "") -> Run:
    """A finished run. StoreError where there is none."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    rows, failures = read_rows(folder), read_rows(folder, "failures")
    return Run(label or folder.name, folder, manifest, rows, failures, tuple(dict(p["set"]) for p in manifest["points"]))


def read_runs(folders: Sequence[Path]) -> list[Run]:
    """Runs under names that tell them apart: as much of the ends of their paths as that takes."""
    paths = [Path(f).resolve() for f in folders]
    if len(set(paths)) < len(paths):
        raise CompareError("a run is named twice")
    length = 1
    while len({p.parts[-length:] for p in paths}) < len(paths):
        length += 1
    return [read_run(f, "/".join(p.parts[-length:])) for f, p in zip(folders, paths, strict=True)]


def shown(swept: dict[str, Any]) -> str:
    """What a point of a sweep sets, in a line."""
    return ", ".join(f"{path} = {value}" for path, value in swept.items())


# ---------------------------------------------------------------- comparing


def compare(runs: Sequence[Run], by: By, columns: Sequence[str] = (), estimators: Sequence[str] = ()) -> list[Pair]:
    """All pairs: "run" compares each other run with the first, estimator by estimator; "estimator" those of each run among themselves.

    columns : position_error_m.mean where left out; estimators : all that can be compared. Points of a sweep are matched by what they
    set. CompareError where there is nothing to compare.
    """
    if by == "run" and len(runs) < 2:
        raise CompareError("one run has nothing to be compared with: name two, or compare its estimators with --by estimator")
    chosen = _columns(runs, columns)
    known = list(dict.fromkeys(id for run in runs for id in run.estimators))
    for id in estimators:
        if id not in known:
            raise CompareError(f"no estimator has the id {id!r}{suggest(id, known)}")
    found: list[Pair] = []
    for column in chosen:
        found += _across(runs, column, estimators) if by == "run" else _within(runs, column, estimators)
    if not found:
        what = "no estimator at the same point of a sweep" if by == "run" else "less than two estimators"
        raise CompareError(f"there is nothing to compare: the runs have {what} in common" if by == "run" else f"there is {what} to compare")
    return holm(found)


def _columns(runs: Sequence[Run], wanted: Sequence[str]) -> list[str]:
    known = [c for c in metric_columns(runs[0].rows) if all(c in run.rows for run in runs)]
    for column in wanted:
        if column not in known:
            raise CompareError(f"not all runs have the figure {column!r}{suggest(column, known)}")
    if wanted:
        return list(dict.fromkeys(wanted))
    if not known:
        raise CompareError("the runs have no figure in common")
    return [MAIN if MAIN in known else known[0]]


def _across(runs: Sequence[Run], column: str, estimators: Sequence[str]) -> list[Pair]:
    first, found = runs[0], []
    for other in runs[1:]:
        for a, b, at in _points(first, other):
            for id in first.estimators:
                if id in other.estimators and (not estimators or id in estimators):
                    found.append(_pair(at, column, (first, a, id, f"{id} in {first.label}"), (other, b, id, f"{id} in {other.label}")))
    return found


def _points(left: Run, right: Run) -> list[tuple[int, int, str]]:
    """Points of two runs that belong together, and what they are called."""
    if len(left.sets) == len(right.sets) == 1:
        return [(0, 0, shown(left.sets[0]))]
    there = {json.dumps(s, sort_keys=True): i for i, s in enumerate(right.sets)}
    return [(i, there[k], shown(s)) for i, s in enumerate(left.sets) if (k := json.dumps(s, sort_keys=True)) in there]


def _within(runs: Sequence[Run], column: str, estimators: Sequence[str]) -> list[Pair]:
    found = []
    for run in runs:
        for point, swept in enumerate(run.sets):
            at = ", ".join(filter(None, [run.label if len(runs) > 1 else "", shown(swept)]))
            ids = [id for id in run.estimators if not estimators or id in estimators]
            found += [_pair(at, column, (run, point, a, a), (run, point, b, b)) for a, b in combinations(ids, 2)]
    return found


def _pair(at: str, column: str, left: tuple[Run, int, str, str], right: tuple[Run, int, str, str]) -> Pair:
    (a, b), sides = (run.values(point, id, column) for run, point, id, _ in (left, right)), [_side(column, *one) for one in (left, right)]
    if not a.keys() & b.keys():  # other targets: then trial by trial
        a, b = ({(trial, ""): v for trial, v in zip(*_by_trial(x), strict=True)} for x in (a, b))
    both = [key for key in a if key in b]
    trials = np.array([key[0] for key in both], dtype=np.int64)
    gap = np.array([a[key] - b[key] for key in both], dtype=np.float64)
    apart = per_trial(trials, gap)[1]
    share = per_trial(trials, np.where(np.isnan(gap), np.nan, (np.sign(gap) + 1) / 2))[1]
    apart = apart[~np.isnan(apart)]
    p, d = test(apart)
    return Pair(at, column, sides[0], sides[1], mean_interval(apart), d, mean_interval(share), p, np.nan, apart)


def _by_trial(values: dict[tuple[int, str], float]) -> tuple[list[int], list[float]]:
    trials, means = per_trial(np.array([k[0] for k in values], dtype=np.int64), np.array(list(values.values()), dtype=np.float64))
    return trials.tolist(), means.tolist()


def _side(column: str, run: Run, point: int, estimator: str, label: str) -> Side:
    values = run.values(point, estimator, column)
    means = np.array(_by_trial(values)[1], dtype=np.float64)
    good = np.sort(means[~np.isnan(means)])
    quantiles = tuple(np.quantile(good, QUANTILES).tolist()) if len(good) else (np.nan,) * len(QUANTILES)
    empty = int(np.isnan(np.array(list(values.values()), dtype=np.float64)).sum())
    return Side(label, mean_interval(means), quantiles, run.failed(point, estimator), empty, good)


def test(apart: Array) -> tuple[float, float]:
    """(p, d) of differences (n,): two-sided by Student's t, and mean by standard deviation. NaN below two.

    Differences that are all the same are no matter of chance: p is 0, or 1 where they are nothing.
    """
    n = len(apart)
    if n < 2:
        return np.nan, np.nan
    mean, spread = float(apart.mean()), float(apart.std(ddof=1))
    if spread == 0:
        return (1.0, 0.0) if mean == 0 else (0.0, float(np.copysign(np.inf, mean)))
    return float(2 * stdtr(n - 1, -abs(mean) / spread * np.sqrt(n))), mean / spread


def holm(pairs: Sequence[Pair]) -> list[Pair]:
    """The pairs with p corrected for all of them; one without a p stays without."""
    p = adjusted(np.array([pair.p for pair in pairs]))
    return [replace(pair, p_holm=float(value)) for pair, value in zip(pairs, p, strict=True)]


def adjusted(p: Array) -> Array:
    """(n,) p after Holm: the i-th smallest of m times m - i + 1, never below an earlier one, at most 1. NaN is no test."""
    found = np.full(len(p), np.nan)
    order = [i for i in np.argsort(p, kind="stable") if not np.isnan(p[i])]
    reached = 0.0
    for rank, i in enumerate(order):
        reached = max(reached, min(1.0, (len(order) - rank) * float(p[i])))
        found[i] = reached
    return found
