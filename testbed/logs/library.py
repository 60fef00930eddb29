"""Logs where they lie: found by a path relative to the present folder or to the project, read once, cut into pieces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np

from testbed.columns import Array, Table
from testbed.logs.bad import LogMissing
from testbed.logs.contents import Path3
from testbed.logs.read import Log, read_log
from testbed.logs.site import SiteModel
from testbed.logs.truth import ONE, read_truth
from testbed.progress import Progress


@dataclass(frozen=True)
class Piece:
    """A stretch of a log with the true paths by target over it, all times from its begin."""

    name: str
    log: Log
    truth: dict[str, Path3]


def located(path: str) -> Path:
    """The file of a path: from the present folder, or else from the project's. LogMissing where neither has it."""
    project = Path(str(resources.files("scenarios"))).parent
    try:
        found = next((place for place in (Path(path), project / path) if place.is_file()), None)
    except (OSError, ValueError):
        found = None
    if found is None:
        raise LogMissing(f"the data {path[:300]} are not on this machine")
    return found


def read_cached(path: Path, site: SiteModel, progress: Progress | None = None) -> Log:
    """`read_log`, remembering the last few: replaying looks at a log before it is run, and each trial wants it again."""
    stat = path.stat()
    key = (str(path), stat.st_mtime_ns, stat.st_size, site.model_dump_json())
    found = _Remembered.logs.get(key)
    if found is None:
        found = read_log(path, site, progress)
        while len(_Remembered.logs) >= _Remembered.most:
            _Remembered.logs.pop(next(iter(_Remembered.logs)))
        _Remembered.logs[key] = found
    return found


class _Remembered:
    most = 16
    logs: dict[tuple[str, int, int, str], Log] = {}  # noqa: RUF012


@lru_cache(maxsize=64)
def _truth(path: Path, stamp: int, how: str, start_s: float) -> dict[str, Path3]:
    del stamp
    return read_truth(path, type(SiteModel.model_fields["truth"].default).model_validate_json(how), start_s)[0]


def pieces(path: str, truth: str | None, site: SiteModel, parts: int = 1, progress: Progress | None = None) -> list[Piece]:
    """A log in `parts` pieces of equal length, with its truth: of the file `truth`, or of the log itself where it holds one."""
    file = located(path)
    log = read_cached(file, site, progress)
    paths = log.truth
    if truth is not None:
        place = located(truth)
        paths = _truth(place, place.stat().st_mtime_ns, site.truth.model_dump_json(), log.start_s)
    length = log.duration / parts
    return [_cut(log, paths, i, parts, length, Path(path).stem) for i in range(parts)]


def _cut(log: Log, truth: dict[str, Path3], i: int, parts: int, length: float, name: str) -> Piece:
    if parts == 1:
        return Piece(name, log, truth)
    begin, end = i * length, (i + 1) * length if i + 1 < parts else np.inf
    streams: dict[str, Table] = {}
    for kind, stream in log.streams.items():
        t = np.asarray(getattr(stream, "t"))  # noqa: B009
        part = stream.take((t >= begin) & (t < end))
        streams[kind] = replace(part, t=part.t - begin, t_arrival=part.t_arrival - begin)  # pyright: ignore
    paths = {target: Path3(path.t - begin, path.position) for target, path in truth.items()}
    last = min(end, log.duration) - begin
    return Piece(f"{name}.{i + 1}", replace(log, streams=streams, duration=last, start_s=log.start_s + begin), paths)


def of_target(truth: dict[str, Path3], target: str, several: bool) -> Path3 | None:
    """The true path of a target: under its name, or the only one there is where there is one target."""
    if target in truth:
        return truth[target]
    return next(iter(truth.values())) if not several and (ONE in truth or len(truth) == 1) else None


def at(path: Path3, t: Array) -> Array:
    """(K, 3) m: the place at times t (K,) s, on straight lines between samples, at rest before the first and after the last."""
    return np.stack([np.interp(t, path.t, axis) for axis in path.position.T], axis=-1)
