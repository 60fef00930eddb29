"""Tracks drawn over a render with the camera's own matrices: solid where they can be seen, faint and dashed where things hide them.

What is hidden is decided by the render's depth image. Lines by OpenCV, with a light rim so that they stand out from anything.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from testbed.columns import Array
from testbed.report import palette, text
from testbed.report.traces import TRUTH, Trace
from testbed.view import Camera, Image

SKIN = 0.03  # m: what lies this little behind a surface is on it
STEP = 2.0  # px between the points at which a line is looked at
FINEST, MOST = 0.02, 20_000  # m; points of a line
DASH = 4.0  # px
FAINT = 0.55  # of a line's own colour where it is hidden
NINETY_FIVE = 5.991464547107979  # 0.95 quantile of χ² with two degrees of freedom
ON_FLOOR = 0.01  # m: ellipses lie on the floor
_SHIFT = 4  # binary digits of pixel fractions in OpenCV's drawing
_FAR = 30_000.0  # px: farther outside the picture nothing is drawn, where OpenCV's numbers end


def visible(image: Image, points: Array) -> Array:
    """(N,) bool: whether the points (N, 3) m can be seen in the picture: inside it and behind nothing.

    A point is hidden if it lies behind all the nine pixels round it by more than SKIN, so a line along a surface is not.
    """
    pixels, depth = image.camera.project(points)
    sight = _Sight(image)
    return sight.inside(pixels) & ~sight.hidden(pixels, depth)


class _Sight:
    """A render as something to look at points in."""

    def __init__(self, image: Image) -> None:
        self.camera = image.camera
        self._farthest = cv2.dilate(image.depth, np.ones((3, 3), dtype=np.uint8))

    def inside(self, pixels: Array) -> Array:
        """(N,) bool: pixels (N, 2) that the picture has."""
        u, v = self._nearest(pixels)
        return (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)

    def hidden(self, pixels: Array, depth: Array) -> Array:
        """(N,) bool: inside the picture and behind something."""
        inside = self.inside(pixels)
        u, v = self._nearest(pixels[inside])
        behind = np.zeros(len(pixels), dtype=bool)
        behind[inside] = depth[inside] > self._farthest[v, u] + SKIN
        return behind

    def _nearest(self, pixels: Array) -> Array:
        near = np.full(pixels.shape, -1)
        np.copyto(near, np.round(pixels), where=_drawable(pixels)[:, None], casting="unsafe")
        return near.T


def _drawable(pixels: Array) -> Array:
    """(N,) bool: pixels (N, 2) that OpenCV can be given."""
    with np.errstate(invalid="ignore"):
        return np.all(np.abs(pixels) < _FAR, axis=1)


def draw(
    image: Image, traces: Sequence[Trace], *, now: float | None = None, until: float | None = None, ellipses: int = 0, legend: bool = True
) -> Array:
    """(H, W, 3) uint8: the render with the traces over it, and below it, where `legend`, a strip that says what is what (H grows).

    now      : s, where a marker stands on each trace, with a plumb line to the floor and the ellipse of its covariance
    until    : s, up to where the traces are drawn; wholly, where it is left out
    ellipses : how many more 95 % ellipses to draw along each trace, on the floor
    """
    rgb, sight = image.rgb.copy(), _Sight(image)
    pieces = [piece for trace in _ordered(traces) for piece in _pieces(sight, trace, now, until, ellipses)]
    rgb = _hidden(rgb, pieces)
    for rim in (True, False):
        for piece in pieces:
            for run in piece.runs(True):
                cv2.polylines(rgb, [run], False, (255, 255, 255) if rim else piece.rgb, piece.width + 2 * rim, cv2.LINE_AA, _SHIFT)
    if now is not None:
        for trace in _ordered(traces):
            _marker(rgb, sight, trace, now)
    return _with_legend(rgb, traces, now, until) if legend else rgb


def _ordered(traces: Sequence[Trace]) -> list[Trace]:
    """The truth first, so that estimates lie over it: it is the wider line."""
    return sorted(traces, key=lambda trace: trace.name != TRUTH)


# ---------------------------------------------------------------- lines


class _Piece:
    """A line in pixels, with what of it can be seen. Lines that leave the picture or pass the camera are interrupted there."""

    def __init__(self, sight: _Sight, points: Array, colour: str, width: int) -> None:
        self.rgb, self.width = palette.rgb(colour), width
        self.pixels, depth = sight.camera.project(_dense(sight.camera, points))
        self.drawn = _drawable(self.pixels)
        self.seen = ~sight.hidden(self.pixels, depth)  # beyond the rim, too: lines run up to it

    def runs(self, seen: bool) -> list[Array]:
        """The parts that can be seen, or the dashes of those that can't, as OpenCV's whole numbers (n, 1, 2)."""
        mask = self.drawn & (self.seen == seen)
        if not seen:
            steps = np.linalg.norm(np.diff(self.pixels, axis=0, prepend=self.pixels[:1]), axis=1)
            mask &= np.cumsum(np.nan_to_num(steps, posinf=0.0)) % (2 * DASH) < DASH
        places = np.flatnonzero(mask)
        parts = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if len(places) else []
        return [np.round(self.pixels[p] * 2**_SHIFT).astype(np.int32)[:, None] for p in parts if len(p) > 1]


def _dense(camera: Camera, points: Array) -> Array:
    """Points along the polyline (K, 3) so close that neighbours are STEP px apart, or FINEST m where that is more."""
    if len(points) < 2:
        return points
    pixels, _ = camera.project(points)
    apart = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    most = np.ceil(np.nan_to_num(length / FINEST))
    count = np.clip(np.where(np.isfinite(apart), np.minimum(np.ceil(apart / STEP), most), most), 1, MOST // len(points) + 1).astype(int)
    start = np.append(np.repeat(np.arange(len(count)), count), len(points) - 1)
    first = np.append(np.repeat(np.cumsum(count) - count, count), len(start) - 1)
    share = (np.arange(len(start)) - first) / np.append(np.repeat(count, count), 1)
    ahead = points[np.minimum(start + 1, len(points) - 1)]
    return points[start] + share[:, None] * (ahead - points[start])


def _pieces(sight: _Sight, trace: Trace, now: float | None, until: float | None, ellipses: int) -> list[_Piece]:
    last = len(trace.t) if until is None else int(np.searchsorted(trace.t, until + 1e-9))
    points = trace.points[:last]
    found = [_Piece(sight, part, trace.colour, 3 if trace.name == TRUTH else 2) for part in _unbroken(points)]
    if trace.covariance is None:
        return found
    chosen = set(np.linspace(0, last - 1, ellipses + 1).astype(int)[1:].tolist()) if last and ellipses else set()
    if now is not None and last:
        chosen.add(_at(trace, now))
    rings = [ellipse(trace.points[k], trace.covariance[k]) for k in sorted(chosen) if np.isfinite(trace.points[k]).all()]
    return found + [_Piece(sight, ring, trace.colour, 1) for ring in rings]


def _unbroken(points: Array) -> list[Array]:
    """The stretches of a track between those where it has nothing to say."""
    good = np.flatnonzero(np.isfinite(points).all(axis=1))
    return [points[part] for part in np.split(good, np.flatnonzero(np.diff(good) > 1) + 1) if len(part) > 1]


def _at(trace: Trace, t: float) -> int:
    return int(np.clip(np.searchsorted(trace.t, t + 1e-9) - 1, 0, len(trace.t) - 1))


def ellipse(point: Array, covariance: Array) -> Array:
    """(49, 3) m: the closed outline, on the floor under `point`, that holds 95 % of a normal distribution with `covariance` (2, 2) m²."""
    value, vector = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2 * np.pi, 49)
    radii = np.sqrt(NINETY_FIVE * np.maximum(value, 0.0))
    flat = point[:2] + np.stack([np.cos(angle), np.sin(angle)], axis=1) * radii @ vector.T
    return np.column_stack([flat, np.full(len(angle), ON_FLOOR)])


def _hidden(rgb: Array, pieces: Sequence[_Piece]) -> Array:
    """Faint dashes for what can't be seen, under everything that can."""
    over = rgb.copy()
    for piece in pieces:
        for run in piece.runs(False):
            cv2.polylines(over, [run], False, piece.rgb, max(1, piece.width - 1), cv2.LINE_AA, _SHIFT)
    return cv2.addWeighted(over, FAINT, rgb, 1 - FAINT, 0.0)


