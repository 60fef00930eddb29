"""The plan of a recording: the hall from above with antennas and gates, the truth, and what was estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from testbed import frames
from testbed.columns import Array
from testbed.report import palette, plan
from testbed.report.amounts import counted, listed
from testbed.report.cases import Case
from testbed.report.figures import (
    DPI,
    FULL,
    LAYER,
    Drawing,
    Styles,
    dots,
    drawing,
    frame_of,
    legend,
    legend_height,
    new,
    settle,
    shape,
    shorten,
    styled,
)
from testbed.report.figures_roads import draw_roads
from testbed.report.labels import Label, around, place
from testbed.report.plan import Footprint

SHADE = {"wall": 0.55, "gate": 0.85, "rack": 0.16}  # of ink; other things
OTHER = 0.3
MARGIN, BEYOND = 0.4, 0.25  # m round the hall; of the hall's size, how far tracks may lead out of it
ELLIPSES = 6  # along each track
MARK = 5.0  # points: an antenna's triangle is twice as long
TOGETHER = 0.3  # m: antennas nearer to each other than this have one mark
HALF, TALLEST = 6.2, 6.6  # inches: half a page, so that the letters have the page's own size


@styled
def floor_plan(case: Case, styles: Styles, name: str, where: str) -> Drawing:
    """The plan. `where` says which trial it is. Its layers: e0, e1, ... the tracks, b0, ... their ellipses, in the styles' order."""
    low, high = _extent(case)
    wide, tall = high - low
    width = FULL if case.is_wide else HALF
    inner = width - 0.75
    handles = _handles(case, styles)
    height = min(TALLEST, inner * tall / wide + 0.8) + legend_height(width, handles)
    title = "Plan: where things were, and where they were said to be"
    figure = new(height, title, width)
    axes = figure.add_subplot()
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set(xlabel="x (m)", ylabel="y (m)")
    standing = plan.standing(case.scene)
    _hall(axes, case, standing)
    draw_roads(axes, case.scene.roads)
    numbered = _antennas(axes, case, MARK * float(wide) / (inner * DPI))
    _movers(axes, case)
    outside = _tracks(axes, case, styles, low, high)
    legend(figure, handles)
    settle(figure)
    marks = [mark(axes, spot) for spot, _ in numbered]
    homeless = place(axes, [*gate_labels(standing), *antenna_labels(numbered), *rack_labels(standing), *_mover_labels(case)], marks)
    caption = _caption(case, where, numbered, outside, homeless)
    return drawing(figure, name, title, caption, frames=[frame_of(axes)])


def _extent(case: Case) -> tuple[Array, Array]:
    """Lowest and highest corner (2,) m of what is shown: the hall, and tracks that lead a little out of it."""
    low, high = np.asarray(case.scene.bounds)[:, :2] + [[-MARGIN], [MARGIN]]
    room = BEYOND * (high - low)
    points = np.concatenate([np.zeros((0, 2)), *(a.truth for a in case.aims), *(line.position for a in case.aims for line in a.lines)])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        low = np.minimum(low, np.maximum(points.min(axis=0) - MARGIN, low - room))
        high = np.maximum(high, np.minimum(points.max(axis=0) + MARGIN, high + room))
    return low, high


def _hall(axes: Axes, case: Case, standing: list[Footprint]) -> None:
    for kind in dict.fromkeys(f.kind for f in standing):
        bodies = [f for f in standing if f.kind == kind]
        solid = shape(p for f in bodies for p in f.solid)
        overhead = shape(p for f in bodies for p in f.overhead if not len(f.solid) or kind != "rack")
        axes.add_patch(PathPatch(solid, facecolor=palette.INK, alpha=SHADE.get(kind, OTHER), edgecolor="none", zorder=1))
        axes.add_patch(PathPatch(overhead, fill=False, edgecolor=palette.INK, alpha=0.5, linewidth=0.7, linestyle=(0, (2, 2)), zorder=1))
    racks = shape(f.outline for f in standing if f.kind == "rack")
    axes.add_patch(PathPatch(racks, fill=False, edgecolor=palette.INK, alpha=0.6, linewidth=0.7, zorder=1))


def antenna_groups(case: Case) -> list[tuple[Array, float, list[int]]]:
    """The antennas of a recording as they are at the start, `grouped`."""
    return grouped(case.near.at(case.trial.truth, np.arange(len(case.antennas)), np.zeros(len(case.antennas))))


