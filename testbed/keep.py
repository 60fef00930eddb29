"""Which trials' recordings to keep, and how much room they will take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.evaluate import Rows, metric_columns, per_trial
from testbed.scenario import Scenario
from testbed.types import POSITION_VELOCITY

DEFAULT = "first:1,failed"
_FORMS = "none, all, failed, first:N, worst:N, or several with commas between them"


@dataclass(frozen=True)
class Keep:
    """Of each point of a sweep: the first trials, the worst, those that failed, or all of them."""

    first: int = 0
    worst: int = 0
    failed: bool = False
    all: bool = False

    @classmethod
    def parse(cls, text: str) -> Keep:
        """From "first:1,failed". ValueError, in a sentence, for anything else than the forms there are."""
        found: dict[str, int | bool] = {}
        words = [word.strip() for word in text.split(",")]
        for word in words:
            name, colon, number = word.partition(":")
            if name in ("first", "worst") and number.isascii() and number.isdecimal() and len(number) < 9:
                found[name] = int(number)
            elif name in ("failed", "all") and not colon:
                found[name] = True
            elif word != "none" or len(words) > 1:
                raise ValueError(f"{word!r} does not say which recordings to keep: {_FORMS}")
        return cls(**found)  # pyright: ignore[reportArgumentType]  the branches above keep numbers and flags apart

    def chosen(self, trials: int) -> range:
        """Trials that are kept whatever comes of them."""
        return range(trials if self.all else min(self.first, trials))

    def worst_of(self, rows: Rows, point: int) -> list[int]:
        """The `worst` trials of a point, worst first: by the mean position error of the scenario's first estimator.

        By its first metric where there is no position error. A trial without a value is not among them.
        """
        if not self.worst or not rows:
            return []
        here = rows["point"] == point
        estimators, columns = rows["estimator"][here], metric_columns(rows)
        if not len(estimators) or not columns:
            return []
        column = "position_error_m.mean" if "position_error_m.mean" in columns else columns[0]
        first = here & (rows["estimator"] == estimators[0])
        trials, values = per_trial(rows["trial"][first], rows[column][first])
        order = [i for i in np.argsort(-values, kind="stable") if not np.isnan(values[i])]
        return [int(trials[i]) for i in order[: self.worst]]


def predict_size(scenario: Scenario, keep: Keep) -> int:
    """About how many bytes the recordings kept will take, from the scenario alone. Failed trials are not counted.

    Truth and tracks are float64 arrays that shrink to about half. Assumed: 200 reads a second and sensor, 20 of them of each
    target, 150 kB for the scene, the site and the heads of 30 small files. Good to a factor of about three.
    """
    trials = scenario.trials
    kept = min(len(keep.chosen(trials)) + (0 if keep.all else keep.worst), trials)
    movers = sum(actor.moves for actor in scenario.actors)
    targets = max(1, sum(len(actor.tags) for actor in scenario.actors if actor.moves) or movers)
    n = len(POSITION_VELOCITY)
    truth = scenario.truth_hz * movers * (7 * 8 + 6) / 2
    track = scenario.report_hz * targets * (n + n * n) * 8 / 2 + 20 * targets * 32
    stream = 200 * 40
    per_second = truth + len(scenario.estimators) * track + len(scenario.sensors) * stream
    return int((150_000 + scenario.duration_s * per_second) * kept * len(scenario.points()))
