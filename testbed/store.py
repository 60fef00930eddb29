"""The output folder of a run: written so that a kill at any moment loses at most the tasks under way, and read back.

    manifest.json      what was run (testbed/manifest.py), written first
    parts/             one file a task, written whole or not at all (testbed/parts.py): what a resumed run builds on
    trials.parquet     a row per point, trial, estimator, target
    world.parquet      a row per point and trial: what the world offered
    timings.parquet    wall times, the one table that differs from run to run
    failures.parquet   what went wrong, with tracebacks
    recordings/        the trials kept (testbed/archive.py)
    log.jsonl          what happened when

The four tables are put together from the parts, in order of point and trial, so they don't depend on jobs or interruptions.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

import numpy as np

from testbed import tables
from testbed.archive import StoreError, load_recording, load_scene, load_tracks, load_trial
from testbed.columns import Array
from testbed.evaluate import Rows
from testbed.identity import Keys
from testbed.manifest import refused
from testbed.parts import Found, Parts, parquet
from testbed.worker import BlockResult, Failure, joined

__all__ = ["Store", "StoreError", "load_recording", "load_scene", "load_tracks", "load_trial", "read_manifest", "read_rows"]

MANIFEST, LOG, PARTS, RECORDINGS = "manifest.json", "log.jsonl", "parts", "recordings"
TABLES = ("trials", "world", "timings", "failures")
_OWN = (MANIFEST, LOG, PARTS, RECORDINGS, "report.html", *(f"{name}.parquet" for name in TABLES))


class Store:
    """An output folder open for writing; one process at a time. Close it, or use it as a context manager.

    StoreError, in a sentence that says what is kept, wherever the disk refuses.
    """

    def __init__(self, folder: Path, manifest: dict[str, Any], *, resume: bool = False, force: bool = False) -> None:
        self.folder, self.manifest = Path(folder), manifest
        self._log: IO[str] | None = None
        with self._disk("start a run in"):
            if self.folder.exists() and not self.folder.is_dir():
                raise StoreError(f"{self.folder} is a file: choose another folder for the results")
            old = _found(self.folder)
            if old is not None and not (resume or force):
                raise StoreError(
                    f"{self.folder} holds results already: continue them with --resume, replace them with --force, or use another folder"
                )
            if old is None and _occupied(self.folder):
                raise StoreError(f"{self.folder} is not empty and holds no run: choose another folder for the results")
            if old is not None and resume:
                self._check_same(old)
                manifest["written_by"] = {**old.get("written_by", {}), **manifest.get("written_by", {})}
            self.folder.mkdir(parents=True, exist_ok=True)
            self._log = self._locked()
            if force and not resume:
                _remove(self.folder)
                self._log = self._locked()
            (self.folder / PARTS).mkdir(exist_ok=True)
            _sweep_rough(self.folder)
            self._parts = Parts(
                self.folder / PARTS, lambda name, error: self.log("damaged part", part=name, error=error, then="runs again")
            )
            if old is not None and resume:
                _realign(self.folder / RECORDINGS, old.get("points", []), manifest["points"])
            for name in TABLES:  # of fewer trials, perhaps: they are put together again at the end
                (self.folder / f"{name}.parquet").unlink(missing_ok=True)
            self._describe()

    def _describe(self) -> None:
        _write(self.folder / MANIFEST, (json.dumps(self.manifest, indent=1, allow_nan=False) + "\n").encode())

    def of_trials(self, trials: int) -> None:
        """Say in the manifest how many trials the run has, where that is found on the way."""
        if self.manifest["trials"] != trials:
            self.manifest["trials"] = trials
            with self._disk("write to"):
                self._describe()

    def _check_same(self, old: dict[str, Any]) -> None:
        try:
            why = refused(old, self.manifest)
        except (KeyError, TypeError, AttributeError):
            why = f"its {MANIFEST} is damaged"
        if why:
            raise StoreError(f"{self.folder} can't be continued: {why}")

    def _locked(self) -> IO[str]:
        """The log, opened to append, and locked: a second run in the same folder is refused. The lock ends with the process."""
        if self._log is not None:
            self._log.close()
        file = (self.folder / LOG).open("a", encoding="utf-8")
        try:
            import fcntl
        except ImportError:  # no such locks on this system
            return file
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise StoreError(f"another run is writing to {self.folder} at this moment") from None
        return file

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the folder."""
        if self._log is not None:
            self._log.close()
            self._log = None

    def log(self, event: str, **what: Any) -> None:
        """A line of log.jsonl."""
        if self._log is None:
            raise ValueError("the store is closed")
        with self._disk("write to the log of"):
            line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event, **what}
            self._log.write(json.dumps(line, default=str) + "\n")
            self._log.flush()

    # ------------------------------------------------------------ parts

    def put(self, results: Sequence[BlockResult], keys: Keys, ran: Sequence[str]) -> None:
        """Keep blocks of one point that were made together, of the estimators `ran`."""
        with self._disk("write to"):
            self._parts.put(results, keys, ran, _write)

    def find(self, point: int, trials: Sequence[int], keys: Keys) -> Found:
        """What there is of a block under its present keys; a damaged file is told in the log, and as good as absent."""
        with self._disk("read"):
            return self._parts.find(point, trials, keys)

    def drop(self, recordings: Iterable[Path]) -> None:
        """Delete recordings."""
        with self._disk("delete a recording in"):
            for place in recordings:
                shutil.rmtree(place)

    # ------------------------------------------------------------ tables

    def merge(self, blocks: Iterable[tuple[int, Sequence[int]]], keys: Sequence[Keys]) -> BlockResult:
        """Put the tables together from the parts of all `blocks` (point, trials), and return what they hold. keys : by point.

        StoreError where a part is missing.
        """
        found = []
        for point, trials in sorted(blocks):
            part = self.find(point, trials, keys[point])
            if part.result is None or part.lacking:
                which = f"point {point}, trials {trials[0]} to {trials[-1]}"
                raise StoreError(f"the results of {which} are missing in {self.folder / PARTS}: --resume makes them")
            found.append(part.result)
        whole = joined(found)
        with self._disk("write to"):
            for name, rows in zip(TABLES, (whole.rows, whole.world, whole.timings, _failure_rows(whole.failures)), strict=True):
                _write(self.folder / f"{name}.parquet", parquet(rows))
        return whole

    def free_bytes(self) -> int:
        """Room left on the disk."""
        return shutil.disk_usage(self.folder).free

    def _disk(self, doing: str) -> _Disk:
        return _Disk(self.folder, doing)


