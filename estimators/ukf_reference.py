"""An unscented Kalman filter that also takes the reference tags which sound like the tag as measurements of its place.

T. Nick, J. Götze, W. John, G. Stoenner, "Localization of UHF RFID labels with reference tags and unscented Kalman filter", RFID-TA 2011.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from estimators.heard import Heard
from estimators.measurements import Linear, Piece
from estimators.neighbours import enough_references, nearest
from estimators.ukf import Ukf, UkfConfig
from estimators.windows import Latest
from testbed.quantity import Seconds
from testbed.types import Array, Event, Prior, RowRandom, Site, UpdateInfo


class UkfReferenceConfig(UkfConfig):
    """`neighbours`: how many reference tags count; left out, as in the paper's tables, 3 with two antennas and 2 with more.

    A level says how a tag sounds for `memory_s`: antennas take turns, and one read alone is like any other. `every_s` is the least time
    from one comparison with the references to the next, for what they say is as wrong a moment later; 0 compares at each snapshot.
    """

    together: bool = True
    neighbours: Annotated[int, Field(ge=1, le=100)] | None = None
    memory_s: Annotated[Seconds, Field(gt=0, le=3600)] = 2.0
    every_s: Annotated[Seconds, Field(ge=0, le=3600)] = 0.0


class UkfReference(Ukf):
    """With each snapshot the k nearest references' positions count as k measurements of the tag's own, with variance 1 / weight in m².

    Compared are the newest levels of the tag and of the references by each antenna; without any of these, its own are taken alone.
    Breaks between references: the weights say which is nearest, not how far it is, so a variance of metres² is the least there is.
    """

    Config = UkfReferenceConfig

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        if not config.together:
            raise ValueError("ukf_reference: a tag is compared with references at one instant: together must be true")
        super().__init__(config, site, rng)
        antennas = len(self._hearing.antennas)
        self._k = config.neighbours or (3 if antennas <= 2 else 2)
        enough_references(site, self._k, "ukf_reference")
        self.consumes = self.consumes | {"reference_snapshots"}
        self._place = np.hstack([np.eye(3), np.zeros((3, 3))])

    def start(self, prior: Prior) -> None:
        super().start(prior)
        references, antennas = len(self._site.references), len(self._site.antennas)
        self._known = Latest(prior.rows, references, antennas)
        self._own = Latest(prior.rows, antennas)
        self._compared = np.full(prior.rows, -np.inf)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "reference_snapshots":
            self._known.add(event.row, event.data.t, event.data.rssi)
            return UpdateInfo.accepted(len(event))
        return super().update(event)

    def _pieces(self, heard: Heard) -> list[Piece]:
        return [self._levels(heard), self._neighbours(heard)]

    def _neighbours(self, heard: Heard) -> Piece:
        """The places of the k nearest references, NaN for those who have none, are not heard, or compared themselves just now."""
        self._own.add(heard.row, heard.t, heard.by_antenna(len(self._site.antennas)))
        picked = self._hearing.antennas
        levels, known = (one.rssi(heard.row, heard.t, self._config.memory_s)[..., picked] for one in (self._own, self._known))
        which, weight = nearest(levels, known, self._k)
        due = heard.present & (heard.t - self._compared[heard.row] >= self._config.every_s - 1e-9)
        said: Array = np.isfinite(weight) & due[:, None]
        self._compared[heard.row[said.any(axis=1)]] = heard.t[said.any(axis=1)]
        position = np.where(said[..., None], self._site.references.position[which], np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = np.where(weight > 0, 1.0 / weight, 1e12)
        e = len(heard.row)
        return Linear(position.reshape(e, -1), np.tile(self._place, (self._k, 1)), np.repeat(variance, 3, axis=1))
