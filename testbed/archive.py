"""Trials on disk: one folder each, from which everything can be replayed and drawn, read back bit for bit.

    trial-000003/
      recording/   what estimators got: recording.json, site.*.parquet, stream.<kind>.parquet, targets.parquet
      truth/       what really happened: truth.parquet, scene.*, tagged.*, truth.json
      tracks/      <estimator>.parquet (and beside it .B and .innovations)
      guides/      of a guided person: a folder like this one for each further guide, which made data of its own

Truth is never in the same file, nor even the same folder, as a stream.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from testbed import tables
from testbed.columns import Array, Columns, Table
from testbed.guided.record import Walk
from testbed.protocols import Tagged
from testbed.recording import Recording, Trial
from testbed.scene import Body, Scene, Truth
from testbed.types import Site, Targets, Track

C = TypeVar("C", bound=Columns)


class StoreError(Exception):
    """Results that can't be written or read, in one sentence."""


def place(folder: Path, point: int, trial: int) -> Path:
    """Where a trial of a run lies, under the run's output folder."""
    return folder / "recordings" / f"point-{point:04d}" / f"trial-{trial:06d}"


def save(
    folder: Path,
    trial: Trial,
    tracks: Mapping[str, Track],
    scene: Scene,
    tagged: Tagged,
    guides: Mapping[str, tuple[Trial, Track]] | None = None,
) -> None:
    """Write a trial as `folder`, whole or not at all; what was there before is replaced. StoreError where the disk won't have it.

    guides : by id, of guides beside the one whose trial this is, theirs
    """
    rough = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        shutil.rmtree(rough, ignore_errors=True)
        for part in ("recording", "truth", "tracks"):
            (rough / part).mkdir(parents=True)
        _save_recording(rough / "recording", trial.recording)
        _save_truth(rough / "truth", trial, scene, tagged)
        for id, track in tracks.items():
            tables.write(track, rough / "tracks" / f"{id}.parquet")
        for id, (own, track) in (guides or {}).items():
            save(rough / "guides" / id, own, {id: track}, scene, tagged)
        if folder.exists():
            shutil.rmtree(folder)
        rough.rename(folder)
    except OSError as error:
        shutil.rmtree(rough, ignore_errors=True)
        raise StoreError(f"can't write the recording {folder}: {error.strerror or error}") from error


def load_recording(folder: Path) -> Recording:
    """What estimators got of the trial in `folder`; reads nothing else. StoreError where it is missing or damaged."""
    return _read(Path(folder), _load_recording)


def load_trial(folder: Path) -> Trial:
    """The trial in `folder` with its truth. StoreError where it is missing or damaged."""
    return _read(Path(folder), _load_trial)


def load_scene(folder: Path) -> tuple[Scene, Tagged]:
    """The hall of the trial in `folder`, and where its tags truly are: for drawing."""
    return _read(Path(folder), _load_scene)


def load_guides(folder: Path) -> dict[str, tuple[Trial, dict[str, Track]]]:
    """Of a guided person's trial in `folder`, what the guides beside the first one made of it, by id: their own trial, and tracks."""
    return {path.name: (load_trial(path), load_tracks(path)) for path in sorted((Path(folder) / "guides").glob("*")) if path.is_dir()}


def load_tracks(folder: Path) -> dict[str, Track]:
    """What each estimator made of the trial in `folder`."""
    return _read(Path(folder), _load_tracks)


def _read(folder: Path, loader: Any) -> Any:
    if not folder.is_dir():
        raise StoreError(f"there is no recording {folder}")
    try:
        return loader(folder)
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
        raise StoreError(f"the recording {folder} can't be read: {error}") from error


# ---------------------------------------------------------------- what estimators got


def _save_recording(folder: Path, recording: Recording) -> None:
    for kind, stream in recording.streams.items():
        tables.write(stream, folder / f"stream.{kind}.parquet")
    tables.write(recording.targets, folder / "targets.parquet")
    _write_array(folder / "asked_sets.parquet", recording.asked_sets)
    _write_array(folder / "target_tags.parquet", np.concatenate([*recording.target_tags, np.empty(0, dtype=np.int32)]))
    plain = {
        "trial": recording.trial,
        "duration": recording.duration,
        "streams": list(recording.streams),
        "target_tags": [len(tags) for tags in recording.target_tags],
        "site": _save_parts(folder, "site", recording.site),
    }
    _write_json(folder / "recording.json", plain)


