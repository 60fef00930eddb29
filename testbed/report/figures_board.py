"""Figures over many runs: errors in small multiples, error against cost, differences with their intervals, distributions side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from testbed.compare import Pair, Side
from testbed.leaderboard import Board, Entry, Place
from testbed.report import palette
from testbed.report.amounts import capital, counted
from testbed.report.figures import FULL, WIDTH, Drawing, Styles, drawing, legend, legend_height, new, settle, shorten, styled
from testbed.report.figures_run import spelled

MOST_PANELS = 24
COLUMNS = 3
WIDE = 12.0  # errors that span more than so many times the least are drawn on a logarithmic axis
BOUND: dict[str, Any] = {"color": palette.INK, "linestyle": (0, (4, 2)), "linewidth": 1.0}


@styled
def errors(board: Board, styles: Styles, name: str) -> Drawing:
    """A panel a place: each estimator's mean error with its 95 % interval, and the bound where there is one."""
    places = board.places[:MOST_PANELS]
    most = max(len(p.entries) for p in places)
    title = f"{capital(spelled(board.column))}, by scenario"
    handles = [Line2D([], [], label="least rms error possible (bound)", **BOUND)] if any(p.has_bound for p in places) else []
    figure, grid = _grid(title, len(places), 0.75 + 0.19 * most, handles)
    for axes, place in zip(grid, places, strict=False):
        _means(axes, place, styles)
        axes.set_title(shorten(place.label, 44))
    for axes in grid[max(0, len(places) - COLUMNS) : len(places)]:
        axes.set_xlabel(spelled(board.column))
    legend(figure, handles)
    settle(figure)
    left = len(board.places) - len(places)
    said = "Mean over trials with 95 % intervals (Student's t); hollow where trials crashed or gave no value."
    return drawing(figure, name, title, said + (f" {counted(left, 'more place')} are in the table." if left > 0 else ""))


def _means(axes: Axes, place: Place, styles: Styles) -> None:
    for row, entry in enumerate(place.entries):
        i = entry.error
        if not i.n:
            axes.text(0.02, row, "no value", transform=axes.get_yaxis_transform(), va="center", fontsize=8)
            continue
        reach = np.nan_to_num(np.array([[i.mean - i.low], [i.high - i.mean]]))
        whole = not (entry.failed or entry.empty)
        colour = styles.colour(entry.estimator)
        marker = {"marker": styles.marker(entry.estimator), "color": colour, "markerfacecolor": colour if whole else "none"}
        axes.errorbar([i.mean], [row], xerr=reach, capsize=2.5, linestyle="none", **marker)  # pyright: ignore[reportArgumentType]
    if place.has_bound:
        axes.axvline(place.bound.mean, **BOUND)
    axes.set_yticks(range(len(place.entries)), [shorten(e.estimator, 18) for e in place.entries])
    axes.set_ylim(len(place.entries) - 0.5, -0.5)
    _from_zero(axes, [e.error.high if np.isfinite(e.error.high) else e.error.mean for e in place.entries], place)


def _from_zero(axes: Axes, tops: Sequence[float], place: Place) -> None:
    """From nought, or on a logarithmic axis where the errors span much."""
    means = [e.error.mean for e in place.entries if e.error.n and e.error.mean > 0]
    if len(means) > 1 and max(means) > WIDE * min(means):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.xaxis.set_minor_formatter(lambda v, _: "")
        return
    found = [v for v in (*tops, place.bound.mean) if np.isfinite(v)]
    axes.set_xlim(0.0, max([*found, 1e-9]) * 1.08)


@styled
def pareto(board: Board, styles: Styles, name: str) -> Drawing | None:
    """A panel a place: mean error against the wall time of an update, and the front that nobody is below; None without wall times."""
    places = [p for p in board.places if any(_drawn(e) for e in p.entries)][:MOST_PANELS]
    if not places:
        return None
    title = "Error against the time that an update takes"
    handles = [styles.handle(id) for id in board.estimators]
    for handle in handles:
        handle.set_linestyle("none")
    front = Line2D([], [], color=palette.FAINT, linewidth=1.2, label="front: nobody is both nearer and faster")
    figure, grid = _grid(title, len(places), 2.0, [*handles, front])
    for axes, place in zip(grid, places, strict=False):
        _costs(axes, place, styles)
        axes.set_title(shorten(place.label, 44))
        axes.set_xlabel("wall time of an update (ms)")
    for axes in grid[::COLUMNS]:
        axes.set_ylabel(spelled(board.column))
    legend(figure, [*handles, front])
    settle(figure)
    said = "Each machine has wall times of its own; crosses are 95 % intervals of both means. Dashed: the least rms error possible."
    return drawing(figure, name, title, said)


def _drawn(entry: Entry) -> bool:
    return bool(entry.error.n) and np.isfinite(entry.cost.mean) and entry.cost.mean > 0


