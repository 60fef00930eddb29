"""The camera pictures of a run: every camera of its scenario, for every recording that was kept, with the tracks drawn over them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from testbed import archive
from testbed.manifest import rebuilt
from testbed.plugins import suggest
from testbed.report import palette, shots
from testbed.report.animation import animate
from testbed.report.cameras import OVERVIEW, CameraSpec
from testbed.report.overlay import draw
from testbed.report.traces import traces
from testbed.scenario import Scenario
from testbed.store import StoreError, read_manifest

DRAWN = 4  # targets whose tracks are drawn over a picture: more would hide the hall


def cameras_of(scenario: Scenario, wanted: Sequence[str] = ()) -> tuple[CameraSpec, ...]:
    """The scenario's cameras, or those named; an overview where it has none. StoreError, with the nearest name, for an unknown one."""
    known = {camera.id: camera for camera in scenario.cameras} or {OVERVIEW.id: OVERVIEW}
    for name in wanted:
        if name not in known:
            raise StoreError(f"the scenario has no camera {name!r}{suggest(name, list(known))}")
    return tuple(camera for id, camera in known.items() if not wanted or id in wanted)


def render(folder: Path, out: Path, cameras: Sequence[str] = (), animated: bool = False, tracks: bool = True) -> Iterator[Path]:
    """Write the pictures of a run's kept recordings into `out`, and yield each file as it is there: PNG, or animated WebP.

    StoreError where nothing was kept, for a camera that the scenario doesn't have, for a world that can't show itself, and where the
    disk refuses; ImportError, saying what to install, where nothing can be drawn on this machine.
    """
    scenario = rebuilt(read_manifest(folder))
    places = sorted(folder.glob("recordings/point-*/trial-*"))
    if not places:
        raise StoreError(f"{folder} holds no recordings: run with --keep first:N or all")
    points = scenario.points()
    try:
        out.mkdir(parents=True, exist_ok=True)
        for place in places:
            point = points[int(place.parent.name.removeprefix("point-"))].scenario
            stem = "" if len(places) == 1 else f"{place.parent.name}.{place.name}."
            for name, content in _pictures(point, place, cameras_of(point, cameras), animated, tracks):
                path = out / f"{stem}{name}"
                path.write_bytes(content)
                yield path
    except OSError as error:
        raise StoreError(f"the pictures can't be written to {out}: {error.strerror}") from None


def _pictures(scenario: Scenario, place: Path, cameras: Sequence[CameraSpec], animated: bool, tracks: bool) -> Iterator[tuple[str, bytes]]:
    trial, (scene, _) = archive.load_trial(place), archive.load_scene(place)
    found = archive.load_tracks(place) if tracks else {}
    targets = [str(name) for name in trial.recording.targets.name[:DRAWN]]
    lines = traces(trial, found, palette.assign(s.id for s in scenario.estimators), targets) if tracks else []
    with shots.renderer_of(scenario, scene) as renderer:
        if renderer is None:
            raise StoreError(f"world {scenario.world.kind} can't show itself: it has no renderer")
        if animated:
            yield from ((f"{camera.id}.webp", animate(trial, scene, camera, renderer, lines)) for camera in cameras)
            return
        for shot in shots.capture(trial, scene, cameras, renderer).values():
            rgb = draw(shot.image, lines, now=shot.t) if lines else shot.image.rgb
            yield f"{shot.name}.png", shots.png(rgb)
