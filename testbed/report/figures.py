"""What all figures share: their look, and the way from matplotlib to an SVG that can stand in a page with others.

Text stays text, so that it can be read aloud, searched and copied. It is laid out in DejaVu Sans; what a browser may have in its
place (Verdana, Arial) is no wider. Ink and paper are CSS variables with the light ground's colours as defaults, so that a page can be dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import wraps
from html import escape
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter

from testbed.columns import Array
from testbed.report import palette

WIDTH = 7.2  # inches
FULL = 10.8  # the whole of a page
DPI = 72  # matplotlib's SVG counts in points
DASHES = ("-", (0, (5, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1.2, 1.2)), (0, (4, 1, 1, 1, 1, 1)), (0, (8, 3)))
MARKERS = ("o", "s", "^", "D", "v", "P")
LAYER = "layer."  # artists with a gid that begins so can be found in the page, by data-layer
VARIABLES = {palette.INK: "--ink", palette.PAPER: "--paper", palette.FAINT: "--faint", palette.TRUTH: "--truth"}
WIDE_RANGE = 30.0  # an axis over more than this times the median is logarithmic

LOOK = {
    "svg.fonttype": "none",
    "svg.hashsalt": "testbed",
    "text.parse_math": False,  # a name may hold a dollar
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "text.color": palette.INK,
    "axes.edgecolor": palette.INK,
    "axes.labelcolor": palette.INK,
    "xtick.color": palette.INK,
    "ytick.color": palette.INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": palette.FAINT,
    "grid.linewidth": 0.5,
    "grid.alpha": 0.4,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.4,
    "lines.markersize": 4.5,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
}

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class Frame:
    """Where an axes lies in its SVG: u = u0 + u_scale x, v = v0 + v_scale y, of log10 of y where `log`; and its edges, all in points."""

    u0: float
    u_scale: float
    v0: float
    v_scale: float
    left: float
    right: float
    top: float
    bottom: float
    log: bool = False


@dataclass(frozen=True)
class Drawing:
    """A figure, ready for the page: SVG markup of its own size (points), and the axes that a player draws into."""

    name: str
    title: str
    caption: str
    svg: str
    width: float
    height: float
    frames: tuple[Frame, ...] = ()


def styled(make: Callable[P, R]) -> Callable[P, R]:
    """Draws with the reports' look, whatever the user's own matplotlib settings are."""

    @wraps(make)
    def with_look(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(LOOK)  # pyright: ignore[reportCallIssue, reportArgumentType]
            return make(*args, **kwargs)

    return with_look


def new(height: float, title: str, width: float = WIDTH) -> Figure:
    """An empty figure of `width` x `height` inches with its title."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", wrap=False)
    return figure


# ---------------------------------------------------------------- lines, legends, axes


