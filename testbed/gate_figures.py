"""The figures of a gate over a whole run: events counted over all trials and tags, with exact limits, and precision at any prevalence.

Precision depends on how many tags stand by for each that moves, which a run chooses and a hall does not. So the chance of each answer
is taken from the run, kind of event by kind, and the prevalence is stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv

from testbed.columns import Array
from testbed.evaluate import CONFIDENCE, Rows
from testbed.metrics.gate_events import ANSWERS, EVENTS

MOVES = ("in", "out", "several")  # answers that say that a tag has moved through


@dataclass(frozen=True)
class Share:
    """Hits of n, and the exact 95 % limits of the chance behind them, each side 2.5 % (Clopper and Pearson 1934); NaN for n = 0.

    Tags of one trial are not quite independent of each other: limits are those of independent events.
    """

    hits: int
    n: int

    @property
    def value(self) -> float:
        return self.hits / self.n if self.n else np.nan

    @property
    def low(self) -> float:
        k, n = self.hits, self.n
        return np.nan if not n else 0.0 if not k else float(betaincinv(k, n - k + 1, (1 - CONFIDENCE) / 2))

    @property
    def high(self) -> float:
        k, n = self.hits, self.n
        return np.nan if not n else 1.0 if k == n else float(betaincinv(k + 1, n - k, (1 + CONFIDENCE) / 2))


@dataclass(frozen=True, eq=False)
class GateFigures:
    """counts (5, 6) of events by `EVENTS` and `ANSWERS`; announced: how often "in" and "out" were; hours of standing tags, moves then.

    latency (n,) s of the announcements that are right, ascending; trials: how many.
    """

    counts: Array
    announced: dict[str, int]
    parked_hours: float
    false_moves: float
    latency: Array
    trials: int

    def events(self, event: str) -> int:
        return int(self.counts[EVENTS.index(event)].sum())

    def share(self, event: str, *answers: str) -> Share:
        """Of the events of a kind, those with one of the answers."""
        row = self.counts[EVENTS.index(event)]
        return Share(int(sum(row[ANSWERS.index(a)] for a in answers)), int(row.sum()))

    def recall(self, move: str) -> Share:
        return self.share(move, move)

    def precision(self, move: str) -> Share:
        """Of all announcements of a move, repeated ones included, those that were right: at the run's own prevalence."""
        return Share(int(self.counts[EVENTS.index(move), ANSWERS.index(move)]), self.announced[move])

    def prevalence(self) -> float:
        """Windows of standing tags for each IN and OUT event of the run."""
        moves = self.events("in") + self.events("out")
        return self.events("stat") / moves if moves else np.nan

    def precision_at(self, move: str, parked: float) -> tuple[float, float]:
        """(as estimated, at worst) precision with `parked` windows of standing tags for each event of the move, and one of each other kind.

        At worst: with recall at its lower limit and each false alarm's chance at its upper one, which is wider than 95 %.
        """
        other = {"in": "out", "out": "in"}[move]
        weights = {other: 1.0, "pass": 1.0, "uturn": 1.0, "stat": parked}
        false = {event: self.share(event, move, "several") for event in weights if self.events(event)}
        found = []
        for chance, alarm in ((self.recall(move).value, "value"), (self.recall(move).low, "high")):
            wrong = sum(weights[event] * getattr(share, alarm) for event, share in false.items())
            found.append(float(chance / (chance + wrong)) if chance + wrong > 0 else np.nan)
        return found[0], found[1]

    @property
    def false_windows(self) -> Share:
        return self.share("stat", *MOVES)

    @property
    def false_moves_per_hour(self) -> float:
        return self.false_moves / self.parked_hours if self.parked_hours else np.nan


def has_gates(rows: Rows) -> bool:
    """Whether the run was scored by `gate_events`."""
    return "gate.windows" in rows


def gate_figures(rows: Rows, point: int, estimator: str) -> GateFigures:
    """The figures of one estimator at one point of the sweep. KeyError without `gate_events` among the metrics."""
    mask = (rows["point"] == point) & (rows["estimator"] == estimator)
    own = {name: np.asarray(rows[name])[mask] for name in rows if name.startswith(("gate", "trial"))}
    windows = np.nan_to_num(own["gate.windows"])
    counts = np.array([[np.nansum(own[f"gate_answers.{e}_{a}"] * windows) for a in ANSWERS] for e in EVENTS])
    standing = ~np.isnan(own["gate.parked_h"])
    false = sum(float(np.nansum(own[f"gate.said_{move}"][standing])) for move in ("in", "out"))
    latency = np.sort(own["gate.latency_s"][~np.isnan(own["gate.latency_s"])])
    announced = {move: int(np.nansum(own[f"gate.said_{move}"])) for move in ("in", "out")}
    hours = float(own["gate.parked_h"][standing].sum())
    return GateFigures(np.rint(counts).astype(np.int64), announced, hours, false, latency, len(np.unique(own["trial"])))
