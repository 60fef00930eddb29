"""The data that flow from a world or a reader's log to a result: streams, what an installer knows, estimates, tracks.

The motion of a world is in `testbed.scene`, out of an estimator's reach. Everything here is columnar and read-only
(`testbed.columns`), SI and radians. Units are in each field's declaration. A time `t` is when a thing was true,
`t_arrival` when the estimator's computer got it; both are seconds from the start of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Self

import numpy as np

from testbed.columns import Array, Columns, Table, column
from testbed.geometry import Boxes, Roads
from testbed.rng import RowRandom

__all__ = [
    "POSITION", "POSITION_VELOCITY", "Antennas", "Array", "Counts", "Estimate", "Event", "Heading", "Heights", "Innovations",
    "Odometry", "Prior", "Ranges", "Reads", "ReferenceSnapshots", "References", "RoundCounts", "Rounds", "Site", "Snapshots", "Status",
    "Stream", "Tags", "Targets", "Track", "UpdateInfo",
]  # fmt: skip

POSITION = ("x", "y", "z")  # m, world frame
POSITION_VELOCITY = ("x", "y", "z", "vx", "vy", "vz")  # m and m/s, world frame


# ---------------------------------------------------------------- streams


@dataclass(frozen=True, eq=False)
class Reads(Table):
    """One row per successful read of a tag.

    antenna and tag index `Site.antennas` and the recording's `Tags`; channel is a place in the hop table, not a
    frequency order. Quantities that a reader does not report are NaN.
    """

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    antenna: Array = column("int32")
    tag: Array = column("int32")
    channel: Array = column("int16", default=0)
    rssi: Array = column("float64", unit="dBm", default=np.nan)
    phase: Array = column("float64", unit="rad, in [0, 2π)", default=np.nan)
    doppler: Array = column("float64", unit="Hz", default=np.nan)


@dataclass(frozen=True, eq=False)
class Rounds(Table):
    """One row per antenna of a reader's inventory round: what was asked, whether or not anything answered.

    `queries` is how often each tag could have answered. `asked` names the population: an index into the recording's
    `asked_sets`, each a mask over its tags (Select and session flags leave tags out; their silence is no data).
    """

    round: Array = column("int64")
    t_start: Array = column("float64", unit="s")
    t_end: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    antenna: Array = column("int32")
    reader: Array = column("int16")
    queries: Array = column("int32")
    asked: Array = column("int32", default=0)

    @property
    def t(self) -> Array:
        """(N,) s: when the count was complete, the time an event is processed at."""
        return self.t_end


@dataclass(frozen=True, eq=False)
class Counts(Table):
    """The non-zero counts of the rounds: (round, antenna, tag) was read n times. A tag asked without a row was silent."""

    round: Array = column("int64")
    antenna: Array = column("int32")
    tag: Array = column("int32")
    n: Array = column("int32")


@dataclass(frozen=True, eq=False)
class RoundCounts(Table):
    """What a tag answered to one antenna of one round, zero included: `Rounds` and `Counts` joined for the rows of an estimator.

    One entry per round, antenna and tag that was asked; the event of the stream "rounds".
    """

    t: Array = column("float64", unit="s, end of the antenna's turn")
    t_start: Array = column("float64", unit="s")
    round: Array = column("int64")
    reader: Array = column("int16")
    antenna: Array = column("int32")
    tag: Array = column("int32")
    queries: Array = column("int32")
    n: Array = column("int32")


@dataclass(frozen=True, eq=False)
class Odometry(Table):
    """Speed along the body's +x and yaw rate (NaN where not measured) of the body `carrier` (index of a target)."""

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    carrier: Array = column("int32")
    speed: Array = column("float64", unit="m/s")
    yaw_rate: Array = column("float64", unit="rad/s", default=np.nan)


@dataclass(frozen=True, eq=False)
class Heading(Table):
    """Yaw of the body `carrier` (index of a target), counter-clockwise from +x, in (-π, π]."""

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    carrier: Array = column("int32")
    heading: Array = column("float64", unit="rad")


@dataclass(frozen=True, eq=False)
class Ranges(Table):
    """Distances between an anchor (index of `Site.antennas`) and a target."""

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    anchor: Array = column("int32")
    target: Array = column("int32")
    range: Array = column("float64", unit="m")


@dataclass(frozen=True, eq=False)
class Heights(Table):
    """Height over the floor of the body `carrier` (index of a target)."""

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s")
    carrier: Array = column("int32")
    height: Array = column("float64", unit="m")


