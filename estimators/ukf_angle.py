"""An unscented Kalman filter that knows how directional antennas look: a level puts the tag on a sphere through the antenna.

T. Nick, M. Z. I. Khan, J. Götze, W. John, "Localization of passive UHF RFID label with unscented Kalman filter based on angle-dependent
RSSI measurements", ICSPCS 2011: with a level that falls as (r / cos θ) a level of "distance" D is heard on the sphere of diameter D
that touches the antenna and lies on its boresight.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from estimators.heard import Heard
from estimators.measurements import Piece, Range, distances
from estimators.ukf import Ukf, UkfConfig
from testbed import frames
from testbed.types import RowRandom, Site


class UkfAngleConfig(UkfConfig):
    """As for a `ukf` in metres; `distance_std_m` is of the radius."""

    together: bool = True
    measure: Literal["power", "distance"] = "distance"


class UkfAngle(Ukf):
    """Measures the radius D / 2 from the sphere's middle, which lies D / 2 before the antenna: the middle is itself measured.

    Breaks with antennas of another pattern than cos^(n/2), and where aims are badly chosen: it knows no front from back.
    """

    Config = UkfAngleConfig

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        if config.measure != "distance":
            raise ValueError("ukf_angle: it knows levels as diameters of spheres alone: measure must be distance")
        super().__init__(config, site, rng)
        self._boresight = frames.rotate(site.antennas.quaternion, np.array([1.0, 0.0, 0.0]))

    def _pieces(self, heard: Heard) -> list[Piece]:
        radius = distances(self._model, heard) / 2
        ahead = np.nan_to_num(radius)[..., None] * self._boresight[heard.antenna]
        middle = self._site.antennas.position[heard.antenna] + ahead
        return [Range(radius, middle, np.full(radius.shape, self._config.distance_std_m**2))]
