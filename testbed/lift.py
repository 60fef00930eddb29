"""A method written for one target, made to work on rows: one object a row, plain numbers to each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache
from types import SimpleNamespace
from typing import Any, ClassVar, cast

import numpy as np

from testbed.columns import Array
from testbed.protocols import Estimator, SingleTarget
from testbed.rng import RowRandom
from testbed.types import POSITION_VELOCITY, Estimate, Event, Prior, Site, Status, UpdateInfo


@cache
def over_rows(method: type) -> type[Estimator]:
    """The class itself if it works on rows already, else the class of an estimator that makes one `method` a row.

    TypeError for a class that is neither an Estimator nor a SingleTarget.
    """
    if issubclass(method, SingleTarget):
        body = {"method": method, "Config": method.Config, "consumes": method.consumes, "__doc__": method.__doc__}
        return cast(type[Estimator], type(f"{method.__name__}OverRows", (_Lifted,), body))
    missing = [name for name in ("consumes", "start", "predict", "update", "estimate") if not hasattr(method, name)]
    if missing:
        raise TypeError(f"{method.__name__} is no estimator: it has no {', '.join(missing)}")
    return cast(type[Estimator], method)


class _Lifted:
    """B objects of a SingleTarget. A row whose numbers are not finite is LOST, whatever it says of itself."""

    method: ClassVar[type[SingleTarget]]
    consumes: frozenset[str]

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        self._config, self._site, self._rng = config, site, rng
        self.consumes = self.method.consumed(config)
        self._make(range(min(1, len(rng.seed))))  # a site that the method can't work with is refused here, not at the start

    def _make(self, rows: Iterable[int]) -> list[SingleTarget]:
        make: Callable[..., SingleTarget] = self.method
        return [make(self._config, self._site, self._rng.generator(row)) for row in rows]

    def start(self, prior: Prior) -> None:
        if prior.components != POSITION_VELOCITY:
            raise ValueError(f"{self.method.__name__} starts from position and velocity, not from {', '.join(prior.components)}")
        self._time = np.array(prior.t)
        self._rows = self._make(range(prior.rows))
        for row, one in enumerate(self._rows):
            one.start(float(prior.t[row]), prior.mean[row].copy(), prior.covariance[row].copy())

    def predict(self, t: Array) -> None:
        for row in np.flatnonzero(t > self._time):
            self._rows[row].predict(float(t[row]))
        self._time = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        names = event.data.column_names()
        entries = zip(*(getattr(event.data, name).tolist() for name in names), strict=True)
        said = [
            self._rows[row].update(event.kind, SimpleNamespace(**dict(zip(names, entry, strict=True))))
            for row, entry in zip(event.row.tolist(), entries, strict=True)
        ]
        used, log_likelihood, nis, dof = zip(*((True, math.nan, math.nan, 0) if s is None else s for s in said), strict=True)
        return UpdateInfo(np.array(used), np.array(log_likelihood), np.array(nis), np.array(dof))

    def estimate(self) -> Estimate:
        components = self.method.components
        mean, covariance = np.empty((len(self._rows), len(components))), np.empty((len(self._rows), len(components), len(components)))
        status = np.empty(len(self._rows), dtype=np.int8)
        for row, one in enumerate(self._rows):
            mean[row], covariance[row], status[row] = one.estimate()
        finite = np.isfinite(mean).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
        return Estimate(components, mean, covariance, np.where(finite, status, Status.LOST))
