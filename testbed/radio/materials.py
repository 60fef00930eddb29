"""What a radio wave at 865-928 MHz loses in the things that stand in a hall.

Loss of a straight path through an obstacle: `entry_db` once, plus `per_metre_db` for each metre inside. Building materials
follow from their permittivity; the others are engineering values, chosen inside the ranges given beside them. Left out:
the angle of incidence, frequency within the band, moisture, and everything that goes round an edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.plugins import suggest

FREQUENCY = 0.87  # GHz, where the dielectric figures are taken; σ changes by 5 % over the band


@dataclass(frozen=True)
class Material:
    """Loss in dB on entry (both faces together) and in dB per metre inside, with the place the figures come from; whether it is metal."""

    entry_db: float
    per_metre_db: float
    source: str
    metal: bool = False


def _dielectric(permittivity: float, c: float, d: float) -> Material:
    """ITU-R P.2040-3: σ = c f^d (Table 3), 1636 σ/√ε' dB per metre (good dielectric), and the reflection at two faces."""
    conductivity = c * FREQUENCY**d
    index = np.sqrt(permittivity)
    reflected = ((index - 1) / (index + 1)) ** 2
    return Material(
        entry_db=float(-20 * np.log10(1 - reflected)),
        per_metre_db=float(1636 * conductivity / index),
        source=f"ITU-R P.2040-3: relative permittivity {permittivity}, conductivity {c} f^{d}",
    )


MATERIALS: dict[str, Material] = {
    "steel": Material(40.0, 0.0, "metal blocks: 35 dB and more; skin depth at 870 MHz is microns", metal=True),
    "rack_bay": Material(10.0, 12.0, "full rack bay of mixed goods, 20-30 dB over about 1.1 m: engineering value"),
    "carton": Material(1.0, 8.0, "packed carton, 3-6 dB over 0.3-0.6 m: engineering value"),
    "liquid_pallet": Material(15.0, 10.0, "pallet of liquid, 20-30 dB over about 1 m: engineering value"),
    "person": Material(5.0, 20.0, "human body, 8-15 dB over 0.2-0.4 m: engineering value"),
    "rubber": Material(3.0, 40.0, "tyre with carbon black: engineering value"),
    "plastic": Material(0.4, 2.0, "polyethylene, relative permittivity 2.3: reflection at two faces; loss inside an engineering value"),
    "wood": _dielectric(1.99, 0.0047, 1.0718),
    "concrete": _dielectric(5.24, 0.0462, 0.7822),
    "glass": _dielectric(6.31, 0.0036, 1.3394),
}


def losses(names: tuple[str, ...]) -> tuple[Array, Array]:
    """(entry_db, per_metre_db), each (materials,), for a scene's materials by name. ValueError for an unknown one."""
    for name in names:
        if name not in MATERIALS:
            raise ValueError(f"unknown material {name!r}{suggest(name, list(MATERIALS))}")
    chosen = [MATERIALS[name] for name in names]
    return np.array([m.entry_db for m in chosen]), np.array([m.per_metre_db for m in chosen])
