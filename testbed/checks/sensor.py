"""Does a sensor keep the contract of `testbed.protocols.Sensor`?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from testbed.checks import surroundings
from testbed.checks.common import ConformanceError, configured, require, untouched_globals
from testbed.columns import Array, Table
from testbed.protocols import Sensed, Sensor, Surroundings
from testbed.types import Counts, Heading, Heights, Odometry, Ranges, Reads, Rounds

STREAMS: dict[str, type[Table]] = {
    "reads": Reads,
    "rounds": Rounds,
    "counts": Counts,
    "odometry": Odometry,
    "heading": Heading,
    "ranges": Ranges,
    "heights": Heights,
}


def check_sensor(cls: type, config: Any = None, *, around: Surroundings | None = None) -> None:
    """Let a sensor sense a made-up hall (a cart with two tags named "cart" drives past a post) and judge its streams.

    `around` replaces that hall. Raises ConformanceError for the first rule that is broken.
    """
    config = configured(cls, config)
    kinds = getattr(cls, "produces", None)
    right = isinstance(kinds, frozenset) and kinds and kinds <= set(STREAMS)
    require(right, cls.__name__, f"produces must be a frozenset out of {sorted(STREAMS)}")
    case = _Case(cls, config, around or surroundings.made())
    with untouched_globals(cls.__name__):
        for check in _CHECKS:
            check(case)


@dataclass(frozen=True)
class _Case:
    cls: type
    config: Any
    around: Surroundings

    def require(self, holds: object, rule: str) -> None:
        require(holds, self.cls.__name__, rule)

    def made(self) -> Sensor:
        make: Callable[..., Sensor] = self.cls
        try:
            return make(self.config, "checked", self.around.scene)
        except ValueError as error:
            raise ConformanceError(f"{self.cls.__name__}: refuses the hall that it is checked in ({error}): give it another") from error

    def sensed(self, around: Surroundings | None = None, first: int = 0) -> Sensed:
        return self.made().sense(around or self.around, first)

    def unlike(self, a: Sensed, b: Sensed) -> str | None:
        """A stream that differs between the two, None where all are equal."""
        return next((kind for kind in sorted(a.streams) if not a.streams[kind].equals(b.streams[kind])), None)


# ---------------------------------------------------------------- the rules


def _describes_itself(case: _Case) -> None:
    sensor = case.made()
    ids = sensor.antennas().id.tolist()
    case.require(len(set(ids)) == len(ids), "two antennas have one id")
    case.require(np.ndim(sensor.frequencies()) == 1, "frequencies() is not a list of numbers")
    case.require(np.isfinite(sensor.frequencies()).all() and (np.asarray(sensor.frequencies()) > 0).all(), "a carrier is no frequency")


def _streams_are_sound(case: _Case) -> None:
    sensed, duration = case.sensed(), case.around.duration
    streams = set(sensed.streams)
    case.require(streams == case.cls.produces, f"says that it produces {sorted(case.cls.produces)}, and made {sorted(streams)}")
    for kind, stream in sensed.streams.items():
        case.require(isinstance(stream, STREAMS[kind]), f"the stream {kind} is made of {type(stream).__name__}")
        if isinstance(stream, Counts):
            continue
        table: Any = stream
        start = table.t_start if kind == "rounds" else table.t
        case.require((np.diff(table.t_arrival) >= 0).all(), f"{kind} are not in the order of arrival")
        case.require((start >= 0).all() and (start <= duration + 1e-9).all(), f"{kind} lie outside of the trial")
        case.require((table.t_arrival >= table.t - 1e-12).all(), f"{kind} arrive before they happen")
    case.require(any(len(s) for s in sensed.streams.values()), "sensed nothing at all")
    finite = all(np.isfinite(v) and w >= 0 for v, w in sensed.shares.values() if w) and all(np.isfinite(v) for v in sensed.rates.values())
    case.require(finite, "a stimulus that has weight is not finite")


def _indices_point_somewhere(case: _Case) -> None:
    first = 5
    limits = {
        "antenna": (first, first + len(case.made().antennas())),
        "tag": (0, len(case.around.tagged.tags)),
        "carrier": (-1, len(case.around.target_bodies)),
        "target": (-1, len(case.around.target_bodies)),
    }
    for kind, stream in case.sensed(first=first).streams.items():
        for name, (low, high) in limits.items():
            index: Array = getattr(stream, name, np.empty(0))
            case.require(((index >= low) & (index < high)).all(), f"{kind}.{name} points to what is not there")


def _repeats_itself(case: _Case) -> None:
    sensor, other_trial = case.made(), replace(case.around, trial=case.around.trial + 1)
    first = sensor.sense(case.around, 0)
    sensor.sense(other_trial, 0)
    for again, what in ((sensor.sense(case.around, 0), "a second time, after another trial,"), (case.sensed(), "by another object")):
        differs = case.unlike(first, again)
        case.require(differs is None, f"the same trial sensed {what} gives other {differs}")


def _place_in_the_site_does_not_matter(case: _Case) -> None:
    def moved(stream: Table, by: int) -> Table:
        return stream.with_(antenna=getattr(stream, "antenna") + by) if hasattr(stream, "antenna") else stream  # noqa: B009

    here, there = case.sensed(), case.sensed(first=7)
    back = replace(there, streams={kind: moved(s, -7) for kind, s in there.streams.items()})
    differs = case.unlike(here, back)
    case.require(differs is None, f"{differs} depend on how many antennas stand before this sensor's in the site")


def _without_first_tag(sensed: Sensed) -> Sensed:
    """The streams less all that is about tag 0, the other tags renumbered."""

    def cut(stream: Table) -> Table:
        if not hasattr(stream, "tag"):
            return stream
        tag: Array = getattr(stream, "tag")  # noqa: B009
        return stream.take(tag > 0).with_(tag=tag[tag > 0] - 1)

    return replace(sensed, streams={kind: cut(stream) for kind, stream in sensed.streams.items()})


def _a_tag_out_of_reach_changes_nothing(case: _Case) -> None:
    """The new tag comes first in the list: whoever draws by a tag's index is found out."""
    more = surroundings.with_a_tag_first(case.around, np.array([0.0, 0.0, 1e5]))
    differs = case.unlike(case.sensed(), _without_first_tag(case.sensed(more)))
    case.require(differs is None, f"a tag out of reach changes the {differs} of the others: draw by name, not by index")


