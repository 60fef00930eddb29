"""The weighted centroid of the antennas that hear a tag: the baseline that anything must beat.

J. Blumenthal, R. Grossmann, F. Golatowski, D. Timmermann, "Weighted centroid localization in Zigbee-based sensor networks", IEEE WISP 2007.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators.belief import StatusConfig
from estimators.rssi_model import fixed_antennas
from estimators.windows import Newest
from testbed.quantity import Metres, Seconds
from testbed.types import POSITION, Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo


class CentroidConfig(StatusConfig):
    """Weights are 10^(exponent · RSSI / 10): 1 weighs by power, 0.25 by the inverse distance under a two-way law of 40 dB a decade.

    `spread_m`: standard deviation on each axis that is added to the scatter of the antennas, for one antenna alone has none.
    """

    memory_s: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0
    exponent: Annotated[float, Field(gt=0, le=10)] = 0.25
    spread_m: Annotated[Metres, Field(gt=0, le=100)] = 0.5


class Centroid:
    """Position as the mean of the antennas that heard the tag within `memory_s`, by weight; it never leaves their convex hull.

    In silence the last position is held, with a doubt that says nothing of how far the tag has gone meanwhile. LOST before the first read.
    """

    Config = CentroidConfig
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config: CentroidConfig, site: Site, rng: RowRandom) -> None:
        fixed_antennas(site, "centroid")
        self._config, self._antennas = config, site.antennas.position

    def start(self, prior: Prior) -> None:
        self._time, self._heard = prior.t, np.full(prior.rows, -np.inf)
        self._newest = Newest(prior.rows, len(self._antennas))
        self._held, self._held_covariance = np.array(prior.mean[:, :3]), np.array(prior.covariance[:, :3, :3])

    def predict(self, t: Array) -> None:
        self._time = t

    def update(self, event: Event) -> UpdateInfo:
        used = self._newest.add(event)
        rows = event.row[used]
        self._heard[rows] = event.data.t[used]
        self._held[rows], self._held_covariance[rows] = self._centroid(rows)
        return UpdateInfo(used)

    def estimate(self) -> Estimate:
        mean, covariance = self._centroid(slice(None))
        silent = np.isnan(mean[:, 0])
        mean = np.where(silent[:, None], self._held, mean)
        covariance = np.where(silent[:, None, None], self._held_covariance, covariance)
        return Estimate(POSITION, mean, covariance, self._status(silent))

    def _status(self, silent: Array) -> Array:
        since = self._time - self._heard
        held = np.where(since > self._config.lost_s, Status.LOST, Status.COASTING)
        return np.where(silent | (since > self._config.coast_s), held, Status.OK).astype(np.int8)

    def _centroid(self, rows: Array | slice) -> tuple[Array, Array]:
        """(rows, 3) and (rows, 3, 3), NaN for those that nobody heard within `memory_s`."""
        rssi = self._newest.rssi(self._time[rows], self._config.memory_s, rows)
        return centroid(rssi, self._antennas, self._config.exponent, self._config.spread_m)


def centroid(rssi: Array, antennas: Array, exponent: float, spread: float) -> tuple[Array, Array]:
    """Weighted mean and covariance (B, 3), (B, 3, 3) of the antennas (M, 3) m by RSSI (B, M) dBm, NaN where not heard."""
    heard = np.isfinite(rssi)
    strongest = np.where(heard, rssi, -np.inf).max(axis=1, keepdims=True)
    level = np.where(heard, rssi - np.where(heard.any(axis=1, keepdims=True), strongest, 0.0), -np.inf)
    weight = 10.0 ** (exponent * level / 10.0)  # relative to the strongest: nothing overflows
    total = weight.sum(axis=1, keepdims=True)
    weight = weight / np.where(total > 0, total, np.nan)
    mean = np.einsum("bm,mi->bi", weight, antennas)
    apart = antennas - mean[:, None]
    scatter = np.einsum("bm,bmi,bmj->bij", weight, apart, apart)
    return mean, (scatter + scatter.transpose(0, 2, 1)) / 2 + spread**2 * np.eye(3)
