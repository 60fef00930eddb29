"""Tag models by name: what the data sheet of a tag's chip says.

Left out: what a tag is stuck on (metal and liquid detune it by many dB), how its sensitivity changes over the band and with
temperature, and the spread from one tag to the next of the same make.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from testbed.plugins import suggest


@dataclass(frozen=True)
class TagModel:
    """Power that wakes the chip (dBm), gain of its antenna in its best direction (dBi), where both come from, and the antenna's pattern.

    A dipole hears by its direction (`testbed.radio.coupling`); `isotropic` is the same all round.
    """

    sensitivity_dbm: float
    gain_dbi: float
    source: str
    pattern: Literal["dipole", "isotropic"] = "dipole"


TAG_MODELS: dict[str, TagModel] = {
    "monza_4": TagModel(-19.5, 2.0, "Impinj Monza 4 data sheet: read sensitivity with a dipole -19.5 dBm"),
    "isotropic": TagModel(-19.5, 2.0, "no tag that exists: Monza 4 without a direction, for closed forms", "isotropic"),
    "monza_r6": TagModel(-22.1, 2.0, "Impinj Monza R6 data sheet: read sensitivity with a dipole -22.1 dBm"),
}


def tag_model(name: str) -> TagModel:
    """ValueError, with the nearest name, for a model nobody knows."""
    if name not in TAG_MODELS:
        raise ValueError(f"unknown tag model {name!r}{suggest(name, list(TAG_MODELS))}")
    return TAG_MODELS[name]
