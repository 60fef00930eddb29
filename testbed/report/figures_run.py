"""What a whole run found: how errors are distributed, and how the main figure changes along a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from testbed.columns import Array
from testbed.evaluate import Summary, per_trial, split
from testbed.report.amounts import capital, counted
from testbed.report.cases import Case
from testbed.report.figures import WIDTH, Drawing, Styles, drawing, is_wide, legend, legend_height, log_axis, new, settle, shorten, styled
from testbed.report.study import MAIN, Study

STEPS = 300  # of a distribution's curve
MOST_PANELS = 6  # of a sweep over several paths
TILT = 14  # letters: longer names of places on an axis are turned
UNITS = {"m": "m", "s": "s", "mps": "m/s", "deg": "°", "rad": "rad", "hz": "Hz", "db": "dB", "dbm": "dBm"}


def spelled(column: str) -> str:
    """A column of the results in words with its unit: "position_error_m.mean" -> "position error, mean (m)"."""
    metric, statistic = split(column)
    stem, _, suffix = metric.rpartition("_")
    unit = UNITS.get(suffix, "") if stem else ""
    words = (stem if unit else metric).replace("_", " ")
    return f"{words}{', ' + statistic.replace('_', ' ') if statistic else ''}{f' ({unit})' if unit else ''}"


# ---------------------------------------------------------------- distribution


@styled
def error_distribution(study: Study, point: int, cases: Sequence[Case], styles: Styles, name: str) -> Drawing | None:
    """Distributions of the position error: over trials, of each trial's mean; over time, in the recordings kept. None without either."""
    over_trials = _by_trial(study, point)
    over_time = _by_time([c for c in cases if c.kept.point == point], styles.ids)
    panels = []
    if max((len(v) for v in over_trials.values()), default=0) > 1:
        panels.append(("mean error of a trial (m)", "share of trials", over_trials))
    if over_time:
        panels.append(("error at a report time (m)", "share of times", over_time))
    if not panels:
        return None
    title = "Distribution of the position error: how often it is at most so large"
    handles = [styles.handle(id) for id in styles.ids if any(id in values for *_, values in panels)]
    figure = new(2.8 + legend_height(WIDTH, handles), title)
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axes, (x_label, y_label, values) in zip(grid, panels, strict=True):
        _curves(axes, values, styles)
        axes.set(xlabel=x_label, ylabel=y_label, ylim=(0.0, 1.02))
        axes.tick_params(labelleft=True)
    legend(figure, handles)
    settle(figure)
    return drawing(figure, name, title, _distribution_caption(study, point, over_trials, cases, panels))


def _by_trial(study: Study, point: int) -> dict[str, Array]:
    if MAIN not in study.rows:
        return {}
    found = {}
    for summary in study.of(point):
        here = (study.rows["point"] == point) & (study.rows["estimator"] == summary.estimator)
        values = per_trial(study.rows["trial"][here], study.rows[MAIN][here])[1]
        found[summary.estimator] = np.sort(values[np.isfinite(values)])
    return {id: values for id, values in found.items() if len(values)}


def _by_time(cases: Sequence[Case], estimators: Sequence[str]) -> dict[str, Array]:
    found = {}
    for id in estimators:
        errors = [line.error for case in cases for aim in case.aims for line in aim.lines if line.estimator == id]
        every = np.concatenate([np.empty(0), *errors])
        if np.isfinite(every).any():
            found[id] = np.sort(every[np.isfinite(every)])
    return found


def _curves(axes: Axes, values: Mapping[str, Array], styles: Styles) -> None:
    every = np.concatenate([*values.values()])
    for id, v in values.items():
        share = np.arange(1, len(v) + 1) / len(v)
        keep = np.unique(np.linspace(0, len(v) - 1, min(len(v), STEPS)).astype(int))
        x, y = np.r_[v[0], v[keep]], np.r_[0.0, share[keep]]
        axes.plot(x, y, drawstyle="steps-post" if len(v) <= 60 else "default", **styles.line(id, len(x)))  # pyright: ignore[reportArgumentType]
    if is_wide(every):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.xaxis.set_minor_formatter(lambda v, _: "")
    else:
        axes.set_xlim(0.0, max(float(every.max()) * 1.04, 1e-6))


