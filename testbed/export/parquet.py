"""Everything as flat Parquet tables with units: streams, truth, estimates. Names of antennas, tags and targets in place of indices.

`<name>.reads.parquet` is the tidy table that `log: {kind: tidy_parquet}` reads.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from testbed import tables
from testbed.columns import Array, Table
from testbed.export.kept import Kept, lines

NAMED = {"antenna": "antennas", "anchor": "antennas", "tag": "tags"}
OF_TARGET = ("carrier", "target")


def write(kept: Kept, out: Path) -> list[Path]:
    """One file a stream, `<name>.truth.parquet` and `<name>.estimates.parquet`."""
    found = [_stream(kept, kind, stream, out) for kind, stream in kept.recording.streams.items()]
    return [*found, *_truth(kept, out), *_estimates(kept, out)]


def _stream(kept: Kept, kind: str, stream: Table, out: Path) -> Path:
    site, targets = kept.recording.site, kept.recording.targets
    units = {f.name: f.metadata["unit"] for f in stream.__dataclass_fields__.values() if "unit" in f.metadata}
    columns: dict[str, Array] = {}
    for name in stream.column_names():
        values = getattr(stream, name)
        if name in NAMED:
            values = getattr(site, NAMED[name]).id[values]
        elif name in OF_TARGET:
            values = targets.name[values]
        columns[name] = np.asarray(values)
    return _file(out / f"{kept.name}.{kind}.parquet", columns, units)


def _truth(kept: Kept, out: Path) -> list[Path]:
    t = kept.true_times()
    names = ("x", "y", "z", "qw", "qx", "qy", "qz")
    parts = [(str(name), kept.true_poses(i, t)) for i, name in enumerate(kept.recording.targets.name)]
    if not parts:
        return []
    poses = np.concatenate([pose for _, pose in parts])
    columns: dict[str, Array] = {"t": np.tile(t, len(parts)), "target": np.repeat([name for name, _ in parts], len(t))}
    columns |= {name: poses[:, k] for k, name in enumerate(names)}
    return [_file(out / f"{kept.name}.truth.parquet", columns, {"t": "s", "x": "m", "y": "m", "z": "m"})]


def _estimates(kept: Kept, out: Path) -> list[Path]:
    found = list(lines(kept))
    if not found:
        return []
    columns: dict[str, Array] = {
        "t": np.concatenate([line.t for line in found]),
        "estimator": np.repeat([line.estimator for line in found], [len(line.t) for line in found]),
        "target": np.repeat([line.target for line in found], [len(line.t) for line in found]),
    }
    position = np.concatenate([line.position for line in found])
    columns |= {name: position[:, k] for k, name in enumerate("xyz")}
    return [_file(out / f"{kept.name}.estimates.parquet", columns, {"t": "s", "x": "m", "y": "m", "z": "m"})]


def _file(path: Path, columns: dict[str, Array], units: dict[str, str]) -> Path:
    tables.write_table(tables.frame(columns, units), path)
    return path