class Styles:
    """A colour, a dash and a marker for each estimator, the same in all figures of a report."""

    def __init__(self, estimators: Sequence[str]) -> None:
        self.ids = tuple(estimators)
        self._colours = palette.assign(estimators)

    def colour(self, estimator: str) -> str:
        return self._colours.get(estimator, palette.INK)

    def place(self, estimator: str) -> int:
        return self.ids.index(estimator) if estimator in self.ids else 0

    def dash(self, estimator: str) -> Any:
        return DASHES[self.place(estimator) % len(DASHES)]

    def marker(self, estimator: str) -> str:
        i = self.place(estimator)
        return MARKERS[(i + i // len(MARKERS)) % len(MARKERS)]  # the seventh has the first one's colour, not its marker

    def line(self, estimator: str, samples: int = 0) -> dict[str, object]:
        """Keyword arguments of `Axes.plot`; of `samples` points some seven have a marker, at other places for each estimator."""
        found: dict[str, object] = {
            "color": self.colour(estimator),
            "linestyle": self.dash(estimator),
            "marker": self.marker(estimator),
            "label": estimator,
        }
        if samples:
            step = max(1, samples // 7)
            found["markevery"] = (self.place(estimator) * step // max(1, len(self.ids)), step)
        return found

    def handle(self, estimator: str) -> Line2D:
        return Line2D([], [], **self.line(estimator))  # pyright: ignore[reportArgumentType]


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """A legend below everything, so that it covers nothing; in as many columns as fit."""
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=_columns(figure.get_figwidth(), handles))


def legend_height(width: float, handles: Sequence[Artist]) -> float:
    """About how tall the legend of a figure of `width` inches will be, inches."""
    return 0.17 * -(-len(handles) // _columns(width, handles)) + 0.1 if handles else 0.0


def _columns(width: float, handles: Sequence[Artist]) -> int:
    longest = max(len(str(h.get_label())) for h in handles)
    return max(1, min(len(handles), int(width * DPI / (8.5 * (0.56 * longest + 5.0)))))


def shorten(text: str, most: int = 26) -> str:
    """A name that fits: its middle left out where it is long."""
    return text if len(text) <= most else f"{text[: most // 2]}…{text[-(most - most // 2 - 1) :]}"


def is_wide(values: Array) -> bool:
    """Whether values span so much that a linear axis would hide most of them."""
    good = values[np.isfinite(values) & (values > 0)]
    return bool(len(good) and good.max() > WIDE_RANGE * np.median(good))


def log_axis(axes: Axes, values: Array) -> None:
    """A logarithmic y axis over the positive values, with plain numbers at its ticks."""
    good = values[np.isfinite(values) & (values > 0)]
    axes.set_yscale("log")
    low, high = (good.min(), good.max()) if len(good) else (0.1, 10.0)
    axes.set_ylim(10 ** np.floor(np.log10(low) - 1e-9), 10 ** np.ceil(np.log10(high) + 1e-9))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda v, _: ""))


def shape(polygons: Iterable[Array], closed: bool = True) -> Path:
    """Many polygons (n, 2) as one path: a tenth of the markup that a patch each would take."""
    vertices: list[Array] = []
    codes: list[int] = []
    begin, onwards, close = (int(code) for code in (Path.MOVETO, Path.LINETO, Path.CLOSEPOLY))
    for polygon in polygons:
        vertices += [polygon, polygon[:1]] if closed else [polygon]
        codes += [begin, *[onwards] * (len(polygon) - 1), *([close] if closed else [])]
    return Path(np.concatenate(vertices), codes) if vertices else Path(np.zeros((0, 2)))


def dots(axes: Axes, x: Array, y: Array, colour: str, size: float = 2.2) -> None:
    """Points as one path of strokes of no length with round ends."""
    if not len(x):
        return
    path = shape([np.array([[a, b], [a, b]]) for a, b in zip(x.tolist(), y.tolist(), strict=True)], closed=False)
    path.should_simplify = False
    axes.add_patch(PathPatch(path, fill=False, edgecolor=colour, linewidth=size, capstyle="round"))


# ---------------------------------------------------------------- to SVG


def settle(figure: Figure) -> None:
    """Run the layout, and keep it: from here on positions in points are final."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def frame_of(axes: Axes) -> Frame:
    """Where an axes of a settled figure lies."""
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes is in no figure")
    tall = figure.get_figheight() * DPI
    log = axes.get_yscale() == "log"
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    (u0, v0), (u1, v1) = axes.transData.transform([(x0, y0), (x1, y1)]).tolist()
    a, b = (np.log10(y0), np.log10(y1)) if log else (y0, y1)
    u_scale, v_scale = (u1 - u0) / (x1 - x0), -(v1 - v0) / (b - a)
    return Frame(u0 - u_scale * x0, u_scale, tall - v0 - v_scale * a, v_scale, u0, u1, tall - v1, tall - v0, log)


def drawing(figure: Figure, name: str, title: str, caption: str, described: str = "", frames: Sequence[Frame] = ()) -> Drawing:
    """The figure as markup. `described` is read aloud in its place; the caption, where it is left out."""
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    width, height = (float(side * DPI) for side in figure.get_size_inches())
    return Drawing(
        name, title, caption, _inline(out.getvalue(), name, title, described or caption, width, height), width, height, tuple(frames)
    )


_REFERENCE = re.compile(r'(?:url\(#|href="#)([^)"]+)')
_FAMILY = re.compile(r" font-family: [^;\"]*;?")
_NUMBERS = re.compile(r'((?: d| x| y| points| transform)=")([^"]*)"')
_LONG = re.compile(r"-?\d+\.\d{3,}")


def _inline(text: str, name: str, title: str, described: str, width: float, height: float) -> str:
    """matplotlib's SVG without what a page has already, its ids made unique, its numbers to a hundredth of a point."""
    text = text[text.index(">", text.index("<svg")) + 1 : text.rindex("</svg>")]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)  # it would hold for the whole page
    needed = set(_REFERENCE.findall(text))

    def identified(match: re.Match[str]) -> str:
        id = match[1]
        if id.startswith(LAYER):
            return f' data-layer="{id.removeprefix(LAYER)}"'
        return f' id="{name}-{id}"' if id in needed else ""

    text = re.sub(r' id="([^"]*)"', identified, text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r'xlink:href="#', f'href="#{name}-', text)
    text = _FAMILY.sub("", text)
    text = _NUMBERS.sub(lambda m: f'{m[1]}{_LONG.sub(_rounded, m[2])}"', text)
    text = re.sub(r' transform="rotate\(-0 [^"]*\)"', "", text)
    for colour, variable in VARIABLES.items():
        text = re.sub(rf": {colour}\b", f": var({variable}, {colour})", text, flags=re.IGNORECASE)
    text = re.sub(r"\s*\n\s*", "\n", text).strip()
    head = f'<svg class="figure" id="{name}" viewBox="0 0 {width:g} {height:g}" style="max-width: {width * 4 / 3:.0f}px" role="img" '
    return f'{head}aria-labelledby="{name}-title {name}-desc">\n<title id="{name}-title">{escape(title)}</title>\n' + (
        f'<desc id="{name}-desc">{escape(described)}</desc>\n{text}\n</svg>'
    )


def _rounded(match: re.Match[str]) -> str:
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")
