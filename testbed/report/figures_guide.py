"""Figures of a guided walk: the routes of all guides, the cloud of one as it narrows, what was told, and the phases of the steps.

After Figs. 1, 2, 4, 6 and 8 of Raptopoulos et al. 2019.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch

from testbed import archive
from testbed.columns import Array
from testbed.guided.record import Walk
from testbed.guided.section import GuidedWalk, guided_actor
from testbed.guided.words import instructions
from testbed.recording import Trial
from testbed.report import palette, plan
from testbed.report.amounts import counted, listed
from testbed.report.cases import Case, reads_of
from testbed.report.figures import FULL, WIDTH, Drawing, Styles, dots, drawing, new, settle, shape, shorten, styled
from testbed.types import Reads, Track
from testbed.units import SPEED_OF_LIGHT

MOST_GUIDES = 6
CLOUD_AT = (0.0, 1 / 3, 2 / 3, 1.0)  # of a walk
ROOM = 1.0  # m round a route
MOST_LINES, COLUMNS = 60, 2  # of what was told
TURNS = 40  # reads of a step that are drawn at the least


def guide_of(case: Case) -> str:
    """The guide whose recording this is: the first of the scenario."""
    return next(iter(archive.load_tracks(case.kept.folder)), "")


def figures(case: Case, styles: Styles, name: str, where: str) -> list[Drawing]:
    """All figures of a guided person's recording; none of any other."""
    if case.trial.walk is None:
        return []
    own = guide_of(case)
    guides = {own: (case.trial, archive.load_tracks(case.kept.folder))} | archive.load_guides(case.kept.folder)
    order = {id: guides[id] for id in [*styles.ids, *guides] if id in guides}
    found = [routes(case, order, f"{name}-routes", where), told(case.trial.walk, own, f"{name}-told", where)]
    samples = {id: _samples(tracks[id]) for id, (_, tracks) in order.items()}
    richest = max(samples, key=lambda id: samples[id])
    if samples[richest]:
        found.insert(1, clouds(richest, order[richest][0], order[richest][1][richest], styles, f"{name}-cloud", where))
    streamed = stream(case.trial, _pause(case), f"{name}-stream", where)
    return [*found, *([streamed] if streamed else [])]


def _samples(track: Track) -> int:
    """How many different particles the first belief of a track has: a cloud of ten is not worth a picture."""
    return len(np.unique(track.particles[0, 0], axis=0)) if track.particles.size else 0


# ---------------------------------------------------------------- routes


