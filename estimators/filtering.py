"""What the Kalman filters on received power share: beliefs over time, what was heard, and the pieces of a measurement.

A filter is a way to take a measurement (linearised, or through sigma points) and a choice of pieces. Subclasses say which.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from estimators import kalman
from estimators.belief import Belief, Motion, StatusConfig
from estimators.heard import Heard, HeardConfig, Hearing
from estimators.measurements import Linear, MeasureConfig, Piece, Power, enough_antennas, ranges
from estimators.motion import ConstantVelocity, MotionConfig
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel
from testbed.quantity import Metres
from testbed.types import Array, Estimate, Event, Prior, Reads, RowRandom, Site, UpdateInfo


class FilterConfig(RssiConfig, HeardConfig, MeasureConfig, MotionConfig, StatusConfig):
    """What every Kalman filter here can be told.

    `height_std_m`: take heights as well, with this deviation. `smooth`: go back over the recording at its end (Rauch, Tung, Striebel).
    """

    gate: kalman.Gate = 0.999
    height_std_m: Annotated[Metres, Field(gt=0, le=100)] | None = None
    smooth: bool = False


class PowerFilter(ABC):
    """Base of filters over (x, y, z, vx, vy, vz) that take received power, read by read or a snapshot at once.

    ValueError for a site that the configuration can't work with.
    """

    consumes: frozenset[str] = frozenset({"reads"})
    points: ClassVar[int] = 1  # that the state holds, position and velocity each

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        self._config, self._site, method = config, site, self._method()
        self._model = RssiModel(config, site, method)
        self._motion: Motion = ConstantVelocity(config, targets=self.points)
        self._hearing = Hearing(config, site, method)
        self.consumes = self._hearing.consumes | (frozenset() if config.height_std_m is None else {"heights"})
        if config.measure == "distance":
            enough_antennas(config, site, self._hearing.antennas, method)

    @classmethod
    def _method(cls) -> str:
        return cls.__module__.rpartition(".")[2]

    @property
    def smooths(self) -> bool:
        """Whether the track is gone back over at the end."""
        return bool(self._config.smooth)

    def start(self, prior: Prior) -> None:
        self._belief = self._begun(prior)
        self._variance = ReadVariance(self._config, prior.rows, len(self._site.antennas))
        self.predict(prior.t)
        self._warm_up()

    def _begun(self, prior: Prior) -> Belief:
        return Belief(prior, self._motion, self._config, keep=self._config.smooth)

    def _warm_up(self) -> None:
        """Compile the kernels here, not in the first update."""
        none = np.empty(0, dtype=np.int64)
        self._correct(none, [self._levels(self._hearing.of(Event("reads", none, Reads.empty())))])

    def predict(self, t: Array) -> None:
        self._belief.predict(t)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "heights":
            return self._correct(event.row, [self._height(event)])
        heard = self._hearing.of(event)
        info = self._correct(event.row, self._pieces(heard))
        self._belief.heard(event.row, info.used)
        self._took(heard, info.used)
        return info

    def estimate(self) -> Estimate:
        return self._belief.estimate()

    def put(self, rows: Array, mean: Array, covariance: Array) -> None:
        """Replace what some rows believe: for banks of filters that mix."""
        self._belief.mean[rows], self._belief.covariance[rows] = mean, covariance

    def smooth(self, t: Array) -> Sequence[Estimate]:
        """The estimates at the times t (K,), with all that came after them taken into account."""
        return self._belief.smoothed(t)

    def _pieces(self, heard: Heard) -> list[Piece]:
        """The measurement of an event; one piece at least."""
        return [self._levels(heard)]

    def _levels(self, heard: Heard, first: int = 0) -> Piece:
        """What was heard, as power or as distance; `first` is where the tag's position stands in the state."""
        if self._config.measure == "distance":
            return ranges(self._config, self._model, self._site, heard, first)
        m = heard.rssi.shape[1]
        row, t = (np.repeat(a, m) if m != 1 else a for a in (heard.row, heard.t))
        return Power(heard, self._model, self._variance.of(row, heard.antenna.ravel(), t).reshape(heard.rssi.shape), first)

    def _height(self, event: Event) -> Piece:
        """A height as a measurement of the first point's z. It keeps no row from being lost: it says nothing of where on the floor."""
        up = np.zeros((1, self._motion.n))
        up[0, 2] = 1.0
        return Linear(event.data.height[:, None], up, np.full((len(event), 1), self._config.height_std_m**2))

    def _took(self, heard: Heard, used: Array) -> None:
        """Later reads of the same antennas are not quite new evidence."""
        if self._config.correlation_s == 0:
            return
        entry, component = np.nonzero(used[:, None] & np.isfinite(heard.rssi))
        self._variance.took(heard.row[entry], heard.antenna[entry, component], heard.t[entry])

    @abstractmethod
    def _correct(self, row: Array, pieces: Sequence[Piece]) -> UpdateInfo:
        """Take a measurement for the rows (E,), in place."""


def stacked(parts: Sequence[Array]) -> Array:
    """Arrays (E, m_i, ...) as one (E, sum of m_i, ...)."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


def diagonal(variance: Array) -> Array:
    """(E, m, m) from (E, m)."""
    e, m = variance.shape
    if m == 1:
        return variance[:, :, None]
    noise = np.zeros((e, m, m))
    noise[:, np.arange(m), np.arange(m)] = variance
    return noise
