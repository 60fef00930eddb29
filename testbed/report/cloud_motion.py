"""The cloud of a map-matching filter as it moves along the roads, while it seeks: an animated picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from testbed.columns import Array
from testbed.geometry import Roads
from testbed.report import palette, shots
from testbed.report.album import QUALITY, Picture
from testbed.report.animation import bounded
from testbed.report.cases import Aim, Case, Line
from testbed.report.figures import Styles

FRAMES, SEEKING_S = 61, 60.0  # El Mokhtari et al. show 54 s
WIDTH, HIGHEST, EDGE, HEAD = 640, 640, 24, 30  # px
LIMIT = 250_000  # bytes
FINE = 4  # bits of a pixel that cv2 draws to


@dataclass(frozen=True, eq=False)
class Sheet:
    """Where places (m) lie on a picture of `size` (width, height) px: `scale` px a metre from the corner `low` (2,) m."""

    low: Array
    scale: float
    size: tuple[int, int]

    @classmethod
    def of(cls, roads: Roads) -> Sheet:
        """A sheet that holds all roads, with an edge, and a line of text above them."""
        low, high = roads.nodes.min(axis=0), roads.nodes.max(axis=0)
        wide, tall = np.maximum(high - low, 1.0)
        scale = min((WIDTH - 2 * EDGE) / wide, (HIGHEST - 2 * EDGE - HEAD) / tall)
        return cls(low, float(scale), (round(scale * wide) + 2 * EDGE, round(scale * tall) + 2 * EDGE + HEAD))

    def px(self, place: Array) -> Array:
        """(..., 2) int32, as cv2 counts with FINE bits: of places (..., 2) m."""
        across = EDGE + self.scale * (place[..., 0] - self.low[0])
        down = self.size[1] - EDGE - self.scale * (place[..., 1] - self.low[1])
        return np.round(np.stack([across, down], axis=-1) * 2**FINE).astype(np.int32)


def cloud_motion(case: Case, styles: Styles) -> Picture | None:
    """The first method's cloud over the first minute (or the whole, where that is shorter); None without roads or particles."""
    roads = case.trial.recording.site.roads
    found = next(((aim, line) for aim in case.aims for line in aim.lines if line.cloud is not None), None)
    if roads is None or found is None or not len(roads.segments):
        return None
    aim, line = found
    until = min(SEEKING_S, case.duration)
    sheet = Sheet.of(roads)
    empty = _map(sheet, roads)
    colour = palette.rgb(styles.colour(line.estimator))
    pictures = [_frame(sheet, empty, aim, line, colour, t) for t in np.linspace(0.0, until, FRAMES).tolist()]
    caption = (
        f"The belief of {line.estimator} over the first {until:g} s: dots are equally weighted samples, the ring is its estimate, "
        f"the cross is the truth. {FRAMES - 1} pictures, then again from the start."
    )
    calm = shots.webp(pictures[0], QUALITY)
    return Picture("The cloud in motion", caption, "image/webp", bounded(pictures, LIMIT), *sheet.size, calm=calm)


def _map(sheet: Sheet, roads: Roads) -> Array:
    """(H, W, 3) uint8: the roads on white."""
    picture = np.full((sheet.size[1], sheet.size[0], 3), 255, dtype=np.uint8)
    for a, b in sheet.px(roads.nodes[roads.segments]):
        cv2.line(picture, a, b, palette.rgb(palette.SKY), 2, cv2.LINE_AA, FINE)
    return picture


def _frame(sheet: Sheet, empty: Array, aim: Aim, line: Line, colour: tuple[int, int, int], t: float) -> Array:
    picture = empty.copy()
    k = int(np.argmin(np.abs(line.t - t)))
    cloud = np.zeros((0, 2)) if line.cloud is None else line.cloud[k]
    for place in sheet.px(cloud[np.isfinite(cloud).all(axis=1)]):
        cv2.circle(picture, place, 3 << FINE, colour, -1, cv2.LINE_AA, FINE)
    truth = np.array([np.interp(t, aim.t, column) for column in aim.truth.T])
    arm = 8 / sheet.scale
    for way in ((arm, arm), (arm, -arm)):
        a, b = sheet.px(truth + np.outer((1, -1), way))
        cv2.line(picture, a, b, palette.rgb(palette.TRUTH), 2, cv2.LINE_AA, FINE)
    if np.isfinite(line.position[k]).all():
        cv2.circle(picture, sheet.px(line.position[k]).tolist(), 9 << FINE, colour, 2, cv2.LINE_AA, FINE)
    cv2.putText(picture, f"t = {t:.0f} s", (EDGE, HEAD - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.6, palette.rgb(palette.TRUTH), 1, cv2.LINE_AA)
    return picture
