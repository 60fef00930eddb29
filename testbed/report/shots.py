"""Pictures of a trial, taken after the run from its recording and kept beside it: `<trial>/cameras/<camera>-<moment>.png`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from testbed.columns import Array
from testbed.plugins import load
from testbed.protocols import Renderer, Renders
from testbed.recording import Trial
from testbed.report.cameras import CameraSpec, moments
from testbed.report.placing import Placed, place
from testbed.scene import Scene
from testbed.view import Image

if TYPE_CHECKING:
    from testbed.scenario import Scenario

FOLDER = "cameras"  # in the folder of a trial


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture: by which camera, at what moment ("start", "3.5s", "enter-dock"), and when that was, s."""

    camera: str
    moment: str
    t: float
    image: Image

    @property
    def name(self) -> str:
        """ "overview-start": unique among the shots of a trial, and fit for a file's name."""
        return re.sub(r"[^A-Za-z0-9_.-]", "_", f"{self.camera}-{self.moment}")


@contextmanager
def renderer_of(scenario: Scenario, scene: Scene) -> Iterator[Renderer | None]:
    """What draws the scene of a scenario's recording (`testbed.archive.load_scene`); None where its world can't show itself.

    Needs no simulation. Raises ImportError, saying what to install, where nothing can be drawn on this machine.
    """
    world = load("worlds", scenario.world.kind)(scenario.world.config)
    with closing(world):
        if not isinstance(world, Renders):
            yield None
            return
        with closing(world.renderer(scene)) as renderer:
            yield renderer


def take(trial: Trial, renderer: Renderer, placed: Placed, t: float, smooth: int = 2) -> Image:
    """What a camera sees at `t` s from where `testbed.report.placing.place` put it, with the moving bodies where they were then."""
    bodies = np.arange(len(trial.truth.bodies))
    poses = trial.truth.pose(bodies, t) if len(bodies) else np.zeros((0, 7))
    return renderer.render(placed[0], poses, placed[1], smooth)


def capture(trial: Trial, scene: Scene, specs: Sequence[CameraSpec], renderer: Renderer, folder: Path | None = None) -> dict[str, Shot]:
    """All pictures that the cameras are to take of a trial, by `Shot.name`; with `folder`, the trial's, written there as PNG too.

    ValueError for a camera on a body that isn't in the scene. OSError where the disk won't have them.
    """
    shots = []
    for spec in specs:
        placed = None
        for name, t in moments(spec, scene, trial):
            if placed is None or spec.body is not None:
                placed = place(spec, scene, trial.truth, t)
            shots.append(Shot(spec.id, name, t, take(trial, renderer, placed, t)))
    if folder is not None and shots:
        cameras = folder / FOLDER
        cameras.mkdir(parents=True, exist_ok=True)
        for shot in shots:
            (cameras / f"{shot.name}.png").write_bytes(png(shot.image.rgb))
    return {shot.name: shot for shot in shots}


def png(rgb: Array) -> bytes:
    """A picture (H, W, 3) uint8 as PNG, without loss."""
    return _encoded(".png", rgb, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def webp(rgb: Array, quality: int = 88) -> bytes:
    """A picture (H, W, 3) uint8 as WebP: for pages, a third of the size."""
    return _encoded(".webp", rgb, [cv2.IMWRITE_WEBP_QUALITY, quality])


def _encoded(suffix: str, rgb: Array, options: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    if not done:
        raise RuntimeError(f"OpenCV can't write {suffix} pictures")
    return data.tobytes()
