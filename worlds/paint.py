"""Colours of the things in a hall, for renders: muted ones, so that the tracks drawn over them stand out.

They differ in brightness as well as in hue, so that people with any kind of colour vision tell them apart.
"""

from __future__ import annotations

Colour = tuple[float, float, float]

BACKGROUND = (244, 246, 248)  # of 255
FLOOR = (214, 217, 219)

_MATERIALS: dict[str, str] = {
    "steel": "#8C96A0",
    "rack_bay": "#C2B49B",
    "carton": "#C9AC82",
    "liquid_pallet": "#8FB4C9",
    "person": "#64796A",
    "wood": "#B08D62",
    "plastic": "#A9B7A4",
    "concrete": "#E4E3DF",
    "rubber": "#33363B",
    "glass": "#CFE0E6",
}
_OTHER = "#B5A9B8"

# what a thing is made of looks different on different things: the steel of a rack is not the steel of a forklift
_KINDS: dict[tuple[str, str], str] = {
    ("rack", "steel"): "#4A6483",
    ("gate", "steel"): "#2C3E57",
    ("forklift", "steel"): "#D9B13B",
    ("trolley", "steel"): "#6E7780",
    ("post", "steel"): "#55606C",
}


def colour(kind: str, material: str) -> Colour:
    """(red, green, blue) in [0, 1] of a material on a kind of body; of unknown ones a neutral colour."""
    text = _KINDS.get((kind, material)) or _MATERIALS.get(material, _OTHER)
    return int(text[1:3], 16) / 255, int(text[3:5], 16) / 255, int(text[5:7], 16) / 255
