"""Text on pictures, in the typeface of the figures (DejaVu Sans, which comes with matplotlib)."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from testbed.columns import Array
from testbed.report.palette import INK


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)


def width(text: str, size: int) -> int:
    """Of a line of text, px."""
    return int(np.ceil(_font(size).getlength(text)))


def write(rgb: Array, lines: list[tuple[float, float, str]], size: int, colour: str = INK) -> Array:
    """A copy of the picture (H, W, 3) uint8 with texts at (x, y) px: the left end, at half the height of small letters."""
    image = Image.fromarray(rgb)
    pen = ImageDraw.Draw(image)
    for x, y, text in lines:
        pen.text((x, y), text, fill=colour, font=_font(size), anchor="lm")
    return np.array(image)
