"""What an estimator announces reaches the track, with its row, however rows are put together, taken apart and kept."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from testbed import tables
from testbed.checks import samples
from testbed.estimate import run
from testbed.quantity import Config
from testbed.types import Estimate, Prior, UpdateInfo


class Herald:
    """Announces every third read of a row, and believes nothing."""

    Config: ClassVar[type[Config]] = Config
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})

    def __init__(self, config, site, rng) -> None:
        self._said: list[tuple[int, float, str, float]] = []

    def start(self, prior: Prior) -> None:
        self._heard, self._said = np.zeros(prior.rows, dtype=int), []

    def predict(self, t) -> None:
        pass

    def update(self, event) -> UpdateInfo:
        self._heard[event.row] += 1
        for row, t in zip(event.row, event.data.t, strict=True):
            if self._heard[row] % 3 == 0:
                self._said.append((int(row), float(t), "in" if self._heard[row] % 2 else "out", 0.995))
        return UpdateInfo.accepted(len(event))

    def estimate(self) -> Estimate:
        rows = len(self._heard)
        return Estimate(("x",), np.zeros((rows, 1)), np.ones((rows, 1, 1)), np.zeros(rows))

    def decisions(self):
        return list(self._said)


def tracked(recordings):
    rows = sum(len(r.targets) for r in recordings)
    prior = Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1)))
    return run(recordings, Herald, Herald.Config(), prior, np.arange(rows, dtype=np.uint64))


def said(track, row):
    own = track.decisions.take(track.decisions.row == row)
    return list(zip(own.t.tolist(), own.what.tolist(), own.probability.tolist(), strict=True))


@pytest.fixture(scope="module")
def two():
    """The same recording twice, at sites that a survey found differently: two estimator objects, one track."""
    first = samples.recording(duration=2.0)
    moved = first.site.antennas.with_(position=first.site.antennas.position + 0.1)
    second = samples.recording(duration=2.0)
    object.__setattr__(second.site, "antennas", moved)
    return first, second


def test_decisions_reach_the_track_by_row(two):
    track = tracked([two[0]])
    assert len(track.decisions) > 5
    assert (np.diff(track.decisions.row) >= 0).all()
    assert set(track.decisions.what) == {"in", "out"}
    for row in range(len(track.target)):
        t = [t for t, _, _ in said(track, row)]
        assert t == sorted(t)


def test_rows_of_several_sites_keep_their_decisions(two):
    together, alone = tracked(list(two)), tracked([two[1]])
    first = len(two[0].targets)
    for row in range(len(alone.target)):
        assert said(together, first + row) == said(alone, row)


def test_some_rows_of_a_track_have_their_own_decisions(two):
    track = tracked([two[0]])
    some = track.take(np.array([1, 2]))
    assert [said(some, 0), said(some, 1)] == [said(track, 1), said(track, 2)]


def test_decisions_are_kept_in_files(two, tmp_path):
    track = tracked([two[0]])
    tables.write(track, tmp_path / "herald.parquet")
    assert tables.read(tmp_path / "herald.parquet").decisions.equals(track.decisions)
