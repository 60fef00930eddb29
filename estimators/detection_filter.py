"""The particle filter on detection counts that the `detection_*` methods share: one cloud a row, every block at a time of its own.

A row's cloud is brought to the time of a count only when the count says something; reports carry its mean and covariance on to
their own time, exactly, for the motion is linear.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from estimators.belief import StatusConfig, status_of
from estimators.detection_cloud import FLOOR, Cloud, View
from estimators.detection_model import DetectionModel, DetectionModelConfig
from estimators.detection_reports import Held, Readers, Reports
from testbed.quantity import Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo

SILENT = 1e-3  # how far the probability of silence may be below 1 for it to be no news


class DetectionFilterConfig(DetectionModelConfig, StatusConfig):
    """A particle filter on counts. `silence` says whose silence counts: that of readers with a read in the round, or everybody's.

    acceleration_density_m2ps3: of the white acceleration that a target is believed to have.
    """

    particles: Annotated[int, Field(ge=2, le=1_000_000)] = 200
    acceleration_density_m2ps3: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    silence: Literal["heard", "all"] = "heard"
    coast_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 3.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 30.0


class DetectionFilter:
    """What the methods share; they say at what time a count is taken (`stamp`). State (x, y, vx, vy) at the prior's own height.

    In the mode `silence: heard` a reader that hears nothing in a round counts for nothing (the paper); in the mode `all` silence does.
    """

    Config: ClassVar[type[DetectionFilterConfig]] = DetectionFilterConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"rounds"})

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        self._config, self._rng, self._antennas = config, rng, site.antennas
        self._name = type(self).__name__
        self._readers = Readers(site, self._name)
        self._model = DetectionModel(config)

    def start(self, prior: Prior) -> None:
        if prior.components != POSITION_VELOCITY:
            raise ValueError(f"{self._name}: a prior over position and velocity is wanted, this one is over {', '.join(prior.components)}")
        self._now, self._heard = np.array(prior.t), np.array(prior.t)
        self._prior = prior
        self._cloud = Cloud(prior, self._config.particles, self._config.acceleration_density_m2ps3, self._rng)
        self._view = View(self._antennas, prior.mean[:, 2])
        self._reports = Reports(prior.rows, len(self._antennas), self._name)
        self._held = Held(prior.rows, self._readers)

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def stamp(self, t: Array) -> Array:
        """(E,) s: the time at which counts that are complete at t (E,) are taken."""
        return t

    def update(self, event: Event) -> UpdateInfo:
        used = self._reports.new(event.row, event.data)
        row, data = event.row[used], event.data.take(used)
        read = data.n > 0
        self._heard[row[read]] = data.t[read]
        if self._config.silence == "heard":
            found = self._held.sort(row, data)
        else:
            found = row, data.antenna.astype(np.int64), data.n.astype(np.int64), data.t, data.queries.astype(np.int64)
            news = self._news(*found)
            found = tuple(part[news] for part in found)
        if len(found[0]):
            self._take(*found)
        return UpdateInfo(used)

    def _news(self, row: Array, antenna: Array, n: Array, t: Array, queries: Array) -> Array:
        """(E,) bool: not a silence that no particle finds surprising, wherever it may be by then."""
        distance = self._cloud.nearest(row, self._view, antenna)
        ahead = np.maximum(self.stamp(t) - self._cloud.at[row], 0.0)
        distance = np.maximum(distance - ahead * 20.0, 0.0)  # m/s: faster goes nothing here
        return (n > 0) | (queries * self._model.mean(distance, 0.0) > SILENT)

    def _take(self, row: Array, antenna: Array, n: Array, t: Array, queries: Array) -> None:
        """Counts of one moment a row (their t may differ by the turns of a reader's antennas)."""
        rows, place = np.unique(row, return_inverse=True)
        latest = np.full(len(rows), -np.inf)
        stamped = self.stamp(t)
        np.maximum.at(latest, place, stamped)
        self._cloud.advance(rows, latest)
        lag = stamped - self._cloud.at[row]
        for many in np.unique(queries):
            of = queries == many
            self._cloud.weigh(row[of], antenna[of], n[of], lag[of], self._model.table(int(many)), self._view)

    def estimate(self) -> Estimate:
        floor, spread = self._cloud.moments(self._now)
        mean, covariance = np.zeros((len(floor), 6)), np.zeros((len(floor), 6, 6))
        mean[:, [2, 5]] = self._prior.mean[:, [2, 5]]
        covariance[:, [2, 5], [2, 5]] = self._prior.covariance[:, [2, 5], [2, 5]]
        mean[:, FLOOR] = floor
        covariance[:, FLOOR[:, None], FLOOR] = spread
        return Estimate(POSITION_VELOCITY, mean, covariance, status_of(self._now - self._heard, self._config))

    def particles(self) -> tuple[Array, Array]:
        """Positions (B, M, 3) carried on to the present, and weights (B, M)."""
        position, weight = self._cloud.shown(self._now)
        height = np.broadcast_to(self._view.height[:, None, None], (*weight.shape, 1))
        return np.concatenate([position, height], axis=2), weight
