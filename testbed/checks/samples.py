"""A small made-up hall with everything in it, for checks and examples: antennas, tags, references, and a stream of each kind.

The numbers follow a plain log-distance law with noise, not the channel of the testbed: a check asks whether a plug-in keeps
its contract, not whether it is any good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed import frames
from testbed.columns import Array, Table
from testbed.geometry import Boxes, Roads
from testbed.guidance import Actions
from testbed.recording import Recording
from testbed.rng import stream
from testbed.types import Antennas, Counts, Heading, Heights, Odometry, Prior, Ranges, Reads, References, Rounds, Site, Tags, Targets

HALL = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 3.0]])  # m
TARGETS = 4  # the last one is a body with two tags
REFERENCES = 6
CARRIERS = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])


def site() -> Site:
    """Four antennas in the corners, six reference tags on the floor, a rack, and a road round it."""
    corners = np.array([[0.0, 0.0, 2.5], [6.0, 0.0, 2.5], [6.0, 5.0, 2.5], [0.0, 5.0, 2.5]])
    antennas = Antennas(
        id=np.array(["southwest", "southeast", "northeast", "northwest"]),
        position=corners,
        quaternion=frames.looking_at(corners, np.array([3.0, 2.5, 1.0])),
        gain=np.full(4, 6.0),
        beamwidth=np.full(4, np.deg2rad(68.0)),
        front_to_back=np.full(4, 18.0),
        power=np.full(4, 29.0),
    )
    x, y = (a.ravel() for a in np.meshgrid([1.0, 3.0, 5.0], [1.0, 4.0]))
    moving = TARGETS + 1
    references = References(tag=moving + np.arange(REFERENCES), position=np.stack([x, y, np.full(REFERENCES, 0.5)], axis=1))
    tags = Tags(id=np.array([f"tag{i}" for i in range(moving)] + [f"reference{i}" for i in range(REFERENCES)]))
    rack = Boxes(center=np.array([[3.0, 2.5, 1.0]]), quaternion=np.array([[1.0, 0.0, 0.0, 0.0]]), half=np.array([[0.5, 0.1, 1.0]]))
    nodes = np.array([[1.0, 1.0], [5.0, 1.0], [5.0, 4.0], [1.0, 4.0]])
    roads = Roads(nodes=nodes, segments=np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    return Site(antennas, tags, CARRIERS, references, rack, roads)


def recording(trial: int = 0, duration: float = 2.0, latency: float = 0.0, reads_hz: float = 15.0) -> Recording:
    """Targets on circles, and streams of every kind about them; reports arrive up to `latency` s late and out of order."""
    where = site()
    places = [(t,) for t in range(TARGETS - 1)] + [(TARGETS - 1, TARGETS)]
    rng = stream(7, trial, "samples")
    names = [f"tag{i}" for i in range(TARGETS - 1)] + ["cart"]
    made: dict[str, Table] = {
        "reads": _reads(where, rng, duration, reads_hz),
        "odometry": _odometry(rng, duration),
        "heading": _heading(rng, duration),
        "ranges": _ranges(where, rng, duration),
        "heights": _heights(duration),
    }
    made["actions"] = _actions(duration)
    made["rounds"], made["counts"] = _rounds(where, rng, duration)
    tags = tuple(np.array(p, dtype=np.int64) for p in places)
    asked = np.ones((1, len(where.tags)), dtype=bool)
    return delayed(Recording(trial, duration, where, made, Targets(np.array(names), np.array(names)), tags, asked), latency)


def delayed(recording: Recording, latency: float) -> Recording:
    """The same recording with reports that arrive up to `latency` s after their time, and overtake each other."""
    rng = stream(8, recording.trial, "latency")
    return replace(recording, streams={kind: _arriving(table, rng, latency) for kind, table in recording.streams.items()})


def only(recording: Recording, target: int) -> Recording:
    """The recording as one of a single target: streams that name targets are cut to it."""
    streams: dict[str, Table] = {}
    for kind, table in recording.streams.items():
        column = {"odometry": "carrier", "heading": "carrier", "heights": "carrier", "ranges": "target", "actions": "target"}.get(kind)
        if column is not None:
            mine = table.take(getattr(table, column) == target)
            table = mine.with_(**{column: np.zeros(len(mine))})
        streams[kind] = table
    return replace(
        recording, streams=streams, targets=recording.targets.take(np.array([target])), target_tags=(recording.target_tags[target],)
    )


def prior(recordings: list[Recording]) -> Prior:
    """A metre of doubt in the middle of the hall, for every row."""
    rows = sum(len(r.targets) for r in recordings)
    mean = np.tile([3.0, 2.5, 1.0, 0.0, 0.0, 0.0], (rows, 1))
    return Prior(t=np.zeros(rows), mean=mean, covariance=np.tile(np.diag([1.0, 1.0, 0.25, 0.25, 0.25, 0.04]), (rows, 1, 1)))


def _where(site: Site, tag: Array, t: Array) -> Array:
    """(N, 3): a circle of its own for each moving tag; reference tags where they are."""
    angle = 0.6 * t + tag
    position = np.stack([3.0 + (1 + 0.2 * tag) * np.cos(angle), 2.5 + 1.5 * np.sin(angle), np.full(len(t), 1.0)], axis=1)
    fixed = site.references.position[np.clip(tag - (TARGETS + 1), 0, REFERENCES - 1)]
    return np.where((tag > TARGETS)[:, None], fixed, position)


def _times(rng: np.random.Generator, duration: float, rate: float) -> Array:
    return np.sort(rng.uniform(0.0, duration, int(duration * rate)))


def _reads(site: Site, rng: np.random.Generator, duration: float, rate: float) -> Reads:
    t = _times(rng, duration, rate * len(site.tags))
    tag, antenna = rng.integers(0, len(site.tags), len(t)), rng.integers(0, len(site.antennas), len(t))
    distance = np.linalg.norm(_where(site, tag, t) - site.antennas.position[antenna], axis=1)
    rssi = -35.0 - 40.0 * np.log10(np.maximum(distance, 0.1)) + rng.normal(0.0, 2.0, len(t))
    phase = rng.uniform(0.0, 2 * np.pi, len(t))
    channel = rng.integers(0, len(CARRIERS), len(t))
    return Reads(t, t, antenna, tag, channel, rssi, phase)


def _rounds(site: Site, rng: np.random.Generator, duration: float) -> tuple[Rounds, Counts]:
    n, antennas = int(duration / 0.05), len(site.antennas)
    start = np.arange(n) * 0.05
    round_, antenna = np.arange(n) // antennas, np.arange(n) % antennas
    rounds = Rounds(
        round=round_, t_start=start, t_end=start + 0.04, t_arrival=start + 0.04, antenna=antenna, reader=np.zeros(n), queries=np.full(n, 10)
    )
    answers = rng.binomial(10, 0.3, (n, len(site.tags))) * (rng.random((n, len(site.tags))) < 0.6)
    which, tag = np.nonzero(answers)
    return rounds, Counts(round=round_[which], antenna=antenna[which], tag=tag, n=answers[which, tag])


def _odometry(rng: np.random.Generator, duration: float) -> Odometry:
    t = _times(rng, duration, 10.0 * TARGETS)
    return Odometry(t, t, rng.integers(0, TARGETS, len(t)), rng.normal(0.9, 0.05, len(t)), rng.normal(0.6, 0.05, len(t)))


def _heading(rng: np.random.Generator, duration: float) -> Heading:
    t = _times(rng, duration, 5.0 * TARGETS)
    return Heading(t, t, rng.integers(0, TARGETS, len(t)), rng.uniform(-3.0, 3.0, len(t)))


def _ranges(site: Site, rng: np.random.Generator, duration: float) -> Ranges:
    t = _times(rng, duration, 5.0 * TARGETS)
    anchor, target = rng.integers(0, len(site.antennas), len(t)), rng.integers(0, TARGETS, len(t))
    distance = np.linalg.norm(_where(site, target, t) - site.antennas.position[anchor], axis=1)
    return Ranges(t, t, anchor, target, distance + rng.normal(0.0, 0.1, len(t)))


def _actions(duration: float) -> Actions:
    """People who listen, turn and step by turns, four times a second; every seventh turn leaves them without an answer."""
    rng = stream(7, 0, "samples.actions")
    n = int(duration * 4) * TARGETS
    t, target, number = 0.25 * (np.arange(n) // TARGETS + 0.9), np.arange(n) % TARGETS, np.arange(n) // TARGETS
    steps = number % 2 == 1
    step, turn = np.where(steps, 0.5, 0.0), np.where(steps | (number == 0), 0.0, rng.uniform(-2.0, 2.0, n))
    change = np.where(steps, rng.uniform(-18.0, 9.0, n), np.nan)
    return Actions(t, t, t - 0.2, target, turn, step, steps | (number % 7 != 6), change)


def _heights(duration: float) -> Heights:
    n = int(5.0 * duration) * TARGETS
    t = (np.arange(n) // TARGETS + 0.5) / 5.0
    return Heights(t, t, np.arange(n) % TARGETS, np.full(n, 1.0) + 0.05 * np.sin(np.arange(n)))


def _arriving(table: Table, rng: np.random.Generator, latency: float) -> Table:
    if isinstance(table, Counts) or not latency:
        return table
    arrival = table.t + rng.uniform(0.0, latency, len(table))  # pyright: ignore[reportAttributeAccessIssue]
    order = np.argsort(arrival, kind="stable")
    return table.with_(t_arrival=arrival).take(order)  # pyright: ignore[reportCallIssue]
