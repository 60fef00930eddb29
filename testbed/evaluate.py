"""From tracks and truth to figures: one row per (point, trial, estimator, target), then statistics over the trials.

A trial is the unit of independence: everything is first averaged over the targets of a trial, so that n is the number of
trials and a standard error is honest. Rows are plain numpy columns by name (`Rows`), as they lie in trials.parquet.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from testbed.columns import Array
from testbed.protocols import Metric
from testbed.quantiles import chi2_quantile, student_quantile
from testbed.recording import Trial
from testbed.types import Track

Rows = Mapping[str, Array]

KEYS = ("point", "trial", "estimator", "target", "seed", "kind", "config", "scenario", "versions")  # all other columns are metrics
CONFIDENCE = 0.95


# ---------------------------------------------------------------- scoring


def score(track: Track, trial: Trial, metrics: Mapping[str, Metric]) -> dict[str, Array]:
    """Every metric's columns, each (B,) float64, of a track whose rows all belong to `trial`; "target" comes first.

    metrics : by the id they have in the scenario. One whose id is not its kind's name has its columns prefixed "<id>.", so that
    two metrics of one kind can stand side by side. ValueError for columns of a wrong shape or of the same name.
    """
    order = {str(name): i for i, name in enumerate(trial.recording.targets.name)}
    places = [order[str(name)] for name in track.target]
    truth = np.ascontiguousarray(trial.target_states(track.t)[:, places])
    # numpy's sums round by the order in which an array lies in memory: a track cut out of a block's must lie as one made alone does
    track = track.with_(**{name: np.ascontiguousarray(getattr(track, name)) for name in ("mean", "covariance", "status", "particles")})
    columns: dict[str, Array] = {"target": np.asarray(track.target)}
    for id, metric in metrics.items():
        own_kind = type(metric).__module__.rpartition(".")[2]
        prefix = "" if id == own_kind else f"{id}."
        for name, values in metric.compute(track, truth, trial).items():
            values = np.asarray(values, dtype=np.float64)
            if values.shape != (len(places),):
                raise ValueError(f"metric {id}: column {name} has shape {values.shape}, wants ({len(places)},), one value a target")
            if prefix + name in columns or prefix + name in KEYS:
                raise ValueError(f"metric {id}: there is already a column {prefix + name}; give one of the two metrics another id")
            columns[prefix + name] = values
    return columns


def metric_columns(rows: Rows) -> list[str]:
    """Names of the columns that hold figures, in order."""
    return [name for name in rows if name not in KEYS]


def split(column: str) -> tuple[str, str]:
    """ "position_error_m.mean" -> ("position_error_m", "mean"); a metric of one column has the statistic ""."""
    metric, _, statistic = column.rpartition(".")
    return (metric, statistic) if metric else (column, "")


# ---------------------------------------------------------------- statistics


@dataclass(frozen=True)
class Interval:
    """A mean over n independent trials, its standard error, and its 95 % confidence interval by Student's t.

    Below two trials there is no spread: se, low and high are NaN; without any trial the mean is as well.
    """

    mean: float
    se: float
    low: float
    high: float
    n: int


def mean_interval(values: Array) -> Interval:
    """Mean of per-trial values (trials,), NaN left out, with mean ± t(0.975, n-1) s/√n."""
    found = values[~np.isnan(values)]
    n = len(found)
    if n < 2:
        return Interval(float(found[0]) if n else np.nan, np.nan, np.nan, np.nan, n)
    if np.all(found == found[0]):  # no spread at all, which rounding in the mean would hide
        return Interval(float(found[0]), 0.0, float(found[0]), float(found[0]), n)
    mean, se = float(found.mean()), float(found.std(ddof=1) / np.sqrt(n))
    reach = float(student_quantile(0.5 + CONFIDENCE / 2, n - 1)) * se
    return Interval(mean, se, mean - reach, mean + reach, n)


def chi2_limits(dof: float, n: int = 1) -> tuple[float, float]:
    """Where the average of n independent χ² statistics of `dof` degrees of freedom lies in 95 % of cases.

    [χ²(0.025, n dof)/n, χ²(0.975, n dof)/n]: Bar-Shalom, Li, Kirubarajan (2001), Eq. 5.4.2-8.
    """
    if not (dof > 0 and n > 0):
        return np.nan, np.nan
    low, high = chi2_quantile([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], n * dof) / n
    return float(low), float(high)


def per_trial(trial: Array, values: Array) -> tuple[Array, Array]:
    """The trials (T,) that have rows, ascending, and each one's mean over its rows (NaN rows left out, NaN if there are no others)."""
    trials, place = np.unique(trial, return_inverse=True)
    there = ~np.isnan(values)
    count = np.bincount(place, weights=there, minlength=len(trials))
    total = np.bincount(place, weights=np.where(there, values, 0.0), minlength=len(trials))
    return trials, np.divide(total, count, out=np.full(len(trials), np.nan), where=count > 0)


