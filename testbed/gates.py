"""Gates as an installer knows them: antennas that hang together, and the vertical plane between outside and inside.

A leaf that estimators see as well as metrics: what is crossed is the same for both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.types import Antennas


@dataclass(frozen=True, eq=False)
class Gates:
    """G gates. name; origin (G, 2) m on the floor, the middle of its antennas; inward: rad, the direction of "in", of all of them.

    antenna_gate (A,) : which gate each antenna of the site belongs to; antenna_place (A,) : its number within the gate
    """

    name: tuple[str, ...]
    origin: Array
    inward: float
    antenna_gate: Array
    antenna_place: Array

    def local(self, gate: Array, position: Array) -> Array:
        """(..., 2) m: positions (..., 2 or 3) of the world in the frames of the gates (...): x inward from the plane, y to its left."""
        away = np.asarray(position)[..., :2] - self.origin[gate]
        c, s = np.cos(self.inward), np.sin(self.inward)
        return np.stack([c * away[..., 0] + s * away[..., 1], c * away[..., 1] - s * away[..., 0]], axis=-1)

    def world(self, gate: Array, local: Array) -> Array:
        """(..., 2) m: the other way."""
        c, s = np.cos(self.inward), np.sin(self.inward)
        x, y = local[..., 0], local[..., 1]
        return self.origin[gate] + np.stack([c * x - s * y, s * x + c * y], axis=-1)


def gates_of(antennas: Antennas, inward_deg: float) -> Gates:
    """Antennas named "<gate>.<place>" make a gate together; one without a full stop in its name belongs to a gate of its reader's name."""
    home = [str(id).rpartition(".")[0] or str(reader) or "gate" for id, reader in zip(antennas.id, antennas.reader, strict=True)]
    names = tuple(dict.fromkeys(home))
    gate = np.array([names.index(h) for h in home], dtype=np.int64)
    place = np.zeros(len(home), dtype=np.int64)
    for g in range(len(names)):
        place[gate == g] = np.arange(int((gate == g).sum()))
    origin = np.array([antennas.position[gate == g, :2].mean(axis=0) for g in range(len(names))]).reshape(-1, 2)
    return Gates(names, origin, float(np.radians(inward_deg)), gate, place)
