"""How far a run is: a bar with the time left on a terminal, now and then a line elsewhere. On stderr; stdout is for results."""

from __future__ import annotations

import sys
from time import monotonic
from typing import IO, Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress


class Progress(Protocol):
    """What a run tells of itself. `advance` counts trials done and failures since the last call."""

    def start(self, title: str, total: int, done: int) -> None: ...

    def advance(self, trials: int, failures: int) -> None: ...

    def note(self, message: str) -> None: ...

    def finish(self) -> None: ...


class Silent:
    """Says nothing."""

    def start(self, title: str, total: int, done: int) -> None: ...

    def advance(self, trials: int, failures: int) -> None: ...

    def note(self, message: str) -> None: ...

    def finish(self) -> None: ...


class Lines:
    """A line at the start, at about every tenth of the trials but not more often than each `every_s` seconds, and at the end."""

    def __init__(self, stream: IO[str], every_s: float = 5.0, of: str = "trials") -> None:
        self._stream, self._every, self._of = stream, every_s, of

    def start(self, title: str, total: int, done: int) -> None:
        self._title, self._total, self._done, self._before, self._failures = title, total, done, done, 0
        self._begun = self._said = monotonic()
        self._next = done + max(total // 10, 1)
        self.note(f"{title}: {total} {self._of}" + (f", {done} of them there already" if done else ""))

    def advance(self, trials: int, failures: int) -> None:
        self._done += trials
        self._failures += failures
        now = monotonic()
        if self._next <= self._done < self._total and now - self._said >= self._every:
            self._said, self._next = now, self._done + max(self._total // 10, 1)
            pace = (now - self._begun) / max(self._done - self._before, 1)
            self.note(f"{self._title}: {self._count()}, about {_span(pace * (self._total - self._done))} left")

    def note(self, message: str) -> None:
        self._stream.write(message + "\n")
        self._stream.flush()

    def finish(self) -> None:
        self.note(f"{self._title}: {self._count()}, {_span(monotonic() - self._begun)}")

    def _count(self) -> str:
        failed = f", {self._failures} failure{'s' if self._failures > 1 else ''}" if self._failures else ""
        return f"{self._done} of {self._total} {self._of}{failed}"


class Bar:
    """A bar with the trials done, the failures, and the time left."""

    def __init__(self, stream: IO[str]) -> None:
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("[red]{task.fields[failed]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(file=stream),
        )

    def start(self, title: str, total: int, done: int) -> None:
        self._failures = 0
        self._task = self._bar.add_task(title, total=total, completed=done, failed="")
        self._bar.start()

    def advance(self, trials: int, failures: int) -> None:
        self._failures += failures
        self._bar.update(self._task, advance=trials, failed=f"{self._failures} failed" if self._failures else "")

    def note(self, message: str) -> None:
        self._bar.console.print(message, markup=False, highlight=False)

    def finish(self) -> None:
        self._bar.stop()


def choose(stream: IO[str] | None = None, of: str = "trials") -> Progress:
    """A bar where `stream` (stderr unless told otherwise) is a terminal, else lines that count trials, or what `of` says."""
    out: IO[str] = sys.stderr if stream is None else stream
    return Bar(out) if out.isatty() else Lines(out, of=of)


def _span(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes} min {seconds:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