@dataclass(frozen=True, eq=False)
class Snapshots(Table):
    """All that the antennas read of a target's tags at one and the same instant; the event of the stream "snapshots".

    Of reads alone, put together: M antennas of the site by T tags of the target (those of the target with the most; -1 for none).
    """

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s, of the last of its reads")
    tag: Array = column("int32", ("N", "T"))
    rssi: Array = column("float64", ("N", "T", "M"), "dBm, NaN where not heard")
    phase: Array = column("float64", ("N", "T", "M"), "rad, NaN where not heard")


@dataclass(frozen=True, eq=False)
class ReferenceSnapshots(Table):
    """All that the antennas read of the site's R reference tags at one instant; the event of the stream "reference_snapshots"."""

    t: Array = column("float64", unit="s")
    t_arrival: Array = column("float64", unit="s, of the last of its reads")
    rssi: Array = column("float64", ("N", "R", "M"), "dBm, NaN where not heard")


Stream = Reads | Rounds | Counts | Odometry | Heading | Ranges | Heights


@dataclass(frozen=True, eq=False)
class Event:
    """One step of a stream for some rows of an estimator: at most one entry a row, each with its own time.

    kind : the stream's kind, as an estimator names it in `consumes` ("reads", "odometry", ...)
    row  : (E,) int64, distinct and ascending, which of the estimator's B rows each entry is for
    data : the kind's Table of E entries (`Reads`, `RoundCounts` for "rounds", ...), entry i for row `row[i]`
    """

    kind: str
    row: Array
    data: Any

    def __len__(self) -> int:
        return len(self.row)


# ---------------------------------------------------------------- what an installer knows


@dataclass(frozen=True, eq=False)
class Antennas(Table):
    """Antennas of all readers of a site. Pose in the frame of `carrier` (a body's name), or of the world where that is "".

    An antenna looks along its own +x. Its pattern is `pattern`, where it has one; else cos^n of the angle off boresight, with n from the
    half-power `beamwidth` (full angle) and a floor `front_to_back` below the maximum. Both are also given, nearly, where there is a
    table. A linear antenna has its field along its own +z.
    """

    id: Array = column("str")
    position: Array = column("float64", ("N", 3), "m")
    quaternion: Array = column("float64", ("N", 4), "(w, x, y, z)")
    gain: Array = column("float64", unit="dBi")
    beamwidth: Array = column("float64", unit="rad")
    front_to_back: Array = column("float64", unit="dB")
    power: Array = column("float64", unit="dBm conducted")
    carrier: Array = column("str", default="")
    reader: Array = column("str", default="")
    polarisation: Array = column("str", unit="circular or linear", default="circular")
    pattern: Array = column(
        "float64", ("N", 181), "dB relative to boresight, at 0, 1, ..., 180° off it; NaN without a table", default=np.nan
    )
    reference: Array = column("float64", unit="dBm, measured of a tag or beacon 1 m off on boresight; NaN if never", default=np.nan)


@dataclass(frozen=True, eq=False)
class References(Table):
    """Tags whose place is known: `tag` indexes the recording's `Tags`."""

    tag: Array = column("int32")
    position: Array = column("float64", ("N", 3), "m")


@dataclass(frozen=True, eq=False)
class Tags(Table):
    """The tags that a recording speaks of: what a data sheet and the EPC say, not where they are.

    `gain` is that of the best direction; a "dipole" has less elsewhere, an "isotropic" tag the same all round.
    """

    id: Array = column("str")
    gain: Array = column("float64", unit="dBi", default=2.0)
    sensitivity: Array = column("float64", unit="dBm", default=-19.5)
    pattern: Array = column("str", unit="dipole or isotropic", default="isotropic")


@dataclass(frozen=True, eq=False)
class Site:
    """What a real installer would know; all that an estimator gets besides the streams. Survey error included.

    frequencies : (C,) Hz, the hop table: a channel index is a place in it
    obstacles   : boxes as surveyed, in the world frame
    """

    antennas: Antennas
    tags: Tags
    frequencies: Array
    references: References = field(default_factory=References.empty)
    obstacles: Boxes = field(default_factory=Boxes.empty)
    roads: Roads | None = None


@dataclass(frozen=True, eq=False)
class Targets(Table):
    """What is to be located: a tag, or a body with all that it carries. Names only: where they are is truth.

    tags[i] of a recording's `target_tags` lists the tags of target i.
    """

    name: Array = column("str")
    body: Array = column("str")


# ---------------------------------------------------------------- estimates


