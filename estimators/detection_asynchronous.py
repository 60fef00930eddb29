"""Tracking by detection counts, every reader's block taken at its own time (PF-asyn).

L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", Eqs. 8-10, 13, 14.
"""

from __future__ import annotations

from typing import ClassVar

from estimators.detection_filter import DetectionFilter, DetectionFilterConfig


class DetectionAsynchronous(DetectionFilter):
    """The paper's filter: propagate and weigh at the end of every block, systematic resampling after each, report at the report's time.

    Counts are right, shelves are not known: where racks block links for good it believes the tag farther away than it is.
    """

    Config: ClassVar[type[DetectionFilterConfig]] = DetectionFilterConfig
