"""From recordings to tracks: the driver. It owns time; estimators never see truth, and neither does this module.

Streams merge in the order in which an estimator's computer would take them, after waiting `hold_s` for reports that overtake
each other: the output for time t is there at t + hold_s. Every event whose turn has come by a report time is taken before that
report; what is older than its row's present time (its last event, or the last report) is late: counted, and dropped unless the
estimator accepts late events. With latency in the stream and hold_s = 0, reads around a report time are therefore late: set
hold_s to the latency. Rows are independent, so batched and one by one agree. A method that smooths is asked again at the end
for all report times, and that is its track.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from testbed.columns import Array, Columns
from testbed.events import Batch, Merge
from testbed.feeds import feeds
from testbed.lift import over_rows
from testbed.protocols import AcceptsLate, Decides, Estimator, HasParticles, Smoother
from testbed.recording import Recording
from testbed.rng import Counter, RowRandom, keys_of
from testbed.types import Decisions, Estimate, Event, Innovations, Prior, Site, Track, UpdateInfo


def run(
    recordings: Sequence[Recording],
    method: type,
    config: Any,
    prior: Prior,
    seeds: Array,
    *,
    report_hz: float = 10.0,
    hold_s: float = 0.0,
    particles: int = 0,
) -> Track:
    """The track of every target of every recording, estimated by `method` (an Estimator or SingleTarget class) with its `config`.

    Rows are numbered by recording, then target; `prior` (B rows) and `seeds` ((B,) uint64, see `row_seeds`) are in that order, and so
    is the track. Reports fall at 0, 1/report_hz, ... up to the recordings' duration, which they must share. Recordings of one site
    share an estimator object, others (a survey error of their own) get one each; the numbers don't depend on it.
    Of a method that has particles, `particles` of each row are kept at every report, for drawing.
    ValueError for input that doesn't fit together, and what the method itself says of its site.
    """
    ticks = _checked(recordings, prior, seeds, report_hz, hold_s)
    estimator = over_rows(method)
    first = np.cumsum([0] + [len(r.targets) for r in recordings])
    parts, order = [], []
    for group in _by_site([r.site for r in recordings]):
        rows = np.concatenate([np.arange(first[i], first[i + 1]) for i in group])
        one = estimator(config, recordings[group[0]].site, RowRandom(np.asarray(seeds)[rows]))
        parts.append(_Run(one, [recordings[i] for i in group], prior.take(rows), ticks, hold_s, particles).track())
        order.append(rows)
    return _assembled(parts, np.concatenate(order))


def row_seeds(root: int, recordings: Sequence[Recording], estimator: str) -> Array:
    """(B,) uint64: a seed for each target of each recording, keyed by (root, trial), the estimator's id and the target's name."""
    parts = [Counter(root, r.trial, f"estimators.{estimator}").bits(keys_of(r.targets.name)) for r in recordings]
    return np.concatenate([np.empty(0, dtype=np.uint64), *parts])


def _checked(recordings: Sequence[Recording], prior: Prior, seeds: Array, report_hz: float, hold_s: float) -> Array:
    """The report times; ValueError for what does not fit together."""
    rows = sum(len(r.targets) for r in recordings)
    if not rows:
        raise ValueError("nothing to estimate: there is no target in the recordings")
    if prior.rows != rows or len(seeds) != rows:
        raise ValueError(f"the recordings have {rows} targets, the prior {prior.rows} rows, and there are {len(seeds)} seeds")
    durations = {r.duration for r in recordings}
    if len(durations) > 1:
        raise ValueError(f"recordings of one run must last equally long, these last {min(durations):g} to {max(durations):g} s")
    if not (report_hz > 0 and np.isfinite(report_hz) and hold_s >= 0 and np.isfinite(hold_s)):
        raise ValueError(f"report_hz must be above 0 and hold_s not below it, they are {report_hz:g} and {hold_s:g}")
    return np.arange(int(durations.pop() * report_hz + 1e-6) + 1) / report_hz


class _Run:
    """One estimator object on the recordings of one site."""

    def __init__(
        self, estimator: Estimator, recordings: Sequence[Recording], prior: Prior, ticks: Array, hold: float, particles: int
    ) -> None:
        self._estimator, self._recordings, self._ticks = estimator, recordings, ticks
        self._present, self._prior = np.array(prior.t), prior
        accepts = isinstance(estimator, AcceptsLate) and bool(estimator.accepts_late)
        self._merge = Merge(feeds(recordings, estimator.consumes, hold), ticks, prior.t, accepts)
        self._used, self._refused = np.zeros(prior.rows, dtype=np.int64), np.zeros(prior.rows, dtype=np.int64)
        self._seconds = np.zeros(prior.rows)
        self._kept = particles if isinstance(estimator, HasParticles) else 0
        self._innovations: list[Innovations] = []
        self._reported = 0

    def track(self) -> Track:
        self._estimator.start(self._prior)
        for batch in self._merge.batches():
            self._report(until=batch.tick)
            self._take(batch)
        self._report(until=len(self._ticks))
        if isinstance(self._estimator, Smoother) and self._estimator.smooths:
            self._look_back(self._estimator)
        return self._stacked()

    def _look_back(self, smoother: Smoother) -> None:
        """Replace what was said on the way by what is believed of it in the end."""
        begun = perf_counter()
        found = smoother.smooth(self._ticks)
        self._seconds += (perf_counter() - begun) / len(self._seconds)
        if len(found) != len(self._ticks):
            raise ValueError(f"{type(smoother).__name__} gave {len(found)} smoothed estimates for {len(self._ticks)} report times")
        for k, estimate in enumerate(found):
            self._mean[k], self._covariance[k], self._status[k] = estimate.mean, estimate.covariance, estimate.status

    def _report(self, until: int) -> None:
        for tick in self._ticks[self._reported : until]:
            # a new array each time: the estimator may keep the one it was given
            self._present = np.maximum(self._present, tick)
            begun = perf_counter()
            self._estimator.predict(self._present)
            self._seconds += (perf_counter() - begun) / len(self._seconds)
            self._keep(self._estimator.estimate())

    def _keep(self, estimate: Estimate) -> None:
        if not self._reported:
            shape, n = (len(self._ticks), len(self._present)), len(estimate.components)
            self._components = estimate.components
            self._particles = np.zeros((*shape, self._kept, 3), dtype=np.float32)
            self._mean, self._covariance, self._status = np.empty((*shape, n)), np.empty((*shape, n, n)), np.empty(shape, dtype=np.int8)
        # copied: an estimator may show its own arrays, and change them afterwards
        k = self._reported
        self._mean[k], self._covariance[k], self._status[k] = estimate.mean, estimate.covariance, estimate.status
        if self._kept and isinstance(self._estimator, HasParticles):
            self._particles[k] = thinned(*self._estimator.particles(), self._kept)
        self._reported += 1

    def _take(self, batch: Batch) -> None:
        present = self._present.copy()
        present[batch.rows] = np.maximum(present[batch.rows], batch.t)
        self._present = present
        begun = perf_counter()
        self._estimator.predict(present)
        infos = [self._estimator.update(event) for event in batch.events]
        self._seconds[batch.rows] += (perf_counter() - begun) / len(batch.rows)
        for event, info in zip(batch.events, infos, strict=True):
            self._note(event, info)

    def _note(self, event: Event, info: UpdateInfo) -> None:
        if len(info.used) != len(event):
            raise ValueError(f"{type(self._estimator).__name__} answered an update of {len(event)} entries for {len(info.used)}")
        self._used[event.row] += info.used
        self._refused[event.row] += ~info.used
        said = (info.dof > 0) & np.isfinite(info.nis)
        if said.any():
            t = event.data.t[said]
            self._innovations.append(Innovations(event.row[said], t, info.nis[said], info.dof[said], info.log_likelihood[said]))

    def _stacked(self) -> Track:
        innovations = Innovations.concatenate(self._innovations)
        return Track(
            t=self._ticks,
            mean=self._mean,
            covariance=self._covariance,
            status=self._status,
            trial=np.repeat([r.trial for r in self._recordings], [len(r.targets) for r in self._recordings]),
            target=np.concatenate([r.targets.name for r in self._recordings]),
            used=self._used,
            refused=self._refused,
            late=self._merge.late,
            update_seconds=self._seconds,
            particles=self._particles,
            components=self._components,
            innovations=innovations.take(np.argsort(innovations.row, kind="stable")),
            decisions=self._decisions(),
        )

    def _decisions(self) -> Decisions:
        said = self._estimator.decisions() if isinstance(self._estimator, Decides) else []
        if not said:
            return Decisions.empty()
        row, t, what, probability = (np.array(column) for column in zip(*said, strict=True))
        found = Decisions(row, t, what, probability)
        return found.take(np.lexsort((found.t, found.row)))


def thinned(position: Array, weight: Array, n: int) -> Array:
    """(B, n, 3): n equally weighted samples of particles at `position` (B, N, 3) with `weight` (B, N), by systematic resampling.

    Without a random number: the points of the resampling comb are (i + 1/2)/n.
    """
    total = np.cumsum(weight, axis=1)
    comb = (np.arange(n) + 0.5) / n
    rows = np.arange(len(position))
    place = np.stack([np.searchsorted(total[b] / total[b, -1], comb) for b in rows]) if len(rows) else np.empty((0, n), dtype=np.int64)
    return position[rows[:, None], np.minimum(place, weight.shape[1] - 1)]


def _by_site(sites: list[Site]) -> list[list[int]]:
    """Indices of recordings, those of one and the same site together."""
    groups: list[list[int]] = []
    for i, site in enumerate(sites):
        home = next((g for g in groups if same_site(sites[g[0]], site)), None)
        if home is None:
            groups.append([i])
        else:
            home.append(i)
    return groups


def same_site(a: Site, b: Site) -> bool:
    """Whether an installer would say the same of both, to the last bit."""
    return a is b or all(_same(getattr(a, name), getattr(b, name)) for name in vars(a))


def _same(a: Any, b: Any) -> bool:
    if a is None or b is None:
        return a is b
    if isinstance(a, Columns):
        return all(_same(getattr(a, name), getattr(b, name)) for name in vars(a))
    a = np.asarray(a)
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")  # NaN stands for what nobody has said: nor has he of the other


def _assembled(parts: list[Track], rows: Array) -> Track:
    """One track from those of several sites, part after part holding the given rows."""
    if len(parts) == 1:
        return parts[0]
    axis0 = {n: np.concatenate([getattr(p, n) for p in parts]) for n in ("trial", "target", "used", "refused", "late", "update_seconds")}
    axis1 = {n: np.concatenate([getattr(p, n) for p in parts], axis=1) for n in ("mean", "covariance", "status", "particles")}
    before = np.cumsum([0] + [len(p.trial) for p in parts])
    innovations = [p.innovations.with_(row=p.innovations.row + n) for p, n in zip(parts, before[:-1], strict=True)]
    decisions = [p.decisions.with_(row=p.decisions.row + n) for p, n in zip(parts, before[:-1], strict=True)]
    beside = {"innovations": Innovations.concatenate(innovations), "decisions": Decisions.concatenate(decisions)}
    whole = parts[0].with_(**axis0, **axis1, **beside)
    return _reordered(whole, np.argsort(rows))


def _reordered(track: Track, order: Array) -> Track:
    """The track with its rows as `order` lists them."""
    if (order == np.arange(len(order))).all():
        return track
    place = np.argsort(order)
    beside = {}
    for name in ("innovations", "decisions"):
        table = getattr(track, name)
        renamed = table.with_(row=place[table.row].astype(np.int32))
        beside[name] = renamed.take(np.argsort(renamed.row, kind="stable"))
    axis0 = {n: getattr(track, n)[order] for n in ("trial", "target", "used", "refused", "late", "update_seconds")}
    axis1 = {n: getattr(track, n)[:, order] for n in ("mean", "covariance", "status", "particles")}
    return track.with_(**axis0, **axis1, **beside)