def _costs(axes: Axes, place: Place, styles: Styles) -> None:
    there = [e for e in place.entries if _drawn(e)]
    front = sorted((e for e in there if e.front), key=lambda e: e.cost.mean)
    times = [1e3 * e.cost.mean for e in there]
    left, right = min(times) / 2.5, max(times) * 2.5
    top = max(e.error.high if np.isfinite(e.error.high) else e.error.mean for e in there) * 1.08
    axes.set_xscale("log")
    if front:
        corners = [(front[0].cost.mean * 1e3, top), *((1e3 * e.cost.mean, e.error.mean) for e in front), (right, front[-1].error.mean)]
        axes.plot(*np.transpose(corners), drawstyle="steps-post", color=palette.FAINT, linewidth=1.2, zorder=1)
    for e in there:
        x, y = 1e3 * e.cost.mean, e.error.mean
        x_reach = np.nan_to_num(1e3 * np.array([[min(e.cost.mean - e.cost.low, 0.9 * e.cost.mean)], [e.cost.high - e.cost.mean]]))
        y_reach = np.nan_to_num(np.array([[y - e.error.low], [e.error.high - y]]))
        look = {"marker": styles.marker(e.estimator), "color": styles.colour(e.estimator)}
        axes.errorbar([x], [y], xerr=x_reach, yerr=y_reach, linestyle="none", elinewidth=0.9, **look)  # pyright: ignore[reportArgumentType]
    if place.has_bound:
        axes.axhline(place.bound.mean, **BOUND)
    axes.set_xlim(left, right)
    axes.set_ylim(0.0, top)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
    axes.xaxis.set_minor_formatter(lambda v, _: "")


# ---------------------------------------------------------------- two sides


@styled
def differences(pairs: Sequence[Pair], name: str) -> Drawing:
    """Each pair's mean difference with its 95 % interval, against nought."""
    shown = pairs[: 2 * MOST_PANELS]
    title = "Differences on the same trials"
    figure = new(1.0 + 0.24 * len(shown), title)
    axes = figure.subplots()
    sure = [p.p_holm < 0.05 for p in shown]
    for row, (pair, known) in enumerate(zip(shown, sure, strict=True)):
        i = pair.difference
        if not i.n:
            continue
        reach = np.nan_to_num(np.array([[i.mean - i.low], [i.high - i.mean]]))
        look = {"color": palette.BLUE, "markerfacecolor": palette.BLUE if known else "none", "marker": "o", "capsize": 2.5}
        axes.errorbar([i.mean], [row], xerr=reach, linestyle="none", **look)  # pyright: ignore[reportArgumentType]
    axes.axvline(0.0, color=palette.INK, linewidth=0.9)
    axes.set_yticks(range(len(shown)), [shorten(_named(p, shown), 56) for p in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    columns = {p.column for p in shown}
    axes.set_xlabel(f"left minus right: {spelled(columns.pop())}" if len(columns) == 1 else "left minus right, each in its own unit")
    settle(figure)
    said = "95 % intervals of the mean difference, each for itself; filled where a difference is shown with all pairs considered (Holm)."
    return drawing(figure, name, title, said)


def _named(pair: Pair, all_: Sequence[Pair]) -> str:
    column = f", {pair.column}" if len({p.column for p in all_}) > 1 else ""
    return f"{pair.left.label} − {pair.right.label}{' at ' + pair.at if pair.at else ''}{column}"


@styled
def distributions(pairs: Sequence[Pair], name: str) -> Drawing | None:
    """A panel a place and figure: the share of trials whose value is at most so large, for each side; None where there is one trial."""
    groups: dict[tuple[str, str], dict[str, Side]] = {}
    for pair in pairs:
        for side in (pair.left, pair.right):
            if len(side.values) > 1:
                groups.setdefault((pair.at, pair.column), {})[side.label] = side
    if not groups:
        return None
    shown = list(groups.items())[:MOST_PANELS]
    labels = list(dict.fromkeys(label for _, sides in shown for label in sides))
    styles = Styles(labels)
    handles = [styles.handle(label) for label in labels]
    title = "How values are spread over trials"
    figure, grid = _grid(title, len(shown), 2.1, handles)
    for axes, ((at, column), sides) in zip(grid, shown, strict=False):
        for label, side in sides.items():
            share = np.arange(1, len(side.values) + 1) / len(side.values)
            axes.plot(side.values, share, drawstyle="steps-post", **styles.line(label, len(share)))  # pyright: ignore[reportArgumentType]
        axes.set(ylim=(0.0, 1.02), xlabel=spelled(column))
        axes.set_title(shorten(at, 44))
    for axes in grid[::COLUMNS]:
        axes.set_ylabel("share of trials")
    legend(figure, handles)
    settle(figure)
    return drawing(
        figure, name, title, "Share of trials whose value is at most so large. Trials that crashed or gave no value are not in it."
    )


def _grid(title: str, count: int, height: float, handles: Sequence[Line2D]) -> tuple[Any, list[Axes]]:
    """A figure of `count` panels, three in a row."""
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    width = FULL if columns > 1 else WIDTH
    figure = new(height * rows + 0.4 + legend_height(width, handles), title, width)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[count:]:
        axes.set_visible(False)
    return figure, grid
