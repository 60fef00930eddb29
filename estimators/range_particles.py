"""A particle filter on ranges to anchors and an odometer: unknown place and heading, ranges that are all too long, several hypotheses.

S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics" (2005), ch. 5.4 (odometry) and 8.3 (particles). An antenna's delay makes all ranges
of a pair of radios too long by the same, and geometry tells by how much: given where a particle has been, the bias of an anchor is a scalar
Kalman filter's matter, so each particle carries its mean and variance (Rao-Blackwellised: K. Murphy, S. Russell, in Doucet et al.,
"Sequential Monte Carlo Methods in Practice", 2001).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators.floor_cloud import CloudConfig, FloorCloud, student
from testbed.quantity import Degrees, DegreesPerSecond, Metres, MetresPerSecond
from testbed.types import Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo


class RangeParticlesConfig(CloudConfig):
    """σ of ranges, biases and odometer. `bias_m`, `bias_std_m`: what is believed of an anchor's bias before any range.

    `freedom`: of Student's t, by which ranges stray. `slip`: σ of the odometer grows by this share of what it says. Without an odometer
    particles wander by `wander_mps`. `heading_jitter_deg`: as `jitter_m`, for an heir's heading.
    """

    particles: Annotated[int, Field(ge=10, le=100_000)] = 4000
    jitter_m: Annotated[Metres, Field(ge=0, le=10)] = 0.005
    margin_m: Annotated[Metres, Field(ge=0, le=1000)] | None = 0.1
    sigma_m: Annotated[Metres, Field(gt=0, le=100)] = 0.1
    freedom: Annotated[float, Field(ge=1, le=1000)] = 5.0
    bias_m: Annotated[Metres, Field(ge=-100, le=100)] = 0.1
    bias_std_m: Annotated[Metres, Field(ge=0, le=100)] = 0.1
    heading_jitter_deg: Annotated[Degrees, Field(ge=0, le=90)] = 1.5
    speed_std_mps: Annotated[MetresPerSecond, Field(gt=0, le=10)] = 0.03
    turn_std_dps: Annotated[DegreesPerSecond, Field(gt=0, le=360)] = 6.0
    slip: Annotated[float, Field(ge=0, le=1)] = 0.05
    wander_mps: Annotated[MetresPerSecond, Field(gt=0, le=10)] = 0.5


class RangeParticles:
    """Place, heading and the anchors' biases by N particles a row, from anywhere and in any direction.

    Breaks where fewer particles than about a thousand have to find a start in some square metres with any heading.
    """

    Config = RangeParticlesConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"ranges", "odometry"})

    def __init__(self, config: RangeParticlesConfig, site: Site, rng: RowRandom) -> None:
        self._config, self._site, self._random = config, site, rng
        if not len(site.antennas):
            raise ValueError("range_particles: the site has no anchors")

    def start(self, prior: Prior) -> None:
        config, anchors = self._config, len(self._site.antennas)
        n = config.particles
        self._cloud = FloorCloud(config, self._site, self._random, prior)
        self._cloud.own["heading"] = 2 * np.pi * self._random.uniform(n)
        self._cloud.own["bias"] = np.full((prior.rows, n, anchors), config.bias_m)
        self._cloud.own["doubt"] = np.full((prior.rows, n, anchors), config.bias_std_m**2)
        self._cloud.rough = {"heading": np.deg2rad(config.heading_jitter_deg)}
        self._speed, self._turn = np.full(prior.rows, np.nan), np.zeros(prior.rows)

    def predict(self, t: Array) -> None:
        cloud, config, n = self._cloud, self._config, self._config.particles
        rows = np.flatnonzero(t > cloud.time)
        if not len(rows):
            return
        dt = (t - cloud.time)[rows, None]
        noise = self._random.normal(3 * n, rows).reshape(-1, 3, n)
        speed, turn = self._speed[rows, None], self._turn[rows, None]
        blind = np.isnan(speed)
        speed = np.where(blind, 0.0, speed) + noise[:, 0] * np.where(
            blind, config.wander_mps, config.speed_std_mps + config.slip * np.abs(speed)
        )
        turn = turn + noise[:, 1] * np.where(blind, np.pi, np.deg2rad(config.turn_std_dps) + config.slip * np.abs(turn))
        heading = cloud.own["heading"]
        middle = heading[rows] + turn * dt / 2
        cloud.moved(rows, (speed * dt)[..., None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1))
        heading[rows] = heading[rows] + turn * dt
        cloud.time = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "odometry":
            there = np.isfinite(event.data.speed)
            self._speed[event.row[there]] = event.data.speed[there]
            self._turn[event.row[there]] = np.nan_to_num(event.data.yaw_rate[there])
            return UpdateInfo(there)
        ranges = event.data
        used = np.isfinite(ranges.range) & (ranges.range >= 0)
        rows = event.row[used]
        log_likelihood = np.full(len(event), np.nan)
        if len(rows):
            log_likelihood[used] = self._ranged(rows, ranges.anchor[used].astype(np.int64), ranges.range[used])
        return UpdateInfo(used, log_likelihood)

    def _ranged(self, rows: Array, anchor: Array, measured: Array) -> Array:
        """Take a range for each of the rows (R,): the biases, given the places, and the weights; (R,) log-likelihoods."""
        cloud, config = self._cloud, self._config
        apart = np.linalg.norm(cloud.points()[rows] - self._site.antennas.position[anchor][:, None], axis=2)
        bias, doubt = cloud.own["bias"], cloud.own["doubt"]
        mean, variance = bias[rows, :, anchor], doubt[rows, :, anchor]  # (R, N)
        total = variance + config.sigma_m**2
        innovation = measured[:, None] - apart - mean
        z = innovation / np.sqrt(total)
        trust = (config.freedom + 1) / (config.freedom + z**2)  # of a sample from Student's t, against a normal one
        gain = variance / (variance + config.sigma_m**2 / trust)
        bias[rows, :, anchor] = mean + gain * innovation
        doubt[rows, :, anchor] = variance * (1 - gain)
        return cloud.weigh(rows, student(z, config.freedom) - np.log(total) / 2)

    def estimate(self) -> Estimate:
        return self._cloud.estimate()

    def particles(self) -> tuple[Array, Array]:
        """(B, N, 3) m and weights (B, N)."""
        return self._cloud.points(), self._cloud.weights()