def _load_recording(folder: Path) -> Recording:
    folder = folder / "recording"
    plain = _read_json(folder / "recording.json")
    tags = _read_array(folder / "target_tags.parquet")
    return Recording(
        trial=plain["trial"],
        duration=plain["duration"],
        site=Site(**_load_parts(folder, "site", plain["site"])),
        streams={kind: _typed(folder / f"stream.{kind}.parquet", Table) for kind in plain["streams"]},
        targets=_typed(folder / "targets.parquet", Targets),
        target_tags=tuple(np.split(tags, np.cumsum(plain["target_tags"])[:-1])) if plain["target_tags"] else (),
        asked_sets=_read_array(folder / "asked_sets.parquet"),
    )


# ---------------------------------------------------------------- what really happened


def _save_truth(folder: Path, trial: Trial, scene: Scene, tagged: Tagged) -> None:
    tables.write(trial.truth, folder / "truth.parquet")
    _write_array(folder / "target_body.parquet", np.asarray(trial.target_body))
    _write_array(folder / "target_pose.parquet", trial.target_pose)
    _write_array(folder / "body_pose.parquet", scene.rest_poses())
    if trial.walk is not None:
        tables.write(trial.walk, folder / "walk.parquet")
    plain = {
        "stimulus": trial.stimulus,
        "bodies": [{"name": b.name, "kind": b.kind, "moving": b.moving} for b in scene.bodies],
        "materials": list(scene.materials),
        "scene": _save_parts(folder, "scene", scene, elsewhere=("bodies", "materials")),
        "tagged": _save_parts(folder, "tagged", tagged),
    }
    _write_json(folder / "truth.json", plain)


def _load_trial(folder: Path) -> Trial:
    recording, folder = _load_recording(folder), folder / "truth"
    plain = _read_json(folder / "truth.json")
    truth = _typed(folder / "truth.parquet", Truth)
    body = _read_array(folder / "target_body.parquet")
    walk = _typed(folder / "walk.parquet", Walk) if (folder / "walk.parquet").is_file() else None
    return Trial(recording, truth, body, _read_array(folder / "target_pose.parquet"), plain["stimulus"], walk)


def _load_scene(folder: Path) -> tuple[Scene, Tagged]:
    folder = folder / "truth"
    plain = _read_json(folder / "truth.json")
    poses = _read_array(folder / "body_pose.parquet")
    bodies = tuple(Body(b["name"], b["kind"], pose, b["moving"]) for b, pose in zip(plain["bodies"], poses, strict=True))
    scene = Scene(bodies=bodies, materials=tuple(plain["materials"]), **_load_parts(folder, "scene", plain["scene"]))
    return scene, Tagged(**_load_parts(folder, "tagged", plain["tagged"]))


def _load_tracks(folder: Path) -> dict[str, Track]:
    # an estimator's id holds no full stop, the tables beside its main one do
    return {path.stem: _typed(path, Track) for path in sorted((folder / "tracks").glob("*.parquet")) if "." not in path.stem}


# ---------------------------------------------------------------- pieces


def _save_parts(folder: Path, name: str, value: Any, elsewhere: tuple[str, ...] = ()) -> list[str]:
    """The fields of a plain dataclass, a file each ("site.antennas.parquet"); returns the names of those that are not None."""
    saved = []
    for f in fields(value):
        content = getattr(value, f.name)
        if content is None or f.name in elsewhere:
            continue
        path = folder / f"{name}.{f.name}.parquet"
        if isinstance(content, Columns):
            tables.write(content, path)
        elif isinstance(content, np.ndarray):
            _write_array(path, content)
        else:
            raise TypeError(f"{type(value).__name__}.{f.name}: a {type(content).__name__} can't be written to a file")
        saved.append(f.name)
    return saved


def _load_parts(folder: Path, name: str, saved: list[str]) -> dict[str, Any]:
    found = {}
    for part in saved:
        path = folder / f"{name}.{part}.parquet"
        found[part] = _read_array(path) if tables.read_table(path).column_names == [_ARRAY] else tables.read(path)
    return found


_ARRAY = "array"


def _write_array(path: Path, array: Array) -> None:
    tables.write_table(tables.frame({_ARRAY: array}), path)


def _read_array(path: Path) -> Array:
    return tables.unframe(tables.read_table(path))[_ARRAY]


def _typed(path: Path, kind: type[C]) -> C:
    value = tables.read(path)
    if not isinstance(value, kind):
        raise tables.NotColumnar(f"{path.name} holds a {type(value).__name__}, not a {kind.__name__}")
    return value


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content), encoding="utf-8")


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
