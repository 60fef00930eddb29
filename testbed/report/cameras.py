"""Cameras as a scenario names them: where they stand, what they look at, and when their picture is taken.

Light to import, for every scenario file is judged with it. Pictures are taken after a run, from its recording
(`testbed.report.shots`).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from testbed.quantity import Config, Degrees, Metres, Point3, Seconds
from testbed.recording import Trial
from testbed.scene import Scene
from testbed.types import Reads

PLAIN_MOMENTS = ("start", "middle", "end", "first_read", "last_read")
_ZONE_MOMENT = re.compile(r"^(enter|leave):(.+)$")
_FOLLOWING = ("offset_m", "distance_m", "azimuth_deg", "elevation_deg")

Span = Annotated[Metres, Field(gt=0, le=1000)]
Glob = Annotated[str, Field(min_length=1, max_length=200)]
BodyName = Annotated[str, Field(min_length=1, max_length=200)]


def _list(value: Any) -> Any:
    return value if isinstance(value, (list, tuple)) else [value]


class CameraSpec(Config):
    """A named camera. What it does follows from what is given:

    * `position_m` (and `look_at_m`, else the middle of the hall): stands still. With `follow` it turns to that body;
    * `follow`: goes along with a body, at `offset_m` in the body's own frame (x ahead, y left, z up), or at `distance_m` from it
      in the world's direction `azimuth_deg` (counter-clockwise from +x, else the one that racks hide least) and `elevation_deg` above it;
    * `shoulder`: looks over the right shoulder of a person, the way the person looks;
    * none of these: an overview of the whole hall, from the side `azimuth_deg` or from where most can be seen.

    Pictures are taken `at_s` (seconds) and `at` (start, middle, end, first_read, last_read, enter:ZONE, leave:ZONE); in the middle
    where neither is given. `cut` names bodies or kinds to cut off above the floor; without it the walls and roofs that
    would hide the view of a following camera or of one outside the hall.
    """

    id: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]
    position_m: Point3 | None = None
    look_at_m: Point3 | None = None
    follow: BodyName | None = None
    offset_m: Point3 | None = None
    distance_m: Span | None = None
    azimuth_deg: Annotated[Degrees, Field(ge=-360, le=360)] | None = None
    elevation_deg: Annotated[Degrees, Field(ge=-10, le=90)] | None = None
    shoulder: BodyName | None = None
    at_s: Annotated[list[Annotated[Seconds, Field(ge=0, le=86_400)]], BeforeValidator(_list), Field(max_length=100)] = Field(
        default_factory=list
    )
    at: Annotated[list[Annotated[str, Field(max_length=100)]], BeforeValidator(_list), Field(max_length=20)] = Field(default_factory=list)
    field_of_view_deg: Annotated[Degrees, Field(ge=5, le=120)] | None = None
    width_px: Annotated[int, Field(ge=64, le=1920)] = 640
    height_px: Annotated[int, Field(ge=64, le=1440)] = 480
    cut: list[Glob] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> CameraSpec:
        if self.shoulder is not None and (self.follow is not None or self.position_m is not None):
            raise ValueError("shoulder already says where the camera stands: remove follow or position_m")
        if self.look_at_m is not None and (self.position_m is None or self.follow is not None):
            raise ValueError("look_at_m goes with position_m, and not with follow, which is what the camera looks at then")
        if self.offset_m is not None and {"distance_m", "azimuth_deg", "elevation_deg"} & self._given():
            raise ValueError("offset_m and distance_m, azimuth_deg, elevation_deg are two ways to say the same: keep one")
        if self.offset_m is not None and (self.follow is None or self.position_m is not None):
            raise ValueError("offset_m is in the frame of a body: name it with follow, without position_m")
        if self.distance_m is not None and (self.follow is None or self.position_m is not None):
            raise ValueError("distance_m goes with follow, without position_m")
        stray = {"azimuth_deg", "elevation_deg"} & self._given()
        if stray and (self.position_m is not None or self.shoulder is not None):
            raise ValueError(f"{min(stray)} goes with follow or an overview: position_m and shoulder say where the camera stands")
        for name in self.at:
            if name not in PLAIN_MOMENTS and not _ZONE_MOMENT.match(name):
                near = difflib.get_close_matches(name, PLAIN_MOMENTS, n=1)
                hint = f", did you mean {near[0]}?" if near else f"; there are {', '.join(PLAIN_MOMENTS)}, enter:ZONE and leave:ZONE"
                raise ValueError(f"at: no moment is called {name!r}{hint}")
        return self

    def _given(self) -> set[str]:
        return {name for name in _FOLLOWING if getattr(self, name) is not None}

    @property
    def body(self) -> str | None:
        """The body that it follows or whose shoulder it looks over."""
        return self.follow or self.shoulder


OVERVIEW = CameraSpec(id="overview")  # what a report shows of a scenario without cameras


def mistakes(spec: CameraSpec, scene: Scene, duration: float) -> list[tuple[str, str]]:
    """What only a hall can tell of a camera: (field, sentence) for a body, a zone or a time that isn't there."""
    found = []
    bodies, zones = [b.name for b in scene.bodies], [str(z) for z in scene.zones.name]
    if spec.body is not None and spec.body not in bodies:
        field = "follow" if spec.follow is not None else "shoulder"
        found.append((field, f"no body is called {spec.body!r}{_hint(spec.body, bodies)}"))
    for name in spec.at:
        match = _ZONE_MOMENT.match(name)
        if match and match[2] not in zones:
            found.append(("at", f"no zone is called {match[2]!r}{_hint(match[2], zones)}"))
    late = [t for t in spec.at_s if t > duration]
    if late:
        found.append(("at_s", f"{late[0]:g} s is after the end of the recording at {duration:g} s"))
    return found


