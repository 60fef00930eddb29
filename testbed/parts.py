"""Finished blocks on disk, by content: a file holds what one task made, whole or not at all, under the keys that it was made of.

    parts/<trials>.<digest>.zip    blocks.json and three Parquet tables, with checksums

What a block is asked for is put together from all files that fit: the trials' world from one, each estimator's rows from whichever has
them under its present key. Points of a sweep are found by what they are, not by their number, so a sweep may grow in the middle.
Nothing that is replaced is deleted: an earlier state of the code finds its results again.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa

from testbed import tables
from testbed.evaluate import Rows
from testbed.identity import Keys
from testbed.worker import HASH_SHOWN, BlockResult, Failure, joined, stack

UNITS = {"seconds": "s", "seconds_per_update": "s"}
DAMAGED = (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, pa.ArrowException)
_TABLES = ("rows", "world", "timings")


@dataclass(frozen=True)
class Entry:
    """One block in one file: the key of its trials' world, and by id the keys of the estimators whose rows are there."""

    path: Path
    place: int
    world: str
    trials: tuple[int, ...]
    estimators: Mapping[str, str]

    def fits(self, keys: Keys) -> list[str]:
        """The estimators whose rows are what is asked for."""
        return [id for id, key in self.estimators.items() if keys.estimators.get(id) == key] if self.world == keys.world else []


@dataclass(frozen=True)
class Found:
    """What there is of a block. lacking: estimators without rows; result is None where not even the trials' world is there."""

    result: BlockResult | None
    lacking: tuple[str, ...]


class Parts:
    """The files of one folder, and what is in each. OSError as the system raises it; a damaged file is as good as absent."""

    def __init__(self, folder: Path, told: Callable[[str, str], None] | None = None) -> None:
        """told(name, error): called for each damaged file, which is deleted."""
        self._folder, self._told = folder, told or (lambda name, error: None)
        self._entries: dict[tuple[str, tuple[int, ...]], list[Entry]] = {}
        self._open: tuple[Path, list[BlockResult]] | None = None
        for path in sorted(folder.glob("*.zip"), key=lambda p: p.stat().st_mtime_ns):
            try:
                with zipfile.ZipFile(path) as archive:
                    self._list(path, json.loads(archive.read("blocks.json")))
            except DAMAGED as error:
                self._drop(path, error)

    def _list(self, path: Path, blocks: Sequence[Mapping[str, Any]]) -> None:
        for place, block in enumerate(blocks):
            entry = Entry(path, place, block["world"], tuple(block["trials"]), block["estimators"])
            self._entries.setdefault((entry.world, entry.trials), []).append(entry)

    def _drop(self, path: Path, error: Exception) -> None:
        self._told(path.name, str(error))
        path.unlink(missing_ok=True)
        self._forget(path)

    def _forget(self, path: Path) -> None:
        self._entries = {key: [e for e in entries if e.path != path] for key, entries in self._entries.items()}
        self._open = None

    def put(self, results: Sequence[BlockResult], keys: Keys, ran: Sequence[str], write: Callable[[Path, bytes], None]) -> None:
        """Keep blocks of one point that were made together, of the estimators `ran`."""
        blocks = _listed(results, keys, ran)
        content = packed(results, blocks)
        trials = f"{results[0].trials[0]:07d}-{results[-1].trials[-1]:07d}"
        path = self._folder / f"trial-{trials}.{hashlib.sha256(content).hexdigest()[:12]}.zip"
        write(path, content)
        self._list(path, blocks)

    def find(self, point: int, trials: Sequence[int], keys: Keys) -> Found:
        """What there is of a block under the present keys, its rows in the order that a run gives them."""
        order = list(keys.estimators)
        parts: list[tuple[BlockResult, list[str]]] = []
        missing = set(order)
        for entry in reversed(self._entries.get((keys.world, tuple(trials)), [])):
            useful = [id for id in entry.fits(keys) if id in missing]
            if (useful or not parts) and (block := self._read(entry)) is not None:
                parts.append((block, useful))
                missing -= set(useful)
        if not parts:
            return Found(None, tuple(order))
        return Found(_composed(point, parts, keys), tuple(id for id in order if id in missing))

    def _read(self, entry: Entry) -> BlockResult | None:
        if self._open is None or self._open[0] != entry.path:
            try:
                self._open = entry.path, unpacked(entry.path.read_bytes())
            except FileNotFoundError:
                return None
            except DAMAGED as error:
                self._drop(entry.path, error)
                return None
        return self._open[1][entry.place]


