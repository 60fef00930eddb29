"""What all filters on a road network share: events in, one step after another, a place on the network out, seeking or tracking.

A step is an odometer sample: the belief moves on by speed times the time since the sample before, and then weighs the compass sample
of the same time. Estimates are given before particles are resampled. Between samples a belief stands where the last one left it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.special import ive

from estimators.roads_fixes import Fixes, FixesConfig
from estimators.roads_map import RoadMap, rounding_saves
from testbed.quantity import Metres, Seconds
from testbed.roads import RoadGraph
from testbed.types import Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo

COMPONENTS = ("x", "y")
AGREE_S = 4.0  # s: over how long compass and belief are compared
DOUBTED = 0.5  # of the mean cosine that κ promises: below it, a belief is doubted


class RoadFilterConfig(FixesConfig):
    """What every filter on roads is told.

    kappa       : concentration of the compass error about the road's direction (von Mises), at one sample
    correlation_s : how long that error lasts: samples that follow each other faster count for less, in proportion
    start       : "network": anywhere, in any direction; "prior": about the prior's place, along its velocity where it has one
    near_m, settle_share, lose_share : a row tracks once this share of its belief lies within near_m of its place, and seeks again
    when less than lose_share does
    lane_std_m  : how far vehicles keep from the middle of their road, standard deviation on each axis
    turn_radius_m : vehicles round their corners so wide, and drive less than the roads are long: the odometer is stretched by what the
    map's corners save on average (`estimators.roads_map.rounding_saves`)
    silent_s    : without an odometer for so long a row is lost
    """

    kappa: Annotated[float, Field(ge=0, le=1e4)] = 2.0
    correlation_s: Annotated[Seconds, Field(ge=0, le=1000)] = 0.0
    start: Literal["network", "prior"] = "network"
    near_m: Annotated[Metres, Field(gt=0, le=1000)] = 3.0
    settle_share: Annotated[float, Field(gt=0, le=1)] = 0.8
    lose_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    lane_std_m: Annotated[Metres, Field(gt=0, le=10)] = 0.3
    turn_radius_m: Annotated[Metres, Field(ge=0, le=100)] = 0.0
    silent_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 5.0


class RoadFilter(ABC):
    """Base of the map-matching filters: time, pending compass samples, fixes, status. Subclasses hold the belief of B rows.

    ValueError for a site without roads, a compass that counts in degrees, and a prior off the network, each naming its place.
    """

    consumes: ClassVar[frozenset[str]] = frozenset({"odometry", "heading", "reads", "reference_reads"})
    watches_agreement: ClassVar[bool] = True  # whether a belief is doubted whose directions and the compass keep falling out

    def __init__(self, config: RoadFilterConfig, site: Site, rng: RowRandom) -> None:
        if site.roads is None or not len(site.roads.segments):
            raise ValueError(f"{type(self).__name__}: the site has no roads to be matched with")
        self.config, self.rng = config, rng
        self.graph = RoadGraph(site.roads)
        self.map = RoadMap.of(self.graph)
        self._stretch = 1 / (1 - rounding_saves(self.graph, config.turn_radius_m))  # of road a metre driven
        self._fixes = Fixes(config, site)
        expected = ive(1, config.kappa) / ive(0, config.kappa) if config.kappa else 0.0
        self._doubted = DOUBTED * expected if self.watches_agreement else -np.inf

    # ------------------------------------------------------------ the belief

    @abstractmethod
    def begin(self, prior: Prior) -> None:
        """Beliefs at the prior's rows: all over the network, or about the prior."""

    @abstractmethod
    def move(self, rows: Array, speed: Array, dt: Array) -> None:
        """Bring some rows (R,) on by a measured speed (R,) m/s over dt (R,) s, stretched where corners are rounded."""

    @abstractmethod
    def weigh(self, rows: Array, heading: Array, kappa: Array, since: Array) -> tuple[Array, Array]:
        """Take a heading (R,) rad: its log-likelihood (R,) over the greatest, and the mean cosine (R,) to the belief before.

        kappa (R,) is what the heading counts for, since (R,) s the time since the one before.
        """

    @abstractmethod
    def weigh_place(self, rows: Array, place: Array, lead: float) -> None:
        """Take a fix: something `lead` m ahead of the vehicle is near `place` (R, 2) m."""

    @abstractmethod
    def summary(self, rows: Array) -> tuple[Array, Array, Array]:
        """(R, 2) places on the network, (R, 2, 2) covariances about them, (R,) share of the belief within near_m of them."""

    @abstractmethod
    def renew(self, rows: Array) -> None:
        """What is to be done after a step, once its estimate is taken: resampling."""

    # ------------------------------------------------------------ the driver's side

    def start(self, prior: Prior) -> None:
        rows = prior.rows
        self._begun, self._time, self._now = np.array(prior.t), np.array(prior.t), np.array(prior.t)
        self._pending, self._pending_t = np.full(rows, np.nan), np.full(rows, -np.inf)
        self._weighed_t = np.array(prior.t)
        self._mean, self._covariance = np.zeros((rows, 2)), np.zeros((rows, 2, 2))
        self._share, self._agreement, self._seeking = np.zeros(rows), np.ones(rows), np.ones(rows, dtype=bool)
        self._fixes.start(rows)
        if self.config.start == "prior":
            self._check_prior(prior)
        self.begin(prior)
        self._look(np.arange(rows))

    def predict(self, t: Array) -> None:
        self._now = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "odometry":
            return self._step(event.row, event.data.t, event.data.speed)
        if event.kind == "heading":
            return self._hear(event.row, event.data.t, event.data.heading)
        return self._fix(event)

    def estimate(self) -> Estimate:
        covariance = self._covariance + self.config.lane_std_m**2 * np.eye(2)
        silent = self._now - self._time > self.config.silent_s
        status = np.where(silent, Status.LOST, np.where(self._seeking, Status.COASTING, Status.OK)).astype(np.int8)
        extras = {"seeking": self._seeking.copy(), "near_share": self._share.copy()}
        return Estimate(COMPONENTS, self._mean.copy(), covariance, status, extras)

    # ------------------------------------------------------------ events

    def _step(self, row: Array, t: Array, speed: Array) -> UpdateInfo:
        used = np.isfinite(speed) & (t > self._time[row])
        rows, t = row[used], t[used]
        self.move(rows, speed[used], self._stretch * (t - self._time[rows]))
        self._time[rows] = t
        told = np.full(len(row), np.nan)
        heard = np.isfinite(self._pending[rows]) & (self._pending_t[rows] <= t)
        told[np.flatnonzero(used)[heard]] = self._weigh(rows[heard])
        self._look(rows)
        self.renew(rows)
        return UpdateInfo(used, log_likelihood=told)

    def _hear(self, row: Array, t: Array, heading: Array) -> UpdateInfo:
        _refuse_degrees(row, t, heading)
        used = np.isfinite(heading) & (t > self._begun[row])  # before the first move nothing is weighed
        rows = row[used]
        kept = rows[np.isfinite(self._pending[rows])]  # the odometer is slower, or silent: the sample before counts where the belief stands
        self._weigh(kept)
        self._pending[rows], self._pending_t[rows] = heading[used], t[used]
        there = rows[self._pending_t[rows] <= self._time[rows]]
        self._weigh(there)
        changed = np.union1d(kept, there)
        if len(changed):
            self._look(changed)
            self.renew(changed)
        return UpdateInfo(used)

    def _weigh(self, rows: Array) -> Array:
        """Let the pending headings of some rows count: their log-likelihood."""
        if not len(rows):
            return np.empty(0)
        since = np.maximum(self._pending_t[rows] - self._weighed_t[rows], 0.0)
        counts = np.minimum(since / self.config.correlation_s, 1.0) if self.config.correlation_s else np.ones(len(rows))
        told, cosine = self.weigh(rows, self._pending[rows], self.config.kappa * counts, since)
        keep = np.exp(-since / AGREE_S)
        self._agreement[rows] = keep * self._agreement[rows] + (1 - keep) * cosine
        self._weighed_t[rows] = np.maximum(self._weighed_t[rows], self._pending_t[rows])
        self._pending[rows] = np.nan
        return told

    def _fix(self, event: Event) -> UpdateInfo:
        used, place, lead = self._fixes.taken(event)
        rows = event.row[used]
        if len(rows):
            self.weigh_place(rows, place[used], lead)
            self._look(rows)
            self.renew(rows)
        return UpdateInfo(used)

    def _look(self, rows: Array) -> None:
        """Take the estimate of some rows, and judge whether they seek or track."""
        if not len(rows):
            return
        self._mean[rows], self._covariance[rows], self._share[rows] = self.summary(rows)
        enough = np.where(self._seeking[rows], self.config.settle_share, self.config.lose_share)
        self._seeking[rows] = self.doubted(rows) | (self._share[rows] < enough)

    def doubted(self, rows: Array) -> Array:
        """(R,) bool: rows whose directions and the compass have fallen out for some seconds: the vehicle is elsewhere."""
        return self._agreement[rows] < self._doubted

    def _check_prior(self, prior: Prior) -> None:
        place = prior.mean[:, :2]
        distance = self.graph.project(place)[2]
        doubt = np.sqrt(np.trace(prior.covariance[:, :2, :2], axis1=1, axis2=2))
        off = np.flatnonzero(~(distance <= self.config.near_m + 5 * doubt))
        if len(off):
            i = off[0]
            x, y = place[i]
            raise ValueError(f"row {i}: the prior's place ({x:g}, {y:g}) is off the network, {distance[i]:.1f} m from the nearest road")


