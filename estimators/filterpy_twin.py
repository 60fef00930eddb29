"""What the filterpy plug-ins share: one target in plain numbers, one filter object, the same measurements as the batched filters."""

from __future__ import annotations

import math
from abc import abstractmethod
from fnmatch import fnmatchcase
from typing import Any, ClassVar, NamedTuple

import numpy as np

from estimators import kalman
from estimators.belief import status_of
from estimators.filtering import FilterConfig
from estimators.measurements import enough_antennas
from estimators.motion import ConstantVelocity
from estimators.rssi_model import LIMITS_DBM, RssiModel
from testbed.protocols import SingleTarget
from testbed.types import POSITION_VELOCITY, Array, Site, Status


class Level(NamedTuple):
    """One level that was heard: by which antenna, of which tag, in dBm."""

    antenna: int
    tag: int
    rssi: float


class FilterpyTwin(SingleTarget):
    """Base of the plug-ins on filterpy. Left out: smoothing and heights, which are refused."""

    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})
    components: ClassVar[tuple[str, ...]] = POSITION_VELOCITY
    _filter: Any

    def __init__(self, config: FilterConfig, site: Site, rng: np.random.Generator) -> None:
        super().__init__(config, site, rng)
        method = type(self).__module__.rpartition(".")[2]
        if config.smooth or config.height_std_m is not None:
            raise ValueError(f"{method}: there is neither smoothing nor height here; take the estimator without _filterpy")
        self._model, self._motion = RssiModel(config, site, method), ConstantVelocity(config)
        self._antennas = [i for i, id in enumerate(site.antennas.id) if fnmatchcase(str(id), config.antennas)]
        self._tags = {i for i, id in enumerate(site.tags.id) if fnmatchcase(str(id), config.tags)}
        if config.measure == "distance":
            enough_antennas(config, site, np.array(self._antennas), method)

    @classmethod
    def consumed(cls, config: Any) -> frozenset[str]:
        """Snapshots where they are taken together, else reads."""
        return frozenset({"snapshots"}) if config.together else cls.consumes

    def start(self, t: float, mean: Array, covariance: Array) -> None:
        self._filter = self._made()
        self._filter.x, self._filter.P = mean, covariance
        self._time = self._heard = t
        self._last: dict[int, float] = {}

    def predict(self, t: float) -> None:
        self._move(*self._motion.matrices(t - self._time))
        self._time = t

    def update(self, kind: str, data: Any) -> tuple[bool, float, float, int]:
        levels = self._levels(kind, data)
        if not levels:
            return False, math.nan, math.nan, 0
        one, m = self._filter, len(levels)
        z = np.array([self._value(level) for level in levels])
        variance = [self._variance_of(level, data.t) for level in levels]
        x, p = one.x, one.P
        self._take(z, levels, variance)
        nis, log_likelihood = judged(one)
        if nis > kalman.gate_limits(self.config.gate, m)[m] or not np.isfinite(one.P).all():
            one.x, one.P = x, p
            return False, log_likelihood, nis, m
        self._heard = data.t
        self._last.update((level.antenna, data.t) for level in levels)
        return True, log_likelihood, nis, m

    def estimate(self) -> tuple[Array, Array, Status]:
        return self._filter.x, self._filter.P, Status(status_of(np.array(self._time - self._heard), self.config))

    def _levels(self, kind: str, data: Any) -> list[Level]:
        """What of an entry counts; nothing for NaN."""
        if kind == "reads":
            found = [Level(data.antenna, data.tag, data.rssi)]
        else:
            found = [Level(a, tag, row[a]) for tag, row in zip(data.tag, data.rssi, strict=True) if tag >= 0 for a in self._antennas]
        return [
            one for one in found if one.antenna in self._antennas and one.tag in self._tags and LIMITS_DBM[0] <= one.rssi <= LIMITS_DBM[1]
        ]

    @property
    def _in_metres(self) -> bool:
        return self.config.measure == "distance"

    def _value(self, level: Level) -> float:
        """dBm, or the metres that they stand for."""
        if not self._in_metres:
            return level.rssi
        link = self._model.link(level.antenna, level.tag)
        return 10 ** ((link.level - level.rssi) / (10 * self.config.path_loss_exponent))

    def _expected(self, level: Level, x: Array) -> float:
        if self._in_metres:
            return math.dist(x[:3], self._model.link(level.antenna, level.tag).origin)
        return self._model.link(level.antenna, level.tag).expected(x)

    def _gradient(self, level: Level, x: Array) -> tuple[float, float, float]:
        link = self._model.link(level.antenna, level.tag)
        if not self._in_metres:
            return link.gradient(x)
        away = math.dist(x[:3], link.origin)
        gx, gy, gz = ((float(a) - b) / away for a, b in zip(x[:3], link.origin, strict=True))
        return gx, gy, gz

    def _variance_of(self, level: Level, t: float) -> float:
        """dB² or m²: as the batched filters have it for a level heard at t."""
        if self._in_metres:
            return self.config.distance_std_m**2
        tau = self.config.correlation_s
        apart = t - self._last.get(level.antenna, -math.inf)
        return self.config.sigma_db**2 / (math.tanh(max(apart, 1e-4 * tau) / (2 * tau)) if tau else 1.0)

    @abstractmethod
    def _made(self) -> Any:
        """A new filter."""

    @abstractmethod
    def _move(self, transition: Array, noise: Array) -> None:
        """Predict."""

    @abstractmethod
    def _take(self, z: Array, levels: list[Level], variance: list[float]) -> None:
        """Update by a vector of levels."""


def judged(one: Any) -> tuple[float, float]:
    """NIS and log-likelihood of filterpy's last update."""
    y, s = np.ravel(one.y), np.atleast_2d(one.S)
    nis = float(y @ np.linalg.solve(s, y))
    return nis, -0.5 * (nis + float(np.linalg.slogdet(2 * np.pi * s)[1]))
