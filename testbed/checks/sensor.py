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
from testbed.types import Counts, Heading, Odometry, Ranges, Reads, Rounds

STREAMS: dict[str, type[Table]] = {
    "reads": Reads,
    "rounds": Rounds,
    "counts": Counts,
    "odometry": Odometry,
    "heading": Heading,
    "ranges": Ranges,
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
    finite = all(np.isfinite(v).all() and w >= 0 for v, w in sensed.stimulus.values() if w)
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


def _a_tag_out_of_reach_changes_nothing(case: _Case) -> None:
    """The new tag is far away and comes first in the list: whoever draws by a tag's index, or in a row, is found out."""
    before = case.sensed()
    after = case.sensed(surroundings.with_a_far_tag_first(case.around))
    for kind, stream in after.streams.items():
        if hasattr(stream, "tag"):
            tag: Array = getattr(stream, "tag")  # noqa: B009
            known = stream.take(tag > 0)
            after.streams[kind] = known.with_(tag=tag[tag > 0] - 1)  # pyright: ignore[reportIndexIssue]
    differs = case.unlike(before, after)
    case.require(differs is None, f"a tag out of reach changes the {differs} of the others: draw by name, not in a row")


_CHECKS: tuple[Callable[[_Case], None], ...] = (
    _describes_itself,
    _streams_are_sound,
    _indices_point_somewhere,
    _repeats_itself,
    _place_in_the_site_does_not_matter,
    _a_tag_out_of_reach_changes_nothing,
)
