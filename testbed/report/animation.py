"""A trial as a short animated picture (WebP, which every browser plays): the camera's view with the tracks growing.

The length is bounded: a minute of recording and an hour get the same number of frames, so they play at different speeds.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from testbed.columns import Array
from testbed.protocols import Renderer
from testbed.recording import Trial
from testbed.report.cameras import CameraSpec
from testbed.report.overlay import draw
from testbed.report.placing import place
from testbed.report.shots import take
from testbed.report.traces import Trace
from testbed.scene import Scene

FRAMES, FRAME_S, SIZE = 50, 0.1, (480, 360)  # s; px
LIMIT, QUALITIES = 400_000, (70, 45, 25)  # bytes; of WebP, in the order they are tried
LAST_S = 1.0  # how long the last frame stands before it begins again


def animate(
    trial: Trial,
    scene: Scene,
    spec: CameraSpec,
    renderer: Renderer,
    traces: Sequence[Trace],
    frames: int = FRAMES,
    size: tuple[int, int] = SIZE,
    limit: int = LIMIT,
) -> bytes:
    """The whole trial in `frames` pictures of `size` (width, height) px, FRAME_S s each: an animated WebP (see `bounded`).

    A camera that stands still takes its pictures several times faster than one that moves, which gets by without smoothing.
    ValueError for fewer than 2 frames or more than 300.
    """
    if not 2 <= frames <= 300:
        raise ValueError(f"an animation has 2 to 300 frames, not {frames}")
    pictures, placed = [], None
    for t in np.linspace(0.0, trial.recording.duration, frames).tolist():
        if placed is None or spec.body is not None:
            placed = place(spec, scene, trial.truth, t, size)
        pictures.append(draw(take(trial, renderer, placed, t, smooth=2 if spec.body is None else 1), traces, now=t, until=t))
    return bounded(pictures, limit)


def bounded(pictures: Sequence[Array], limit: int) -> bytes:
    """The pictures, FRAME_S s each, in the best quality that fits into `limit` bytes; if none does, every other picture, twice as long.

    The smallest there is where nothing fits, from 8 pictures on.
    """
    data, every = b"", 1
    while every == 1 or len(pictures[::every]) >= 8:
        for quality in QUALITIES:
            data = encode(pictures[::every], every * FRAME_S, quality)
            if len(data) <= limit:
                return data
        every *= 2
    return data


def encode(pictures: Sequence[Array], frame_s: float, quality: int) -> bytes:
    """Pictures (H, W, 3) uint8 as an animated WebP that runs for ever, `frame_s` s each and LAST_S the last."""
    animation = cv2.Animation()
    animation.frames = [cv2.cvtColor(p, cv2.COLOR_RGB2BGRA) for p in pictures]
    animation.durations = [round(1000 * frame_s)] * (len(pictures) - 1) + [round(1000 * LAST_S)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "animation.webp"
        if not cv2.imwriteanimation(os.fspath(path), animation, [cv2.IMWRITE_WEBP_QUALITY, quality]):
            raise RuntimeError("OpenCV can't write animated WebP")
        return path.read_bytes()
