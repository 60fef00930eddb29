"""Tag models by name: what the data sheet of a tag's chip says."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.plugins import suggest


@dataclass(frozen=True)
class TagModel:
    """Power that wakes the chip (dBm), antenna gain (dBi, assumed the same all round), and the place it comes from."""

    sensitivity_dbm: float
    gain_dbi: float
    source: str


TAG_MODELS: dict[str, TagModel] = {
    "monza_4": TagModel(-19.5, 2.0, "Impinj Monza 4 data sheet: read sensitivity with a dipole -19.5 dBm"),
    "monza_r6": TagModel(-22.1, 2.0, "Impinj Monza R6 data sheet: read sensitivity with a dipole -22.1 dBm"),
}


def tag_model(name: str) -> TagModel:
    """ValueError, with the nearest name, for a model nobody knows."""
    if name not in TAG_MODELS:
        raise ValueError(f"unknown tag model {name!r}{suggest(name, list(TAG_MODELS))}")
    return TAG_MODELS[name]
