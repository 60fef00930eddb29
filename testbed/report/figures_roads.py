"""What map matching looks like: the error over time of many runs, when they settle, and clouds of particles on the roads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch

from testbed.columns import Array
from testbed.geometry import Roads
from testbed.metrics.error_curve import ERROR, RIGHT, SLICES
from testbed.quantity import convert
from testbed.report import palette
from testbed.report.cases import Case, Line
from testbed.report.figures import (
    FULL,
    WIDTH,
    Drawing,
    Styles,
    dots,
    drawing,
    legend,
    legend_height,
    new,
    settle,
    shape,
    shorten,
    styled,
)
from testbed.report.study import Study

SETTLE, LOST = "settle_s", "lost_runs"
MOST_LINES = 12
MOMENTS = (0.0, 8.0, 34.0, 54.0)  # s: those of El Mokhtari et al., Figs. 5 to 8
SHARES = (0.0, 0.04, 0.17, 0.27)  # of a shorter recording: the same shares of the paper's 200 s
CURVE_COLUMNS = (f"{ERROR}.", f"{RIGHT}.")  # too many for a table: they are drawn


def draw_roads(axes: Axes, roads: Roads | None, zorder: float = 1.5) -> None:
    """The network as thin lines, one way roads with an arrow in their middle."""
    if roads is None or not len(roads.segments):
        return
    ends = np.asarray(roads.nodes)[np.asarray(roads.segments)]
    lines = PathPatch(shape(ends, closed=False), fill=False, edgecolor=palette.SKY, linewidth=1.1, alpha=0.8, zorder=zorder)
    lines.set_gid("layer.roads")
    axes.add_patch(lines)
    for a, b in ends[np.asarray(roads.one_way)]:
        axes.annotate(
            "", (0.55 * b + 0.45 * a), (0.45 * b + 0.55 * a), arrowprops={"arrowstyle": "->", "color": palette.SKY, "linewidth": 1.1}
        )


# ---------------------------------------------------------------- over many runs


@styled
def curves(study: Study, name: str) -> Drawing | None:
    """Error and share of right segments over time, means over trials, a line for each estimator and point; None without `error_curve`."""
    if f"{ERROR}.s00" not in study.rows:
        return None
    lines = _lines(study)
    styles = Styles(tuple(lines))
    duration = _duration(study)
    t = (np.arange(SLICES) + 0.5) * duration / SLICES
    panels = [(ERROR, "position error (m)")]
    if np.isfinite(study.rows[f"{RIGHT}.s00"]).any():
        panels.append((RIGHT, "share with the right segment"))
    title = "Over time: the mean of all runs"
    handles = [styles.handle(label) for label in lines]
    figure = new(2.7 + legend_height(WIDTH, handles), title)
    grid = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (column, y_label) in zip(grid, panels, strict=True):
        for label, mask in lines.items():
            values = np.array([np.nanmean(study.rows[f"{column}.s{i:02d}"][mask]) if mask.any() else np.nan for i in range(SLICES)])
            axes.plot(t, values, **styles.line(label, SLICES))  # pyright: ignore[reportArgumentType]
        axes.set(xlabel="time (s)", ylabel=y_label, xlim=(0.0, duration))
        axes.set_ylim(0.0, 1.0 if column == RIGHT else None)
    legend(figure, handles)
    settle(figure)
    caption = (
        f"Means over trials and targets in {SLICES} equal parts of the time. A mean over runs stays high while a few runs are lost: "
        "when the others settled is in the figure of settle times."
    )
    return drawing(figure, name, title, caption)


@styled
def settling(study: Study, name: str) -> Drawing | None:
    """The share of runs that have settled by a time, lost ones never; None without `settle_time`."""
    if SETTLE not in study.rows:
        return None
    lines = _lines(study)
    styles = Styles(tuple(lines))
    duration = _duration(study)
    title = "When runs settle: share of runs that have by then"
    handles = [styles.handle(label) for label in lines]
    figure = new(2.7 + legend_height(WIDTH, handles), title)
    axes = figure.add_subplot()
    said = []
    for label, mask in lines.items():
        t = settle_times(study.rows, mask)
        if not len(t):
            continue
        found = t[np.isfinite(t)]
        steps = np.concatenate([[0.0], found, [duration]])
        share = np.concatenate([[0.0], np.arange(1, len(found) + 1), [len(found)]]) / len(t)
        axes.plot(steps, share, drawstyle="steps-post", **styles.line(label, len(steps)))  # pyright: ignore[reportArgumentType]
        said.append(f"{label}: median {_seconds(t, 0.5)}, 90 % {_seconds(t, 0.9)}, {len(t) - len(found)} of {len(t)} runs lost")
    axes.set(xlabel="settle time (s)", ylabel="share of runs", xlim=(0.0, duration), ylim=(0.0, 1.02))
    legend(figure, handles)
    settle(figure)
    caption = "A run settles at the start of its first unbroken stretch with a small error; one that never does is kept as “never”. "
    return drawing(figure, name, title, caption + "; ".join(said) + ".")


def settle_times(rows: Mapping[str, Array], mask: Array) -> Array:
    """(n,) s, ascending: settle times of the rows in `mask`, inf for a lost run; rows without either are left out."""
    t, lost = rows[SETTLE][mask].astype(np.float64), rows[LOST][mask].astype(np.float64)
    return np.sort(np.where(lost > 0, np.inf, t)[np.isfinite(t) | (lost > 0)])


def _duration(study: Study) -> float:
    """s; in the document it may be text with a unit."""
    return float(convert(study.manifest["scenario"]["document"]["duration_s"], "s"))


def _seconds(t: Array, share: float) -> str:
    """A quantile of sorted times by the nearest rank, so that "never" can be one."""
    value = t[min(len(t) - 1, max(0, int(np.ceil(share * len(t))) - 1))]
    return f"{value:.0f} s" if np.isfinite(value) else "never"


def _lines(study: Study) -> dict[str, Array]:
    """Labels of the lines of a figure over the whole run, with the rows of each: an estimator, at a point where there are several."""
    found: dict[str, Array] = {}
    for summary in study.summaries[:MOST_LINES]:
        label = study.label(summary.point)
        name = summary.estimator if not label else label if len(study.estimators) == 1 else f"{summary.estimator}, {label}"
        found[shorten(name, 60)] = (study.rows["point"] == summary.point) & (study.rows["estimator"] == summary.estimator)
    return found


# ---------------------------------------------------------------- one run


@styled
def clouds(case: Case, styles: Styles, name: str, where: str) -> Drawing | None:
    """The particles of the first method that has some, on the roads at four times; None without roads or particles."""
    roads = case.trial.recording.site.roads
    found = next(((aim, line) for aim in case.aims for line in aim.lines if line.cloud is not None), None)
    if roads is None or found is None:
        return None
    aim, line = found
    moments = MOMENTS if case.duration >= MOMENTS[-1] else tuple(share * case.duration for share in SHARES)
    nodes = np.asarray(roads.nodes)
    low, high = nodes.min(axis=0) - 1.5, nodes.max(axis=0) + 1.5
    title = f"The cloud of {shorten(line.estimator, 30)} on the roads"
    height = min(8.0, FULL / 2 * float((high - low)[1] / (high - low)[0]) + 0.5)
    figure = new(2 * height, title, FULL)
    for axes, moment in zip(figure.subplots(2, 2).flat, moments, strict=True):
        k = int(np.argmin(np.abs(line.t - moment)))
        draw_roads(axes, roads)
        _cloud_at(axes, line, k, styles.colour(line.estimator))
        truth = [np.interp(line.t[k], aim.t, column) for column in aim.truth.T]
        axes.plot(*truth, color=palette.TRUTH, marker="x", markersize=9, markeredgewidth=2, linestyle="none", zorder=6)
        axes.set(
            xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", title=f"t = {line.t[k]:g} s", xlabel="x (m)", ylabel="y (m)"
        )
    settle(figure)
    caption = f"{where}. Dots are equally weighted samples of the belief, the ring is its estimate, the cross is the truth."
    return drawing(figure, name, title, caption)


def _cloud_at(axes: Axes, line: Line, k: int, colour: str) -> None:
    cloud = np.zeros((0, 2)) if line.cloud is None else line.cloud[k]
    there = np.isfinite(cloud).all(axis=1)
    dots(axes, cloud[there, 0], cloud[there, 1], colour, size=3.0)
    axes.plot(*line.position[k], color=colour, marker="o", markersize=10, markerfacecolor="none", linestyle="none", zorder=5)
