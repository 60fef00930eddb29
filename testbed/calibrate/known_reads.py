"""Reads of tags whose place is known at every read: what a reader's channel can be fitted to.

A place is known from the site (`tags.N.position_m`, which never moves) or from a truth file. A tag that moves without a truth says
nothing of levels, and two tags with one EPC say nothing of flips: both are left out, and notes say so.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from testbed import frames
from testbed.calibrate import CalibrationError
from testbed.columns import Array, Table, column
from testbed.logs.library import Piece, at, of_target
from testbed.logs.recordings import targets_of
from testbed.logs.site import SiteModel, antennas_of
from testbed.logs.still import shares_an_epc
from testbed.radio.antenna import exponent
from testbed.types import Antennas, Reads

CELL_M = 0.17  # half a wavelength at 866 MHz: nearer places fade alike, and count as one
NEAR_M = 0.1
OMNIDIRECTIONAL = np.pi  # rad of beam width, from which an antenna counts as the same all round


@dataclass(frozen=True, eq=False)
class KnownReads(Table):
    """N reads by antenna, tag, time. pattern: of the antenna towards the tag, once; place: a number of antenna, tag and CELL_M of floor."""

    t: Array = column("float64", unit="s")
    antenna: Array = column("int64")
    tag: Array = column("int64")
    channel: Array = column("int64")
    rssi: Array = column("float64", unit="dBm")
    phase: Array = column("float64", unit="rad")
    distance: Array = column("float64", unit="m")
    pattern: Array = column("float64", unit="dB relative to boresight")
    place: Array = column("int64")


@dataclass(frozen=True)
class Heard:
    """A log for calibration. every: reads of all tags, which the reader's pace is of; names: of the tags that `known` indexes."""

    known: KnownReads
    every: Reads
    duration: float
    names: list[str]
    notes: list[str] = field(default_factory=list)


def known_reads(site: SiteModel, piece: Piece) -> Heard:
    """The reads of a log with their tags' places. CalibrationError where no tag has one."""
    log, notes = piece.log, list(piece.log.notes)
    fixed = {t.id: np.array(t.position_m) for t in site.tags if t.position_m is not None}
    targets, tags = targets_of(site, log)
    path = {}
    for name, own in zip(targets.name, tags, strict=True):
        found = of_target(piece.truth, str(name), len(targets) > 1) if piece.truth else None
        path.update({int(tag): found for tag in own if found is not None})
    parts: list[KnownReads] = []
    antennas = antennas_of(site.antennas)
    for tag, name in enumerate(log.tags):
        reads = log.reads.take((log.reads.tag == tag) & np.isfinite(log.reads.rssi))
        if name in fixed:
            if shares_an_epc(reads):
                notes.append(f"{name} is left out: its reads are of two tags with one EPC")
                continue
            position = np.broadcast_to(fixed[name], (len(reads), 3))
        elif tag in path:
            reads = reads.take((reads.t >= path[tag].t[0]) & (reads.t <= path[tag].t[-1]))
            position = at(path[tag], reads.t)
        else:
            notes.append(f"{name} is left out: nobody says where it is (position_m in the site, or a truth)")
            continue
        parts.append(_placed(reads, position, antennas))
    if not sum(map(len, parts)):
        raise CalibrationError(
            f"{piece.name}: no read is of a tag whose place is known: give tags position_m in the site, or a path with --truth"
        )
    known = KnownReads.concatenate(parts)
    known = known.take(np.lexsort((known.t, known.tag, known.antenna)))
    return Heard(known, log.reads, log.duration, list(log.tags), notes)


def _placed(reads: Reads, position: Array, antennas: Antennas) -> KnownReads:
    towards = position - antennas.position[reads.antenna]
    distance = np.linalg.norm(towards, axis=1)
    cells = np.column_stack([reads.antenna, reads.tag, np.floor(position / CELL_M).astype(np.int64)])
    place = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1) if len(cells) else np.empty(0, dtype=np.int64)
    tag = int(reads.tag[0]) if len(reads) else 0
    return KnownReads(
        reads.t, reads.antenna.astype(np.int64), reads.tag.astype(np.int64), reads.channel.astype(np.int64), reads.rssi, reads.phase,
        np.maximum(distance, NEAR_M), _pattern(antennas, reads.antenna, towards, distance), place + (tag << 32),
    )  # fmt: skip


def _pattern(antennas: Antennas, antenna: Array, towards: Array, distance: Array) -> Array:
    """(N,) dB: cos^n of each antenna about its axis down to its floor behind; 0 for one that is the same all round."""
    width = np.minimum(antennas.beamwidth, OMNIDIRECTIONAL * 0.999)
    n = np.where(antennas.beamwidth < OMNIDIRECTIONAL, exponent(width), 0.0)[antenna]
    axis = frames.rotate(antennas.quaternion[antenna], np.array([1.0, 0.0, 0.0]))
    cosine = np.einsum("ni,ni->n", axis, towards) / np.maximum(distance, 1e-9)
    floor = np.where(n > 0, -antennas.front_to_back[antenna], 0.0)
    return np.where(n > 0, np.maximum(10 * n * np.log10(np.maximum(cosine, 1e-12)), floor), 0.0)
