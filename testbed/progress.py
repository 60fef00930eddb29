"""How far a run is: a bar with the time left on a terminal, now and then a line elsewhere. On stderr; stdout is for results."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import isnan, nan
from time import monotonic
from typing import IO, Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

Points = Sequence[tuple[str, int, int]]  # of a sweep: what it is called, its trials, how many of them are there already


class Progress(Protocol):
    """What a run tells of itself. `advance` counts trials done and failures since the last call, at one point of the sweep."""

    def start(self, title: str, total: int, done: int, points: Points = ()) -> None: ...

    def advance(self, trials: int, failures: int, point: int = 0) -> None: ...

    def note(self, message: str) -> None: ...

    def finish(self) -> None: ...


class Silent:
    """Says nothing."""

    def start(self, title: str, total: int, done: int, points: Points = ()) -> None: ...

    def advance(self, trials: int, failures: int, point: int = 0) -> None: ...

    def note(self, message: str) -> None: ...

    def finish(self) -> None: ...


class _Count:
    """How far a run is, over all and at each point."""

    def __init__(self, total: int, done: int, points: Points) -> None:
        self.total, self.done, self.before, self.failures = total, done, done, 0
        self._points = [[label, size, there, 0] for label, size, there in points]
        self.begun = monotonic()

    def add(self, trials: int, failures: int, point: int) -> str:
        """Count on; what became of a point that is done with this, in a phrase, "" otherwise."""
        self.done += trials
        self.failures += failures
        if len(self._points) < 2:
            return ""
        here = self._points[point]
        here[2] += trials
        here[3] += failures
        label, size, done, failed = here
        return f"{label}: {size} trials{_failed(failed)}" if trials and done == size else ""

    @property
    def points(self) -> str:
        """How many points are done: "2 of 6 points"; "" without a sweep."""
        done = sum(there == size for _, size, there, _ in self._points)
        return f"{done} of {len(self._points)} points" if len(self._points) > 1 else ""

    def rate(self) -> float:
        """Since the start, a second; NaN before anything is done."""
        spent = monotonic() - self.begun
        return (self.done - self.before) / spent if self.done > self.before and spent > 0 else nan

    def left_s(self) -> float:
        return (self.total - self.done) / self.rate()


class Lines:
    """For logs: a line at the start, at about every tenth of the trials but not more often than each `every_s` seconds, after a minute
    without one, for each point of a sweep, and at the end."""

    def __init__(self, stream: IO[str], every_s: float = 5.0, of: str = "trials", silence_s: float = 60.0) -> None:
        self._stream, self._every, self._of, self._silence = stream, every_s, of, silence_s

    def start(self, title: str, total: int, done: int, points: Points = ()) -> None:
        self._title, self._count = title, _Count(total, done, points)
        self._said = self._count.begun
        self._step = max(total // 10, 1)
        self._next = done + self._step
        where = f" at {len(points)} points" if len(points) > 1 else ""
        self.note(f"{title}: {total} {self._of}{where}" + (f", {done} of them there already" if done else ""))

    def advance(self, trials: int, failures: int, point: int = 0) -> None:
        count = self._count
        ready = count.add(trials, failures, point)
        if ready:
            self.note(f"{self._title}: done {ready}")
        silent = monotonic() - self._said
        if count.done < count.total and ((count.done >= self._next and silent >= self._every) or silent >= self._silence):
            self._said, self._next = monotonic(), count.done + self._step
            self.note(f"{self._title}: {self._state()}, {_per_second(count.rate())}, about {_span(count.left_s())} left")

    def note(self, message: str) -> None:
        self._stream.write(message + "\n")
        self._stream.flush()

    def finish(self) -> None:
        spent = _span(monotonic() - self._count.begun)
        rate = self._count.rate()
        self.note(f"{self._title}: {self._state()}, {spent}{'' if isnan(rate) else ', ' + _per_second(rate)}")

    def _state(self) -> str:
        count = self._count
        points = f", {count.points}" if count.points else ""
        return f"{count.done} of {count.total} {self._of}{points}{_failed(count.failures)}"


class Bar:
    """A bar with the trials done, the failures, the rate, and the time left."""

    def __init__(self, stream: IO[str]) -> None:
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[points]}"),
            TextColumn("[red]{task.fields[failed]}"),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(file=stream),
        )

    def start(self, title: str, total: int, done: int, points: Points = ()) -> None:
        self._count = _Count(total, done, points)
        self._task = self._bar.add_task(title, total=total, completed=done, points=self._count.points, failed="", rate="")
        self._bar.start()

    def advance(self, trials: int, failures: int, point: int = 0) -> None:
        count = self._count
        ready = count.add(trials, failures, point)
        if ready:
            self.note(f"done {ready}")
        failed = f"{count.failures} failed" if count.failures else ""
        self._bar.update(self._task, advance=trials, points=count.points, failed=failed, rate=_per_second(count.rate()))

    def note(self, message: str) -> None:
        self._bar.console.print(message, markup=False, highlight=False)

    def finish(self) -> None:
        self._bar.stop()


def choose(stream: IO[str] | None = None, of: str = "trials") -> Progress:
    """A bar where `stream` (stderr unless told otherwise) is a terminal, else lines that count trials, or what `of` says."""
    out: IO[str] = sys.stderr if stream is None else stream
    return Bar(out) if out.isatty() else Lines(out, of=of)


def _failed(failures: int) -> str:
    return f", {failures} failure{'s' if failures > 1 else ''}" if failures else ""


def _per_second(rate: float) -> str:
    """A rate in the unit that suits it: "12/s", "3.4/min"."""
    if isnan(rate):
        return ""
    return f"{rate:.2g}/s" if 1 <= rate < 100 else f"{rate:.0f}/s" if rate >= 100 else f"{60 * rate:.2g}/min"


def _span(seconds: float) -> str:
    if isnan(seconds):
        return "?"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes} min {seconds:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
