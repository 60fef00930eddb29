"""Labels that neither overlap nor leave their axes: each is tried at several places, and left out where none of them is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox

from testbed.report import palette

PADDING = 1.5  # points kept free round a label


@dataclass(frozen=True)
class Label:
    """A text and the points (x, y) in data coordinates that it may stand at, best first; (dx, dy) points beside each of them."""

    text: str
    places: Sequence[tuple[float, float]]
    offsets: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    size: float = 8.0
    colour: str = palette.INK
    bold: bool = False


def around(radius: float) -> list[tuple[float, float]]:
    """Offsets in eight directions, points."""
    return [(radius * np.cos(a), radius * np.sin(a)) for a in np.radians([90, 0, 180, 270, 45, 135, 315, 225])]


def place(axes: Axes, labels: Sequence[Label], taken: Sequence[Bbox] = ()) -> list[str]:
    """Put labels into a settled figure, the first ones first; returns the texts that found no place.

    taken : boxes in display coordinates that must stay free
    """
    canvas = axes.figure.canvas
    if not isinstance(canvas, FigureCanvasAgg):
        raise TypeError("labels need a canvas that can measure text")
    renderer = canvas.get_renderer()
    inside, boxes, homeless = axes.get_window_extent(renderer), list(taken), []
    for label in labels:
        text = axes.annotate(
            label.text,
            (0.0, 0.0),
            (0.0, 0.0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=label.size,
            color=label.colour,
            fontweight="bold" if label.bold else "normal",
            annotation_clip=False,
            bbox={"boxstyle": "square,pad=0.12", "facecolor": palette.PAPER, "edgecolor": "none", "alpha": 0.72},
            zorder=9,
        )
        for place, offset in ((p, o) for p in label.places for o in label.offsets):
            text.xy, text.xyann = place, offset
            box = text.get_window_extent(renderer).padded(PADDING)
            within = box.x0 >= inside.x0 and box.x1 <= inside.x1 and box.y0 >= inside.y0 and box.y1 <= inside.y1
            if within and not any(box.overlaps(other) for other in boxes):
                boxes.append(box)
                break
        else:
            text.remove()
            homeless.append(label.text)
    return homeless
