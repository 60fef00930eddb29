"""Random numbers by name and by counter: who draws never depends on who else draws.

Two kinds, both keyed by (root seed, trial, name):

* `stream(root, trial, name)`: an ordinary numpy Generator, for something that draws once in a fixed order (the start of
  a vehicle, the offset of a prior). Adding another name moves nothing.
* `Counter(root, trial, name)`: a mixed 64-bit function of the key and of any number of integer counters (antenna key,
  tag key, read index), for the radio and for rows of an estimator. Each draw is a function of its own indices, so adding
  a tag or an antenna, another chunk size or another order changes no other draw.

The mixing function is the finaliser of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
OOPSLA 2014), applied once a counter.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from testbed.columns import Array

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)


def key_of(name: str) -> int:
    """A 64-bit key of a name (blake2b), the same in every process."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def keys_of(names: list[str] | tuple[str, ...] | Array) -> Array:
    """(N,) uint64: `key_of` for each name."""
    return np.array([key_of(str(name)) for name in names], dtype=np.uint64)


def stream(root: int, trial: int, name: str) -> np.random.Generator:
    """The generator of one named consumer in one trial."""
    words = np.frombuffer(hashlib.blake2b(name.encode(), digest_size=16).digest(), dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(root, spawn_key=(trial, *map(int, words)))))


def _mix(z: Array) -> Array:
    z = (z ^ (z >> np.uint64(30))) * _MIX1
    z = (z ^ (z >> np.uint64(27))) * _MIX2
    return z ^ (z >> np.uint64(31))


def mix(key: ArrayLike, *counters: ArrayLike) -> Array:
    """A 64-bit hash of `key` and the counters, broadcast together: uint64, as good as independent for distinct inputs."""
    with np.errstate(over="ignore"):
        state = np.asarray(key).astype(np.uint64)
        for place, counter in enumerate(counters, start=1):
            word = np.asarray(counter)
            word = word.astype(np.int64).view(np.uint64) if word.dtype.kind == "i" else word.astype(np.uint64)
            state = _mix(state + _GOLDEN * np.uint64(place) ^ _mix(word + _GOLDEN))
        return _mix(state + _GOLDEN)


def uniform_of(bits: Array) -> Array:
    """uint64 to float64 in the open interval (0, 1): 53 bits, centred so that neither end is hit."""
    return ((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53


class Counter:
    """Counter-based draws of one name in one trial: every draw is a function of its integer indices alone."""

    def __init__(self, root: int, trial: int, name: str) -> None:
        words = np.random.SeedSequence(root, spawn_key=(trial,)).generate_state(1, np.uint64)
        self.key = mix(words[0], np.uint64(key_of(name)))

    def bits(self, *counters: ArrayLike) -> Array:
        """uint64, the broadcast shape of the counters."""
        return mix(self.key, *counters)

    def uniform(self, *counters: ArrayLike) -> Array:
        """float64 in (0, 1), the broadcast shape of the counters."""
        return uniform_of(self.bits(*counters))

    def normal(self, *counters: ArrayLike) -> Array:
        """float64, standard normal by inversion (one draw a number, so a draw stays a function of its indices)."""
        return ndtri(self.uniform(*counters))


class RowRandom:
    """What an estimator draws from: B rows, each with its own stream, so that a row's numbers do not depend on its company.

    A row's n-th draw is a function of (row seed, n): rows may be batched, split or reordered.
    """

    def __init__(self, seed: ArrayLike) -> None:
        self.seed = np.asarray(seed, dtype=np.uint64)
        self._drawn = np.zeros(self.seed.shape, dtype=np.uint64)

    def uniform(self, n: int, rows: Array | None = None) -> Array:
        """(B, n) float64 in (0, 1); or (len(rows), n) for the rows given, which must be distinct."""
        from testbed.mixing import row_uniforms  # compiled: not for those who only want a name's stream

        rows = np.arange(len(self.seed)) if rows is None else rows
        first = self._drawn[rows]
        self._drawn[rows] += np.uint64(n)
        return row_uniforms(self.seed[rows], first, n)

    def normal(self, n: int, rows: Array | None = None) -> Array:
        """(B, n) float64 standard normal; or (len(rows), n)."""
        return ndtri(self.uniform(n, rows))

    def generator(self, row: int) -> np.random.Generator:
        """An ordinary numpy Generator for one row: for methods written for one target."""
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(self.seed[row]))))
