"""Detection counts measured where tags and antennas truly are: blocks of queries by distance and angle off boresight.

This is the bench of whoever sets readers up: they know where the tag stands. No estimator gets any of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.calibrate import CalibrationError
from testbed.columns import Array, Table, column
from testbed.progress import Progress
from testbed.protocols import Surroundings
from testbed.radio.antenna import off_boresight
from testbed.radio.links import Ends
from testbed.scenario import Scenario
from testbed.simulate import Simulator
from testbed.types import Counts, Rounds

CELLS = 20_000_000  # (round, tag) pairs of one trial: 1 GB of temporaries


@dataclass(frozen=True, eq=False)
class Blocks(Table):
    """n reads of `queries` queries of a tag by an antenna, so far and so many degrees off its boresight.

    run: blocks of one antenna and tag in one trial of one place share it, for what fades there stays. trial: to be held out together.
    """

    distance: Array = column("float64", unit="m")
    degrees: Array = column("float64", unit="deg off boresight, in [0, 180]")
    n: Array = column("int64")
    queries: Array = column("int64")
    run: Array = column("int64")
    trial: Array = column("int64")


def measure(scenario: Scenario, block_s: float, progress: Progress) -> Blocks:
    """All blocks of a scenario's points and trials. CalibrationError for a scenario without readers that count, or without tags."""
    points, found, runs = scenario.points(), [], 0
    progress.start(scenario.name, len(points) * scenario.trials, 0)
    for point in points:
        with Simulator(point.scenario) as simulator:
            for trial in range(scenario.trials):
                part, runs = _trial(simulator, trial, block_s, runs)
                found.append(part)
                progress.advance(1, 0)
    progress.finish()
    blocks = Blocks.concatenate(found)
    if not len(blocks):
        raise CalibrationError(f"{scenario.name}: nobody was asked: readers (kind rfid) and tags are wanted")
    return blocks


def _trial(simulator: Simulator, index: int, block_s: float, runs: int) -> tuple[Blocks, int]:
    around = simulator.moved(index)
    parts = [Blocks.empty()]
    for section, sensor in zip(simulator.scenario.sensors, simulator.sensors, strict=True):
        ends = getattr(sensor, "ends", None)
        if ends is None:
            continue
        sensed = sensor.sense(around, 0)
        rounds, counts = sensed.streams["rounds"], sensed.streams["counts"]
        if not isinstance(rounds, Rounds) or not isinstance(counts, Counts):
            raise TypeError(f"{section.id}: rounds and counts are wanted")
        check(rounds, counts, section.id)
        sets = np.ones((1, len(around.tagged.tags)), dtype=bool) if sensed.asked_sets is None else sensed.asked_sets
        part = joined(rounds, counts, sets, ends, around, block_s)
        parts.append(part.with_(run=part.run + runs, trial=np.full(len(part), index)))
        runs += int(part.run.max(initial=-1)) + 1
    return Blocks.concatenate(parts), runs


def check(rounds: Rounds, counts: Counts, who: str) -> None:
    """CalibrationError, naming the row, for a round without queries, a count without its round, or one over the number of queries."""
    for i in np.flatnonzero(rounds.queries < 1)[:1]:
        raise CalibrationError(f"{who}: row {i} of rounds (round {rounds.round[i]}, antenna {rounds.antenna[i]}) has no queries")
    place = _rows_of(rounds, counts)
    for i in np.flatnonzero(place < 0)[:1]:
        raise CalibrationError(f"{who}: row {i} of counts is of round {counts.round[i]}, antenna {counts.antenna[i]}, which is no round")
    for i in np.flatnonzero((counts.n < 0) | (counts.n > rounds.queries[place]))[:1]:
        asked = rounds.queries[place[i]]
        raise CalibrationError(f"{who}: row {i} of counts (round {counts.round[i]}) has {counts.n[i]} reads of {asked} queries")


def _rows_of(rounds: Rounds, counts: Counts) -> Array:
    """(N,) the row of each count's round, -1 where there is none."""
    antennas = int(max(rounds.antenna.max(initial=0), counts.antenna.max(initial=0))) + 1
    key, wanted = rounds.round * antennas + rounds.antenna, counts.round * antennas + counts.antenna
    order = np.argsort(key)
    place = np.minimum(np.searchsorted(key[order], wanted), max(len(key) - 1, 0))
    found = order[place] if len(key) else np.full(len(wanted), -1)
    return np.where(key[found] == wanted, found, -1) if len(key) else found


def joined(rounds: Rounds, counts: Counts, sets: Array, ends: Ends, around: Surroundings, block_s: float) -> Blocks:
    """Blocks of one sensor in one trial; runs are numbered from 0. Distance and angle are means over a block's rounds.

    What ends after the last whole block is left out: its last visit was cut off, and asked without waiting for answers.
    """
    tags = len(around.tagged.tags)
    if len(rounds) * tags > CELLS:
        raise CalibrationError(f"{len(rounds):,} rounds of {tags:,} tags are more than can be put together: fewer tags, or a shorter trial")
    whole = np.floor(rounds.t_end / block_s + 1e-9) < np.floor(around.duration / block_s + 1e-9)
    row, tag = np.nonzero(sets[rounds.asked] & whole[:, None])
    n = np.zeros((len(rounds), tags), dtype=np.int64)
    n[_rows_of(rounds, counts), counts.tag] = counts.n
    antenna, t = rounds.antenna[row], rounds.t_end[row]
    looking = ends.at(around.truth, antenna, t)
    place = Ends(around.tagged.body, around.tagged.pose).at(around.truth, tag, t)
    cosine, distance = off_boresight(looking[:, 3:], place[:, :3] - looking[:, :3])
    degrees = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    block = np.floor(t / block_s + 1e-9).astype(np.int64)
    cells, of = np.unique(np.stack([antenna * tags + tag, block], axis=1), axis=0, return_inverse=True)
    sums: Any = [np.bincount(of.ravel(), weights=v, minlength=len(cells)) for v in (n[row, tag], rounds.queries[row], distance, degrees)]
    each = np.maximum(np.bincount(of.ravel(), minlength=len(cells)), 1)
    run = np.unique(cells[:, 0], return_inverse=True)[1]
    return Blocks(
        distance=sums[2] / each,
        degrees=sums[3] / each,
        n=np.round(sums[0]).astype(np.int64),
        queries=np.round(sums[1]).astype(np.int64),
        run=run.ravel(),
        trial=np.zeros(len(cells), dtype=np.int64),
    )
