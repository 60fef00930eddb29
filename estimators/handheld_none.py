"""No filter at all: the control that every guide has to beat."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from estimators.handheld_guide import Guide, GuideConfig
from testbed.quantity import Degrees
from testbed.types import Array


class HandheldNone(Guide):
    """Straight on while the tag answers, a quarter turn to one side when it is silent. It measures nothing.

    In a readable run it takes as many steps as the published filter, for the antenna's edge alone leads to the tag; only a run without
    that edge (omni) tells them apart.
    """

    class Config(GuideConfig):
        """search_deg: a quarter turn to the left."""

        search_deg: Degrees = 90.0

    config: Config
    consumes: ClassVar[frozenset[str]] = frozenset({"actions"})

    def _begin(self) -> None:
        self._nothing = np.zeros(self.rows)

    def _turned(self, rows: Array, turn: Array, heard: Array, before: Array) -> None:
        """Nothing is kept."""

    def _stepped(self, rows: Array, step: Array, change: Array, spread: Array, trusted: Array) -> None:
        """Nothing is kept."""

    def _aim(self) -> Array:
        return self._nothing.copy()

    def _belief(self) -> tuple[Array, Array]:
        mean = np.stack([np.full(self.rows, 5.0), np.zeros(self.rows)], axis=1)
        return mean, np.tile(25.0 * np.eye(2), (self.rows, 1, 1))
