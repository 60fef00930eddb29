"""Reads of one instant, put together: who gets which, what is NaN, when it is there."""

from typing import ClassVar

import numpy as np
import pytest

from testbed.checks import samples
from testbed.estimate import run
from testbed.feeds import feeds
from testbed.quantity import Config
from testbed.recording import Recording
from testbed.types import POSITION, Estimate, Prior, Reads, Targets, UpdateInfo

SITE = samples.site()  # four antennas; tags 0 to 4 are targets', 5 to 10 are references


def recording(reads, targets=((0,),), trial=0, duration=1.0):
    """Reads as (t, t_arrival, antenna, tag, rssi)."""
    t, arrival, antenna, tag, rssi = np.array(reads, dtype=float).reshape(-1, 5).T
    names = np.array([f"thing{i}" for i in range(len(targets))])
    stream = Reads(t, arrival, antenna.astype(int), tag.astype(int), rssi=rssi, phase=rssi / 100)
    tags = tuple(np.array(t) for t in targets)
    return Recording(trial, duration, SITE, {"reads": stream}, Targets(names, names), tags)


def snapshots(recordings, kind="snapshots", hold=0.0):
    (feed,) = feeds(recordings, frozenset({kind}), hold)
    entry, place = feed.spread(0, len(feed.table.t))
    return feed.data(entry, place), feed.lists.row[place], feed


def test_reads_of_one_instant_and_target_are_one_entry_with_nan_where_not_heard():
    data, row, _ = snapshots([recording([(0.1, 0.1, 2, 0, -50), (0.1, 0.1, 0, 0, -60), (0.2, 0.2, 3, 0, -70)])])
    np.testing.assert_array_equal(data.t, [0.1, 0.2])
    np.testing.assert_array_equal(data.rssi[:, 0], [[-60, np.nan, -50, np.nan], [np.nan, np.nan, np.nan, -70]])
    np.testing.assert_array_equal(data.phase[0, 0], [-0.6, np.nan, -0.5, np.nan])
    np.testing.assert_array_equal(row, [0, 0])


def test_the_tags_of_a_target_are_side_by_side_in_the_targets_order():
    data, row, _ = snapshots([recording([(0.1, 0.1, 0, 4, -40), (0.1, 0.1, 1, 3, -30), (0.1, 0.1, 2, 1, -20)], targets=((3, 4), (1,)))])
    np.testing.assert_array_equal(row, [0, 1])
    np.testing.assert_array_equal(data.tag, [[3, 4], [1, -1]])
    np.testing.assert_array_equal(data.rssi[0], [[np.nan, -30, np.nan, np.nan], [-40, np.nan, np.nan, np.nan]])
    np.testing.assert_array_equal(data.rssi[1], [[np.nan, np.nan, -20, np.nan], [np.nan] * 4])


def test_a_tag_of_two_targets_is_in_the_snapshots_of_both():
    data, row, _ = snapshots([recording([(0.1, 0.1, 0, 2, -40)], targets=((2,), (1, 2)))])
    np.testing.assert_array_equal(row, [0, 1])
    assert data.rssi[0, 0, 0] == data.rssi[1, 1, 0] == -40


def test_the_same_instant_of_two_recordings_stays_two():
    made = [recording([(0.1, 0.1, 0, 0, -40 - trial)], trial=trial) for trial in range(2)]
    data, row, _ = snapshots(made)
    np.testing.assert_array_equal(row, [0, 1])
    np.testing.assert_array_equal(data.rssi[:, 0, 0], [-40, -41])


def test_reads_of_other_tags_make_no_snapshot():
    data, _, _ = snapshots([recording([(0.1, 0.1, 0, 3, -40), (0.2, 0.2, 0, 7, -40)])])
    assert len(data) == 0


def test_a_read_given_twice_counts_once_and_one_without_a_level_does_not_hide_one_with():
    data, _, _ = snapshots([recording([(0.1, 0.1, 0, 0, -40), (0.1, 0.1, 0, 0, -41), (0.1, 0.1, 0, 0, np.nan)])])
    assert data.rssi[0, 0, 0] == -41