class _Disk:
    """Turns what the system says of a disk into one sentence."""

    def __init__(self, folder: Path, doing: str) -> None:
        self._folder, self._doing = folder, doing

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, OSError):
            return
        reason = (error.strerror or str(error)).lower()
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = "the disk is full; what was finished is kept: free some space, then continue with --resume"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            reason = f"it can't be written ({reason}): choose another folder with --out"
        raise StoreError(f"can't {self._doing} {self._folder}: {reason}") from error


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run. StoreError where there is none."""
    manifest = _found(Path(folder))
    if manifest is None:
        raise StoreError(f"{folder} holds no run: there is no {MANIFEST}")
    return manifest


def read_rows(folder: Path, table: str = "trials") -> dict[str, Array]:
    """One of a run's tables ("trials", "world", "timings", "failures"), by column. StoreError where it is missing or damaged."""
    path = Path(folder) / f"{table}.parquet"
    try:
        return tables.unframe(tables.read_table(path))
    except FileNotFoundError:
        raise StoreError(f"there is no {path}: the run is not finished, --resume finishes it") from None
    except tables.NotColumnar as error:
        raise StoreError(str(error)) from error


# ---------------------------------------------------------------- the folder


def _found(folder: Path) -> dict[str, Any] | None:
    """The manifest in a folder, None where there is none; one that is damaged counts as an empty one."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError:
        return {}
    return manifest if isinstance(manifest, dict) else {}


def _is_rough(path: Path) -> bool:
    return path.name.startswith(".") and path.name.endswith(".part")


def _occupied(folder: Path) -> bool:
    """Whether a folder without a manifest holds anything that a run, killed before it wrote one, would not have left."""
    return folder.is_dir() and any(not _is_rough(p) and p.name not in (PARTS, LOG) for p in folder.iterdir())


def _remove(folder: Path) -> None:
    """Delete what runs write, and nothing else."""
    for name in _OWN:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _sweep_rough(folder: Path) -> None:
    """Delete files and recordings that were under way when a run was killed."""
    for path in [*folder.rglob(".*.part")]:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: aside, flushed to the disk, then renamed over what was there."""
    rough = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with rough.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        rough.replace(path)
    except OSError:
        rough.unlink(missing_ok=True)
        raise
    if os.name == "posix":  # the rename itself must reach the disk as well
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _realign(recordings: Path, old: Sequence[dict[str, Any]], new: Sequence[dict[str, Any]]) -> None:
    """Let recordings follow their points where a sweep has grown or shrunk, by what each point sets; those of points that went, go."""
    places = {json.dumps(point["set"], sort_keys=True): point["index"] for point in new}
    moves = {point["index"]: places.get(json.dumps(point["set"], sort_keys=True)) for point in old}
    if all(a == b for a, b in moves.items()):
        return
    aside = {a: recordings / f".point-{a:04d}.moved.part" for a in moves}
    for a, path in aside.items():
        if (recordings / f"point-{a:04d}").is_dir():
            (recordings / f"point-{a:04d}").rename(path)
    for a, b in moves.items():
        if b is None:
            shutil.rmtree(aside[a], ignore_errors=True)
        elif aside[a].is_dir():
            aside[a].rename(recordings / f"point-{b:04d}")


def _failure_rows(failures: Sequence[Failure]) -> Rows:
    names = [f.name for f in fields(Failure)]
    columns = {name: np.array([getattr(f, name) for f in failures]) for name in names}
    if not failures:
        return {name: np.empty(0, dtype=np.int64 if name in ("point", "trial") else np.str_) for name in names}
    return columns
