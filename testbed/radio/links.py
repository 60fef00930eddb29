"""The links between antennas and tags: where both ends are, how they look at each other, what stands between them.

Obstruction is split by what can change: the static hall is cast once for a pair that never moves and kept for all trials;
moving bodies are cast at each instant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.protocols import Caster, Obstruction
from testbed.radio.antenna import exponent, off_boresight, pattern_db
from testbed.scene import WORLD, Truth
from testbed.types import Antennas


@dataclass(frozen=True)
class Ends:
    """One side of the links, N antennas or tags: moving body of each (-1 for the world) and pose (N, 7) in its frame."""

    body: Array
    pose: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", np.asarray(self.pose, dtype=np.float64))  # whole numbers would be carried as whole numbers

    def at(self, truth: Truth, index: Array, t: Array) -> Array:
        """World poses (..., 7) of the ends `index` (...) at times t (...)."""
        index, t = np.broadcast_arrays(index, t)
        pose = np.array(self.pose[index])
        rides = self.body[index] != WORLD
        if rides.any():
            carrier = truth.pose(self.body[index[rides]], t[rides])
            pose[rides] = frames.compose(carrier, pose[rides])
        return pose


@dataclass(frozen=True)
class Geometry:
    """N links at their instants: ends (N, 3) m, distance (N,) m, and the antenna's gain towards the tag (N,) dBi."""

    start: Array
    end: Array
    distance: Array
    gain: Array


class StaticObstruction:
    """Obstruction of antenna × tag pairs by what never moves, cast when first asked for and kept."""

    def __init__(self, antennas: int, tags: int) -> None:
        self._known = np.zeros((antennas, tags), dtype=bool)
        self._count = np.zeros((antennas, tags), dtype=np.int32)
        self._loss = np.zeros((antennas, tags))

    def of(self, caster: Caster, antenna: Array, tag: Array, geometry: Geometry, fixed: Array) -> Obstruction:
        """Obstruction (N,) of the links; where `fixed` (N,) says that neither end moves it is looked up."""
        new = fixed & ~self._known[antenna, tag]
        first = np.zeros(len(antenna), dtype=bool)
        first[np.unique(antenna * self._known.shape[1] + tag, return_index=True)[1]] = True
        cast = np.flatnonzero(~fixed | (new & first))
        found = caster.static(geometry.start[cast], geometry.end[cast])
        keep = fixed[cast]
        a, k = antenna[cast[keep]], tag[cast[keep]]
        self._known[a, k], self._count[a, k], self._loss[a, k] = True, found.count[keep], found.loss[keep]
        count, loss = self._count[antenna, tag], self._loss[antenna, tag]
        count[cast], loss[cast] = found.count, found.loss
        return Obstruction(count=count, loss=loss)


class Links:
    """All links of one sensor in one trial."""

    def __init__(self, antennas: Antennas, near: Ends, far: Ends, truth: Truth, caster: Caster, static: StaticObstruction) -> None:
        self._antennas, self._near, self._far = antennas, near, far
        self._truth, self._caster, self._static = truth, caster, static
        self._exponent = exponent(antennas.beamwidth)

    def geometry(self, antenna: Array, tag: Array, t: Array) -> Geometry:
        """Links between antennas (N,) and tags (N,) at times t (N,)."""
        looking = self._near.at(self._truth, antenna, t)
        end = self._far.at(self._truth, tag, t)[..., :3]
        cosine, distance = off_boresight(looking[..., 3:], end - looking[..., :3])
        shape = pattern_db(cosine, self._exponent[antenna], self._antennas.front_to_back[antenna])
        return Geometry(looking[..., :3], end, distance, self._antennas.gain[antenna] + shape)

    def obstruction(self, antenna: Array, tag: Array, t: Array, geometry: Geometry) -> Obstruction:
        """What stands on those links at those times: count (N,), loss (N,) dB."""
        fixed = (self._near.body[antenna] == WORLD) & (self._far.body[tag] == WORLD)
        static = self._static.of(self._caster, antenna, tag, geometry, fixed)
        if not self._truth.bodies or not len(antenna):
            return static
        instants, instant = np.unique(t, return_inverse=True)
        poses = self._truth.pose(np.arange(len(self._truth.bodies)), instants[:, None])
        moving = self._caster.moving(geometry.start, geometry.end, poses, instant.astype(np.int64))
        return Obstruction(count=static.count + moving.count, loss=static.loss + moving.loss)