def _marker(rgb: Array, sight: _Sight, trace: Trace, t: float) -> None:
    """A dot on the trace at time t, a ring where it is hidden, and a plumb line to the floor."""
    if not len(trace.t) or not np.isfinite(trace.points[_at(trace, t)]).all():
        return
    point = trace.points[_at(trace, t)]
    foot = np.array([point[0], point[1], min(0.0, point[2])])
    plumb = _Piece(sight, np.stack([point, foot]), trace.colour, 1)
    for run in plumb.runs(True) + plumb.runs(False):
        cv2.polylines(rgb, [run], False, plumb.rgb, 1, cv2.LINE_AA, _SHIFT)
    pixels, depth = sight.camera.project(point[None])
    if not _drawable(pixels)[0]:
        return
    centre = tuple(int(c) for c in np.round(pixels[0] * 2**_SHIFT))
    size = (6 if trace.name == TRUTH else 5) * 2**_SHIFT
    seen = not sight.hidden(pixels, depth)[0]
    cv2.circle(rgb, centre, size + 2**_SHIFT, (255, 255, 255), -1 if seen else 3, cv2.LINE_AA, _SHIFT)
    cv2.circle(rgb, centre, size, plumb.rgb, -1 if seen else 1, cv2.LINE_AA, _SHIFT)