def test_a_snapshot_is_there_when_its_last_read_has_arrived():
    made = [recording([(0.1, 0.15, 0, 0, -40), (0.1, 0.4, 1, 0, -41), (0.2, 0.2, 0, 0, -42)])]
    data, _, feed = snapshots(made)
    np.testing.assert_array_equal(data.t, [0.2, 0.1])
    np.testing.assert_array_equal(feed.key, [0.2, 0.4])
    _, _, feed = snapshots(made, hold=0.3)
    np.testing.assert_array_equal(feed.key, [0.1, 0.2])


def test_reference_snapshots_hold_all_references_and_go_to_every_row_of_their_recording():
    first = recording([(0.1, 0.1, 0, 6, -50), (0.1, 0.1, 3, 10, -60), (0.1, 0.1, 0, 0, -1)], targets=((0,), (1,)))
    data, row, _ = snapshots([first, recording([(0.1, 0.1, 1, 5, -70)], trial=1)], "reference_snapshots")
    np.testing.assert_array_equal(row, [0, 1, 2])
    assert data.rssi.shape == (3, samples.REFERENCES, 4)
    assert (data.rssi[0, 1, 0], data.rssi[1, 5, 3], data.rssi[2, 0, 1]) == (-50, -60, -70)
    assert np.isfinite(data.rssi).sum(axis=(1, 2)).tolist() == [2, 2, 1]


class Witness:
    """Writes down what it is told, row by row."""

    class Config(Config):
        pass

    consumes: ClassVar = frozenset({"snapshots", "reference_snapshots"})
    told: ClassVar[list] = []

    def __init__(self, config, site, rng):
        pass

    def start(self, prior):
        self.rows = prior.rows

    def predict(self, t):
        pass

    def update(self, event):
        self.told += [(int(row), event.kind, float(t)) for row, t in zip(event.row, event.data.t, strict=True)]
        return UpdateInfo.accepted(len(event))

    def estimate(self):
        return Estimate(POSITION, np.zeros((self.rows, 3)), np.tile(np.eye(3), (self.rows, 1, 1)))


def prior(rows):
    return Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1)))


def test_at_one_time_references_come_before_the_tag_itself():
    made = recording([(0.1, 0.1, 0, 0, -40), (0.1, 0.1, 0, 6, -41), (0.2, 0.2, 0, 6, -41), (0.2, 0.2, 0, 0, -41)])
    Witness.told = []
    run([made], Witness, Witness.Config(), prior(1), np.zeros(1, dtype=np.uint64))
    reference, own = "reference_snapshots", "snapshots"
    assert Witness.told == [(0, reference, 0.1), (0, own, 0.1), (0, reference, 0.2), (0, own, 0.2)]


@pytest.mark.parametrize("seed", range(3))
def test_nothing_that_was_read_is_lost_or_made_up(seed):
    rng = np.random.default_rng(seed)
    n = 200
    reads = np.column_stack([
        np.round(rng.uniform(0, 1, n), 1), np.zeros(n), rng.integers(0, 4, n), rng.integers(0, 5, n), np.arange(n) - 300.0
    ])  # fmt: skip
    reads[:, 1] = reads[:, 0]
    data, row, _ = snapshots([recording(reads, targets=((0,), (1, 2), (3, 4)))])
    owner = {0: (0, 0), 1: (1, 0), 2: (1, 1), 3: (2, 0), 4: (2, 1)}
    expected = {}
    for t, _, antenna, tag, rssi in reads:
        target, slot = owner[int(tag)]
        expected[(target, t, slot, int(antenna))] = rssi  # the last of several
    found = {
        (int(row[i]), float(data.t[i]), int(slot), int(antenna)): float(data.rssi[i, slot, antenna])
        for i, slot, antenna in np.argwhere(np.isfinite(data.rssi))
    }
    assert found == expected
