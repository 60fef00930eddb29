"""What happened in a recording over time: the error above what the antennas saw and read, the signal strengths, the consistency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.ticker import MaxNLocator

from testbed.columns import Array
from testbed.quantiles import chi2_quantile
from testbed.report import palette
from testbed.report.amounts import counted, listed
from testbed.report.cases import Aim, Case, Line
from testbed.report.figures import (
    FULL,
    WIDTH,
    Drawing,
    Styles,
    dots,
    drawing,
    frame_of,
    is_wide,
    legend,
    legend_height,
    log_axis,
    new,
    settle,
    shape,
    shorten,
    styled,
)

NARROW = 5.8  # inches: what stands beside a plan
SLOTS = 500  # instants that a strip can tell apart
COLUMNS = 4  # of the grid of antennas
GRID = (220, 60)  # points that a panel of signal strengths can tell apart
TARGET_COLOURS = (palette.BLUE, palette.VERMILLION, palette.GREEN)
MOST_LOG = 1e6  # of NEES: more is told in words
BANDS = (  # of an honest filter, by how many components are judged
    {"facecolor": palette.FAINT, "alpha": 0.28, "edgecolor": "none"},
    {"facecolor": "none", "edgecolor": palette.INK, "linestyle": (0, (2, 2)), "linewidth": 0.8},
)


# ---------------------------------------------------------------- error over time


@styled
def error_over_time(case: Case, styles: Styles, name: str, where: str) -> Drawing | None:
    """Position error of every estimator, over a strip with each antenna's clear line of sight and reads. None without a target."""
    if not case.aims:
        return None
    heights = [h for aim in case.aims for h in (1.75, 0.155 * max(3, len(aim.antennas)) + 0.1)]
    title = "Position error, and when antennas saw and read the target"
    width = FULL if case.is_wide else NARROW
    handles = [*(styles.handle(id) for id in _shown(case.aims, styles)), *_strip_handles(case.aims)]
    figure = new(sum(heights) + 0.55 * len(case.aims) + 0.25 + legend_height(width, handles), title, width)
    grid = figure.subplots(len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for aim, above, below in zip(case.aims, grid[::2], grid[1::2], strict=True):
        _errors(above, aim, styles)
        if len(case.aims) > 1:
            above.set_title(shorten(aim.name, 60))
        _strip(below, aim, case)
    grid[-1].set_xlabel("time (s)")
    grid[-1].set_xlim(0.0, case.duration)
    legend(figure, handles)
    figure.align_ylabels()
    settle(figure)
    caption = _error_caption(case, where)
    return drawing(figure, name, title, caption, frames=[frame_of(axes) for axes in grid[::2]])


def _shown(aims: Sequence[Aim], styles: Styles) -> list[str]:
    there = {line.estimator for aim in aims for line in aim.lines}
    return [id for id in styles.ids if id in there]


def _errors(axes: Axes, aim: Aim, styles: Styles) -> None:
    every = np.concatenate([np.empty(0), *(line.error for line in aim.lines)])
    for line in aim.lines:
        (drawn,) = axes.plot(line.t, line.error, **styles.line(line.estimator, len(line.t)))  # pyright: ignore[reportArgumentType]
        drawn.set_gid(f"layer.e{styles.place(line.estimator)}")
    if is_wide(every):
        log_axis(axes, every)
    else:
        axes.set_ylim(0.0, _top(every))
        axes.yaxis.set_major_locator(MaxNLocator(5))
    dims = sorted({line.dims for line in aim.lines}) or [3]
    axes.set_ylabel("error (m)" if dims == [3] else "error on the floor (m)" if dims == [2] else "error (m), 2-D or 3-D")


def _top(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(good.max() * 1.06) if len(good) and good.max() > 0 else 1.0


def _strip(axes: Axes, aim: Aim, case: Case) -> None:
    """A row for each antenna: a bar while its line of sight is clear, and over it a mark for each instant with a read."""
    axes.grid(False)
    rows = len(aim.antennas)
    for row, antenna in enumerate(aim.antennas):
        if aim.sight is not None:
            step = aim.sight.t[1] - aim.sight.t[0]
            spans = _spans(aim.sight.t[aim.sight.clear[:, row]], step, case.duration)
            _bars(axes, spans, row - 0.02, row + 0.36, palette.SKY)
        reads = aim.reads.t[aim.reads.antenna == antenna]
        step = case.duration / SLOTS
        _bars(axes, _spans(np.unique(np.floor(reads / step)) * step + step / 2, step, case.duration), row - 0.4, row - 0.04, palette.INK)
    axes.set_ylim(max(3, rows) - 0.4, -0.6)
    axes.set_yticks(np.arange(rows), [f"{shorten(str(case.antennas.id[i]), 22)}  {i + 1}" for i in aim.antennas], fontsize=7)
    axes.tick_params(axis="y", length=0)
    if not rows:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no antenna", transform=axes.transAxes, ha="center", va="center")


def _spans(t: Array, step: float, end: float) -> list[tuple[float, float]]:
    """Instants `step` apart as the spans of time that they stand for."""
    if not len(t):
        return []
    breaks = np.flatnonzero(np.diff(t) > 1.5 * step)
    first, last = np.r_[0, breaks + 1], np.r_[breaks, len(t) - 1]
    return [(max(0.0, float(t[a] - step / 2)), min(end, float(t[b] + step / 2))) for a, b in zip(first, last, strict=True)]


def _bars(axes: Axes, spans: Sequence[tuple[float, float]], low: float, high: float, colour: str) -> None:
    path = shape(np.array([[a, low], [b, low], [b, high], [a, high]]) for a, b in spans)
    axes.add_patch(PathPatch(path, facecolor=colour, edgecolor="none"))


def _strip_handles(aims: Sequence[Aim]) -> list[Patch]:
    found = [Patch(facecolor=palette.INK, label="read by the antenna")]
    if any(aim.sight is not None for aim in aims):
        found.append(Patch(facecolor=palette.SKY, label="line of sight clear"))
    return found


def _error_caption(case: Case, where: str) -> str:
    said = [f"{where}. A gap in a line: the method has no estimate that it stands by."]
    if not len(case.antennas) or not any(aim.tags for aim in case.aims):
        pass  # nothing looks at anything
    elif all(aim.sight is None for aim in case.aims):
        said.append("Lines of sight can't be made again here: the world's ray caster is not installed.")
    else:
        said.append("A line of sight is clear where the straight line from the antenna to one of the target's tags crosses nothing.")
    more = len(case.antennas) - max(len(aim.antennas) for aim in case.aims)
    if more > 0:
        said.append(f"{counted(more, 'antenna')} with fewer reads not shown.")
    return " ".join(said)


# ---------------------------------------------------------------- signal strength


@styled
def signal_strength(case: Case, name: str, where: str) -> Drawing | None:
    """RSSI of each antenna's reads of the targets over time, a panel an antenna. None where none was read."""
    antennas = np.unique(np.concatenate([np.empty(0, dtype=int), *(a.antennas[np.isin(a.antennas, a.reads.antenna)] for a in case.aims)]))
    antennas = antennas.astype(int)
    rssi = np.concatenate([np.empty(0), *(aim.reads.rssi for aim in case.aims)])
    if not len(antennas) or not np.isfinite(rssi).any():
        return None
    columns = min(COLUMNS, len(antennas))
    rows = -(-len(antennas) // columns)
    title = "Signal strength (RSSI) of the target's reads over time, by antenna"
    figure = new(1.05 * rows + 1.1, title)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    low, high = np.nanmin(rssi) - 2.0, np.nanmax(rssi) + 2.0
    for axes, antenna in zip(grid.flat, antennas, strict=False):
        for k, aim in enumerate(case.aims):
            mine = aim.reads.take((aim.reads.antenna == antenna) & np.isfinite(aim.reads.rssi))
            dots(axes, *_thinned(mine.t, mine.rssi, case.duration, low, high), TARGET_COLOURS[k], 2.4 - 0.5 * k)
        axes.set_title(f"{antenna + 1} {shorten(str(case.antennas.id[antenna]), 22)}", fontsize=7.5)
        axes.set(xlim=(0.0, case.duration), ylim=(low, high))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
    _outer_only(grid, len(antennas))
    figure.supylabel("RSSI (dBm)", fontsize=9)
    if len(case.aims) > 1:
        legend(figure, [_dot(aim.name, TARGET_COLOURS[k]) for k, aim in enumerate(case.aims)])
    settle(figure)
    return drawing(figure, name, title, f"{where}. One dot for each read, or for several that fall together.")


def _thinned(t: Array, value: Array, duration: float, low: float, high: float) -> tuple[Array, Array]:
    """Points of which no two fall together at the size of a panel."""
    if not len(t):
        return t, value
    cells = np.stack([np.floor(t / duration * GRID[0]), np.floor((value - low) / (high - low) * GRID[1])], axis=1)
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return t[first], value[first]


def _outer_only(grid: Array, used: int) -> None:
    """Hide panels that hold nothing, and put tick labels under the last panel of each column."""
    columns = grid.shape[1]
    for i, axes in enumerate(grid.flat):
        axes.set_visible(i < used)
        is_last = i + columns >= used
        axes.tick_params(labelbottom=is_last, labelleft=i % columns == 0)
        axes.set_xlabel("time (s)" if is_last else "")


def _dot(label: str, colour: str) -> Line2D:
    return Line2D([], [], color=colour, marker="o", linestyle="none", label=shorten(label, 40))


# ---------------------------------------------------------------- consistency


@styled
def consistency(case: Case, styles: Styles, name: str, where: str) -> Drawing | None:
    """NEES of every estimator over time, with the limits of an honest filter. None where no estimate has one."""
    aims = [aim for aim in case.aims if any(_positive(line).any() for line in aim.lines)]
    if not aims:
        return None
    title = "Consistency (NEES) over time: squared error by the filter's own covariance"
    dofs = sorted({line.dof for aim in aims for line in aim.lines if _positive(line).any()})
    handles: list[Line2D | Patch] = [styles.handle(id) for id in _shown(aims, styles)]
    handles += [Patch(**look, label=f"95 % of an honest filter, {dof} components") for dof, look in zip(dofs, BANDS, strict=False)]  # pyright: ignore[reportArgumentType]
    figure = new(1.75 * len(aims) + 0.75 + legend_height(WIDTH, handles), title)
    grid = figure.subplots(len(aims), 1, sharex=True, squeeze=False)[:, 0]
    for aim, axes in zip(aims, grid, strict=True):
        for line in aim.lines:
            shown = np.where(_positive(line) & (line.nees <= MOST_LOG), line.nees, np.nan)
            axes.plot(line.t, shown, **styles.line(line.estimator, len(line.t)))  # pyright: ignore[reportArgumentType]
        log_axis(axes, np.concatenate([[0.5, 20.0], *(line.nees[line.nees <= MOST_LOG] for line in aim.lines)]))
        axes.set_ylim(max(axes.get_ylim()[0], 1e-3), None)
        for dof, look in zip(dofs, BANDS, strict=False):
            axes.axhspan(*chi2_quantile([0.025, 0.975], dof), **look, zorder=0)
        if len(aims) > 1:
            axes.set_title(shorten(aim.name, 60))
        axes.set_ylabel("NEES")
    grid[-1].set(xlabel="time (s)", xlim=(0.0, case.duration))
    legend(figure, handles)
    settle(figure)
    return drawing(figure, name, title, _consistency_caption(aims, dofs, where))


def _positive(line: Line) -> Array:
    return np.isfinite(line.nees) & (line.nees > 0)


def _consistency_caption(aims: Sequence[Aim], dofs: list[int], where: str) -> str:
    said = [f"{where}. Above the band the filter is too sure of itself, below it too modest; no unit."]
    if len(dofs) > 1:
        which = {dof: dict.fromkeys(line.estimator for aim in aims for line in aim.lines if line.dof == dof) for dof in dofs}
        said.append("Components judged: " + "; ".join(f"{dof} of {listed(list(ids))}" for dof, ids in which.items()) + ".")
    beyond = {line.estimator: int((line.nees > MOST_LOG).sum()) for aim in aims for line in aim.lines}
    said += [f"{id} is above 1,000,000 at {counted(n, 'time')}." for id, n in beyond.items() if n]
    return " ".join(said)
