"""Where a reader may transmit, and how strongly: carriers and power limits of a region.

A hop table is a list: the channel index that a reader reports is a place in it, not an order of frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array


@dataclass(frozen=True)
class Region:
    """Carriers (C,) Hz in table order, the limit of radiated power (dBm EIRP), how long a reader may stay on a carrier."""

    carriers: Array
    limit_dbm: float
    limit_says: str
    dwell_s: float


REGIONS: dict[str, Region] = {
    "etsi": Region(np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6]), 35.15, "ETSI EN 302 208: 2 W ERP = 35.15 dBm EIRP", 0.2),
    "fcc": Region(902.75e6 + 0.5e6 * np.arange(50), 36.0, "FCC 15.247: 4 W EIRP = 36 dBm", 0.2),
}