# ---------------------------------------------------------------- summaries


@dataclass(frozen=True)
class Summary:
    """What one estimator did at one point of the sweep, over its trials.

    statistics : per column, the mean over trials of the per-trial value (itself a mean over the trial's targets)
    missing    : per column, how many (trial, target) rows have no value
    limits     : 95 % limits of "nees.mean" and "nis.mean" for an honest filter. NEES: for the average over the n trials at one
                 time (an average over a track's times and targets varies less: outside is significant, inside proves little).
                 NIS, per degree of freedom: for the sum over all updates, which are independent for an honest filter.
    """

    point: int
    estimator: str
    statistics: dict[str, Interval]
    missing: dict[str, int]
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)

    def document(self) -> dict[str, dict[str, Any]]:
        """As `testbed run --json` prints it: by metric; what can't be said (NaN) is null.

        "p50" of a metric is the mean over trials of the trials' own medians, "p50_se" its standard error; "se" belongs to "mean" (or to
        the only column). n is the number of trials with a value; a column with another n says so in "<statistic>_n".
        """
        out: dict[str, dict[str, Any]] = {}
        for column, s in self.statistics.items():
            metric, statistic = split(column)
            first = metric not in out
            entry = out.setdefault(metric, {})
            label = statistic or "mean"
            entry[label] = plain(s.mean)
            entry["se" if label == "mean" else f"{label}_se"] = plain(s.se)
            if first:
                entry["n"] = s.n
            elif s.n != entry["n"]:
                entry[f"{label}_n"] = s.n
            if self.missing[column]:
                entry["missing"] = max(self.missing[column], entry.get("missing", 0))
            if column in self.limits:
                entry["limits_95"] = [plain(limit) for limit in self.limits[column]]
        return out


def plain(value: float) -> float | None:
    """A number for JSON, which has no NaN and no infinity: null."""
    return float(value) if np.isfinite(value) else None


def summarise(rows: Rows) -> list[Summary]:
    """A summary of each (point, estimator) that has rows: points ascending, estimators in the order of their first row."""
    order = np.argsort(rows["point"], kind="stable")
    ordered = {name: column[order] for name, column in rows.items()}
    points, first = np.unique(ordered["point"], return_index=True)
    summaries = []
    for point, a, b in zip(points, first, np.append(first, len(order))[1:], strict=True):
        here = {name: column[a:b] for name, column in ordered.items()}
        for estimator in dict.fromkeys(here["estimator"].tolist()):
            mine = here["estimator"] == estimator
            summaries.append(_summary({name: column[mine] for name, column in here.items()}, int(point), estimator))
    return summaries


def _summary(rows: Rows, point: int, estimator: str) -> Summary:
    statistics, missing = {}, {}
    for column in metric_columns(rows):
        statistics[column] = mean_interval(per_trial(rows["trial"], rows[column])[1])
        missing[column] = int(np.isnan(rows[column]).sum())
    limits = {}
    for column in statistics:
        prefix, found, _ = column.rpartition("nees.mean")
        if found:
            dof = rows[prefix + "nees.dof"]
            dof = np.unique(dof[~np.isnan(dof)])
            limits[column] = chi2_limits(dof[0], statistics[column].n) if len(dof) == 1 else (np.nan, np.nan)
        prefix, found, _ = column.rpartition("nis.mean")
        if found:
            limits[column] = chi2_limits(1.0, int(np.nansum(rows[prefix + "nis.dof"])))
    return Summary(point, estimator, statistics, missing, limits)


def paired(rows: Rows, point: int, left: str, right: str, column: str) -> Interval:
    """Mean over trials of `left` minus `right` on the same trials and targets, with its 95 % confidence interval.

    Rows that only one of the two has, or that are NaN in one, are left out. KeyError for an unknown column.
    """
    trials, apart = _apart(rows, point, left, right, column)
    return mean_interval(per_trial(trials, apart)[1])