@styled
def routes(case: Case, guides: Mapping[str, tuple[Trial, dict[str, Track]]], name: str, where: str) -> Drawing:
    """Where each guide led the person, a panel each."""
    shown = [(id, trial.walk) for id, (trial, _) in guides.items() if trial.walk is not None][:MOST_GUIDES]
    columns = min(3, len(shown))
    rows, width = -(-len(shown) // columns), FULL if columns > 1 else WIDTH
    target = case.trial.target_pose[0, :2]
    every = np.concatenate([target[None], *(np.stack([walk.x, walk.y], axis=1) for _, walk in shown)])
    low, high = every.min(axis=0) - ROOM, every.max(axis=0) + ROOM
    tall = float(np.clip((high - low)[1] / (high - low)[0], 0.35, 1.4))
    title = "The routes on which the person was led"
    figure = new((0.9 * tall * width / columns + 0.55) * rows + 0.3, title, width)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, (id, walk) in zip(grid.flat, shown, strict=False):
        _route(axes, case, walk, target, low, high)
        axes.set_title(f"{shorten(id, 24)}: {_summed(walk)}")
    for axes in list(grid.flat)[len(shown) :]:
        axes.set_visible(False)
    settle(figure)
    left = len(guides) - len(shown)
    more = f" {counted(left, 'more guide')} not shown." if left > 0 else ""
    caption = (
        f"{where}. Crosses end steps, the green point is the start, the star the tag; a ring is a turn after which nothing was heard.{more}"
    )
    return drawing(figure, name, title, caption)


def _summed(walk: Walk) -> str:
    steps, turns = int((walk.kind == "step").sum()), int((walk.kind == "turn").sum())
    return f"{steps} steps, {turns} turns, {'found' if walk.found.any() else 'not found'}"


def _route(axes: Axes, case: Case, walk: Walk, target: Array, low: Array, high: Array) -> None:
    way = np.stack([walk.x, walk.y], axis=1)
    ends = way[walk.kind == "step"]
    for thing in plan.standing(case.scene):
        if (thing.outline.max(axis=0) > low).all() and (thing.outline.min(axis=0) < high).all():
            axes.add_patch(PathPatch(shape(thing.solid), facecolor=palette.INK, alpha=0.25, edgecolor="none", zorder=1))
    axes.plot(*way.T, color=palette.BLUE, linewidth=1.0, zorder=3)
    axes.plot(*ends.T, color=palette.TRUTH, marker="+", linestyle="none", markersize=6, zorder=4)
    silent = (walk.kind == "turn") & ~np.asarray(walk.heard)
    axes.plot(*way[silent].T, color=palette.ORANGE, marker="o", markerfacecolor="none", linestyle="none", markersize=8, alpha=0.6, zorder=2)
    axes.plot(*way[0], color=palette.GREEN, marker="o", markersize=7, zorder=5)
    axes.plot(*target, color=palette.VERMILLION, marker="*", markersize=12, zorder=6)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")


# ---------------------------------------------------------------- cloud


@styled
def clouds(id: str, trial: Trial, track: Track, styles: Styles, name: str, where: str) -> Drawing:
    """The particles of a guide at four steps, about the tag: each is a place where the person might be, turned to their true heading."""
    walk = trial.walk
    if walk is None:
        raise ValueError("only a guided person's trial has a cloud about its tag")
    steps = np.flatnonzero(walk.kind == "step")
    chosen = steps[[round(share * (len(steps) - 1)) for share in CLOUD_AT]] if len(steps) else np.zeros(1, dtype=np.int64)
    title = f"Where {shorten(id, 30)} takes the person to be, about the tag"
    figure = new(3.1, title, FULL)
    grid = figure.subplots(1, len(chosen), squeeze=False)[0]
    tag = trial.target_pose[0, :2]
    for axes, k in zip(grid, chosen.tolist(), strict=True):
        person = np.array([walk.x[k], walk.y[k]])
        cloud = person - np.asarray(track.particles[k, 0, :, :2], dtype=np.float64)
        dots(axes, cloud[:, 0], cloud[:, 1], styles.colour(id), size=3.0)
        true, look = person - tag, np.array([np.cos(walk.heading[k]), np.sin(walk.heading[k])])
        reach = 1.15 * max(1.0, float(np.abs(true).max()), float(np.percentile(np.abs(cloud), 95)))
        axes.annotate("", xy=true + 0.25 * reach * look, xytext=true, arrowprops={"arrowstyle": "->", "color": palette.TRUTH}, zorder=5)
        axes.plot(*true, color=palette.TRUTH, marker="o", markersize=5, zorder=5)
        axes.plot(0, 0, color=palette.VERMILLION, marker="*", markersize=11, zorder=6)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="m", title=f"after step {int((steps <= k).sum())}")
    settle(figure)
    caption = (
        f"{where}. Dots are equally weighted samples of the belief, each a place of the person about the tag (star), all turned so that "
        "they look as the person truly looks; the dark point and arrow are the truth. The player above shows the same cloud in motion, as "
        "places of the tag about the person."
    )
    return drawing(figure, name, title, caption)


# ---------------------------------------------------------------- what was told