class Status(IntEnum):
    """What an estimator says of its own estimate."""

    OK = 0
    COASTING = 1  # alive by prediction alone
    LOST = 2  # not to be relied on


@dataclass(frozen=True, eq=False)
class Prior(Columns):
    """Where the B rows of an estimator start. mean and covariance speak of `components`."""

    t: Array = column("float64", ("B",), "s")
    mean: Array = column("float64", ("B", "n"))
    covariance: Array = column("float64", ("B", "n", "n"))
    components: tuple[str, ...] = POSITION_VELOCITY

    @property
    def rows(self) -> int:
        """B."""
        return len(self.t)

    def take(self, rows: Array) -> Self:
        """The prior of some rows."""
        return self.with_(t=self.t[rows], mean=self.mean[rows], covariance=self.covariance[rows])


@dataclass(frozen=True, eq=False)
class UpdateInfo(Columns):
    """What an update did, per entry of its event. NaN (and dof 0) where a method has no such figure.

    nis is the normalised innovation squared, χ² with `dof` degrees of freedom under the method's own model.
    """

    used: Array = column("bool", ("E",))
    log_likelihood: Array = column("float64", ("E",), default=np.nan)
    nis: Array = column("float64", ("E",), default=np.nan)
    dof: Array = column("int32", ("E",), default=0)

    @classmethod
    def accepted(cls, n: int) -> Self:
        """All n entries taken, nothing else to say."""
        return cls(used=np.ones(n, dtype=bool))


@dataclass(frozen=True, eq=False)
class Estimate(Columns):
    """What B rows believe at one time: named components, mean, covariance, status, and the method's own extras.

    A row with nothing to say is LOST and may hold NaN; any other row is finite.
    """

    components: tuple[str, ...]
    mean: Array = column("float64", ("B", "n"))
    covariance: Array = column("float64", ("B", "n", "n"))
    status: Array = column("int8", ("B",), default=0)
    extras: dict[str, Array] = field(default_factory=dict)
    frame: str = "world"


@dataclass(frozen=True, eq=False)
class Innovations(Table):
    """Every update that said something of itself: row of the track, time, χ² statistic and its degrees of freedom."""

    row: Array = column("int32")
    t: Array = column("float64", unit="s")
    nis: Array = column("float64")
    dof: Array = column("int32")
    log_likelihood: Array = column("float64")


@dataclass(frozen=True, eq=False)
class Decisions(Table):
    """What an estimator announced of its rows: row of the track, when, what ("in", "out", ...), and how likely it held that to be."""

    row: Array = column("int32")
    t: Array = column("float64", unit="s")
    what: Array = column("str")
    probability: Array = column("float64")


@dataclass(frozen=True, eq=False)
class Track(Columns):
    """Estimates stacked over K report times, for B rows (trial, target), and what happened to the events on the way.

    particles holds P equally weighted samples of each belief where the method has particles and they were asked for, else P is 0.
    """

    t: Array = column("float64", ("K",), "s")
    mean: Array = column("float64", ("K", "B", "n"))
    covariance: Array = column("float64", ("K", "B", "n", "n"))
    status: Array = column("int8", ("K", "B"))
    trial: Array = column("int64", ("B",))
    target: Array = column("str", ("B",))
    used: Array = column("int64", ("B",))  # events taken
    refused: Array = column("int64", ("B",))  # events the estimator would not use (a gate, a NaN)
    late: Array = column("int64", ("B",))  # events dropped because the row had passed their time
    update_seconds: Array = column("float64", ("B",), "s")  # wall time of predict and update, shared among the rows of a call
    particles: Array = column("float32", ("K", "B", "P", 3), "m", default=0.0)
    components: tuple[str, ...] = POSITION_VELOCITY
    innovations: Innovations = field(default_factory=Innovations.empty)
    decisions: Decisions = field(default_factory=Decisions.empty)

    def take(self, rows: Array) -> Self:
        """The track of some rows (ascending indices)."""
        beside = {}
        for name in ("innovations", "decisions"):
            table = getattr(self, name)
            kept = table.take(np.isin(table.row, rows))
            beside[name] = kept.with_(row=np.searchsorted(rows, kept.row).astype(np.int32))
        axis0 = {n: getattr(self, n)[rows] for n in ("trial", "target", "used", "refused", "late", "update_seconds")}
        axis1 = {n: getattr(self, n)[:, rows] for n in ("mean", "covariance", "status", "particles")}
        return self.with_(**axis0, **axis1, **beside)


__all__ += ["Decisions", "RowRandom"]
