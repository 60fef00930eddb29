"""`testbed export`: the recordings of a run, each in the format asked for."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from testbed.archive import StoreError
from testbed.export.kept import Kept, recordings
from testbed.plugins import suggest

WRITERS = {
    "sllurp": ("reader_logs", "sllurp"),
    "itemtest": ("reader_logs", "itemtest"),
    "tum": ("tum", "write"),
    "epcis": ("epcis_file", "write"),
    "mcap": ("mcap_file", "write"),
    "rerun": ("rerun_file", "write"),
    "parquet": ("parquet", "write"),
}


def writer(kind: str) -> Callable[[Kept, Path], list[Path]]:
    """What writes a format. ValueError, with the nearest name, for one that nobody knows."""
    if kind not in WRITERS:
        raise ValueError(f"nothing is exported to {kind!r}{suggest(kind, list(WRITERS))}")
    module, name = WRITERS[kind]
    return getattr(import_module(f"testbed.export.{module}"), name)


def export(folder: Path, kind: str, out: Path, point: int | None = None, trial: int | None = None) -> list[Path]:
    """Write every kept recording of the run in `folder`, or one of them, into the folder `out`; returns the files.

    StoreError for a run without such a recording and where the disk refuses; ValueError for a format that nobody knows or that can't
    hold what is there; ImportError, saying what to install, for one that needs an extra.
    """
    write = writer(kind)
    found = recordings(folder, point, trial)
    try:
        out.mkdir(parents=True, exist_ok=True)
        return [path for kept in found for path in write(kept, out)]
    except OSError as error:
        raise StoreError(f"can't write to {out}: {error.strerror or error}") from None
