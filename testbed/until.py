"""Enough trials: run until a figure's confidence interval is as narrow as asked for.

    ukf.position_error_m.mean ± 2%        half the 95 % interval is at most 2 % of the figure
    centroid - ukf.position_error_m.mean ± 0.01    the mean difference, known to 0.01 in the figure's unit; "+-" will do for "±"

After the scenario's own trials (at least 16) one looks; while the interval is too wide, as many trials more are run as its width asks
for, at most as many again as there are, and one looks anew. This is the rule of Y. S. Chow and H. Robbins, "On the asymptotic theory of
fixed-width sequential confidence intervals for the mean", Annals of Mathematical Statistics 36 (1965), with growing steps.

It has a price: one stops at a moment when the spread happens to look small. The interval then covers the truth somewhat less often than
its 95 %: in 93 to 95 of 100 runs for figures that are spread like normal ones, in 89 to 94 for skewed ones that start with 16 trials, the
nearer to 95 the more trials it takes; and an interval relative to the figure itself stops a little early where the figure is low, so
that it comes out low by less than a tenth of the width asked for. `tests/statistics/test_until_coverage.py` measures both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from testbed.evaluate import Interval, Rows, figure_of, plain, split
from testbed.scenario import Claim

FEWEST = 16  # trials before the first look: of fewer the spread itself is hardly known
MOST = 10_000  # trials, unless told otherwise
_FORM = re.compile(r"^\s*(?P<figure>\S.*?)\s*(?:±|\+/?-)\s*(?P<width>[0-9.eE+-]+)\s*(?P<percent>%?)\s*$")


class NotReached(ValueError):
    """A figure that has no interval at all, however many trials there are."""


@dataclass(frozen=True)
class Until:
    """A figure, half the width that its 95 % interval may have, and whether that is a share of the figure."""

    text: str
    claim: Claim
    width: float
    is_relative: bool
    most: int = MOST

    @classmethod
    def parse(cls, text: str, most: int = MOST) -> Until:
        """From "ukf.position_error_m.mean ± 2%". ValueError, in a sentence, for anything of another form."""
        found = _FORM.match(text)
        subject, dot, column = found["figure"].partition(".") if found else ("", "", "")
        try:
            width = float(found["width"]) if found else math.nan
        except ValueError:
            width = math.nan
        if not (found and dot and subject and column and 0 < width < math.inf):
            raise ValueError(f'{text!r} does not say until when: write "ESTIMATOR.METRIC.STATISTIC ± 2%", or ± an amount above 0')
        metric, statistic = split(column.strip())
        claim = Claim(" ".join(subject.split()), metric, statistic, "max", 0.0)
        relative = bool(found["percent"])
        return cls(text.strip(), claim, width / 100 if relative else width, relative, most)

    def first(self, trials: int) -> int:
        """How many trials to begin with."""
        return min(max(trials, FEWEST), self.most)

    def more(self, trials: int, rows: Rows, world: Rows, points: Sequence[int], block: int) -> int:
        """How many trials to have next, in whole blocks; as many as there are where it is enough. NotReached for a figure without value."""
        wanted = max(self._wanted(trials, self.interval(rows, world, point)) for point in points)
        if wanted <= trials:
            return trials
        wanted = min(max(wanted, trials + block), 2 * trials)
        return min(-(-wanted // block) * block, self.most)

    def interval(self, rows: Rows, world: Rows, point: int) -> Interval:
        """The figure at a point. NotReached where it has no interval."""
        interval, note = figure_of(self.claim, rows, world, point)
        if interval.n < 2:
            raise NotReached(f"--until {self.text}: {note or 'of one trial there is no interval'}")
        return interval

    def allowed(self, interval: Interval) -> float:
        """Half the width that the interval may have."""
        return self.width * abs(interval.mean) if self.is_relative else self.width

    def _wanted(self, trials: int, interval: Interval) -> int:
        reach, allowed = (interval.high - interval.low) / 2, self.allowed(interval)
        if reach <= allowed:
            return trials
        return 2 * trials if allowed == 0 else math.ceil(min(trials * (reach / allowed) ** 2, 2 * trials))


@dataclass(frozen=True)
class Stopped:
    """How a run with an `Until` ended: after how many looks, with what width at the widest point, against what was asked for there."""

    until: Until
    trials: int
    looks: int
    reach: float
    allowed: float

    @property
    def is_reached(self) -> bool:
        return self.reach <= self.allowed

    def __str__(self) -> str:
        end = "reached" if self.is_reached else f"NOT reached within {self.until.most} trials"
        note = ", so the 95 % interval covers somewhat less" if self.looks > 1 else ""
        looks = f"{self.looks} look{'s' if self.looks > 1 else ''}{note}"
        return f"until {self.until.text}: {end} with {self.trials} trials: ± {self.reach:.3g}, asked for {self.allowed:.3g} ({looks})"

    def document(self) -> dict[str, Any]:
        """For `testbed run --json`."""
        found = {"text": self.until.text, "reached": self.is_reached, "trials": self.trials, "looks": self.looks}
        return {**found, "half_width": plain(self.reach), "allowed": plain(self.allowed)}


def stopped(until: Until, trials: int, looks: int, rows: Rows, world: Rows, points: Sequence[int]) -> Stopped:
    """How it ended, at the point that is farthest from what was asked for."""
    found = [until.interval(rows, world, point) for point in points]
    worst = max(found, key=lambda i: (i.high - i.low) / (2 * until.allowed(i)) if until.allowed(i) else math.inf)
    return Stopped(until, trials, looks, (worst.high - worst.low) / 2, until.allowed(worst))
