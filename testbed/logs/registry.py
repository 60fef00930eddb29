"""The formats by name: one file each in `formats/`, with a class that is named like the file."""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from typing import Protocol

from testbed.logs.bad import LogError
from testbed.logs.contents import Contents, Job
from testbed.plugins import suggest


class Format(Protocol):
    """A way to write a log. `says` is one line for people: who writes it, what its rows are."""

    says: str

    def read(self, job: Job) -> Contents:
        """All that the file holds. LogError where it can't be read under its declaration; bad rows go to `job.bad`."""
        ...


def kinds() -> list[str]:
    """Names of the formats, sorted."""
    return sorted(path.stem for path in (Path(__file__).parent / "formats").glob("*.py") if not path.stem.startswith("_"))


@cache
def format_of(kind: str) -> Format:
    """The format of a name. LogError, with the nearest name, for one that nobody knows."""
    if kind not in kinds():
        raise LogError(f"log.kind: no format is called {kind!r}{suggest(kind, kinds())}")
    module = importlib.import_module(f"testbed.logs.formats.{kind}")
    return getattr(module, kind.title().replace("_", ""))()
