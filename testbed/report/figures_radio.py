"""What antennas heard of a tag, as strips over time, and the phase of one link beside that of its range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from testbed.columns import Array
from testbed.report import palette
from testbed.report.amounts import counted, number
from testbed.report.cases import Case
from testbed.report.figures import DPI, FULL, Drawing, dots, drawing, new, settle, shape, shorten, styled
from testbed.report.strips import Strip, Turning, strips, turning

ROW = 0.105  # inches, of a strip
LEAST = 4  # rows that a panel has room for: its colour bar needs them
BAR = 0.16  # inches, width of a colour bar
CLASSES = 24  # of the phase; 15° each
LEVELS, STEPS = 16, 10  # of RSSI, of the share that is clear
ZERO = "#C9CCD1"  # asked and silent
HIDDEN, SEEN = 0.90, 0.25  # grey of a blocked and of a clear line: white and black are those of the page
MOST_READS = 6  # a round: more are of the last colour


# ---------------------------------------------------------------- strips


@styled
def radio_strips(case: Case, name: str, where: str) -> tuple[Drawing, ...]:
    """A figure for each of the target tags that were heard most. None of a recording in which none was heard."""
    found, more = strips(case)
    return tuple(_figure(case, one, f"{name}-{i}", where, more if one is found[-1] else 0) for i, one in enumerate(found))


@dataclass(frozen=True, eq=False)
class Panel:
    """One quantity: the class (R, M) of each cell, -1 for none; a colour a class; and how the colour bar is labelled.

    ticks : (place from 0 at the bottom to 1 at the top of the bar, text)
    """

    title: str
    place: Array
    colours: tuple[str, ...]
    ticks: tuple[tuple[float, str], ...]


def _panels(strip: Strip) -> list[Panel]:
    found = []
    if np.isfinite(strip.phase).any():
        place = np.where(np.isfinite(strip.phase), np.floor(np.mod(np.nan_to_num(strip.phase) / (2 * np.pi), 1.0) * CLASSES), -1)
        found.append(Panel("phase (rad)", place, cyclic(CLASSES), ((0.0, "0"), (0.25, "π/2"), (0.5, "π"), (0.75, "3π/2"), (1.0, "2π"))))
    if np.isfinite(strip.rssi).any():
        low, high = np.floor(np.nanmin(strip.rssi)), np.ceil(np.nanmax(strip.rssi) + 1e-9)
        high = max(high, low + 1.0)
        place = np.minimum(np.floor((strip.rssi - low) / (high - low) * LEVELS), LEVELS - 1)
        colours = tuple(to_hex(c) for c in colormaps["cividis"](np.linspace(0.02, 1.0, LEVELS)))
        ticks = [v for v in MaxNLocator(4, integer=True).tick_values(low, high) if low <= v <= high]
        found.append(Panel("RSSI (dBm)", _or_none(place), colours, tuple(((v - low) / (high - low), number_of(v)) for v in ticks)))
    if np.isfinite(strip.rounds).any():
        found.append(_rounds(strip.rounds))
    if strip.clear is not None:
        place = np.minimum(np.floor(strip.clear * STEPS), STEPS - 1)
        greys = tuple(to_hex((g, g, g)) for g in np.linspace(HIDDEN, SEEN, STEPS))
        found.append(Panel("line of sight (share clear)", place, greys, ((0.0, "0"), (0.5, "0.5"), (1.0, "1"))))
    return found


def _rounds(mean: Array) -> Panel:
    """Reads per round in whole numbers: none, one or a mean up to it, two, ..."""
    most = int(min(MOST_READS, max(1.0, np.ceil(np.nanmax(mean) - 1e-9))))
    place = np.minimum(np.ceil(mean - 1e-9), most)
    colours = (ZERO, *(to_hex(c) for c in colormaps["YlGnBu"](np.linspace(0.4, 1.0, most))))
    texts = ["none", *(f"≤ {k}" for k in range(1, most + 1))]
    if np.nanmax(mean) > most:
        texts[-1] = f"> {most - 1}"
    return Panel("reads per round", _or_none(place), colours, tuple(((k + 0.5) / (most + 1), text) for k, text in enumerate(texts)))


def _or_none(place: Array) -> Array:
    return np.where(np.isfinite(place), place, -1)


def number_of(value: float) -> str:
    """A whole number with a real minus sign."""
    return f"{value:.0f}".replace("-", "−")


def _figure(case: Case, strip: Strip, name: str, where: str, more_tags: int) -> Drawing:
    panels, rows = _panels(strip), len(strip.rows)
    tall = ROW * max(rows, LEAST)
    title = f"What the antennas heard of the tag {shorten(strip.name, 40)}"
    figure = new(len(panels) * (tall + 0.30) + 0.65, title, FULL)
    wide = FULL - 0.9
    grid = figure.subplots(len(panels), 2, squeeze=False, gridspec_kw={"width_ratios": [wide - BAR, BAR], "wspace": 0.01})
    names = [f"{shorten(str(case.antennas.id[a]), 22)}  {a + 1}" for a in strip.rows]
    for k, (panel, (axes, bar)) in enumerate(zip(panels, grid, strict=True)):
        axes.grid(False)
        axes.set(xlim=(0.0, case.duration), ylim=(rows - 0.5, -0.5))
        axes.set_title(panel.title, pad=3)
        axes.set_yticks(np.arange(rows), names, fontsize=6.5)
        axes.tick_params(axis="y", length=0)
        axes.tick_params(axis="x", labelbottom=k == len(panels) - 1)
        bar.set(xlim=(0, 1), ylim=(0, 1), xticks=[])
        bar.yaxis.tick_right()
        bar.set_yticks([at for at, _ in panel.ticks], [text for _, text in panel.ticks], fontsize=7)
        bar.grid(False)
        bar.spines[:].set_visible(False)
    grid[-1, 0].set_xlabel("time (s)")
    settle(figure)
    for panel, (axes, bar) in zip(panels, grid, strict=True):
        _cells(axes, panel, case.duration)
        _bar(bar, panel)
    return drawing(figure, name, title, _caption(strip, panels, where, more_tags))


def _cells(axes: Axes, panel: Panel, duration: float) -> None:
    """The cells as strokes as wide as a row, those of one colour as one path: two points a run of equal cells."""
    rows, columns = panel.place.shape
    width = axes.get_window_extent().height / rows * 0.9
    step = duration / columns
    for k, colour in enumerate(panel.colours):
        lines = [np.array([[first * step, row], [last * step, row]]) for row in range(rows) for first, last in runs(panel.place[row] == k)]
        _strokes(axes, lines, colour, width)


def _bar(axes: Axes, panel: Panel) -> None:
    many, width = len(panel.colours), axes.get_window_extent().width
    for k, colour in enumerate(panel.colours):
        _strokes(axes, [np.array([[0.5, k / many], [0.5, (k + 1) / many]])], colour, width)


def _strokes(axes: Axes, lines: Sequence[Array], colour: str, width: float) -> None:
    if lines:
        path = shape(lines, closed=False)
        path.should_simplify = False
        axes.add_patch(PathPatch(path, fill=False, edgecolor=colour, linewidth=width * 72 / DPI, capstyle="butt"))


def runs(there: Array) -> list[tuple[int, int]]:
    """Where a mask (M,) is true, as pairs (first, one after the last)."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def _caption(strip: Strip, panels: Sequence[Panel], where: str, more_tags: int) -> str:
    titles = " ".join(panel.title for panel in panels)
    step = strip.edges[1] - strip.edges[0]
    said = [f"{where}. A row for each antenna, a column for each {number(1e3 * step)} ms; empty where nothing was read."]
    if "phase" in titles:
        said.append("Phase as the reader reports it, of the last read: it leaps where the carrier changes.")
    if "reads per round" in titles:
        said.append("Reads per round: grey where the tag was asked and silent, empty where it was not asked.")
    if "sight" in titles:
        said.append("Line of sight: the share of 0.6 of the first Fresnel zone that is clear, found again from the true geometry.")
    if strip.more:
        said.append(f"{counted(strip.more, 'further antenna')} read it less often and {'is' if strip.more == 1 else 'are'} not shown.")
    if more_tags:
        said.append(f"{counted(more_tags, 'further target tag')} read less often {'has' if more_tags == 1 else 'have'} no figure.")
    return " ".join(said)


