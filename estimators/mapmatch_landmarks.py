"""A vehicle is among the surveyed tags that its own reader hears: no odometer, no compass, the nearest road."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.quantity import Config, Metres, Seconds
from testbed.roads import RoadGraph
from testbed.types import Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo

COMPONENTS = ("x", "y")


class MapmatchLandmarksConfig(Config):
    """spread_m: standard deviation on each axis that is added to the scatter of the tags. Lost after lost_s of silence."""

    memory_s: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0
    spread_m: Annotated[Metres, Field(gt=0, le=100)] = 2.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 10.0


class MapmatchLandmarks:
    """Mean of the places of the reference tags heard within `memory_s`, each tag once, projected on the nearest road.

    What a reader alone can say, to judge a fusion by. It is ahead of the vehicle by as much as the reader looks ahead, because without a
    heading nobody knows where that is; and it stands still in silence. ValueError for a site without roads or reference tags.
    """

    Config = MapmatchLandmarksConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reference_reads"})

    def __init__(self, config: MapmatchLandmarksConfig, site: Site, rng: RowRandom) -> None:
        if site.roads is None:
            raise ValueError("MapmatchLandmarks: the site has no roads to be matched with")
        if not len(site.references):
            raise ValueError("MapmatchLandmarks: the site has no reference tags, whose places it could tell")
        self.config, self._graph = config, RoadGraph(site.roads)
        self._place = site.references.position[:, :2]
        self._number = np.full(len(site.tags), -1)
        self._number[site.references.tag] = np.arange(len(site.references))

    def start(self, prior: Prior) -> None:
        self._now = np.array(prior.t)
        self._newest = np.full((prior.rows, len(self._place)), -np.inf)
        self._held, self._scatter = np.full((prior.rows, 2), np.nan), np.zeros((prior.rows, 2, 2))

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        number, row = self._number[event.data.tag], event.row
        used = number >= 0
        self._newest[row[used], number[used]] = np.maximum(self._newest[row[used], number[used]], event.data.t[used])
        self._look(row[used], event.data.t[used])
        return UpdateInfo(used)

    def _look(self, rows: Array, t: Array) -> None:
        heard = self._newest[rows] >= (t - self.config.memory_s)[:, None]
        share = heard / np.maximum(heard.sum(axis=1, keepdims=True), 1)
        middle = share @ self._place
        self._held[rows] = self._graph.project(middle)[1]
        apart = self._place - self._held[rows][:, None]
        self._scatter[rows] = np.einsum("bm,bmi,bmj->bij", share, apart, apart)

    def estimate(self) -> Estimate:
        lost = self._now - self._newest.max(axis=1) > self.config.lost_s
        covariance = self._scatter + self.config.spread_m**2 * np.eye(2)
        status = np.where(lost | np.isnan(self._held[:, 0]), Status.LOST, Status.OK).astype(np.int8)
        return Estimate(COMPONENTS, self._held.copy(), covariance, status)
