"""The tables of a report as plain cells: every mean with its standard error and its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from testbed.evaluate import Interval, Summary, metric_columns
from testbed.report.amounts import NOTHING, counted, interval, limits, number, seconds
from testbed.report.figures_roads import CURVE_COLUMNS
from testbed.report.figures_run import spelled
from testbed.report.study import Study

SHARES = (
    "availability",
    "nees.inside_95",
    "nis.inside_95",
    "line_of_sight",
    "found",
    "in_time",
    "slips",
    "trusted",
    "segment.identified",
    "lost_runs",
)  # in %
RESULTS = {  # column of the results -> heading, unit
    "position_error_m.mean": ("mean error", "m"),
    "position_error_m.p50": ("median error", "m"),
    "position_error_m.p95": ("95 % point of error", "m"),
    "position_error_m.final": ("final error", "m"),
    "availability": ("available", "% of the time"),
    "nees.mean": ("NEES", ""),
    "nees.inside_95": ("NEES within its 95 % limits", "% of the time"),
    "nis.mean": ("NIS per degree of freedom", ""),
    "time_lost_s.total": ("time lost", "s"),
    "segment.identified": ("right road segment", "% of the time"),
    "settle_s": ("settle time, of runs that settle", "s"),
    "lost_runs": ("runs that never settle", "% of trials"),
    "steps": ("steps", ""),
    "turns": ("turns", ""),
    "distance_m": ("way walked", "m"),
    "found": ("found", "% of trials"),
    "in_time": ("found in time", "% of trials"),
    "cosine.mean": ("guidance cosine", "mean over a trial's steps"),
    "seconds": ("until the end", "s"),
    "slips": ("steps whose phase slipped", "%"),
    "trusted": ("steps whose phase was trusted", "%"),
}


@dataclass(frozen=True)
class Head:
    """A column's heading and, under it, its unit."""

    text: str
    under: str = ""
    number: bool = True


@dataclass(frozen=True)
class Cell:
    """What stands in a cell, smaller lines under it, and whether it is "good" or "bad"."""

    text: str
    under: tuple[str, ...] = ()
    mark: str = ""


@dataclass(frozen=True)
class Grid:
    """A table with its caption. The first column names the rows."""

    caption: str
    heads: tuple[Head, ...]
    rows: tuple[tuple[Cell, ...], ...] = field(default=())


def mean_cell(found: Interval | None, share: bool = False, more: Sequence[str] = ()) -> Cell:
    """A mean ± its standard error, under it the 95 % interval; a share in %."""
    if found is None or not math.isfinite(found.mean):
        return Cell(NOTHING)
    if share:
        found = Interval(100 * found.mean, 100 * found.se, 100 * found.low, 100 * found.high, found.n)
    value = number(found.mean, found.se)
    if not math.isfinite(found.se):
        return Cell(value, tuple(more))
    return Cell(f"{value} ± {number(found.se, found.se) if found.se else 0}", (interval(found), *more))


def is_share(column: str) -> bool:
    return column.split(".", 1)[-1] in SHARES or column in SHARES


# ---------------------------------------------------------------- results


def results(study: Study, point: int) -> Grid:
    """Figures of merit in rows, estimators in columns; figures that no estimator has are left out."""
    here = study.of(point)
    shown = [c for c in RESULTS if any(c in s.statistics and math.isfinite(s.statistics[c].mean) for s in here)]
    rows = [(Cell(*_named(c)), *(mean_cell(s.statistics.get(c), is_share(c), _honest(s, c)) for s in here)) for c in shown]
    if any("cosine.sum" in s.statistics for s in here):
        rows.append((Cell("guidance cosine (pooled over all steps)"), *(Cell(_pooled(s, "cosine.sum", "cosine.steps")) for s in here)))
    rows.append((Cell("wall time per update", ("of this machine",)), *(_wall(study.wall.get((point, s.estimator))) for s in here)))
    rows.append((Cell("trials"), *(_trials(s, study.main) for s in here)))
    heads = (Head("", number=False), *(Head(s.estimator) for s in here))
    return Grid(f"Results{_at(study, point)}: mean over trials ± standard error, and under it the 95 % interval", heads, tuple(rows))


def _pooled(summary: Summary, total: str, count: str) -> str:
    """A mean over everything in all trials, from the means over trials of a sum and of how many it is over."""
    many = summary.statistics[count].mean
    return f"{summary.statistics[total].mean / many:.2f}" if many > 0 else NOTHING


def _named(column: str) -> tuple[str, tuple[str, ...]]:
    name, unit = RESULTS[column]
    return f"{name} ({unit})" if unit else name, ()


def _honest(summary: Summary, column: str) -> tuple[str, ...]:
    """The χ² limits of a consistency figure, and on which side of them it lies."""
    if column not in summary.limits or not math.isfinite(summary.limits[column][0]):
        return ()
    low, high = summary.limits[column]
    value = summary.statistics[column].mean
    side = "above, too sure" if value > high else "below, too modest" if value < low else "within"
    return (f"χ² limits {limits(low, high)}: {side}",)


def _trials(summary: Summary, main: str | None) -> Cell:
    """How many trials the main figure is the mean of, and how many (trial, target) rows have none."""
    n = max((i.n for i in summary.statistics.values()), default=0) if main is None else summary.statistics[main].n
    missing = 0 if main is None else summary.missing[main]
    return Cell(f"{n:,}", (f"{counted(missing, 'row')} without a value",) if missing else ())


def _wall(found: Interval | None) -> Cell:
    if found is None or not math.isfinite(found.mean):
        return Cell(NOTHING)
    spread = (f"{seconds(max(0.0, found.low))} to {seconds(found.high)}",) if math.isfinite(found.low) else ()
    return Cell(seconds(found.mean), spread)


