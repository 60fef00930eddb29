"""Colours that people with any kind of colour vision can tell apart, in one place for all figures, renders and pages.

After M. Okabe and K. Ito, "Color universal design" (2008). The truth is always black; estimators get the others in the order of
the scenario, from the one that stands out best on light ground. Yellow is left out: on white nobody sees it.
"""

from __future__ import annotations

from collections.abc import Iterable

TRUTH = "#000000"
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
ESTIMATORS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
INK, PAPER, FAINT = "#1F2430", "#FFFFFF", "#9AA0A8"  # text, ground, what is of little weight


def assign(ids: Iterable[str]) -> dict[str, str]:
    """A colour "#RRGGBB" for each estimator, by its place among all; they repeat after six."""
    return {id: ESTIMATORS[i % len(ESTIMATORS)] for i, id in enumerate(ids)}


def rgb(colour: str) -> tuple[int, int, int]:
    """(red, green, blue) in 0 to 255 of "#RRGGBB"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
