"""The pictures of a recording that a page shows: what its cameras saw with the tracks drawn over it, and the whole trial in motion."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from testbed import archive
from testbed.columns import Array
from testbed.protocols import Renderer
from testbed.report import shots
from testbed.report.animation import animate
from testbed.report.cameras import CameraSpec
from testbed.report.cases import Case
from testbed.report.figures import Styles
from testbed.report.overlay import draw
from testbed.report.pictures import cameras_of
from testbed.report.traces import Trace, traces

MOST = 8  # pictures of one recording in a page: `testbed render` writes them all
QUALITY = 82  # of WebP
ELLIPSES = 4  # along each track
LEGEND = "Tracks are solid where they can be seen, faint and dashed where things hide them; ellipses hold 95 %."
FRAMES = 36  # of the animation: it must not take longer than all the rest


@dataclass(frozen=True)
class Picture:
    """An image of a page: what it shows in a few words, and in a sentence; its type and its bytes.

    calm : of a moving one, a picture that stands still, for those who want no motion
    """

    title: str
    caption: str
    mime: str
    content: bytes
    width: int
    height: int
    calm: bytes = b""

    @property
    def address(self) -> str:
        """The image itself as an address: nothing is fetched."""
        return f"data:{self.mime};base64,{base64.b64encode(self.content).decode()}"

    @property
    def calm_address(self) -> str:
        """The same of the one that stands still; "" where this one does."""
        return f"data:{self.mime};base64,{base64.b64encode(self.calm).decode()}" if self.calm else ""


@dataclass(frozen=True)
class Album:
    """Pictures, or in a sentence why there are none (or fewer)."""

    pictures: tuple[Picture, ...] = ()
    note: str = ""


def album(case: Case, styles: Styles, moving: bool) -> Album:
    """What the cameras of the case's scenario saw; with `moving`, the first camera's view of the whole trial as well.

    The plain renders are kept in the recording's folder, where that can be written.
    """
    if case.scenario is None:
        return Album(note="No camera pictures: the scenario can't be built on this machine any more.")
    try:
        with shots.renderer_of(case.scenario, case.scene) as renderer:
            if renderer is None:
                return Album(note=f"No camera pictures: the world {case.scenario.world.kind} can't show itself.")
            return _filled(case, cameras_of(case.scenario), renderer, _traces(case, styles), moving)
    except ImportError as error:
        return Album(note=f"No camera pictures: {error}")


def _traces(case: Case, styles: Styles) -> list[Trace]:
    tracks = archive.load_tracks(case.kept.folder)
    known = {id: tracks[id] for id in [*styles.ids, *tracks] if id in tracks and {"x", "y"} <= set(tracks[id].components)}
    return traces(case.trial, known, {id: styles.colour(id) for id in known}, [aim.name for aim in case.aims])


def _filled(case: Case, cameras: Sequence[CameraSpec], renderer: Renderer, lines: list[Trace], moving: bool) -> Album:
    try:
        taken = shots.capture(case.trial, case.scene, cameras, renderer, case.kept.folder)
    except OSError:  # a folder that is read only: the page has the pictures all the same
        taken = shots.capture(case.trial, case.scene, cameras, renderer)
    found = [_still(shot, lines) for shot in list(taken.values())[:MOST]]
    if found:
        found[0] = replace(found[0], caption=f"{found[0].caption} {LEGEND}")
    if moving:
        content = animate(case.trial, case.scene, cameras[0], renderer, lines, frames=FRAMES)
        text = f"The whole trial of {case.duration:g} s as the camera {cameras[0].id} sees it, over and over."
        picture = _picture("In motion", text, content)
        found.append(replace(picture, calm=shots.webp(_first_frame(picture.title, content), QUALITY)))
    more = len(taken) - MOST
    return Album(tuple(found), f"{more} more pictures: testbed render writes them all." if more > 0 else "")


def _still(shot: shots.Shot, lines: list[Trace]) -> Picture:
    rgb = draw(shot.image, lines, now=shot.t, ellipses=ELLIPSES)
    return _picture(f"Camera {shot.camera}, {shot.moment}", f"At {shot.t:.1f} s.", shots.webp(rgb, QUALITY))


def _picture(title: str, caption: str, content: bytes) -> Picture:
    height, width = _first_frame(title, content).shape[:2]
    return Picture(title, caption, "image/webp", content, width, height)


def _first_frame(title: str, content: bytes) -> Array:
    """(H, W, 3) uint8, RGB."""
    first = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_COLOR_RGB)
    if first is None:
        raise RuntimeError(f"{title}: OpenCV can't read its own picture")
    return first
