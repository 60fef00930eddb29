"""Whether the road that a vehicle was said to be on is the one that it was on."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import usable
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Metres, Seconds
from testbed.recording import Trial
from testbed.roads import nearest_segment, project
from testbed.types import Track


def identified(track: Track, truth: Array, trial: Trial) -> Array:
    """(K, B) bool: report times at which the segment nearest to the estimate is the one nearest to the truth (K, B, 6).

    False where a row is lost, has no place in x and y, or the site has no roads.
    """
    roads = trial.recording.site.roads
    stands = usable(track)
    if roads is None or not {"x", "y"} <= set(track.components):
        return np.zeros(stands.shape, dtype=bool)
    places = [track.components.index(name) for name in ("x", "y")]
    said = nearest_segment(roads, np.where(stands[..., None], track.mean[..., places], np.nan))
    return (said >= 0) & (said == nearest_segment(roads, truth[..., :2]))


class RoadSegment:
    """Share of report times with the right segment, and share of those at which the vehicle itself was off the network.

    A lost row has named no segment, and counts as wrong. NaN where the site has no roads.
    """

    on_request: ClassVar[bool] = True  # says nothing without roads: scenarios name it

    class Config(BaseConfig):
        """skip_s: report times before it are left out; off_m: a vehicle further from every road than this is off the network."""

        skip_s: Annotated[Seconds, Field(ge=0)] = 0.0
        off_m: Annotated[Metres, Field(gt=0)] = 1.5

    columns: ClassVar[dict[str, str]] = {
        "segment.identified": "share of report times at which the right road segment was named, 0 to 1",
        "segment.off_network": "share of report times at which the vehicle was off every road, 0 to 1",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), from 0 to 1."""
        chosen = track.t >= self._config.skip_s
        roads = trial.recording.site.roads
        if roads is None or not chosen.any():
            return {name: np.full(len(track.trial), np.nan) for name in self.columns}
        right = identified(track, truth, trial)[chosen]
        off = project(roads, truth[chosen][..., :2])[2] > self._config.off_m
        return {"segment.identified": right.mean(axis=0), "segment.off_network": off.mean(axis=0)}