def _refuse_degrees(row: Array, t: Array, heading: Array) -> None:
    wrong = np.flatnonzero(np.abs(heading) > 2 * np.pi + 1e-6)
    if len(wrong):
        i = wrong[0]
        raise ValueError(
            f"heading of row {row[i]} at t = {t[i]:g} s is {heading[i]:g}: radians within ±π are wanted, these look like degrees"
        )


def prior_weight(prior: Prior, rows: Array, position: Array, direction: Array, slowest: float = 0.2) -> Array:
    """(R, n): how likely places (n, 2) m with directions (n,) rad are under the priors of some rows, over the greatest.

    Normal about the prior's place. Where the prior moves faster than `slowest` m/s, directions count by the cosine to its velocity.
    """
    mean, covariance = prior.mean[rows], prior.covariance[rows][:, :2, :2]
    apart = position - mean[:, None, :2]
    squared = np.einsum("rni,rij,rnj->rn", apart, np.linalg.inv(covariance), apart)
    weight = np.exp(-0.5 * (squared - squared.min(axis=1, keepdims=True)))
    if mean.shape[1] >= 5:
        vx, vy = mean[:, 3], mean[:, 4]
        cosine = np.cos(np.arctan2(vy, vx)[:, None] - direction)
        weight *= np.where((np.hypot(vx, vy) > slowest)[:, None], np.exp(5.0 * (cosine - 1)), 1.0)
    return weight
