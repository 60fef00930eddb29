"""Who went in and out, as announced, against what the trolleys did: a figure an event."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.gates import Gates, gates_of
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Degrees, Metres, Seconds
from testbed.recording import Trial
from testbed.types import Decisions, Track

EVENTS = ("in", "out", "pass", "uturn", "stat")  # what a tag did
ANSWERS = ("in", "out", "several", "pass", "uturn", "none")  # what was announced of it
STEP = 0.05  # s, at which the truth is looked at
STIRRED = 0.3  # m: a tag that never was farther from where it began has stood


class GateEventsConfig(BaseConfig):
    """inward_deg and opening_m as the detector has them; a tag that stands is judged in windows of window_s each."""

    inward_deg: Degrees = 0.0
    opening_m: Annotated[Metres, Field(gt=0, le=20)] = 2.8
    window_s: Annotated[Seconds, Field(gt=0, le=3600)] = 4.0


class GateEvents:
    """Each tag that moves in a trial is one event, IN, OUT, PASS or UTURN; one that stands is a STAT event in each whole window.

    IN and OUT are by the side of its gate's plane on which it begins and ends; without such a change it is a UTURN if it ends nearer to its
    beginning than half its way is long, else a PASS. An event is answered by what was announced of its tag: one "in" or "out", or, of more
    than one, "several"; else the last "pass" or "uturn"; else "none". Hints ("in?") don't count. What is announced of a standing tag
    after its last whole window is left out.
    """

    on_request: ClassVar[bool] = True  # says nothing without gates: scenarios name it
    Config = GateEventsConfig

    columns: ClassVar[dict[str, str]] = {
        "gate.in_recall": "share of IN events announced as in, once",
        "gate.out_recall": "share of OUT events announced as out, once",
        "gate.in_precision": "share of what was announced as in that was, at the run's own prevalence",
        "gate.out_precision": "share of what was announced as out that was, at the run's own prevalence",
        "gate.swapped": "share of IN and OUT events announced as the other",
        "gate.moved_by_others": "share of PASS and UTURN events announced as in or out",
        "gate.latency_s": "from the crossing of the plane to its announcement, where that is right, s",
        "gate.false_windows": "share of a standing tag's windows with an in or out announced",
        "gate.false_moves_per_h": "in and out announced of standing tags, in an hour of one tag",
        "gate.windows": "events of a row: 1 for a tag that moves, else its windows",
        "gate.parked_h": "how long a standing tag was watched, h",
        "gate.said_in": "how often in was announced of a row",
        "gate.said_out": "how often out was announced of a row",
        **{f"gate_answers.{e}_{a}": f"share of {e.upper()} events answered by {a}" for e in EVENTS for a in ANSWERS},
    }

    def __init__(self, config: GateEventsConfig) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,): NaN where a row has no such event."""
        c = self._config
        rows = len(track.target)
        found = {name: np.full(rows, np.nan) for name in self.columns}
        events = true_events(track, trial, c.inward_deg, c.opening_m)
        for b, (event, crossing) in enumerate(events):
            own = track.decisions.take(track.decisions.row == b)
            if event == "stat":
                self._stands(found, b, own, trial.recording.duration)
            else:
                self._moves(found, b, event, crossing, own)
        return found

    def _moves(self, found: dict[str, Array], b: int, event: str, crossing: float, own: Decisions) -> None:
        answer = answered(own.what)
        _share(found, b, event, np.array([answer]))
        said = {what: int((own.what == what).sum()) for what in ("in", "out")}
        found["gate.windows"][b] = 1.0
        _precisions(found, b, said, event if event == answer else "")
        if event in ("in", "out"):
            found[f"gate.{event}_recall"][b] = answer == event
            found["gate.swapped"][b] = answer in ("in", "out") and answer != event
            if answer == event:
                found["gate.latency_s"][b] = own.t[own.what == event][0] - crossing
        else:
            found["gate.moved_by_others"][b] = any(said.values())

    def _stands(self, found: dict[str, Array], b: int, own: Decisions, duration: float) -> None:
        windows = int(duration / self._config.window_s + 1e-9)
        if not windows:
            return
        own = own.take(own.t < windows * self._config.window_s)
        place = (own.t / self._config.window_s).astype(np.int64)
        answers = np.array([answered(own.what[place == k]) for k in range(windows)])
        _share(found, b, "stat", answers)
        said = {what: int((own.what == what).sum()) for what in ("in", "out")}
        found["gate.windows"][b] = windows
        found["gate.false_windows"][b] = np.isin(answers, ("in", "out", "several")).mean()
        found["gate.parked_h"][b] = windows * self._config.window_s / 3600
        found["gate.false_moves_per_h"][b] = sum(said.values()) / found["gate.parked_h"][b]
        _precisions(found, b, said, "")


def answered(what: Array) -> str:
    """One of `ANSWERS`, from what was announced, in order."""
    moves = [str(w) for w in what if w in ("in", "out")]
    if moves:
        return moves[0] if len(moves) == 1 else "several"
    others = [str(w) for w in what if w in ("pass", "uturn")]
    return others[-1] if others else "none"


def true_events(track: Track, trial: Trial, inward_deg: float, opening_m: float) -> list[tuple[str, float]]:
    """(B,) what each row's tag did in the trial, one of `EVENTS`, and when it crossed the plane of its gate for good, s (NaN if never).

    Its gate is the one that it comes nearest to. A plane is crossed where the gate is open, within opening_m / 2 of its middle.
    """
    gates = gates_of(trial.recording.site.antennas, inward_deg)
    order = {str(name): i for i, name in enumerate(trial.recording.targets.name)}
    t = np.arange(0.0, trial.recording.duration + STEP / 2, STEP)
    states = trial.target_states(t)
    return [_event(gates, t, states[:, order[str(name)], :2], opening_m) for name in track.target]


def _event(gates: Gates, t: Array, way: Array, opening: float) -> tuple[str, float]:
    if not len(gates.name) or np.hypot(*(way - way[0]).T).max() < STIRRED:
        return "stat", np.nan
    nearest = np.array([np.hypot(*(way - origin).T).min() for origin in gates.origin])
    x, y = gates.local(np.full(len(t), np.argmin(nearest)), way).T
    through = np.flatnonzero((np.sign(x[1:]) != np.sign(x[:-1])) & (np.abs(y[1:]) <= opening / 2))
    if len(through) and np.sign(x[0]) != np.sign(x[-1]):
        k = through[-1]
        return "in" if x[-1] > 0 else "out", float(t[k] + STEP * x[k] / (x[k] - x[k + 1]))
    length = np.hypot(*np.diff(way, axis=0).T).sum()
    return "uturn" if np.hypot(*(way[-1] - way[0])) < length / 2 else "pass", np.nan


def _share(found: dict[str, Array], b: int, event: str, answers: Array) -> None:
    for answer in ANSWERS:
        found[f"gate_answers.{event}_{answer}"][b] = (answers == answer).mean()


def _precisions(found: dict[str, Array], b: int, said: dict[str, int], right: str) -> None:
    """right: the one announcement that is, "" where none is."""
    for what, n in said.items():
        found[f"gate.said_{what}"][b] = n
        if n:
            found[f"gate.{what}_precision"][b] = float(right == what)
