"""Reads as fixes for a vehicle on roads: at an antenna that stands, or of a reference tag by an antenna that rides along."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import frames
from testbed.quantity import Config, Metres, Seconds
from testbed.types import Array, Event, Site

AHEAD = 1.0  # m: so far in front of a standing antenna tags are read on average


class FixesConfig(Config):
    """What a read says of the vehicle's place.

    fix_std_m : the likelihood is fix_floor + exp(-½ (d / fix_std_m)²), with d between what is read and where it is expected. Without it
    reads are not used at all
    fix_every_s : reads of one antenna (of one reference tag) within it count once: what one tells, the next repeats
    fix_ahead_m : standing antennas are looked for above the vehicle; an antenna that rides along and reads a reference tag has it so far
    ahead of the vehicle on average
    """

    fix_std_m: Annotated[Metres, Field(gt=0, le=1000)] | None = None
    fix_floor: Annotated[float, Field(ge=0, le=1)] = 0.01
    fix_every_s: Annotated[Seconds, Field(ge=0, le=1000)] = 0.5
    fix_ahead_m: Annotated[Metres, Field(ge=-100, le=100)] = 0.0


class Fixes:
    """Which reads count, and which place each speaks of."""

    def __init__(self, config: FixesConfig, site: Site) -> None:
        self._config = config
        antennas = site.antennas
        self._stands = antennas.carrier == ""
        # a gate's antennas look across the passage: the middle of their beam is where tags are read, a little ahead of the antenna
        forward = frames.rotate(antennas.quaternion, np.array([1.0, 0.0, 0.0])) if len(antennas) else np.empty((0, 3))
        self._place = antennas.position[:, :2] + AHEAD * forward[:, :2]
        self._tag_place = np.full((len(site.tags), 2), np.nan)
        self._tag_place[site.references.tag] = site.references.position[:, :2]

    def start(self, rows: int) -> None:
        """Forget what was heard."""
        self._newest = {kind: np.full((rows, n), -np.inf) for kind, n in self._sources().items()}

    def _sources(self) -> dict[str, int]:
        return {"reads": len(self._stands), "reference_reads": len(self._tag_place)}

    def taken(self, event: Event) -> tuple[Array, Array, float]:
        """(E,) which reads count, (E, 2) m the place of each, and how far ahead of the vehicle that is expected."""
        reads = event.data
        if event.kind == "reads":
            source, place, ahead = reads.antenna, self._place[reads.antenna], 0.0
            speaks = self._stands[reads.antenna]
        else:
            source, place, ahead = reads.tag, self._tag_place[reads.tag], self._config.fix_ahead_m
            speaks = ~self._stands[reads.antenna]
        if self._config.fix_std_m is None:
            return np.zeros(len(event), dtype=bool), place, ahead
        newest = self._newest[event.kind]
        used = speaks & np.isfinite(place).all(axis=1) & (reads.t - newest[event.row, source] >= self._config.fix_every_s)
        newest[event.row[used], source[used]] = reads.t[used]
        return used, place, ahead
