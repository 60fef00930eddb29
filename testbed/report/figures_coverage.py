"""Coverage over the plan: read probability, number of antennas and level as maps, a panel for each height, dead zones hatched.

Cells are one picture a panel, embedded in the SVG; all else stays lines and text. What lies on the cells has colours of its own, the
same on light and dark pages, since the cells have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch

from testbed.columns import Array
from testbed.coverage import DEAD, HEARD, Coverage
from testbed.report import palette, plan
from testbed.report.amounts import counted, listed
from testbed.report.figures import DPI, FULL, Drawing, drawing, legend, legend_height, new, settle, shape, styled
from testbed.report.figures_plan import MARK, antenna_labels, gate_labels, grouped, mark, numbers, rack_labels, triangles
from testbed.report.labels import place
from testbed.scene import Scene, Truth

COLOURS = "cividis"  # J. R. Nunez et al., PLoS ONE 13 (2018): even steps of lightness with any kind of colour vision
SOLID, LINE, LIGHT = "#B7BCC4", "#14171C", "#FDFDFD"  # things at that height; lines over light cells, and over dark ones
ALONE, TALLEST = 6.6, 7.0  # inches: width of a figure of one panel, height of a panel
BAR = 1.15  # inches, for the colour bar and its label
MOST_NUMBER = 6  # antennas: more are of the last colour
LEVEL_STEP = 5.0  # dB between ticks of the level


@dataclass(frozen=True, eq=False)
class _Map:
    """One quantity over (Z, Y, X), how it is coloured, and what the bar beside it says: (value, text) of its ticks."""

    name: str
    title: str
    values: Array
    colours: Colormap
    norm: Normalize
    label: str
    ticks: tuple[tuple[float, str], ...]


@styled
def coverage_maps(found: Coverage, scene: Scene, truth: Truth, name: str = "coverage") -> tuple[Drawing, ...]:
    """Figures of read probability, number of antennas and, where there are any, levels. `truth`: moving bodies as they start."""
    return tuple(_figure(found, scene, truth, one, f"{name}-{one.name}") for one in _maps(found))


def _maps(found: Coverage) -> list[_Map]:
    continuous = matplotlib.colormaps[COLOURS]
    quarters = tuple((q, f"{100 * q:.0f}") for q in (0.0, 0.25, 0.5, 0.75, 1.0))
    maps = [
        _Map(
            "read", "Coverage: where a tag is read", found.read, continuous, Normalize(0, 1),
            "visits in which a tag is read (%)", quarters,
        ),
    ]  # fmt: skip
    most = int(min(MOST_NUMBER, max(1, np.nanmax(found.antennas, initial=0))))
    colours = ListedColormap(continuous(np.linspace(0.0, 1.0, most + 1)))
    more = bool(np.nanmax(found.antennas, initial=0) > most)
    ticks = tuple((float(n), f"{n}{' and more' if more and n == most else ''}") for n in range(most + 1))
    number = np.minimum(found.antennas, most)
    maps.append(
        _Map("antennas", "Coverage: by how many antennas", number, colours, BoundaryNorm(np.arange(most + 2) - 0.5, most + 1),
             "antennas that read a tag", ticks)
    )  # fmt: skip
    if np.isfinite(found.level).any():
        told = found.level[np.isfinite(found.level) & ~found.dead]
        told = told if len(told) else found.level[np.isfinite(found.level)]  # of dead zones alone where there is nothing else
        low, high = told.min() // LEVEL_STEP * LEVEL_STEP, -(-told.max() // LEVEL_STEP) * LEVEL_STEP
        high = max(high, low + LEVEL_STEP)
        every = LEVEL_STEP * max(1, round((high - low) / LEVEL_STEP / 6))
        ticks = tuple((float(v), f"{v:.0f}".replace("-", "−")) for v in np.arange(low, high + 0.1, every))
        maps.append(_Map("level", "Coverage: how strong", found.level, continuous, Normalize(low, high), "mean RSSI (dBm)", ticks))
    return maps


# ---------------------------------------------------------------- a figure


def _figure(found: Coverage, scene: Scene, truth: Truth, one: _Map, name: str) -> Drawing:
    wide, tall = np.ptp(np.asarray(scene.bounds)[:, :2], axis=0)
    panels = len(found.z)
    columns = 1 if panels == 1 else 2 if wide > 0.6 * tall else 3
    width = ALONE if panels == 1 and wide < 1.6 * tall else FULL
    inner = (width - BAR) / columns - 0.6
    rows = -(-panels // columns)
    handles = _handles(found, truth, one)
    height = rows * (min(TALLEST, inner * tall / wide) + 0.7) + 0.4 + legend_height(width, handles)
    figure = new(height, one.title, width)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    standing, groups = plan.standing(scene), grouped(found.pose)
    drawn: list[Axes] = list(grid.ravel()[:panels])
    for axes in grid.ravel()[panels:]:
        axes.set_axis_off()
    for k, axes in enumerate(drawn):
        _panel(axes, found, scene, truth, one, k)
        axes.set_title(f"{found.z[k]:g} m above the floor")
        axes.set(xlabel="x (m)" if k >= panels - columns else "", ylabel="y (m)" if k % columns == 0 else "")
        axes.tick_params(labelbottom=k >= panels - columns)
        path = triangles(groups, MARK * float(wide) / (inner * DPI))
        axes.add_patch(PathPatch(path, facecolor=LIGHT, edgecolor=LINE, linewidth=0.9, zorder=6))
    _bar(figure, grid.ravel().tolist(), one)
    legend(figure, handles)
    settle(figure)
    labels = [*gate_labels(standing), *antenna_labels([(spot, numbers(members)) for spot, _, members in groups]), *rack_labels(standing)]
    homeless = [text for axes in drawn for text in place(axes, labels, [mark(axes, spot) for spot, _, _ in groups])]
    return drawing(figure, name, one.title, _caption(found, truth, one, homeless))


def _panel(axes: Axes, found: Coverage, scene: Scene, truth: Truth, one: _Map, k: int) -> None:
    half = found.step_m / 2
    extent = (found.x[0] - half, found.x[-1] + half, found.y[0] - half, found.y[-1] + half)
    cells = np.ma.masked_invalid(one.values[k])
    ground = one.colours.with_extremes(bad="#00000000")
    axes.imshow(cells, cmap=ground, norm=one.norm, origin="lower", extent=extent, interpolation="none", zorder=0.5)
    low, high = np.asarray(scene.bounds)[:, :2]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    axes.grid(False)
    edges = (found.x - half, found.y - half)
    axes.add_patch(PathPatch(shape(_runs(found.inside[k], *edges, found.step_m)), facecolor=SOLID, edgecolor="none", zorder=1))
    if found.dead[k].any():
        dead = shape(_runs(found.dead[k], *edges, found.step_m))
        axes.add_patch(PathPatch(dead, fill=False, hatch="////", edgecolor=LIGHT, linewidth=0.0, zorder=2))
        outline = shape(_outline(found.dead[k], *edges, found.step_m), closed=False)
        axes.add_patch(PathPatch(outline, fill=False, edgecolor=LINE, linewidth=2.2, capstyle="projecting", zorder=2.1))
        axes.add_patch(PathPatch(outline, fill=False, edgecolor=LIGHT, linewidth=1.1, capstyle="projecting", zorder=2.2))
    bodies = [*(f.outline for f in plan.standing(scene) if f.kind != "gate"), *_starting(scene, truth)]
    for colour, width in ((LIGHT, 1.7), (LINE, 0.8)):
        axes.add_patch(PathPatch(shape(bodies), fill=False, edgecolor=colour, linewidth=width, zorder=3))
    gates = shape(p for f in plan.standing(scene) if f.kind == "gate" for p in (*f.solid, *f.overhead))
    axes.add_patch(PathPatch(gates, facecolor=LINE, edgecolor=LIGHT, linewidth=0.5, alpha=0.9, zorder=3.1))


def _starting(scene: Scene, truth: Truth) -> list[Array]:
    """Outlines of moving bodies where they start."""
    return [plan.placed(outline, truth.poses[0, i]) for i, outline in enumerate(plan.outlines(scene)) if len(outline)]


def _runs(mask: Array, x: Array, y: Array, step: float) -> list[Array]:
    """A rectangle (4, 2) for each run of marked cells in a row; x, y: lower edges of columns and rows."""
    found = []
    for row, line in enumerate(mask):
        turns = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        for first, last in zip(turns[::2], turns[1::2], strict=True):
            left, right, low, high = x[first], x[last - 1] + step, y[row], y[row] + step
            found.append(np.array([[left, low], [right, low], [right, high], [left, high]]))
    return found


def _outline(mask: Array, x: Array, y: Array, step: float) -> list[Array]:
    """Straight lines (2, 2) between marked cells and others; those that follow each other are one."""
    level = _borders(mask, x, y, step)
    return level + [line[:, ::-1] for line in _borders(mask.T, y, x, step)]


def _borders(mask: Array, x: Array, y: Array, step: float) -> list[Array]:
    """The lines along x."""
    padded = np.zeros((mask.shape[0] + 2, mask.shape[1]), dtype=np.int8)
    padded[1:-1] = mask
    found = []
    for row, line in enumerate(np.diff(padded, axis=0) != 0):
        turns = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        at = y[0] + row * step
        found += [np.array([[x[a], at], [x[b - 1] + step, at]]) for a, b in zip(turns[::2], turns[1::2], strict=True)]
    return found


def _bar(figure: Figure, axes: Sequence[Axes], one: _Map) -> None:
    below = "min" if one.name == "level" and np.nanmin(one.values) < (one.norm.vmin or 0.0) else "neither"
    bar = figure.colorbar(ScalarMappable(one.norm, one.colours), ax=axes, extend=below, fraction=0.05, shrink=0.9, aspect=28, pad=0.02)
    bar.set_label(one.label)
    bar.set_ticks([v for v, _ in one.ticks], labels=[text for _, text in one.ticks])
    bar.ax.minorticks_off()


def _handles(found: Coverage, truth: Truth, one: _Map) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = []
    if found.dead.any():
        dark = matplotlib.colormaps[COLOURS](0.12)
        handles.append(Patch(facecolor=dark, edgecolor=LIGHT, hatch="////", label=f"dead zone: < {100 * DEAD:.0f} % of visits"))
    if found.inside.any():
        handles.append(Patch(facecolor=SOLID, edgecolor="none", label="inside of something"))
    if one.name == "level" and (np.isnan(found.level) & ~found.inside).any():
        handles.append(Patch(facecolor="none", edgecolor=palette.FAINT, label="no antenna hears it"))
    handles.append(Line2D([], [], markerfacecolor=LIGHT, markeredgecolor=LINE, marker=">", markersize=7, linestyle="none", label="antenna"))
    if len(truth.bodies):
        handles.append(Patch(facecolor="none", edgecolor=palette.INK, label="moving body at its start"))
    return handles


def _caption(found: Coverage, truth: Truth, one: _Map, homeless: list[str]) -> str:
    said = {
        "read": "Probability that a tag in the middle of a cell is read when every antenna comes by once, each fading by itself.",
        "antennas": f"How many antennas read a tag there with a probability of {100 * HEARD:.0f} % or more at one visit.",
        "level": "Mean RSSI, over fades and carriers, at the antenna that has most of it; a tag that does not wake sends none.",
    }[one.name]
    shares = found.shares()
    floor = [
        f"at {z:g} m {', '.join(f'{100 * s:.0f} %' for s in share)}"
        for z, share in zip(found.z, shares, strict=True)
        if np.isfinite(share[0])
    ]
    text = f"{said} Of the floor is read by 1, 2, 3 antennas or more: {'; '.join(floor) or 'nothing, for all is inside of something'}."
    text += (
        f" The tag is a {found.tag} with the same gain all round; cells are {found.step_m:g} m; {counted(len(found.antenna), 'antenna')}"
    )
    text += f" of {listed(list(dict.fromkeys(str(s) for s in found.sensor)))}."
    if homeless:
        text += f" No room for the labels {listed(list(dict.fromkeys(homeless)), 20)}."
    return text