def cyclic(n: int) -> tuple[str, ...]:
    """n colours round a circle in CIELAB through orange, light, blue and dark, which people with any kind of colour vision tell apart.

    L* = 57 + 27 sin φ, (a*, b*) = (15, 38) cos φ: half the circle is told by lightness, the other half by the one axis of hue
    (orange to blue) that is left to all dichromats.
    """
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    lightness, a, b = 57 + 27 * np.sin(angle), 15 * np.cos(angle), 38 * np.cos(angle)
    f = np.stack([(lightness + 16) / 116 + a / 500, (lightness + 16) / 116, (lightness + 16) / 116 - b / 200], axis=1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * (0.95047, 1.0, 1.08883)  # D65
    linear = xyz @ np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]).T
    linear = np.clip(linear, 0.0, 1.0)
    return tuple(to_hex(c) for c in np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


# ---------------------------------------------------------------- the phase of one link


@styled
def phase_by_range(case: Case, name: str, where: str) -> Drawing | None:
    """Phase of the busiest link on one carrier, and the phase that its true range alone would give. None without phases."""
    found = turning(case)
    if found is None:
        return None
    antenna = shorten(str(case.antennas.id[found.antenna]), 30)
    title = f"Phase of the tag {shorten(found.tag, 30)} at {antenna} on {found.frequency / 1e6:.2f} MHz"
    figure = new(2.1, title, FULL)
    axes = figure.subplots()
    axes.add_patch(PathPatch(_wrapped(found), fill=False, edgecolor=palette.FAINT, linewidth=0.7))
    dots(axes, found.t, found.phase, palette.BLUE, 2.6)
    turn = found.whole / np.pi
    aside = 0.02 * case.duration
    axes.set(
        xlim=(max(0.0, found.t[0] - aside), min(case.duration, found.t[-1] + aside)),
        ylim=(0.0, found.whole),
        xlabel="time (s)",
        ylabel="phase (rad)",
    )
    axes.set_yticks([0.0, found.whole / 2, found.whole], ["0", "π" if turn == 2 else "π/2", "2π" if turn == 2 else "π"])
    settle(figure)
    return drawing(
        figure, name, title, f"{where}. Dots: reads of the link and carrier with most of them. Line: −4π f d / c of the true range d, "
        f"its constant offset fitted to the reads. They agree to a mean resultant length of {number(found.agreement)} (1 is perfect): "
        "what differs is noise, flips by π, reflections and ways round obstacles.",
    )  # fmt: skip


def _wrapped(found: Turning) -> Path:
    """The expected phase as a path that breaks where it begins again."""
    turns = np.floor(found.expected / found.whole)
    pieces = np.split(np.arange(len(turns)), np.flatnonzero(np.diff(turns)) + 1)
    return shape([np.stack([found.at[p], found.expected[p] - turns[p] * found.whole], axis=1) for p in pieces if len(p) > 1], closed=False)