def share_above(rows: Rows, point: int, left: str, right: str, column: str) -> Interval:
    """Share of trials (and in each of its targets) in which `left` is above `right`; equal figures count half. Otherwise as `paired`."""
    trials, apart = _apart(rows, point, left, right, column)
    return mean_interval(per_trial(trials, np.where(np.isnan(apart), np.nan, (np.sign(apart) + 1) / 2))[1])


def _apart(rows: Rows, point: int, left: str, right: str, column: str) -> tuple[Array, Array]:
    """Trials and differences of all (trial, target) that both have."""
    sides = []
    for estimator in (left, right):
        mask = (rows["point"] == point) & (rows["estimator"] == estimator)
        keys = zip(rows["trial"][mask].tolist(), rows["target"][mask].tolist(), strict=True)
        sides.append(dict(zip(keys, rows[column][mask].tolist(), strict=True)))
    both = [key for key in sides[0] if key in sides[1]]
    apart = np.array([sides[0][key] - sides[1][key] for key in both], dtype=np.float64)
    return np.array([key[0] for key in both], dtype=np.int64), apart


# ---------------------------------------------------------------- claims


@dataclass(frozen=True)
class ClaimResult:
    """Whether an expectation of the scenario held at one point of its sweep.

    value is what was compared (for a paired claim the confidence limit is, and value is the mean difference); interval is
    the 95 % confidence interval of value, NaN below two trials.
    """

    point: int
    text: str
    line: int | None
    value: float
    interval: tuple[float, float]
    ok: bool
    note: str = ""

    def document(self) -> dict[str, Any]:
        """As `testbed run --json` prints it."""
        interval = [plain(limit) for limit in self.interval]
        out = {"claim": self.text, "value": plain(self.value), "interval": interval, "ok": self.ok, "line": self.line, "point": self.point}
        return {**out, "note": self.note} if self.note else out


def check_claims(claims: Iterable[Any], rows: Rows, world: Rows, points: Sequence[int]) -> list[ClaimResult]:
    """Judge claims (`testbed.scenario.Claim`) at every point that they speak of.

    world : columns "point", "trial" and one a stimulus. A plain claim compares the mean over trials itself. A paired one ("a - b")
    with the bound "min" holds where the lower 95 % limit of the mean difference reaches it, with "max" where the upper
    limit stays within. A share ("a > b") is of the trials in which a's figure is above b's, and is compared itself. A claim about
    something that has no value fails, and its note says why.
    """
    return [_check(claim, rows, world, point) for claim in claims for point in points if claim.concerns(point)]


def _check(claim: Any, rows: Rows, world: Rows, point: int) -> ClaimResult:
    is_pair = " - " in claim.subject
    interval, note = figure_of(claim, rows, world, point)
    compared = interval.mean
    if is_pair and not np.isnan(compared):
        compared = interval.low if claim.bound == "min" else interval.high
        if np.isnan(compared):
            note = "one trial has no confidence limit: run at least two"
    ok = bool(compared >= claim.value if claim.bound == "min" else compared <= claim.value)
    return ClaimResult(point, claim.text, claim.line, interval.mean, (interval.low, interval.high), ok, note)


def figure_of(claim: Any, rows: Rows, world: Rows, point: int) -> tuple[Interval, str]:
    """The figure that a claim speaks of at a point, its bound aside, and a note where it has no value."""
    nothing = mean_interval(np.empty(0))
    if claim.subject == "world":
        table, column = world, claim.metric
    else:
        table, column = rows, f"{claim.metric}.{claim.statistic}" if claim.statistic else claim.metric
        if column not in table and claim.statistic == "mean" and claim.metric in table:
            column = claim.metric  # a metric of one column: its mean over trials
    known = [name for name in table if name not in KEYS]
    if column not in known:
        return nothing, f"no value: there is no {column!r}; there are {', '.join(known) or 'none'}"
    for relation, compared in ((" - ", paired), (" > ", share_above)):
        if relation in claim.subject:
            left, right = claim.subject.split(relation)
            interval = compared(rows, point, left.strip(), right.strip(), column)
            return interval, "" if interval.n else "no value: no trial has both"
    mask = table["point"] == point
    if claim.subject != "world":
        mask = mask & (table["estimator"] == claim.subject)
    interval = mean_interval(per_trial(table["trial"][mask], table[column][mask])[1])
    return interval, "" if interval.n else "no value: " + ("no trial has rows" if not mask.any() else "every trial's is undefined")