def grouped(pose: Array) -> list[tuple[Array, float, list[int]]]:
    """Antennas at poses (A, 7) that are one spot from above: (its place (2,) m, yaw of the first, their indices)."""
    groups: list[tuple[Array, float, list[int]]] = []
    for i, p in enumerate(pose):
        for spot, _, members in groups:
            if np.linalg.norm(p[:2] - spot) < TOGETHER:
                members.append(i)
                break
        else:
            groups.append((p[:2], float(frames.yaw_of(p[3:])), [i]))
    return groups


def _antennas(axes: Axes, case: Case, size: float) -> list[tuple[Array, str]]:
    """Triangles about `size` m that point where antennas look; returns each spot with the numbers of its antennas."""
    groups = antenna_groups(case)
    axes.add_patch(PathPatch(triangles(groups, size), facecolor=palette.INK, edgecolor=palette.PAPER, linewidth=0.5, zorder=6))
    return [(spot, numbers(members)) for spot, _, members in groups]


def triangles(groups: list[tuple[Array, float, list[int]]], size: float) -> Path:
    """A triangle about `size` m for each group of antennas, that points where they look."""
    corners = size * np.array([[1.35, 0.0], [-0.75, 0.7], [-0.75, -0.7]])
    turns = [np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) for _, yaw, _ in groups]
    return shape(corners @ turn + spot for turn, (spot, _, _) in zip(turns, groups, strict=True))


def mark(axes: Axes, spot: Array) -> Bbox:
    """What an antenna's triangle covers of the picture, where no label may stand."""
    u, v = axes.transData.transform(spot)
    return Bbox.from_extents(u - MARK, v - MARK, u + MARK, v + MARK)


def numbers(members: list[int]) -> str:
    """ "1-3, 7" of [0, 1, 2, 6]."""
    runs: list[list[int]] = []
    for i in members:
        if runs and i == runs[-1][-1] + 1:
            runs[-1].append(i)
        else:
            runs.append([i])
    return ", ".join(f"{r[0] + 1}" if len(r) == 1 else f"{r[0] + 1}–{r[-1] + 1}" for r in runs)


