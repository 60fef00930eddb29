"""What an event says of received power, as vectors: E entries of m components, each by one antenna of one tag.

A read is a vector of one; a snapshot has a component for each antenna and tag, NaN where the one did not hear the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Annotated

import numpy as np
from pydantic import Field

from estimators.rssi_model import measured
from testbed.quantity import Config
from testbed.types import Array, Event, Site, Snapshots

Pattern = Annotated[str, Field(min_length=1, max_length=200)]


class HeardConfig(Config):
    """Which reads count, and whether those of one instant are taken together, as one vector.

    `antennas` and `tags` are patterns over their ids. Taken together, a filter linearises once for all antennas; one by one,
    each read is taken where the one before it has brought the belief.
    """

    together: bool = False
    antennas: Pattern = "*"
    tags: Pattern = "*"


@dataclass(frozen=True, eq=False)
class Heard:
    """Received power by entry and component: row (E,), t (E,) s, antenna and tag (E, m), rssi (E, m) dBm with NaN for none.

    slot (m,): which of its target's tags a component is about, as the target lists them; 0 for reads.
    """

    row: Array
    t: Array
    antenna: Array
    tag: Array
    rssi: Array
    slot: Array

    @property
    def present(self) -> Array:
        """(E,) bool: whether anything was heard at all."""
        return np.asarray(np.isfinite(self.rssi).any(axis=1))

    def by_antenna(self, antennas: int) -> Array:
        """(E, antennas) dBm: of the target's first tag that an antenna heard; NaN where it heard none."""
        found = np.full((len(self.row), antennas), np.nan)
        entry = np.arange(len(self.row))
        for component in reversed(range(self.rssi.shape[1])):
            there = np.isfinite(self.rssi[:, component])
            found[entry[there], self.antenna[there, component]] = self.rssi[there, component]
        return found


class Hearing:
    """Makes vectors of events, for the antennas and tags that a configuration picks.

    ValueError, in the name of `method`, for a pattern that nothing fits.
    """

    def __init__(self, config: HeardConfig, site: Site, method: str) -> None:
        self.consumes = frozenset({"snapshots" if config.together else "reads"})
        self.antennas = chosen(config.antennas, site.antennas.id, "antenna", method)
        self._antenna_counts = np.isin(np.arange(len(site.antennas)), self.antennas)
        self._tag_counts = np.isin(np.arange(len(site.tags)), chosen(config.tags, site.tags.id, "tag", method))
        self._all = bool(self._antenna_counts.all() and self._tag_counts.all())

    def of(self, event: Event) -> Heard:
        """The event's vectors; components that no entry has are left out."""
        return self._snapshots(event) if event.kind == "snapshots" else self._reads(event)

    def counts(self, shots: Snapshots) -> Array:
        """(E, T, M) bool: which cells of snapshots are of tags and antennas that are picked."""
        return self._wanted(shots.tag)[:, :, None] & self._antenna_counts

    def _wanted(self, tag: Array) -> Array:
        return (tag >= 0) & self._tag_counts[tag]

    def _reads(self, event: Event) -> Heard:
        reads = event.data
        rssi = measured(reads.rssi)
        if not self._all:
            rssi = np.where(self._antenna_counts[reads.antenna] & self._tag_counts[reads.tag], rssi, np.nan)
        return Heard(event.row, reads.t, reads.antenna[:, None], reads.tag[:, None], rssi[:, None], _FIRST)

    def _snapshots(self, event: Event) -> Heard:
        shots = event.data
        slots, antennas = shots.tag.shape[1], self.antennas
        counts = self._wanted(shots.tag)
        rssi = np.where(counts[:, :, None], measured(shots.rssi[:, :, antennas]), np.nan).reshape(len(event), slots * len(antennas))
        antenna = np.tile(antennas, slots)
        tag = np.repeat(np.maximum(shots.tag, 0), len(antennas), axis=1)
        some = np.flatnonzero(np.isfinite(rssi).any(axis=0))
        by = np.broadcast_to(antenna[some], (len(event), len(some)))
        return Heard(event.row, shots.t, by, tag[:, some], rssi[:, some], np.repeat(np.arange(slots), len(antennas))[some])


_FIRST = np.zeros(1, dtype=np.int64)


def chosen(pattern: str, ids: Array, what: str, method: str) -> Array:
    """Indices of the ids that fit a pattern. ValueError where none does, unless there are no ids at all."""
    found = [i for i, id in enumerate(ids) if fnmatchcase(str(id), pattern)]
    if not found and len(ids):
        more = ", ..." if len(ids) > 8 else ""
        raise ValueError(f"{method}: no {what} is named {pattern!r}; there are {', '.join(map(str, ids[:8]))}{more}")
    return np.array(found, dtype=np.int64)
