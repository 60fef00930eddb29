"""LANDMARC: a tag is where the reference tags are that sound like it.

L. M. Ni, Y. Liu, Y. C. Lau, A. P. Patil, "LANDMARC: indoor location sensing using active RFID", Wireless Networks 10 (2004).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators.belief import StatusConfig
from estimators.heard import Pattern, chosen
from estimators.neighbours import enough_references, nearest
from estimators.windows import Newest
from testbed.quantity import Metres, Seconds
from testbed.types import POSITION, Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo


class LandmarcConfig(StatusConfig):
    """`neighbours`: how many references share a place. `spread_m`: doubt on each axis that is added to the scatter of the neighbours."""

    neighbours: Annotated[int, Field(ge=1, le=100)] = 4
    memory_s: Annotated[Seconds, Field(gt=0, le=3600)] = 2.0
    spread_m: Annotated[Metres, Field(gt=0, le=100)] = 0.3
    antennas: Pattern = "*"
    tags: Pattern = "*"


class Landmarc:
    """Position as the weighted mean of the k references nearest in signal space, by the newest level of each antenna.

    It has no memory beyond `memory_s` and no idea of motion: the baseline of all that has. LOST before the first read, and after
    `lost_s` of silence; in between the last position is held.
    Breaks where references are sparser than a fading dip is wide, or the tag is mounted otherwise than they are.
    """

    Config = LandmarcConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads", "reference_reads"})

    def __init__(self, config: LandmarcConfig, site: Site, rng: RowRandom) -> None:
        enough_references(site, config.neighbours, "landmarc")
        self._config, self._references = config, site.references
        self._antennas = chosen(config.antennas, site.antennas.id, "antenna", "landmarc")
        self._tag_counts = np.isin(np.arange(len(site.tags)), chosen(config.tags, site.tags.id, "tag", "landmarc"))
        self._count = len(site.antennas)

    def start(self, prior: Prior) -> None:
        self._time, self._heard = prior.t, np.full(prior.rows, -np.inf)
        self._own = Newest(prior.rows, self._count)
        self._known = Newest(prior.rows, self._count, self._references.tag)
        self._held, self._covariance = np.array(prior.mean[:, :3]), np.array(prior.covariance[:, :3, :3])

    def predict(self, t: Array) -> None:
        self._time = t

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "reference_reads":
            return UpdateInfo(self._known.add(event))
        counts = self._tag_counts[event.data.tag] & np.isin(event.data.antenna, self._antennas)
        mine = Event(event.kind, event.row[counts], event.data.take(counts))
        used = np.zeros(len(event), dtype=bool)
        used[counts] = self._own.add(mine)
        rows = event.row[used]
        self._heard[rows] = event.data.t[used]
        self._held[rows], self._covariance[rows] = self._placed(rows)
        return UpdateInfo(used)

    def estimate(self) -> Estimate:
        mean, covariance = self._placed(np.arange(len(self._time)))
        since = self._time - self._heard
        status = np.where(since > self._config.lost_s, Status.LOST, np.where(since > self._config.coast_s, Status.COASTING, Status.OK))
        return Estimate(POSITION, mean, covariance, status.astype(np.int8))

    def _placed(self, rows: Array) -> tuple[Array, Array]:
        """(rows, 3) and (rows, 3, 3): by the neighbours where there are some now, else as held."""
        t, memory, picked = self._time[rows], self._config.memory_s, self._antennas
        own, known = self._own.rssi(t, memory, rows)[:, picked], self._known.rssi(t, memory, rows)[:, :, picked]
        which, weight = nearest(own, known, self._config.neighbours)
        place = self._references.position[which]
        mean = np.einsum("ek,eki->ei", weight, place)
        apart = place - mean[:, None]
        scatter = np.einsum("ek,eki,ekj->eij", weight, apart, apart)
        covariance = (scatter + scatter.transpose(0, 2, 1)) / 2 + self._config.spread_m**2 * np.eye(3)
        there = np.isfinite(mean).all(axis=1)
        return np.where(there[:, None], mean, self._held[rows]), np.where(there[:, None, None], covariance, self._covariance[rows])
