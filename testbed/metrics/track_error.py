"""How far a track is from the truth: the pieces that several metrics share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.columns import Array
from testbed.types import POSITION, POSITION_VELOCITY, Status, Track


def usable(track: Track) -> Array:
    """(K, B) bool: report times at which a row says something that it stands by, a finite mean and not LOST."""
    return np.isfinite(track.mean).all(axis=-1) & (track.status != Status.LOST)


def known_components(track: Track) -> list[str]:
    """The components of a track that the truth speaks of as well, in the track's order."""
    return [name for name in track.components if name in POSITION_VELOCITY]


def difference(track: Track, truth: Array, components: Sequence[str]) -> Array:
    """(K, B, len(components)): estimate minus truth (K, B, 6). ValueError for a component that either doesn't have."""
    mine = [track.components.index(name) for name in components]
    true = [POSITION_VELOCITY.index(name) for name in components]
    return track.mean[..., mine] - truth[..., true]


def distance(track: Track, truth: Array, dims: int) -> Array:
    """(K, B) m: distance between estimate and truth, on the floor (dims 2) or in space (dims 3).

    NaN where the track is not `usable`, and everywhere for a method that doesn't estimate all the axes asked for.
    """
    axes = list(POSITION[:dims])
    if not set(axes) <= set(track.components):
        return np.full(track.status.shape, np.nan)
    return np.where(usable(track), np.linalg.norm(difference(track, truth, axes), axis=-1), np.nan)
