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
from testbed.types import Event, Prior, RowRandom, Site, UpdateInfo


class UkfReferenceConfig(UkfConfig):
    """`neighbours`: how many reference tags count; left out, as in the paper's tables, 3 with two antennas and 2 with more."""

    together: bool = True
    neighbours: Annotated[int, Field(ge=1, le=100)] | None = None


class UkfReference(Ukf):
    """With each snapshot the k nearest references' positions count as k measurements of the tag's own, with variance 1 / weight in m².

    The references' levels are those of their newest snapshot; without any, the tag's own levels are taken alone.
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
        self._references = np.full((prior.rows, len(self._site.references), len(self._site.antennas)), np.nan)

    def update(self, event: Event) -> UpdateInfo:
        if event.kind == "reference_snapshots":
            self._references[event.row] = event.data.rssi
            return UpdateInfo.accepted(len(event))
        return super().update(event)

    def _pieces(self, heard: Heard) -> list[Piece]:
        picked = self._hearing.antennas
        levels = heard.by_antenna(len(self._site.antennas))[:, picked]
        which, weight = nearest(levels, self._references[heard.row][:, :, picked], self._k)
        position = np.where(np.isfinite(weight)[..., None], self._site.references.position[which], np.nan)
        e = len(heard.row)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = np.where(weight > 0, 1.0 / weight, 1e12)
        here = Linear(position.reshape(e, -1), np.tile(self._place, (self._k, 1)), np.repeat(variance, 3, axis=1))
        return [self._levels(heard), here]
