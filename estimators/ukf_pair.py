"""Two tags on one trolley, whose distance from each other is known: a constrained unscented Kalman filter.

T. Nick, J. Götze, W. John, G. Stoenner, "Localization of passive UHF RFID labels using an unscented Kalman filter with relative position
information", RFID SysTech 2011; D. Simon, "Kalman filtering with state constraints", IET Control Theory 4 (2010): perfect measurements.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from estimators.belief import Belief
from estimators.heard import Heard
from estimators.measurements import Linear, Piece
from estimators.ukf import Ukf, UkfConfig
from testbed.quantity import Point3
from testbed.types import Prior, RowRandom, Site


class UkfPairConfig(UkfConfig):
    """`offset_m`: where the target's second tag is from its first. `constraint_variance` (m² and m²/s²): 0 would be singular."""

    together: bool = True
    kappa: Annotated[float, Field(gt=-12, le=100)] = 0.0
    offset_m: Point3 = (0.0, 0.0, 0.5)
    constraint_variance: Annotated[float, Field(gt=0, le=1e3)] = 1e-4


class UkfPair(Ukf):
    """Twelve states, both tags' position and velocity; with every snapshot their known distance and equal velocity count as measured.

    The estimate is of the first tag. The target needs two tags; what a third one says is left out. A tag that is not heard leaves the
    other to carry both. Breaks where the tags do not keep their distance, as on a trolley that turns: the offset is in world axes.
    """

    Config = UkfPairConfig
    points: ClassVar[int] = 2

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        if not config.together:
            raise ValueError("ukf_pair: the two tags are measured at one instant: together must be true")
        super().__init__(config, site, rng)
        self._bond = np.hstack([-np.eye(6), np.eye(6)])
        self._known = np.concatenate([config.offset_m, np.zeros(3)])

    def _begun(self, prior: Prior) -> Belief:
        apart = np.array([self._config.offset_m])
        return Belief(prior, self._motion, self._config, apart, keep=self._config.smooth)

    def _pieces(self, heard: Heard) -> list[Piece]:
        e = len(heard.row)
        bond = np.where(heard.present[:, None], self._known, np.nan)  # silence is no measurement
        tied = Linear(bond, self._bond, np.full((e, 6), self._config.constraint_variance))
        return [self._levels(self._of_slot(heard, slot), 6 * slot) for slot in range(2)] + [tied]

    def _of_slot(self, heard: Heard, slot: int) -> Heard:
        """What was heard of the target's first tag (slot 0), or of its second."""
        return replace(heard, rssi=np.where(heard.slot == slot, heard.rssi, np.nan))
