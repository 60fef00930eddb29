"""Does an estimator keep the contract of `testbed.protocols.Estimator`?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from testbed.checks import samples
from testbed.checks.common import ConformanceError, alike, configured, require, same, untouched_globals
from testbed.columns import Array, Table
from testbed.estimate import row_seeds, run
from testbed.events import Batch, Merge
from testbed.feeds import KINDS, feeds
from testbed.lift import over_rows
from testbed.protocols import Estimator
from testbed.recording import Recording
from testbed.rng import RowRandom
from testbed.types import Estimate, Prior, Status, Track, UpdateInfo

REPORT_HZ = 10.0
_MEASURED = ("rssi", "phase", "doppler", "speed", "yaw_rate", "heading", "range")


def check_estimator(cls: type, config: Any = None, *, recordings: Sequence[Recording] | None = None) -> None:
    """Run an estimator class (or a SingleTarget) through what the driver, and whoever compares estimators, relies on.

    `recordings` replace the made-up hall for a method that needs a site of its own kind; a second or two of data is plenty.
    Raises ConformanceError for the first rule that is broken.
    """
    config = configured(cls, config)
    kinds = getattr(cls, "consumes", None)
    require(isinstance(kinds, frozenset) and kinds and kinds <= KINDS, cls.__name__, f"consumes must be a frozenset out of {sorted(KINDS)}")
    require(not getattr(cls, "__abstractmethods__", None), cls.__name__, f"lacks {', '.join(getattr(cls, '__abstractmethods__', ()))}")
    made = list(recordings) if recordings is not None else [samples.recording(t, duration=1.0, reads_hz=10.0) for t in range(2)]
    case = _Case(cls, config, made, samples.prior(made))
    with untouched_globals(cls.__name__):
        for check in _CHECKS:
            check(case)


@dataclass(frozen=True)
class _Case:
    cls: type
    config: Any
    recordings: list[Recording]
    prior: Prior

    def require(self, holds: object, rule: str) -> None:
        require(holds, self.cls.__name__, rule)

    @property
    def seeds(self) -> Array:
        return row_seeds(11, self.recordings, "checked")

    def made(self) -> tuple[Estimator, RowRandom]:
        rng = RowRandom(self.seeds)
        try:
            return over_rows(self.cls)(self.config, self.recordings[0].site, rng), rng
        except ValueError as error:
            raise ConformanceError(f"{self.cls.__name__}: refuses the site that it is checked on ({error}): give recordings") from error

    def started(self) -> Estimator:
        estimator, _ = self.made()
        estimator.start(self.prior)
        return estimator

    def track(self, recordings: list[Recording] | None = None) -> Track:
        return run(recordings or self.recordings, self.cls, self.config, self.prior, self.seeds, report_hz=REPORT_HZ)

    def changed(self, change: Callable[[str, Table], Table]) -> list[Recording]:
        """The recordings with every stream replaced by what `change` makes of it."""
        return [replace(r, streams={kind: change(kind, table) for kind, table in r.streams.items()}) for r in self.recordings]

    def steps(self) -> list[Batch]:
        ticks = np.arange(int(self.recordings[0].duration * REPORT_HZ) + 1) / REPORT_HZ
        return list(Merge(feeds(self.recordings, self.made()[0].consumes, 0.0), ticks, self.prior.t, False).batches())

    def sound(self, track: Track, when: str) -> None:
        """Finite where not LOST, a covariance symmetric and not negative, a status that there is."""
        self.require(np.isin(track.status, list(Status)).all(), f"a status is none of {[s.name for s in Status]} {when}")
        alive = track.status != Status.LOST
        mean, covariance = track.mean[alive], track.covariance[alive]
        self.require(np.isfinite(mean).all() and np.isfinite(covariance).all(), f"an estimate that is not LOST is not finite {when}")
        size = np.abs(covariance).max(axis=(1, 2), initial=0.0, keepdims=True)
        asymmetry = np.abs(covariance - covariance.transpose(0, 2, 1))
        self.require((asymmetry <= 1e-9 * size).all(), f"a covariance is not symmetric {when}")
        smallest = np.linalg.eigvalsh((covariance + covariance.transpose(0, 2, 1)) / 2).min(axis=1, initial=0.0)
        self.require((smallest >= -1e-9 * size[:, 0, 0]).all(), f"a covariance has a negative eigenvalue {when}")


def _advance(estimator: Estimator, present: Array, step: Batch) -> tuple[Array, list[UpdateInfo]]:
    """Take a batch as the driver does: the rows' new present times, and what the updates said."""
    present = present.copy()
    present[step.rows] = np.maximum(present[step.rows], step.t)
    estimator.predict(present)
    return present, [estimator.update(event) for event in step.events]


def _frozen(estimate: Estimate) -> tuple[Array, Array, Array]:
    return estimate.mean.copy(), estimate.covariance.copy(), estimate.status.copy()


def _equal(estimate: Estimate, was: tuple[Array, Array, Array]) -> bool:
    return all(same(a, b) for a, b in zip((estimate.mean, estimate.covariance, estimate.status), was, strict=True))


# ---------------------------------------------------------------- the rules


def _says_what_it_estimates(case: _Case) -> None:
    estimate = case.started().estimate()
    n, rows = len(estimate.components), case.prior.rows
    case.require(estimate.mean.shape == (rows, n), f"names {n} components and estimates {estimate.mean.shape} for {rows} rows")
    case.require(estimate.covariance.shape == (rows, n, n), f"the covariance of {rows} rows of {n} is of shape {estimate.covariance.shape}")
    case.require(len(set(estimate.components)) == n, "names a component twice")


