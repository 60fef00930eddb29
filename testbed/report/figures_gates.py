"""What a run at gates found: what was announced of each kind of event, how sure it was and how right, and precision by prevalence."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from testbed.columns import Array
from testbed.gate_figures import GateFigures, Share, gate_figures, has_gates
from testbed.metrics.gate_calibration import BINS
from testbed.metrics.gate_events import ANSWERS, EVENTS
from testbed.report import palette
from testbed.report.amounts import counted
from testbed.report.figures import FULL, WIDTH, Drawing, Styles, drawing, legend, legend_height, new, settle, shorten, styled
from testbed.report.study import Study

PARKED = np.geomspace(1.0, 1000.0, 40)  # windows of standing tags for each move
STATED = (20.0, 100.0)  # those that are told in words
MOST_PANELS = 6


def gates(study: Study) -> list[Drawing]:
    """All figures of a run scored by `gate_events` and `gate_calibration`; none of any other."""
    found = [confusion(study, "gate-answers"), prevalence(study, "gate-prevalence")] if has_gates(study.rows) else []
    return [*found, *([calibration(study, "gate-calibration")] if "calibration.n0" in study.rows else [])]


def _each(study: Study) -> list[tuple[str, int, str]]:
    """(label, point, estimator) of what is drawn."""
    found = []
    for summary in study.summaries:
        label = study.label(summary.point)
        name = f"{summary.estimator}, {label}" if label and len(study.estimators) > 1 else label or summary.estimator
        found.append((shorten(name, 60), summary.point, summary.estimator))
    return found[:MOST_PANELS]


# ---------------------------------------------------------------- confusion


@styled
def confusion(study: Study, name: str) -> Drawing:
    """A panel for each estimator and point: events by kind in rows, what was announced of them in columns."""
    each = _each(study)
    columns = min(2, len(each))
    rows = -(-len(each) // columns)
    title = "What was announced of each event"
    figure = new(2.3 * rows + 0.4, title, FULL if columns > 1 else WIDTH)
    grid = figure.subplots(rows, columns, squeeze=False)
    said = []
    for axes, (label, point, estimator) in zip(grid.flat, each, strict=False):
        figures = gate_figures(study.rows, point, estimator)
        _matrix(axes, figures.counts)
        axes.set_title(label)
        said.append(f"{label}: {summed(figures)}")
    for axes in list(grid.flat)[len(each) :]:
        axes.set_visible(False)
    settle(figure)
    caption = (
        "An event is a tag's whole errand, or a window of a tag that stands (stat). Counts over all trials; shade is the share of the row. "
        "“several” is more than one in or out for one event. " + " ".join(said)
    )
    return drawing(figure, name, title, caption)


def _matrix(axes: Axes, counts: Array) -> None:
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.set(xlim=(0, len(ANSWERS)), ylim=(len(EVENTS), 0))
    for i, j in np.ndindex(*counts.shape):
        right = EVENTS[i] == ANSWERS[j] or (EVENTS[i] == "stat" and ANSWERS[j] == "none")
        colour = palette.GREEN if right else palette.VERMILLION
        if share[i, j]:
            axes.fill([j, j + 1, j + 1, j], [i, i, i + 1, i + 1], color=colour, alpha=0.12 + 0.5 * float(share[i, j]), linewidth=0)
        axes.text(j + 0.5, i + 0.5, f"{counts[i, j]:,}", ha="center", va="center", fontsize=8.5)
    axes.set_xticks(np.arange(len(ANSWERS)) + 0.5, ANSWERS)
    axes.set_yticks(np.arange(len(EVENTS)) + 0.5, EVENTS)
    axes.grid(False)
    axes.tick_params(length=0)
    axes.set(xlabel="announced", ylabel="was")


def summed(figures: GateFigures) -> str:
    """The figures in words, with 95 % limits: recall and precision of in and out, what was swapped, false moves, latency."""
    said = []
    for move, other in (("in", "out"), ("out", "in")):
        recall, precision, swapped = figures.recall(move), figures.precision(move), figures.share(move, other)
        at = "; ".join(f"{figures.precision_at(move, parked)[0]:.4f} at {parked:g}:1" for parked in STATED)
        said.append(f"{move} recall {_interval(recall)}, precision {_interval(precision)} ({at}), swapped {swapped.hits} of {swapped.n}")
    standing = figures.false_windows
    said.append(
        f"false moves of standing tags {standing.hits} of {standing.n:,} windows (at most {100 * standing.high:.3f} %), "
        f"{figures.false_moves_per_hour:.3g} in an hour of one tag; {figures.prevalence():.3g} windows for each in and out"
    )
    if len(figures.latency):
        late, latest = np.percentile(figures.latency, [50, 95])
        said.append(f"announced {late:.2f} s after the crossing in the median, {latest:.2f} s in 95 %")
    return "; ".join(said) + "."


def _interval(share: Share) -> str:
    return f"{share.value:.3f} ({share.low:.3f} to {share.high:.3f}, n = {share.n})"


# ---------------------------------------------------------------- prevalence


@styled
def prevalence(study: Study, name: str) -> Drawing:
    """Precision of in and out, as estimated and at worst, against how many windows of standing tags there are for each move."""
    each = _each(study)
    title = "Precision, by how many tags stand by"
    own = Styles([label for label, *_ in each])
    handles = [own.handle(label) for label, *_ in each]
    figure = new(2.7 + legend_height(WIDTH, handles), title)
    for axes, move in zip(figure.subplots(1, 2, sharey=True), ("in", "out"), strict=True):
        for label, point, estimator in each:
            figures = gate_figures(study.rows, point, estimator)
            mean, worst = np.array([figures.precision_at(move, parked) for parked in PARKED]).T
            axes.plot(PARKED, mean, **own.line(label, len(PARKED)))
            axes.fill_between(PARKED, worst, mean, color=own.colour(label), alpha=0.15, linewidth=0)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.set(xlabel="windows of standing tags for each move", ylabel=f"precision of {move}", ylim=(0.0, 1.02), xlim=(1.0, 1000.0))
        axes.tick_params(labelleft=True)
    legend(figure, handles)
    settle(figure)
    caption = (
        "The chance of each false alarm is the run's, the prevalence is not. The band reaches down to where recall is at its lower and "
        "each false alarm's chance at its upper 95 % limit at once: with none seen in n windows the chance may still be 3.7 in n."
    )
    return drawing(figure, name, title, caption)


# ---------------------------------------------------------------- calibration


@styled
def calibration(study: Study, name: str) -> Drawing:
    """The share of claims that came true against the probability that was claimed, in bins, with exact 95 % limits."""
    each = _each(study)
    title = "Is it as often right as it says?"
    own = Styles([label for label, *_ in each])
    handles = [own.handle(label) for label, *_ in each]
    figure = new(3.0 + legend_height(WIDTH, handles), title)
    axes = figure.add_subplot()
    axes.plot([0.3, 1.0], [0.3, 1.0], color=palette.INK, linewidth=0.8, linestyle=":")
    total = 0
    for label, point, estimator in each:
        claimed, shares = calibrated(study, point, estimator)
        total += sum(s.n for s in shares)
        value, low, high = np.array([(s.value, s.low, s.high) for s in shares]).reshape(-1, 3).T
        line = own.line(label) | {"linestyle": "-"}
        axes.errorbar(claimed, value, [value - low, high - value], capsize=2.5, linewidth=1.0, **line)  # pyright: ignore[reportArgumentType]
    axes.set(xlabel="probability that was claimed", ylabel="share that came true", xlim=(0.45, 1.01), ylim=(0.0, 1.02))
    legend(figure, handles)
    settle(figure)
    caption = (
        f"{counted(total, 'claim')}, decisions and the hints on the way to them, by how sure they were; bars are 95 % limits as of "
        "independent claims, which those of one tag are not. Above the dotted line it is more often right than it says."
    )
    return drawing(figure, name, title, caption)


def calibrated(study: Study, point: int, estimator: str) -> tuple[Array, list[Share]]:
    """Mean claim of each bin that has claims, and the share of them that came true."""
    mask = (study.rows["point"] == point) & (study.rows["estimator"] == estimator)
    claimed, shares = [], []
    for i in range(BINS):
        n, mean, so = (np.nan_to_num(study.rows[f"calibration.{what}{i}"][mask]) for what in ("n", "claimed", "so"))
        if n.sum():
            claimed.append(float((n * mean).sum() / n.sum()))
            shares.append(Share(round(float((n * so).sum())), round(float(n.sum()))))
    return np.array(claimed), shares
