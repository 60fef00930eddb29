"""Scenarios × estimators as one table: who is nearest to the truth where, how sure that is, what it costs, and what is possible at all.

Reads the finished runs under a folder. In each scenario (each point of a sweep is one) the estimator with the lowest mean error leads;
those whose difference from it, on the same trials, could be chance (p after Holm over all of them) share its place. An estimator that
crashed, or gave no value in some trials, is marked: its error is of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.archive import StoreError
from testbed.compare import MAIN, SURE, Run, adjusted, read_run, shown, test
from testbed.evaluate import Interval, Rows, mean_interval, metric_columns, per_trial, plain
from testbed.store import read_rows

BOUND, RMS = "position_bound_m.filtered", "position_error_m.rms"
DEEPEST = 4  # folders under the one that is named


@dataclass(frozen=True)
class Entry:
    """One estimator in one place.

    error, rms : m (or what the column is in); cost : wall time of an update, s
    p          : that the difference from the leader is chance, after Holm; NaN for the leader
    leads      : nobody is shown to be better; front : nobody is both better on average and faster
    failed, empty : trials that crashed, and rows without a value
    """

    estimator: str
    error: Interval
    rms: Interval
    cost: Interval
    failed: int
    empty: int
    p: float = math.nan
    leads: bool = False
    front: bool = False


@dataclass(frozen=True)
class Place:
    """One scenario at one point of its sweep. bound: the least root mean square error possible, NaN in it where nobody said."""

    scenario: str
    at: str
    trials: int
    entries: tuple[Entry, ...]
    bound: Interval

    @property
    def label(self) -> str:
        return f"{self.scenario}: {self.at}" if self.at else self.scenario

    @property
    def has_bound(self) -> bool:
        return math.isfinite(self.bound.mean)


@dataclass(frozen=True)
class Board:
    """All places; over all: by estimator, in how many it leads, and how many times the leader's error its own is, by geometric mean."""

    column: str
    places: tuple[Place, ...]
    notes: tuple[str, ...]

    @property
    def estimators(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(e.estimator for place in self.places for e in place.entries))

    def overall(self) -> list[tuple[str, int, int, float]]:
        """(estimator, places, of these led, error by the best one's), the best first; only what has a value counts."""
        found = []
        for id in self.estimators:
            ratios, led = [], 0
            for place in self.places:
                best = min((e.error.mean for e in place.entries if e.error.n), default=math.nan)
                for e in place.entries:
                    if e.estimator == id and e.error.n and best > 0:
                        ratios.append(e.error.mean / best)
                        led += e.leads
            mean = float(np.exp(np.mean(np.log(ratios)))) if ratios else math.nan
            found.append((id, len(ratios), led, mean))
        return sorted(found, key=lambda one: (-one[1], one[3] if math.isfinite(one[3]) else math.inf))

    def document(self) -> dict[str, Any]:
        """For `testbed leaderboard --json`."""
        over = [{"estimator": id, "places": n, "leads": led, "error_by_best": plain(r)} for id, n, led, r in self.overall()]
        return {"metric": self.column, "places": [_document(place) for place in self.places], "overall": over, "notes": list(self.notes)}


def _document(place: Place) -> dict[str, Any]:
    entries = [
        {
            "estimator": e.estimator,
            "error": plain(e.error.mean),
            "interval_95": [plain(e.error.low), plain(e.error.high)],
            "n": e.error.n,
            "rms": plain(e.rms.mean),
            "seconds_per_update": plain(e.cost.mean),
            "failed_trials": e.failed,
            "rows_without_value": e.empty,
            "p_holm": plain(e.p),
            "leads": e.leads,
            "on_the_front": e.front,
        }
        for e in place.entries
    ]
    return {"scenario": place.scenario, "at": place.at, "trials": place.trials, "bound_rms": plain(place.bound.mean), "estimators": entries}


# ---------------------------------------------------------------- reading


def read(folder: Path, column: str = MAIN) -> Board:
    """The board of all finished runs under a folder. StoreError where there is none; runs that can't be read are in the notes."""
    places: list[Place] = []
    notes: list[str] = []
    for home in _homes(Path(folder)):
        try:
            run = read_run(home)
            timings = read_rows(home, "timings")
        except StoreError as error:
            notes.append(f"left out: {error}")
            continue
        places += _places(run, timings, column, notes)
    if not places:
        raise StoreError(f"{folder} holds no finished run with the figure {column}: testbed run SCENARIO... --out {folder} makes some")
    return Board(column, tuple(_told_apart(holm(places))), tuple(notes))