def _hint(word: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f", did you mean {near[0]}?" if near else f"; there are {', '.join(known[:12]) or 'none'}{', …' if len(known) > 12 else ''}"


def moments(spec: CameraSpec, scene: Scene, trial: Trial) -> list[tuple[str, float]]:
    """(name, time in s) of each picture, in the order of the file, times first. An event that never happened has no picture."""
    end = trial.recording.duration
    found = [(f"{t:g}s", float(t)) for t in spec.at_s if t <= end]
    for name in spec.at or ([] if spec.at_s else ["middle"]):
        t = _time_of(name, spec, scene, trial)
        if t is not None:
            found.append((name.replace(":", "-"), t))
    return found


def _time_of(name: str, spec: CameraSpec, scene: Scene, trial: Trial) -> float | None:
    end = trial.recording.duration
    fixed = {"start": 0.0, "middle": end / 2, "end": end}
    if name in fixed:
        return fixed[name]
    match = _ZONE_MOMENT.match(name)
    if match is None:
        return _read_time(name, trial)
    truth, zones = trial.truth, [str(z) for z in scene.zones.name]
    if match[2] not in zones:
        return None
    inside = truth.zone == zones.index(match[2])
    if spec.body in truth.bodies:
        inside = inside[:, [truth.index(spec.body)]]
    changed = (inside[1:] & ~inside[:-1]) if match[1] == "enter" else (inside[:-1] & ~inside[1:])
    times = truth.t[1:][changed.any(axis=1)]
    return float(times[0]) if len(times) else None


def _read_time(name: str, trial: Trial) -> float | None:
    """Of the first or the last read of any target's tag."""
    reads = trial.recording.streams.get("reads")
    if not isinstance(reads, Reads):
        return None
    wanted = np.concatenate([*trial.recording.target_tags, np.empty(0, dtype=np.int64)])
    times = reads.t[np.isin(reads.tag, wanted)]
    if not len(times):
        return None
    return float(times.min() if name == "first_read" else times.max())
