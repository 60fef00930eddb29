"""The shape of a person, shared by everybody who walks, pushes or drives."""

from __future__ import annotations

import numpy as np

from worlds.parts import Builder


def stand(built: Builder, height: float, x: float = 0.0) -> None:
    """Boxes of a standing adult of `height` m at (x, 0), looking along +x: two legs, torso with arms, head and neck.

    Proportions after the body-segment lengths of Drillis and Contini (1966): legs to 0.53 of the height, shoulders at 0.82,
    shoulder breadth 0.26.
    """
    h = height
    for side in (1, -1):
        inner, outer = 0.01 * h, 0.10 * h
        low, high = sorted((side * inner, side * outer))
        built.box("person", (x - 0.06 * h, low, 0.0), (x + 0.06 * h, high, 0.53 * h))
    built.box("person", (x - 0.07 * h, -0.13 * h, 0.53 * h), (x + 0.07 * h, 0.13 * h, 0.82 * h))
    built.box("person", (x - 0.055 * h, -0.045 * h, 0.82 * h), (x + 0.055 * h, 0.045 * h, h))


def sit(built: Builder, x: float, seat: float) -> None:
    """Boxes of a seated driver at (x, 0), looking along +x, on a seat `seat` m above the floor: thighs, torso, head."""
    built.box("person", (x, -0.2, seat), (x + 0.5, 0.2, seat + 0.16))
    built.box("person", (x - 0.12, -0.23, seat), (x, 0.23, seat + 0.58))
    built.box("person", (x - 0.1, -0.08, seat + 0.58), (x + 0.09, 0.08, seat + 0.85))


def badge_places(height: float) -> list[tuple[str, tuple[float, float, float], float]]:
    """Where a person carries a tag, as (name, place, yaw): on the chest, on the back, at either hip."""
    reach, chest, hip = 0.07 * height + 0.02, 0.72 * height, 0.55 * height
    side = 0.13 * height + 0.02
    return [
        ("chest", (reach, 0.0, chest), 0.0),
        ("back", (-reach, 0.0, chest), np.pi),
        ("left", (0.0, side, hip), np.pi / 2),
        ("right", (0.0, -side, hip), -np.pi / 2),
    ]