def _at(study: Study, point: int) -> str:
    return f" at {study.label(point)}" if study.label(point) else ""


def everything(study: Study, point: int) -> Grid:
    """Every figure of merit in a row, estimators in columns."""
    here = study.of(point)
    columns = [c for c in metric_columns(study.rows) if any(c in s.statistics and s.statistics[c].n for s in here)]
    columns = [c for c in columns if not c.startswith(CURVE_COLUMNS)]
    rows = [
        (Cell(spelled(c), (c,)), *(mean_cell(s.statistics.get(c), is_share(c), (f"n = {s.statistics[c].n}",)) for s in here))
        for c in columns
    ]
    heads = (Head("figure", number=False), *(Head(s.estimator) for s in here))
    caption = "Mean over trials, ± standard error, 95 % interval, and from how many trials; shares (availability, inside 95) in %"
    return Grid(caption, heads, tuple(rows))


def world(study: Study, point: int) -> Grid | None:
    """What the world offered, by sensor and over all of them, without figures that had nothing to speak of; None where it says nothing."""
    found = {name: value for name, value in study.world[point].items() if value.n}
    if not found:
        return None
    sensors = {name.rpartition(".")[0] for name in found} - {""}
    if len(sensors) == 1:  # then the figures over all sensors are its own
        found = {name: value for name, value in found.items() if "." not in name}
    rows = [(Cell(_stimulus(name, len(sensors))), mean_cell(value, is_share(name)), Cell(f"{value.n:,}")) for name, value in found.items()]
    return Grid(
        f"What the world offered{_at(study, point)}",
        (Head("stimulus", number=False), Head("mean over trials"), Head("trials")),
        tuple(rows),
    )


def _stimulus(name: str, sensors: int) -> str:
    sensor, _, own = name.rpartition(".")
    words = f"{own.replace('_', ' ')} (%)" if is_share(name) else spelled(own)
    return f"{words}, {sensor}" if sensor else f"{words}, all sensors" if sensors > 1 else words


def pairs(study: Study, point: int) -> Grid | None:
    """Differences of estimators on the same trials; None where there are none to compare."""
    here = [p for p in study.pairs if p.point == point and p.interval.n]
    if not here:
        return None
    rows = []
    for p in here:
        low, high = p.interval.low, p.interval.high
        if not math.isfinite(low):
            said = Cell("one trial says nothing of it")
        elif low > 0 or high < 0:
            said = Cell(f"{p.left if high < 0 else p.right} is lower")
        else:
            said = Cell("no difference shown")
        rows.append((Cell(f"{p.left} − {p.right}"), Cell(spelled(p.column)), mean_cell(p.interval), Cell(f"{p.interval.n:,}"), said))
    heads = (
        Head("difference", number=False),
        Head("of", number=False),
        Head("mean ± standard error", "95 % interval"),
        Head("trials"),
        Head("conclusion", number=False),
    )
    return Grid(f"Estimators compared on the same trials{_at(study, point)}", heads, tuple(rows))


# ---------------------------------------------------------------- claims, identity


def claims(study: Study) -> Grid | None:
    """Every expectation at every point, and whether it held."""
    if not study.claims:
        return None
    swept = len(study.sets) > 1
    rows = []
    for c in study.claims:
        mark = Cell("✓ holds", mark="good") if c.ok else Cell("✗ failed", mark="bad")
        se = (c.interval[1] - c.interval[0]) / 4
        got = Cell(number(c.value, se), (f"{number(c.interval[0], se)} to {number(c.interval[1], se)}",) if math.isfinite(se) else ())
        cells = [Cell(c.text, (c.note,) if c.note else ()), mark, got, Cell(NOTHING if c.line is None else str(c.line))]
        rows.append((*cells, Cell(study.label(c.point))) if swept else tuple(cells))
    heads = [Head("claim", number=False), Head("", number=False), Head("got", "95 % interval"), Head("line", "of the scenario")]
    if swept:
        heads.append(Head("at", number=False))
    held = sum(c.ok for c in study.claims)
    caption = (
        f"{held} of {len(study.claims)} hold; a claim on a difference wants its 95 % limit within the bound, any other the mean itself"
    )
    return Grid(caption, tuple(heads), tuple(rows))


def identity(study: Study) -> Grid:
    """What was run, to the digit: scenario, seed, versions."""
    manifest = study.manifest
    versions = manifest.get("versions", {})
    libraries = ", ".join(f"{name} {v}" for name, v in versions.items() if name not in ("code", "testbed", "python"))
    pairs = [
        ("scenario", study.name),
        ("scenario hash", str(manifest["scenario"]["hash"])),
        ("seed", str(manifest["seed"])),
        ("trials", f"{manifest['trials']}{f' at each of {len(study.sets)} points of the sweep' if len(study.sets) > 1 else ''}"),
        ("estimators", ", ".join(f"{e['id']} ({e['kind']})" if e["id"] != e["kind"] else e["id"] for e in manifest["estimators"])),
        ("testbed", f"{versions.get('testbed', NOTHING)}, code {versions.get('code', NOTHING)}"),
        ("Python", f"{versions.get('python', NOTHING)} with {libraries}"),
        ("machine", ", ".join(dict.fromkeys(str(v) for v in manifest.get("platform", {}).values()))),
        ("recordings kept", str(manifest.get("keep", NOTHING))),
    ]
    heads = (Head("", number=False), Head("", number=False))
    return Grid("", heads, tuple((Cell(name), Cell(value)) for name, value in pairs))
