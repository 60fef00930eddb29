"""What a format gets to write: one recording of a run, with its truth, its hall, and what each estimator made of it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed import archive
from testbed.archive import StoreError
from testbed.columns import Array
from testbed.recording import Recording, Trial, mounted
from testbed.scene import WORLD, Scene
from testbed.types import POSITION, Reads, Status, Track


@dataclass(frozen=True)
class Kept:
    """One recording. `name` tells it from the others of the run: "point-0000.trial-000003"."""

    name: str
    trial: Trial
    tracks: Mapping[str, Track]
    scene: Scene

    @property
    def recording(self) -> Recording:
        """What estimators got."""
        return self.trial.recording

    @property
    def reads(self) -> Reads:
        """The stream of reads by time, those of one time in the order in which they came. Empty where there is none."""
        reads = self.recording.streams.get("reads")
        return reads.take(np.argsort(reads.t, kind="stable")) if isinstance(reads, Reads) else Reads.empty()

    def true_poses(self, target: int, t: Array) -> Array:
        """(K, 7): where a target truly was at times t (K,) s."""
        body, pose = int(self.trial.target_body[target]), self.trial.target_pose[target]
        return np.tile(pose, (len(t), 1)) if body == WORLD else mounted(self.trial.truth, body, pose, t)

    def true_times(self) -> Array:
        """(K,) s: the times at which the truth is kept, those of the recording."""
        t = self.trial.truth.t
        return t[t <= self.recording.duration + 1e-9]


@dataclass(frozen=True)
class Line:
    """What one estimator says of one target where it stands by it: t (K,) s, position (K, 3) m (z 0 where it gives none)."""

    estimator: str
    target: str
    t: Array
    position: Array
    quaternion: Array  # (K, 4), w x y z; of its heading where it gives one


def lines(kept: Kept) -> Iterator[Line]:
    """Of every estimator and target; those that give no x and y are left out."""
    for estimator, track in kept.tracks.items():
        if not {"x", "y"} <= set(track.components):
            continue
        for row, target in enumerate(track.target):
            axes = [track.components.index(name) for name in POSITION if name in track.components]
            position = np.zeros((len(track.t), 3))
            position[:, : len(axes)] = track.mean[:, row][:, axes]
            fine = (track.status[:, row] != Status.LOST) & np.isfinite(position).all(axis=1)
            yaw = track.mean[:, row, track.components.index("heading")] if "heading" in track.components else np.zeros(len(track.t))
            quaternion = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=1)
            yield Line(estimator, str(target), track.t[fine], position[fine], quaternion[fine])


def recordings(folder: Path, point: int | None = None, trial: int | None = None) -> list[Kept]:
    """The recordings that a run kept, or one of them. StoreError where there is none."""
    places = sorted(Path(folder).glob("recordings/point-*/trial-*"))
    if not places and Path(folder).name.startswith("trial-"):
        places = [Path(folder).resolve()]
    chosen = [p for p in places if (point is None or _number(p.parent) == point) and (trial is None or _number(p) == trial)]
    if not chosen:
        there = ", ".join(f"{_number(p.parent)}/{_number(p)}" for p in places[:10])
        kept = f"; it keeps point/trial {there}" if places else ": run with --keep first:N or all"
        raise StoreError(f"{folder} holds no such recording{kept}")
    return [load(place) for place in chosen]


def load(place: Path) -> Kept:
    """One recording by its folder. StoreError where it is damaged."""
    scene, _ = archive.load_scene(place)
    return Kept(f"{place.parent.name}.{place.name}", archive.load_trial(place), archive.load_tracks(place), scene)


def _number(folder: Path) -> int:
    return int(re.sub(r"\D", "", folder.name) or 0)


def safe(name: str) -> str:
    """A name as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name)


def plain(value: Any) -> float | None:
    """A number for JSON: None for NaN."""
    return None if not np.isfinite(value) else float(value)
