"""Tracking by detection counts with all that an installer knows: racks as surveyed, silence that counts, a target that may stop."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from estimators.belief import StatusConfig, status_of
from estimators.detection_cloud import FLOOR, View
from estimators.detection_map import RackMap, RackMapConfig
from estimators.detection_model import DetectionModel, DetectionModelConfig
from estimators.detection_reports import Found, Readers, Reports
from estimators.detection_rows import Motion, Rows, Sizes
from testbed.quantity import MetresPerSecond, Seconds
from testbed.types import POSITION, POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo

CHECK_PERIOD = 1.0  # s between checkpoints


class DetectionGeometryConfig(DetectionModelConfig, RackMapConfig, StatusConfig):
    """use_map: whether the site's obstacles say what is closed. lag_s: reports speak of so long ago, and are the better for it.

    late_s: reports that come so late are taken, by going back to a checkpoint before them; later ones are refused. 0 refuses them all.
    stop_s, go_s: how long a target stands, and moves, on average; it sets off with speed_mps in any direction. stop_s 0: it never stands.
    resample_below: particles are resampled when the effective share of them is smaller.
    """

    particles: Annotated[int, Field(ge=2, le=1_000_000)] = 1000
    acceleration_density_m2ps3: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    use_map: bool = True
    lag_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.0
    late_s: Annotated[Seconds, Field(ge=0, le=60)] = 3.0
    stop_s: Annotated[Seconds, Field(ge=0, le=1e6)] = 0.0
    go_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 10.0
    speed_mps: Annotated[MetresPerSecond, Field(ge=0, le=20)] = 1.5
    resample_below: Annotated[float, Field(gt=0, le=1)] = 0.5
    coast_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 3.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 30.0

    @model_validator(mode="after")
    def _fits_in_memory(self) -> DetectionGeometryConfig:
        if self.particles * (self.lag_s + 1) * (self.late_s + 1) > 20_000_000:
            raise ValueError("particles, lag_s and late_s together want more than a gigabyte a target: make one of them smaller")
        return self


class DetectionGeometry:
    """A particle filter whose belief is a function of the counts in order of their own times, whenever they came.

    Beside the published likelihood: readers that hear nothing count; the way to an antenna is closed as far as racks of the survey stand in
    it, P(dead) = 1 - (1 - g)(1 - E λ), and no particle goes through a rack; velocities are integrated out (Rao-Blackwell); two modes,
    moving and standing, with exact jumps between them; the past of the particles for reports with a lag. A silence may be weighed half a
    second from the particles' own time, along their velocities. Breaks where the survey is wrong: a rack that is not there repels.
    """

    Config: ClassVar[type[DetectionGeometryConfig]] = DetectionGeometryConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"rounds"})
    accepts_late: ClassVar[bool] = True

    def __init__(self, config: DetectionGeometryConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._site, self._rng = config, site, rng
        self._readers = Readers(site, "detection_geometry")
        self._model = DetectionModel(config)
        self._sizes = Sizes(
            particles=config.particles,
            checkpoints=math.ceil(config.late_s / CHECK_PERIOD) + 2 if config.late_s > 0 else 0,
            period=CHECK_PERIOD,
            past=math.ceil((config.lag_s + config.late_s) / 0.5) + 4 if config.lag_s > 0 else 0,
            threshold=config.resample_below,
        )
        stops = config.stop_s > 0
        self._motion = Motion(
            config.acceleration_density_m2ps3,
            go_rate=1 / config.stop_s if stops else 0.0,
            stop_rate=1 / config.go_s if stops else 0.0,
            speed=config.speed_mps,
        )

    def start(self, prior: Prior) -> None:
        if prior.components != POSITION_VELOCITY:
            raise ValueError(f"detection_geometry: a prior over position and velocity is wanted, not over {', '.join(prior.components)}")
        self._prior, self._now, self._heard = prior, np.array(prior.t), np.array(prior.t)
        height = prior.mean[:, 2]
        racks = RackMap(self._config, self._site, height) if self._config.use_map and len(self._site.obstacles) else None
        self._rows = Rows(prior, self._sizes, self._motion, self._model, View(self._site.antennas, height), racks, self._rng)
        self._reports = Reports(prior.rows, self._readers, "detection_geometry", heard=False)

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        used, found = self._reports.sort(event.row, event.data)
        in_time = found.t >= self._now[found.row] - self._config.late_s - 1e-9
        if not in_time.all():
            used &= event.data.t >= self._now[event.row] - self._config.late_s - 1e-9
            found = Found(*(part[in_time] for part in found))
        read = found.n > 0
        self._heard[found.row[read]] = np.maximum(self._heard[found.row[read]], found.t[read])
        self._rows.add(found)
        return UpdateInfo(used)

    def estimate(self) -> Estimate:
        status = status_of(self._now - self._heard, self._config)
        if self._config.lag_s > 0:
            return self._lagged(status)
        floor, spread = self._rows.moments(self._now)
        mean, covariance = np.zeros((len(floor), 6)), np.zeros((len(floor), 6, 6))
        mean[:, [2, 5]] = self._prior.mean[:, [2, 5]]
        covariance[:, [2, 5], [2, 5]] = self._prior.covariance[:, [2, 5], [2, 5]]
        mean[:, FLOOR] = floor
        covariance[:, FLOOR[:, None], FLOOR] = spread
        return Estimate(POSITION_VELOCITY, mean, covariance, status)

    def _lagged(self, status: Array) -> Estimate:
        """Where targets were `lag_s` ago, as far as the start goes back."""
        place, weight = self._rows.places(np.maximum(self._now - self._config.lag_s, self._prior.t))
        mean, covariance = np.array(self._prior.mean[:, :3]), np.zeros((len(place), 3, 3))
        mean[:, :2] = np.einsum("bim,bm->bi", place, weight)
        apart = place - mean[:, :2, None]
        spread = np.einsum("bim,bjm,bm->bij", apart, apart, weight)
        covariance[:, :2, :2] = (spread + spread.transpose(0, 2, 1)) / 2
        covariance[:, 2, 2] = self._prior.covariance[:, 2, 2]
        return Estimate(POSITION, mean, covariance, status)

    def particles(self) -> tuple[Array, Array]:
        """Places (B, M, 3) of the particles at the time that reports speak of, and weights (B, M)."""
        place, weight = self._rows.places(np.maximum(self._now - self._config.lag_s, self._prior.t))
        height = np.broadcast_to(self._prior.mean[:, 2, None, None], (*weight.shape, 1))
        return np.concatenate([place.transpose(0, 2, 1), height], axis=2), weight