@styled
def told(walk: Walk, id: str, name: str, where: str) -> Drawing:
    """The instructions, as the person read them."""
    every = [one for one in instructions(walk) if one.text]
    shown = every[:MOST_LINES]
    lines = [
        f"{i + 1:3d}  {one.t:6.1f} s  {shorten(one.text + (f' ({one.answer})' if one.answer else ''), 96)}" for i, one in enumerate(shown)
    ]
    rows = -(-len(lines) // COLUMNS)
    title = f"What {shorten(id, 30)} told the person"
    figure = new(0.145 * max(rows, 1) + 0.45, title, FULL)
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set(xlim=(0, COLUMNS), ylim=(max(rows, 1), 0))
    for i, line in enumerate(lines):
        written = axes.text(i // rows, i % rows + 0.5, line, fontsize=7.0, va="center", family="DejaVu Sans")
        written.set_in_layout(False)  # long lines must not push the columns together
    settle(figure)
    more = f" {counted(len(every) - len(shown), 'more instruction')} left out." if len(every) > len(shown) else ""
    spoken = listed([one.text for one in shown[:12]], 12)
    return drawing(figure, name, title, f"{where}. `testbed speak` writes them as text and, with espeak-ng, as sound.{more}", spoken)


# ---------------------------------------------------------------- phases


@styled
def stream(trial: Trial, pause: float, name: str, where: str) -> Drawing | None:
    """The wrapped phases of the step with the most reads, and the same at the wraps nearest to the truth; None without reads.

    pause : for how long (s) the person stands at the end of a step
    """
    walk, reads = trial.walk, reads_of(trial)
    if walk is None or not len(reads):
        return None
    steps = [k for k in np.flatnonzero(walk.kind == "step").tolist() if _during(reads, walk, k).sum() >= TURNS]
    if not steps:
        return None
    k = max(steps, key=lambda k: int(_during(reads, walk, k).sum()))
    mine = reads.take(_during(reads, walk, k))
    period = np.pi if float(np.nanmax(reads.phase)) < 3.3 else 2 * np.pi
    title = "The phase over a step: as read, and unwrapped"
    figure = new(2.9, title, FULL)
    left, right = figure.subplots(1, 2)
    dots(left, mine.t, mine.phase, palette.BLUE, size=2.0)
    left.set(xlim=(walk.began[k], walk.t[k]), ylim=(0, period), xlabel="time (s)", ylabel="phase (rad), as read")
    line, brought = _brought(trial, walk, k, mine, period, pause)
    dots(right, mine.t, brought, palette.BLUE, size=2.0)
    right.plot(mine.t, line, color=palette.TRUTH, linewidth=1.2)
    low, high = float(np.nanmin(line)) - 1.5, float(np.nanmax(line)) + 1.5
    right.set(xlim=(walk.began[k], walk.t[k]), ylim=(low, high), xlabel="time (s)", ylabel="phase (rad), of one carrier's offset")
    settle(figure)
    wrap = "π" if period < 4 else "2π"
    true = _wavenumber(trial) * float(walk.range[k] - walk.range[k - 1])
    said = f"the guide made {walk.followed[k]:.2f} rad of it" if np.isfinite(walk.followed[k]) else "the guide made nothing of it"
    caption = (
        f"{where}. Step {int((walk.kind[: k + 1] == 'step').sum())}: {counted(len(mine), 'read')}, wrapped at {wrap}. "
        "To the right each read is at the wrap nearest to the true motion (line), carrier by carrier. The range on the floor changed by "
        f"{true:.2f} rad of phase; {said}{'' if walk.trusted[k] else ', and did not trust that'}."
    )
    return drawing(figure, name, title, caption)


def _pause(case: Case) -> float:
    actor = guided_actor(case.scenario) if case.scenario is not None else None
    return actor.route.pause_s if actor is not None and isinstance(actor.route, GuidedWalk) else 0.0


def _during(reads: Reads, walk: Walk, k: int) -> Array:
    return (reads.t >= walk.began[k]) & (reads.t <= walk.t[k]) & np.isfinite(reads.phase)


def _wavenumber(trial: Trial) -> float:
    frequencies = trial.recording.site.frequencies
    return 4 * np.pi * float(np.mean(frequencies)) / SPEED_OF_LIGHT if len(frequencies) else np.nan


def _brought(trial: Trial, walk: Walk, k: int, reads: Reads, period: float, pause: float) -> tuple[Array, Array]:
    """The phase of the true motion at the reads (N,), and the reads brought to the wrap nearest to it, each carrier by its own offset."""
    share = np.clip((reads.t - walk.began[k]) / max(float(walk.t[k] - walk.began[k]) - pause, 1e-9), 0.0, 1.0)
    here, there = (np.array([walk.x[i], walk.y[i]]) for i in (k - 1, k))
    distance = np.hypot(*(trial.target_pose[0, :2] - here - share[:, None] * (there - here)).T)
    line = -_wavenumber(trial) * distance
    apart = np.asarray(reads.phase) - line
    for channel in np.unique(reads.channel):
        mine = reads.channel == channel
        offset = np.angle(np.exp(2j * np.pi * apart[mine] / period).mean()) * period / (2 * np.pi)
        apart[mine] -= offset
    return line, line + apart - period * np.round(apart / period)