def _composed(point: int, parts: Sequence[tuple[BlockResult, list[str]]], keys: Keys) -> BlockResult:
    """One result of several, each with the estimators that are taken from it; the trials' own figures are the first one's."""
    first = parts[0][0]
    rank = {id: i for i, id in enumerate(keys.estimators)}
    here = {"point": point, "scenario": keys.scenario[:HASH_SHOWN]}
    rows = stack([_of(block.rows, useful) for block, useful in parts])
    timings = stack([_of(block.timings, [*useful, ""] if block is first else useful) for block, useful in parts])
    failures = [f for block, useful in parts for f in block.failures if f.estimator in useful or (block is first and not f.estimator)]
    failures.sort(key=lambda f: (f.trial, rank.get(f.estimator, -1)))
    if rows:
        places = np.array([rank[id] for id in rows["estimator"].tolist()])
        rows = {name: column[np.lexsort((places, rows["trial"]))] for name, column in rows.items()}
    return BlockResult(
        point=point,
        trials=first.trials,
        rows=_at(rows, here),
        world=_at(first.world, here),
        timings=_at(timings, here),
        failures=tuple(replace(f, point=point) for f in failures),
        notes=first.notes,
    )


def _of(rows: Rows, estimators: Sequence[str]) -> Rows:
    if not rows or "estimator" not in rows:
        return rows
    mask = np.isin(rows["estimator"], list(estimators))
    return {name: column[mask] for name, column in rows.items()} if mask.any() else {}


def _at(rows: Rows, here: Mapping[str, Any]) -> Rows:
    """The rows with what they are called in the study that they are read for."""
    return {name: np.full(len(column), here[name]) if name in here else column for name, column in rows.items()}


# ---------------------------------------------------------------- a file


def _listed(results: Sequence[BlockResult], keys: Keys, ran: Sequence[str]) -> list[dict[str, Any]]:
    own = {id: keys.estimators[id] for id in ran}
    return [
        {"world": keys.world, "estimators": own, "trials": list(r.trials), "failures": [asdict(f) for f in r.failures], "notes": r.notes}
        for r in results
    ]


def packed(results: Sequence[BlockResult], blocks: Sequence[Mapping[str, Any]]) -> bytes:
    """Blocks of one point and what is listed of them: a zip archive, whose checksums tell a damaged one."""
    whole = joined(results)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("blocks.json", json.dumps(blocks))
        for name in _TABLES:
            archive.writestr(f"{name}.parquet", parquet(getattr(whole, name)))
    return out.getvalue()


def unpacked(content: bytes) -> list[BlockResult]:
    """The blocks of a file. One of `DAMAGED` is raised where it is not whole."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        blocks = json.loads(archive.read("blocks.json"))
        found = {name: tables.unframe(tables.read_table(_reader(archive.read(f"{name}.parquet")))) for name in _TABLES}
    return [_block(block, found) for block in blocks]


def _block(plain: Mapping[str, Any], found: Mapping[str, Rows]) -> BlockResult:
    trials = tuple(plain["trials"])
    own = {}
    for name, rows in found.items():
        mask = np.isin(rows["trial"], trials) if "trial" in rows else np.zeros(0, dtype=bool)
        own[name] = {column: values[mask] for column, values in rows.items()} if mask.any() else {}
    failures = tuple(Failure(**f) for f in plain["failures"])
    return BlockResult(failures[0].point if failures else 0, trials, **own, failures=failures, notes=tuple(plain["notes"]))


def _reader(content: bytes) -> pa.NativeFile:
    return cast(pa.NativeFile, pa.BufferReader(content))


def parquet(rows: Rows) -> bytes:
    """A table as the bytes of a Parquet file."""
    out = pa.BufferOutputStream()
    tables.write_table(tables.frame(rows, units={name: UNITS.get(name, "") for name in rows}), out)
    return out.getvalue().to_pybytes()
