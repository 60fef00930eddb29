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
from estimators.detection_reports import Found, Readers, Reports
from testbed.quantity import Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo

SILENT = 1e-3  # how far the probability of silence may be below 1 for it to be no news
FASTEST = 20.0  # m/s: nothing in a hall goes faster


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
        self._reports = Reports(prior.rows, self._readers, self._name, self._config.silence == "heard")

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def stamp(self, t: Array) -> Array:
        """(E,) s: the time at which counts that are complete at t (E,) are taken."""
        return t

    def update(self, event: Event) -> UpdateInfo:
        used, found = self._reports.sort(event.row, event.data)
        read = np.flatnonzero(event.data.n > 0)
        if len(read):
            self._heard[event.row[read]] = event.data.t[read]
        if self._config.silence == "all" and len(found.row):
            news = self._news(found)
            found = Found(*(part[news] for part in found))
        if len(found.row):
            self._take(found)
        return UpdateInfo(used)

    def _news(self, found: Found) -> Array:
        """(F,) bool: not a silence that no particle finds surprising, wherever it may be by then."""
        distance = self._cloud.nearest(found.row, self._view, found.antenna)
        ahead = np.maximum(self.stamp(found.t) - self._cloud.at[found.row], 0.0)
        distance = np.maximum(distance - ahead * FASTEST, 0.0)
        return (found.n > 0) | (found.queries * self._model.mean(distance, 0.0) > SILENT)

    def _take(self, found: Found) -> None:
        """Counts of one moment a row (their t may differ by the turns of a reader's antennas)."""
        stamped = self.stamp(found.t)
        latest = np.array(self._cloud.at)
        np.maximum.at(latest, found.row, stamped)
        rows = np.flatnonzero(latest > self._cloud.at)
        self._cloud.advance(rows, latest[rows])
        lag = stamped - self._cloud.at[found.row]
        many = found.queries[0]
        if (found.queries == many).all():
            self._cloud.weigh(found.row, found.antenna, found.n, lag, self._model.table(int(many)), self._view)
            return
        for many in np.unique(found.queries):
            of = found.queries == many
            self._cloud.weigh(found.row[of], found.antenna[of], found.n[of], lag[of], self._model.table(int(many)), self._view)

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