def _estimates_are_sound(case: _Case) -> None:
    track = case.track()
    case.sound(track, "on ordinary data")
    case.require(track.used.sum() > 0, "used not one event of ordinary data")


def _repeats_itself(case: _Case) -> None:
    a, b = case.track(), case.track()
    fields = ("mean", "covariance", "status", "used", "refused", "late")
    case.require(all(same(getattr(a, f), getattr(b, f)) for f in fields), "two runs with one seed differ")
    case.require(a.innovations.equals(b.innovations), "two runs with one seed say different things of their updates")


def _estimate_is_pure(case: _Case) -> None:
    asked, unasked, present = case.started(), case.started(), case.prior.t
    shown: list[tuple[Estimate, tuple[Array, Array, Array]]] = []
    for step in case.steps()[:40]:
        first = asked.estimate()
        shown.append((first, _frozen(first)))
        case.require(_equal(asked.estimate(), shown[-1][1]), "estimate() is not pure: a second call says something else")
        _advance(unasked, present, step)
        present, _ = _advance(asked, present, step)
    case.require(_equal(asked.estimate(), _frozen(unasked.estimate())), "estimate() is not pure: asking changes what is believed later")
    case.require(all(_equal(e, was) for e, was in shown), "an estimate changes after it was given: hand out copies")


def _predict_is_idempotent(case: _Case) -> None:
    once, twice, present = case.started(), case.started(), case.prior.t
    for step in case.steps()[:40]:
        later, _ = _advance(once, present, step)
        present, _ = _advance(twice, present, step)
        twice.predict(later.copy())
        case.require(
            _equal(twice.estimate(), _frozen(once.estimate())), "predict() is not idempotent: a second call for the same time counts"
        )
    moved, before = present.copy(), _frozen(once.estimate())
    moved[::2] += 0.01
    once.predict(moved)
    kept = all(same(a[1::2], b[1::2]) for a, b in zip(_frozen(once.estimate()), before, strict=True))
    case.require(kept, "predict() changes rows whose time stands still")


def _updates_say_what_they_did(case: _Case) -> None:
    estimator, present = case.started(), case.prior.t
    for step in case.steps():
        present, infos = _advance(estimator, present, step)
        for event, info in zip(step.events, infos, strict=True):
            case.require(isinstance(info, UpdateInfo), f"update() returned a {type(info).__name__}, not an UpdateInfo")
            case.require(len(info.used) == len(event), f"update() answered for {len(info.used)} entries of {len(event)}")
            case.require(not (info.nis < 0).any() and (info.dof >= 0).all(), "update() gave a negative NIS or number of degrees of freedom")


def _survives_silence(case: _Case) -> None:
    case.sound(case.track(case.changed(lambda _, table: table.take(slice(0)))), "when nothing is ever heard")


def _survives_duplicates(case: _Case) -> None:
    twice = case.changed(lambda kind, table: table if kind in ("rounds", "counts") else table.take(np.repeat(np.arange(len(table)), 2)))
    case.sound(case.track(twice), "when every entry comes twice")


def _survives_nan(case: _Case) -> None:
    def spoilt(share: float) -> Callable[[str, Table], Table]:
        draws = np.random.default_rng(5)

        def change(kind: str, table: Table) -> Table:
            names = [n for n in _MEASURED if n in table.column_names()]
            return table.with_(**{n: np.where(draws.random(len(table)) < share, np.nan, getattr(table, n)) for n in names})

        return change

    case.sound(case.track(case.changed(spoilt(0.3))), "when some measured values are NaN")
    case.sound(case.track(case.changed(spoilt(1.0))), "when all measured values are NaN")


def _survives_late_events(case: _Case) -> None:
    late = [samples.delayed(r, 0.3) for r in case.recordings]
    track = case.track(late)
    case.sound(track, "when events arrive late and out of order")
    accepts = bool(getattr(over_rows(case.cls), "accepts_late", False))
    case.require(not (accepts and track.late.any()), "accepts late events, and yet some were dropped")


def _rows_are_independent(case: _Case) -> None:
    together, row = case.track(), 0
    for r in case.recordings:
        for target in range(len(r.targets)):
            alone = samples.only(r, target)
            one = run([alone], case.cls, case.config, case.prior.take(np.array([row])), case.seeds[[row]], report_hz=REPORT_HZ)
            for name in ("mean", "covariance", "status"):
                a, b = getattr(one, name)[:, 0], getattr(together, name)[:, row]
                case.require(alike(a, b), f"rows are not independent: {name} of one alone and among others differ by more than 1e-9")
            row += 1


def _forgets(case: _Case) -> None:
    estimator, rng = case.made()
    ends = []
    for _ in range(2):
        estimator.start(case.prior)
        present = case.prior.t
        for step in case.steps()[:40]:
            present, _ = _advance(estimator, present, step)
        ends.append(_frozen(estimator.estimate()))
    if same(rng.uniform(1), RowRandom(case.seeds).uniform(1)):  # it drew nothing; else the second run has, rightly, other numbers
        case.require(all(same(a, b) for a, b in zip(*ends, strict=True)), "start() does not forget: the same data lead elsewhere after it")


_CHECKS: tuple[Callable[[_Case], None], ...] = (
    _says_what_it_estimates,
    _updates_say_what_they_did,
    _estimates_are_sound,
    _repeats_itself,
    _estimate_is_pure,
    _predict_is_idempotent,
    _survives_silence,
    _survives_duplicates,
    _survives_nan,
    _survives_late_events,
    _rows_are_independent,
    _forgets,
)