def _distribution_caption(
    study: Study,
    point: int,
    over_trials: Mapping[str, Array],
    cases: Sequence[Case],
    panels: Sequence[tuple[str, str, Mapping[str, Array]]],
) -> str:
    said = [f"{study.label(point)}." if study.label(point) else ""]
    if panels[0][2] is over_trials:
        said.append(f"Over trials: {counted(max(len(v) for v in over_trials.values()), 'trial')}, each by its mean error over time.")
    else:
        said.append("Of one trial there is no distribution over trials.")
    if len(panels) > 1 or panels[0][2] is not over_trials:
        kept = [c for c in cases if c.kept.point == point]
        said.append(f"Over time: all report times of {counted(len(kept), 'recording')} kept; neighbouring times are not independent.")
    return " ".join(s for s in said if s)


# ---------------------------------------------------------------- sweep


@styled
def sweep(study: Study, styles: Styles, name: str) -> Drawing | None:
    """The main figure against what is swept, with 95 % intervals; None without a sweep or results."""
    if study.main is None or len(study.sets) < 2:
        return None
    paths = list(dict.fromkeys(path for point in study.sets for path in point))
    values = {path: list(dict.fromkeys(str(point.get(path)) for point in study.sets)) for path in paths}
    along = max(paths, key=lambda path: len(values[path]))
    others = [path for path in paths if path != along]
    groups: dict[tuple[str, ...], list[int]] = {}
    for i, point in enumerate(study.sets):
        groups.setdefault(tuple(str(point.get(path)) for path in others), []).append(i)
    shown = list(groups.items())[:MOST_PANELS]
    title = f"{capital(spelled(study.main))} along the sweep"
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    handles = [styles.handle(id) for id in styles.ids]
    figure = new(2.5 * rows + 0.7 + legend_height(WIDTH, handles), title)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    every = np.concatenate([np.empty(0), *([s.statistics[study.main].mean] for s in study.summaries)])
    for axes, (which, points) in zip(grid.flat, shown, strict=False):
        _along(axes, study, points, along, styles)
        axes.set_title(shorten(", ".join(f"{p.rpartition('.')[2]} = {v}" for p, v in zip(others, which, strict=True)), 40))
        axes.set_xlabel(shorten(along, 60 if columns == 1 else 30))
        if is_wide(every):
            log_axis(axes, every)
    for axes in list(grid.flat)[len(shown) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel(spelled(study.main))
    legend(figure, handles)
    settle(figure)
    return drawing(figure, name, title, _sweep_caption(study, len(shown), len(groups)))


def _along(axes: Axes, study: Study, points: Sequence[int], path: str, styles: Styles) -> None:
    """One panel: a line an estimator, its points a little apart so that their bars don't cover each other."""
    raw = [study.sets[i].get(path) for i in points]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in raw)
    places = np.array(raw, dtype=np.float64) if numeric else np.arange(len(raw), dtype=np.float64)
    gap = float(np.min(np.diff(np.unique(places)))) if len(np.unique(places)) > 1 else 1.0
    for id in styles.ids:
        by_point = {s.point: s for s in study.summaries if s.estimator == id}
        there = [(x, by_point[i]) for x, i in zip(places.tolist(), points, strict=True) if i in by_point]
        there.sort(key=lambda one: one[0])  # a line along the values, whatever order the file has them in
        if there:
            shift = 0.06 * gap * (styles.place(id) - (len(styles.ids) - 1) / 2) / max(1, len(styles.ids) - 1)
            _bars(axes, there, shift, study.main or "", id, styles)
    if numeric and len(raw) <= 8:
        axes.set_xticks(places, [f"{v:g}" for v in places])
    elif not numeric:
        names = [shorten(str(v), 20) for v in raw]
        turned = max(map(len, names)) > TILT or sum(map(len, names)) > 60
        axes.set_xticks(places, names, rotation=35 if turned else 0, ha="right" if turned else "center")


def _bars(axes: Axes, there: Sequence[tuple[float, Summary]], shift: float, column: str, id: str, styles: Styles) -> None:
    found = [s.statistics[column] for _, s in there]
    mean, low, high = (np.array([getattr(i, part) for i in found]) for part in ("mean", "low", "high"))
    reach = np.nan_to_num(np.stack([mean - low, high - mean]))
    axes.errorbar(np.array([x for x, _ in there]) + shift, mean, yerr=reach, capsize=2.5, **styles.line(id))  # pyright: ignore[reportArgumentType]


def _sweep_caption(study: Study, shown: int, groups: int) -> str:
    n = [s.statistics[study.main].n for s in study.summaries] if study.main else []
    fewest, most = min(n, default=0), max(n, default=0)
    count = f"{fewest} to {most}" if fewest < most else f"{most}"
    said = [f"Means over trials ({count} a point) with 95 % confidence intervals (Student's t)."]
    if most < 2:
        said = ["One trial a point: there are no intervals."]
    if groups > shown:
        said.append(f"{groups - shown} more combinations are in the tables.")
    return " ".join(said)
