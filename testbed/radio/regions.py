"""Where a reader may transmit, and how strongly: carriers and power limits of a region.

A hop table is a list: the channel index that a reader reports is a place in it, not an order of frequencies.

ETSI EN 302 208 has four channels of 200 kHz for 2 W, and a reader leaves one after 4 s at the latest; FCC part 15.247 has 50 of 500 kHz,
each for 0.4 s in 20 s at the most. 0.2 s is how long an Impinj R420 stays under FCC, and is taken for both. Left out: listening
before talking and the pauses after it, ETSI's upper band (915-921 MHz), other regions, the limit of conducted power alone (FCC: 30
dBm), and the order in which a reader hops, which is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.quantity import Misplaced

SAME = 1e3  # Hz: a carrier written to three places of a MHz
ROUNDING = 1e-9  # dB


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


def hop_table(region: str, chosen_mhz: Sequence[float] | None = None) -> Array:
    """(C,) Hz: the carriers of a region in its order, or those of them that a reader is told to use, in the order given.

    Misplaced, at the place in `carriers_mhz`, for a carrier outside the region, or one that comes twice.
    """
    allowed = REGIONS[region].carriers
    if chosen_mhz is None:
        return allowed
    if not len(chosen_mhz):
        raise Misplaced(("carriers_mhz",), "no carrier is left: name some, or leave carriers_mhz out for all of the region's")
    found: list[int] = []
    for i, chosen in enumerate(chosen_mhz):
        near = int(np.argmin(np.abs(allowed - chosen * 1e6)))
        if abs(allowed[near] - chosen * 1e6) > SAME:
            says = f"the nearest is {allowed[near] / 1e6:g} (it has {len(allowed)}, from {allowed[0] / 1e6:g} to {allowed[-1] / 1e6:g})"
            raise Misplaced(("carriers_mhz", i), f"{chosen:g} MHz is no carrier of the region {region!r}: {says}")
        if near in found:
            raise Misplaced(("carriers_mhz", i), f"{chosen:g} MHz comes twice")
        found.append(near)
    return allowed[found]


def within_limit(region: str, power_dbm: float, gain_dbi: float) -> None:
    """ValueError, naming the limit and the mend, where a conducted power and the antenna's gain make more than the region allows."""
    limit, eirp = REGIONS[region].limit_dbm, power_dbm + gain_dbi
    if eirp > limit + ROUNDING:
        raise ValueError(
            f"it radiates {eirp:g} dBm EIRP ({power_dbm:g} dBm and {gain_dbi:g} dBi), over the limit of {limit:g} dBm "
            f"({REGIONS[region].limit_says}): at most {limit - gain_dbi:g} dBm go with this antenna"
        )