# ---------------------------------------------------------------- legend


def _with_legend(rgb: Array, traces: Sequence[Trace], now: float | None, until: float | None) -> Array:
    """The picture with a strip below it, where nothing is covered."""
    size = int(np.clip(rgb.shape[1] / 48, 10, 18))
    row, swatch, gap = round(size * 1.8), round(size * 1.9), round(size * 0.6)
    named = dict.fromkeys((trace.name, trace.colour) for trace in _ordered(traces))
    entries = [(name, colour, False) for name, colour in named] + ([("hidden", palette.FAINT, True)] if traces else [])
    clock = now if now is not None else until
    label = "" if clock is None else f"t = {clock:.1f} s"
    room = rgb.shape[1] - 2 * gap - (text.width(label, size) + 2 * gap if label else 0)
    places, x, y = [], 0, 0
    for name, _, _ in entries:
        wide = swatch + gap + text.width(name, size) + 2 * gap
        if x and x + wide > room:
            x, y = 0, y + 1
        places.append((gap + x, y))
        x += wide
    strip = np.full(((y + 1) * row, rgb.shape[1], 3), 255, dtype=np.uint8)
    lines = []
    for (name, colour, dashed), (left, line) in zip(entries, places, strict=True):
        level = line * row + row // 2
        for a, b in [(0.0, 0.28), (0.36, 0.64), (0.72, 1.0)] if dashed else [(0.0, 1.0)]:
            ends = [(left + round(s * swatch), level) for s in (a, b)]
            cv2.line(strip, ends[0], ends[1], palette.rgb(colour), 3 if name == TRUTH else 2, cv2.LINE_AA)
        lines.append((left + swatch + gap, level, name))
    if label:
        lines.append((rgb.shape[1] - gap - text.width(label, size), row // 2, label))
    return np.concatenate([rgb, text.write(strip, lines, size)])
