"""The centroid of the readers that detect a tag (CE-asyn): the baseline of the paper.

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", section 5.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from estimators.belief import StatusConfig, status_of
from estimators.detection_reports import Readers, Reports
from testbed import frames
from testbed.quantity import Metres, Seconds
from testbed.types import POSITION, Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo


class DetectionCentroidConfig(StatusConfig):
    """period_s: length of a slot. reader_place: where its antennas' boresights meet, or in the middle of the antennas.

    spread_m: standard deviation on each axis that is added to the scatter of the readers, for one reader alone has none.
    """

    period_s: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0
    reader_place: Literal["boresights", "antennas"] = "boresights"
    spread_m: Annotated[Metres, Field(gt=0, le=1e3)] = 2.0
    coast_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 3.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 30.0


class DetectionCentroid:
    """Unweighted mean of the places of the readers with a read in the slot; held while all are silent, the prior before the first read.

    Its height is the prior's: counts say nothing of it here.
    """

    Config: ClassVar[type[DetectionCentroidConfig]] = DetectionCentroidConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"rounds"})

    def __init__(self, config: DetectionCentroidConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._readers = config, Readers(site, "detection_centroid")
        self._places = places_of(self._readers, site, config.reader_place)

    def start(self, prior: Prior) -> None:
        self._now, self._heard = np.array(prior.t), np.array(prior.t)
        self._mean, self._covariance = np.array(prior.mean[:, :3]), np.array(prior.covariance[:, :3, :3])
        self._slot = np.full(prior.rows, np.iinfo(np.int64).min)
        self._reports = Reports(prior.rows, self._readers, "detection_centroid", heard=False)
        self._found = np.zeros((prior.rows, len(self._places)), dtype=bool)

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        used, _ = self._reports.sort(event.row, event.data)
        read = used & (event.data.n > 0)
        row, t = event.row[read], event.data.t[read]
        self._heard[row] = t
        slot = np.ceil(t / self._config.period_s - 1e-9).astype(np.int64)
        later = slot > self._slot[row]
        self._found[row[later]], self._slot[row[later]] = False, slot[later]
        now = slot == self._slot[row]
        self._found[row[now], self._readers.of[event.data.antenna[read][now]]] = True
        return UpdateInfo(used)

    def estimate(self) -> Estimate:
        mean, covariance = self._mean.copy(), self._covariance.copy()
        rows = np.flatnonzero(self._found.any(axis=1))
        weight = self._found[rows] / self._found[rows].sum(axis=1, keepdims=True)
        mean[rows, :2] = weight @ self._places
        apart = self._places - mean[rows, None, :2]
        scatter = np.einsum("br,bri,brj->bij", weight, apart, apart)
        covariance[rows, :2, :2] = (scatter + scatter.transpose(0, 2, 1)) / 2 + self._config.spread_m**2 * np.eye(2)
        covariance[rows, :2, 2] = covariance[rows, 2, :2] = 0.0
        return Estimate(POSITION, mean, covariance, status_of(self._now - self._heard, self._config))


def places_of(readers: Readers, site: Site, how: str) -> Array:
    """(R, 2) m: where the readers stand on the plan. ValueError, naming it, for one whose antennas' boresights don't meet in a point."""
    position = site.antennas.position[:, :2]
    if how == "antennas":
        return np.array([position[readers.of == r].mean(axis=0) for r in range(len(readers.names))])
    ahead = frames.rotate(site.antennas.quaternion, np.array([1.0, 0.0, 0.0])).reshape(-1, 3)[:, :2]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    across = np.eye(2) - ahead[:, :, None] * ahead[:, None, :]
    found = []
    for r, name in enumerate(readers.names):
        mine = readers.of == r
        total = across[mine].sum(axis=0)
        if np.linalg.cond(total) > 1e6:
            raise ValueError(
                f"detection_centroid: where reader {str(name) or '(unnamed)'} stands is not known, its antennas' boresights don't meet "
                "in one point: set reader_place: antennas"
            )
        found.append(np.linalg.solve(total, np.einsum("aij,aj->i", across[mine], position[mine])))
    return np.array(found)
