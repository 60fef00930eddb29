"""Models fitted to what was measured: each by its name, for `testbed calibrate SOURCE --model NAME`.

A model lives in a module of its own with a function `calibrate(request) -> Calibration`; only the one asked for is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from testbed.plugins import suggest
from testbed.progress import Progress, Silent

if TYPE_CHECKING:
    from rich.console import Console

    from testbed.columns import Table
    from testbed.report.figures import Drawing

MODELS = {"logistic_beta": "testbed.calibrate.logistic_beta", "reader_log": "testbed.calibrate.reader_log"}  # name to module


class CalibrationError(ValueError):
    """What was measured can't be used, or says nothing of the model; the message names the place."""


@dataclass(frozen=True)
class Request:
    """What is to be fitted to: a scenario that makes measurements (a file, or a name that ships), or whatever else the model reads.

    block_s: counts are put together over so long. trials, seed and sets as in `testbed run`. Of a log: site and truth are files,
    ways 1 (a beacon's own transmitter) or 2 (backscatter) in the place of what its kind has, profile the reader that it is of.
    """

    source: str
    trials: int | None = None
    seed: int | None = None
    sets: Sequence[str] = ()
    block_s: float = 1.0
    progress: Progress = field(default_factory=Silent)
    site: str | None = None
    truth: str | None = None
    ways: int | None = None
    profile: str | None = None


class Calibration(Protocol):
    """A fitted model."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        ...

    def show(self, console: Console) -> None:
        """For people."""
        ...

    def measured(self) -> tuple[Table, dict[str, str]]:
        """What it was fitted to, and units by column."""
        ...

    def drawings(self) -> Sequence[Drawing]:
        """Figures of what was measured and of the fit."""
        ...


@runtime_checkable
class Files(Protocol):
    """A calibration that writes files of its own, such as sections of a scenario."""

    def files(self) -> dict[str, str]:
        """Texts by name."""
        ...


def model(name: str) -> Callable[[Request], Calibration]:
    """The function that fits a model. CalibrationError for a name that none has."""
    if name not in MODELS:
        raise CalibrationError(f"no model is named {name!r}{suggest(name, sorted(MODELS))}")
    return import_module(MODELS[name]).calibrate
