"""Tracking by detection counts as if all readers of a slot had counted at its end (PF-syn): what asynchronism costs if it is overlooked.

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", Eq. 11.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from estimators.detection_filter import DetectionFilter, DetectionFilterConfig
from testbed.quantity import Seconds
from testbed.types import Array


class DetectionSynchronousConfig(DetectionFilterConfig):
    """`period_s`: length of a slot."""

    period_s: Annotated[Seconds, Field(gt=0, le=3600)] = 1.0


class DetectionSynchronous(DetectionFilter):
    """The same filter with every block taken at the end of its slot. Reports within a slot go back from there along the velocity."""

    Config: ClassVar[type[DetectionFilterConfig]] = DetectionSynchronousConfig

    def stamp(self, t: Array) -> Array:
        """The end of the slot that t lies in."""
        period = self._config.period_s
        return np.ceil(t / period - 1e-9) * period