def _homes(folder: Path) -> list[Path]:
    patterns = ["/".join(["*"] * depth + ["manifest.json"]) for depth in range(DEEPEST + 1)]
    return sorted({path.parent for pattern in patterns for path in folder.glob(pattern)})


def _places(run: Run, timings: Rows, column: str, notes: list[str]) -> list[Place]:
    if column not in metric_columns(run.rows):
        notes.append(f"left out: {run.folder} has no figure {column}")
        return []
    found = []
    for point, swept in enumerate(run.sets):
        entries = [_entry(run, timings, point, id, column) for id in run.estimators]
        known = [e for e in entries if e.error.n]
        best = min(known, key=lambda e: e.error.mean, default=None)
        done = [_ranked(e, best, run, point, column, known) for e in entries]
        bound = next((c for c in metric_columns(run.rows) if c == BOUND or c.endswith(f".{BOUND}")), None)
        found.append(Place(run.name, shown(swept), int(run.manifest["trials"]), tuple(done), _figure(run.rows, point, None, bound)))
    return found


def _entry(run: Run, timings: Rows, point: int, id: str, column: str) -> Entry:
    values = np.array(list(run.values(point, id, column).values()), dtype=np.float64)
    updates = {name: c[timings["stage"] == "update"] for name, c in timings.items()} if "stage" in timings else {}
    return Entry(
        estimator=id,
        error=_figure(run.rows, point, id, column),
        rms=_figure(run.rows, point, id, RMS),
        cost=_figure(updates, point, id, "seconds_per_update"),
        failed=run.failed(point, id),
        empty=int(np.isnan(values).sum()),
    )


def _figure(rows: Rows, point: int, estimator: str | None, column: str | None) -> Interval:
    """The mean over trials of a column; of all estimators' rows where none is named."""
    if column is None or column not in rows:
        return mean_interval(np.empty(0))
    mask = rows["point"] == point
    if estimator is not None:
        mask = mask & (rows["estimator"] == estimator)
    return mean_interval(per_trial(rows["trial"][mask], rows[column][mask])[1])


def _ranked(entry: Entry, best: Entry | None, run: Run, point: int, column: str, known: Sequence[Entry]) -> Entry:
    """The entry with its p against the best one, not yet corrected, and whether it is on the front."""
    if best is None or not entry.error.n:
        return entry
    beaten = any(_better(o, entry) for o in known)
    if entry is best:
        return replace(entry, leads=True, front=not beaten)
    mine, theirs = (run.values(point, id, column) for id in (entry.estimator, best.estimator))
    both = [key for key in mine if key in theirs]
    gap = np.array([mine[key] - theirs[key] for key in both], dtype=np.float64)
    apart = per_trial(np.array([key[0] for key in both], dtype=np.int64), gap)[1]
    return replace(entry, p=test(apart[~np.isnan(apart)])[0], front=not beaten)


def _better(other: Entry, entry: Entry) -> bool:
    """Whether another is no worse in error and cost, and better in one."""
    a, b = (other.error.mean, other.cost.mean), (entry.error.mean, entry.cost.mean)
    return not any(map(math.isnan, (*a, *b))) and a[0] <= b[0] and a[1] <= b[1] and a != b


def holm(places: Sequence[Place]) -> list[Place]:
    """The places with all their p corrected together; who is not shown to be behind, leads."""
    p = iter(adjusted(np.array([e.p for place in places for e in place.entries])).tolist())
    found = []
    for place in places:
        entries = [replace(e, p=(value := next(p)), leads=e.leads or value >= SURE) for e in place.entries]
        entries.sort(key=lambda e: e.error.mean if e.error.n else math.inf)
        found.append(replace(place, entries=tuple(entries)))
    return found


def _told_apart(places: Sequence[Place]) -> list[Place]:
    """Runs of one scenario under the same name get numbers."""
    seen: dict[str, int] = {}
    found = []
    for place in places:
        seen[place.label] = seen.get(place.label, 0) + 1
        found.append(place if seen[place.label] == 1 else replace(place, scenario=f"{place.scenario} ({seen[place.label]})"))
    return found