def _movers(axes: Axes, case: Case) -> None:
    """Outlines of moving bodies where they begin and where they end, and the ways of those that are not targets themselves."""
    truth = case.trial.truth
    followed = {int(case.trial.target_body[_target(case, a.name)]) for a in case.aims}
    ends = []
    for i, outline in enumerate(plan.outlines(case.scene)):
        if not len(outline):
            continue
        ends += [plan.placed(outline, truth.poses[k, i]) for k in (0, -1)]
        if i not in followed:
            way = truth.poses[:: max(1, len(truth.t) // 200), i, :2]
            axes.plot(way[:, 0], way[:, 1], color=palette.FAINT, linewidth=1.2, linestyle=(0, (1, 1.5)), zorder=2)
    patch = PathPatch(shape(ends), fill=False, edgecolor=palette.INK, linewidth=0.8, linestyle=(0, (3, 1.5)), zorder=3)
    patch.set_gid(LAYER + "ends")
    axes.add_patch(patch)


def _target(case: Case, name: str) -> int:
    return [str(n) for n in case.trial.recording.targets.name].index(name)


def _tracks(axes: Axes, case: Case, styles: Styles, low: Array, high: Array) -> list[str]:
    """Truth and estimates; returns what has to be said of estimates beyond the picture."""
    outside: dict[str, int] = {}
    for aim in case.aims:
        still = np.ptp(aim.truth, axis=0).max() < 0.02
        (line,) = axes.plot(*aim.truth.T, color=palette.TRUTH, linewidth=2.4, zorder=4, solid_capstyle="round")
        line.set_gid(LAYER + "truth")
        axes.plot(*aim.truth[0], color=palette.TRUTH, marker="x" if still else "s", markersize=7 if still else 4.5, zorder=7)
        for estimate in aim.lines:
            i, there = styles.place(estimate.estimator), np.atleast_1d(np.isfinite(estimate.position).all(axis=1))
            (line,) = axes.plot(*estimate.position.T, **styles.line(estimate.estimator, len(estimate.t)), zorder=5)  # pyright: ignore[reportArgumentType]
            line.set_gid(f"{LAYER}e{i}")
            inside = ((estimate.position >= low) & (estimate.position <= high)).all(axis=1)
            outside[estimate.estimator] = outside.get(estimate.estimator, 0) + int((there & ~inside).sum())
            _single(axes, estimate.position, there, styles.colour(estimate.estimator), i)
            chosen = np.flatnonzero(there)
            chosen = chosen[np.linspace(0, len(chosen) - 1, min(ELLIPSES, len(chosen))).astype(int)] if len(chosen) else chosen
            rings = [plan.ellipse(estimate.covariance[k], estimate.position[k]) for k in chosen]
            patch = PathPatch(shape(r for r in rings if np.isfinite(r).all()), facecolor="none", zorder=4)
            patch.set(edgecolor=styles.colour(estimate.estimator), linewidth=0.8, alpha=0.75, linestyle=styles.dash(estimate.estimator))
            patch.set_gid(f"{LAYER}b{i}")
            axes.add_patch(patch)
    return [f"{counted(n, 'estimate')} of {id} lie outside this plan" for id, n in outside.items() if n]


def _single(axes: Axes, position: Array, there: Array, colour: str, layer: int) -> None:
    """Dots for estimates that have no neighbour in time to be joined to."""
    alone = there & ~np.r_[False, there[:-1]] & ~np.r_[there[1:], False]
    if alone.any():
        dots(axes, position[alone, 0], position[alone, 1], colour)
        axes.patches[-1].set_gid(f"{LAYER}e{layer}")


def _handles(case: Case, styles: Styles) -> list[Line2D | Patch]:
    shown = dict.fromkeys(line.estimator for aim in case.aims for line in aim.lines)
    found: list[Line2D | Patch] = [
        Line2D([], [], color=palette.TRUTH, linewidth=2.4, marker="s", markevery=[0], label="truth (square: start)")
    ]
    found += [styles.handle(id) for id in styles.ids if id in shown]
    if shown:
        found.append(Patch(facecolor="none", edgecolor=palette.INK, label="95 % ellipses of an estimate"))
    if case.scene.roads is not None:
        found.append(Line2D([], [], color=palette.SKY, linewidth=1.1, label="road"))
    found.append(Line2D([], [], color=palette.INK, marker=">", linestyle="none", label="antenna"))
    return found


# ---------------------------------------------------------------- labels and caption


def gate_labels(standing: list[Footprint]) -> list[Label]:
    """Beside the ends of each gate, where nobody goes through."""
    return [
        Label(shorten(f.name, 18), [(float(x), float(y)) for x, y in (*_ends(f.outline), f.outline.mean(axis=0))], around(16.0), bold=True)
        for f in standing
        if f.kind == "gate"
    ]


def _ends(outline: Array) -> Sequence[Array]:
    """The middles of the two short sides of an outline."""
    middle = outline.mean(axis=0)
    along = np.linalg.svd(outline - middle)[2][0]
    reach = (outline - middle) @ along
    return [middle + along * reach.max(), middle + along * reach.min()]


def antenna_labels(numbered: list[tuple[Array, str]]) -> list[Label]:
    return [Label(text, [(float(p[0]), float(p[1]))], around(11.0) + around(16.0), size=7.0) for p, text in numbered]


def rack_labels(standing: list[Footprint]) -> list[Label]:
    found = []
    for f in standing:
        if f.kind == "rack":
            middle, ends = f.outline.mean(axis=0), _ends(f.outline)
            places = [middle, (middle + ends[0]) / 2, (middle + ends[1]) / 2]
            found.append(Label(shorten(f.name, 18), [(float(x), float(y)) for x, y in places], size=7.5))
    return found


def _mover_labels(case: Case) -> list[Label]:
    truth = case.trial.truth
    return [
        Label(
            f"{shorten(name, 16)}, start",
            [(float(truth.poses[0, i, 0]), float(truth.poses[0, i, 1]))],
            around(17.0) + around(24.0),
            size=7.5,
        )
        for i, name in enumerate(truth.bodies)
    ]


def _caption(case: Case, where: str, numbered: list[tuple[Array, str]], outside: list[str], homeless: list[str]) -> str:
    ids = [f"{i + 1} {id}" for i, id in enumerate(case.antennas.id)]
    said = [f"{where}. Seen from above; dashed outlines are where moving things begin and end, dotted lines their ways."]
    if ids:
        said.append(f"Antennas: {', '.join(ids[:64])}{f' and {len(ids) - 64} more' if len(ids) > 64 else ''}.")
    if case.left_out:
        shown = listed([a.name for a in case.aims])
        said.append(f"Of {len(case.aims) + case.left_out} targets the best, the median and the worst one are shown: {shown}.")
    said += [f"{text}." for text in outside]
    if homeless:
        said.append(f"No room for the labels {listed(list(dict.fromkeys(homeless)), 20)}.")
    return " ".join(said)