def _a_tag_in_reach_changes_no_draw(case: _Case) -> None:
    """It may take the reader's time, so that reads fall elsewhere; but a read at the same instant of the same visit is the same read."""
    more = surroundings.with_a_tag_first(case.around, case.around.tagged.pose[-1, :3])
    before, after = case.sensed(), _without_first_tag(case.sensed(more))
    if "reads" in before.streams:
        a, b = _by_instant(before), _by_instant(after)
        changed = any(not np.array_equal(a[key], b[key], equal_nan=True) for key in a.keys() & b.keys())
        case.require(not changed, "a tag in reach changes what reads of the others say: draw by name, not in a row")


def _by_instant(sensed: Sensed) -> dict[tuple[float, int, int, int], Array]:
    """What each read says, by its time, antenna, tag and the number of the antenna's round (0 for a sensor without rounds)."""
    reads: Any = sensed.streams["reads"]
    values = np.stack([reads.channel, reads.rssi, reads.phase, reads.doppler], axis=1)
    number = np.zeros(len(reads), dtype=np.int64)
    if "rounds" in sensed.streams:
        rounds: Any = sensed.streams["rounds"]
        for antenna in np.unique(reads.antenna):
            mine = reads.antenna == antenna
            number[mine] = np.searchsorted(np.sort(rounds.t_start[rounds.antenna == antenna]), reads.t[mine])
    keys = zip(reads.t.tolist(), reads.antenna.tolist(), reads.tag.tolist(), number.tolist(), strict=True)
    return dict(zip(keys, values, strict=True))


_CHECKS: tuple[Callable[[_Case], None], ...] = (
    _describes_itself,
    _streams_are_sound,
    _indices_point_somewhere,
    _repeats_itself,
    _place_in_the_site_does_not_matter,
    _a_tag_out_of_reach_changes_nothing,
    _a_tag_in_reach_changes_no_draw,
)
