"""What a scenario expects of its own results: `expect`, read into claims that keep their line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from testbed.plugins import suggest
from testbed.scenario.problems import Loc
from testbed.scenario.source import Review
from testbed.scenario.wording import shown

WORLD = "world"
DIFFERENCE, SHARE = " - ", " > "  # between two estimators' ids
_SIGNS = {"min": ">=", "max": "<="}


@dataclass(frozen=True)
class Claim:
    """One bound on one figure.

    subject is an estimator's id, a paired difference "ekf - ukf", the share of trials in which one's figure is above the other's
    "ekf > ukf", or "world" (the stimulus). statistic is "" for a figure
    that is one number. line is None where the claim is not in the file; point is the one point of the sweep that it speaks of, None
    for all of them.
    """

    subject: str
    metric: str
    statistic: str
    bound: Literal["min", "max"]
    value: float
    line: int | None = field(default=None, compare=False)
    point: int | None = None

    @property
    def column(self) -> str:
        """The metric column it speaks of: "position_error_m.mean", "availability"."""
        return f"{self.metric}.{self.statistic}" if self.statistic else self.metric

    @property
    def estimators(self) -> tuple[str, ...]:
        """Ids of the estimators it compares: none, one, or the two of a difference or of a share."""
        return () if self.subject == WORLD else tuple(named(self.subject))

    @property
    def is_difference(self) -> bool:
        """Whether it is about the mean difference of two estimators, which its confidence limit has to keep."""
        return DIFFERENCE in self.subject

    @property
    def text(self) -> str:
        """The claim in a line: "ukf.position_error_m.mean <= 0.35"."""
        subject = f"({self.subject})" if len(self.estimators) == 2 else self.subject
        return f"{subject}.{self.column} {_SIGNS[self.bound]} {self.value:.12g}"

    def concerns(self, point: int) -> bool:
        """Whether it speaks of the point of the sweep with this index."""
        return self.point is None or self.point == point

    def holds(self, value: float) -> bool:
        """Whether a figure keeps the bound; NaN, a figure that could not be had, never does."""
        return value >= self.value if self.bound == "min" else value <= self.value


def claims(raw: Any, estimators: Sequence[str], columns: Sequence[str] | None, review: Review) -> tuple[Claim, ...]:
    """The claims of an `expect` mapping. `columns` are those of the scenario's metrics, None where that can't be known."""
    found: list[Claim] = []
    for subject, metrics in raw.items() if isinstance(raw, dict) else ():
        loc: Loc = ("expect", subject)
        name = subject_of(subject, estimators, loc, review)
        if not isinstance(metrics, dict) or not metrics:
            review.note(loc, "a mapping of metrics is wanted, as in {position_error_m: {mean: {max: 0.35}}}")
            continue
        for metric, inner in metrics.items():
            here: Loc = (*loc, metric)
            if not isinstance(inner, dict) or not inner:
                review.note(here, "bounds are wanted, as in {max: 0.35}, or {mean: {max: 0.35}}")
                continue
            bounds = {k: v for k, v in inner.items() if k in _SIGNS and not isinstance(v, dict)}
            statistics = {k: v for k, v in inner.items() if k not in bounds}
            if bounds:
                found += _bounds((name, metric, ""), bounds, here, columns, review)
            for statistic, bounds in statistics.items():
                found += _statistic((name, metric, statistic), bounds, (*here, statistic), columns, review)
    return tuple(found)


def subject_of(subject: str, estimators: Sequence[str], loc: Loc, review: Review) -> str:
    """The subject, its spaces made plain; mistakes are put down."""
    if subject == WORLD:
        return subject
    parts, relation = named(subject), SHARE if SHARE in subject else DIFFERENCE
    for part in parts:
        if part not in estimators:
            review.note(loc, f"no estimator has the id {part!r}{suggest(part, list(dict.fromkeys([*estimators, WORLD])))}", at_key=True)
    if len(parts) > 2 or len(set(parts)) < len(parts):
        review.note(loc, 'two estimators are compared, as in "ekf - ukf" or "ekf > ukf"', at_key=True)
    return relation.join(parts)


def named(subject: str) -> list[str]:
    """The estimators that a subject speaks of: one, or two with " - " or " > " between them."""
    return [part.strip() for part in subject.split(SHARE if SHARE in subject else DIFFERENCE)]


def _statistic(named: tuple[str, str, str], bounds: Any, loc: Loc, columns: Sequence[str] | None, review: Review) -> list[Claim]:
    subject, metric, statistic = named
    if subject == WORLD:
        review.note(loc, f"{metric} of the world is one figure: give it min or max, without {statistic}", at_key=True)
    elif not isinstance(bounds, dict) or not bounds:
        own = [of for name, of in map(_split, columns or ()) if name == metric]
        near = suggest(statistic, [*own, *_SIGNS]) if statistic not in own else ""
        review.note(loc, f"bounds are wanted, as in {{max: 0.35}}{near}")
    else:
        return _bounds(named, bounds, loc, columns, review)
    return []


def _bounds(named: tuple[str, str, str], bounds: Mapping[str, Any], loc: Loc, columns: Sequence[str] | None, review: Review) -> list[Claim]:
    subject, metric, statistic = named
    if subject != WORLD and columns is not None:
        known(metric, statistic, columns, loc, review)
    found: list[Claim] = []
    for bound, value in bounds.items():
        here = (*loc, bound)
        if bound not in _SIGNS:
            review.note(here, f"a bound is min or max, not {bound}", at_key=True)
        elif isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            review.note(here, f"a number is wanted, not {shown(value)}")
        else:
            found.append(Claim(subject, metric, statistic, "min" if bound == "min" else "max", float(value), review.source.line(here)))
    limits = {claim.bound: claim.value for claim in found}
    if len(limits) == 2 and limits["min"] > limits["max"]:
        review.note(loc, f"nothing is at least {limits['min']:g} and at most {limits['max']:g}", at_key=True)
    return found


def known(metric: str, statistic: str, columns: Sequence[str], loc: Loc, review: Review) -> None:
    """Put down a figure that no metric of the scenario computes."""
    if (f"{metric}.{statistic}" if statistic else metric) in columns:
        return
    statistics = [of for name, of in map(_split, columns) if name == metric]
    if not statistics:
        place = loc[:3]
        review.note(
            place, f"no metric computes {metric!r}{suggest(metric, sorted({name for name, _ in map(_split, columns)}))}", at_key=True
        )
    elif not statistic:
        review.note(loc, f"{metric} has several statistics: name one of {', '.join(statistics)}", at_key=True)
    elif statistics == [""]:
        review.note(loc, f"{metric} is one figure: give it min or max, without {statistic}", at_key=True)
    else:
        review.note(loc, f"{metric} has no statistic {statistic!r}{suggest(statistic, statistics)}", at_key=True)


def _split(column: str) -> tuple[str, str]:
    """ "position_error_m.mean" -> ("position_error_m", "mean"); a metric of one column has the statistic ""."""
    metric, _, statistic = column.rpartition(".")
    return (metric, statistic) if metric else (column, "")
