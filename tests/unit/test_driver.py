"""The driver against a plain loop over one row's events, which is what it must amount to."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed import events
from testbed.checks import samples
from testbed.estimate import row_seeds, run
from testbed.protocols import SingleTarget
from testbed.quantity import Config
from testbed.recording import Recording
from testbed.rng import RowRandom
from testbed.types import Counts, Estimate, Odometry, Prior, Reads, Rounds, Status, Targets, UpdateInfo


class Diary:
    """Writes down what each row is told, and believes a number that depends on all of it and on its order."""

    Config: ClassVar[type[Config]] = Config
    consumes: ClassVar[frozenset[str]] = frozenset({"reads", "odometry"})
    made: ClassVar[list[Diary]] = []

    def __init__(self, config, site, rng: RowRandom) -> None:
        self.rng, self.calls = rng, 0
        type(self).made.append(self)

    def start(self, prior: Prior) -> None:
        self.now, self.value = prior.t, prior.mean[:, 0].copy()
        self.told: list[list[tuple[str, float, float]]] = [[] for _ in range(prior.rows)]

    def predict(self, t) -> None:
        assert (t >= self.now).all()
        self.value += 0.25 * (t - self.now)
        self.now = t

    def update(self, event) -> UpdateInfo:
        self.calls += 1
        assert (np.diff(event.row) > 0).all()
        said = event.data.rssi if event.kind == "reads" else event.data.speed
        if not getattr(self, "accepts_late", False):
            assert (self.now[event.row] == np.maximum(event.data.t, self.now[event.row])).all()
        for row, t, value in zip(event.row, event.data.t, said, strict=True):
            self.told[row].append((event.kind, float(t), float(value)))
        self.value[event.row] = 0.75 * self.value[event.row] + said + self.rng.normal(1, event.row)[:, 0]
        refused = said > 8
        return UpdateInfo(used=~refused, nis=said, dof=np.ones(len(event)), log_likelihood=-said)

    def estimate(self) -> Estimate:
        return Estimate(("x",), self.value[:, None], np.ones((len(self.value), 1, 1)), np.zeros(len(self.value)))


class LateDiary(Diary):
    accepts_late: ClassVar[bool] = True


@pytest.fixture(autouse=True)
def _fresh_diaries():
    Diary.made = LateDiary.made = []


def recording(trial, target_tags, reads, odometry, duration=1.0):
    """reads and odometry: lists of (t, delay, index, value)."""

    def columns(rows):
        t, delay, index, value = np.array(rows, dtype=float).reshape(-1, 4).T
        order = np.argsort(t + delay, kind="stable")
        return t[order], (t + delay)[order], index[order].astype(int), value[order]

    t, arrival, tag, rssi = columns(reads)
    made = {"reads": Reads(t=t, t_arrival=arrival, antenna=np.zeros(len(t)), tag=tag, rssi=rssi)}
    t, arrival, carrier, speed = columns(odometry)
    made["odometry"] = Odometry(t, arrival, carrier, speed)
    names = np.array([f"target{i}" for i in range(len(target_tags))])
    tags = tuple(np.array(t, dtype=np.int64) for t in target_tags)
    return Recording(trial, duration, samples.site(), made, Targets(names, names), tags)


def prior_of(recordings, t=0.0):
    rows = sum(len(r.targets) for r in recordings)
    return Prior(np.full(rows, t), np.arange(rows * 6.0).reshape(rows, 6), np.tile(np.eye(6), (rows, 1, 1)))


def drive(recordings, method=Diary, prior=None, **options):
    prior = prior_of(recordings) if prior is None else prior
    return run(recordings, method, Config(), prior, row_seeds(3, recordings, "diary"), **options)


def one_by_one(of: Recording, target: int, ticks, hold: float, start: float, accepts_late=False):
    """What a row is told, and how many events come too late for it, by the plainest loop."""
    events = []
    for place, r in enumerate(zip(*(of.streams["odometry"].__dict__[n] for n in ("t", "t_arrival", "carrier", "speed")), strict=True)):
        if r[2] == target:
            events.append((r[0] if r[1] <= r[0] + hold else r[1] - hold, r[0], "odometry", place, r[3]))
    for place, r in enumerate(zip(*(of.streams["reads"].__dict__[n] for n in ("t", "t_arrival", "tag", "rssi")), strict=True)):
        events += [(r[0] if r[1] <= r[0] + hold else r[1] - hold, r[0], "reads", place, r[3])] * list(of.target_tags[target]).count(r[2])
    told, late, present = [], 0, start
    reports = [(tick + 1e-9, np.inf) for tick in ticks]
    for key, t, *rest in sorted([*events, *reports]):
        if not rest:
            present = max(present, key - 1e-9)
        elif key > ticks[-1] + 1e-9:
            continue
        elif t < present and not accepts_late:
            late += 1
        else:
            present = max(present, t)
            told.append((rest[0], t, rest[2]))
    return told, late


times = st.integers(0, 22).map(lambda i: i / 20)  # a coarse grid: many events at one time, and on the report times
entries = st.lists(st.tuples(times, st.sampled_from([0.0, 0.0, 0.05, 0.1, 0.15, 0.3]), st.integers(0, 2), st.integers(0, 9)), max_size=25)
trials = st.lists(st.tuples(st.sampled_from([[[0]], [[0], [1]], [[0], [1, 2], [1]]]), entries, entries), min_size=1, max_size=3)


def recordings_of(pattern):
    made = []
    for trial, (target_tags, reads, odometry) in enumerate(pattern):
        made.append(recording(trial, target_tags, reads, [o for o in odometry if o[2] < len(target_tags)]))
    return made


@settings(max_examples=60, deadline=None)
@given(trials, st.sampled_from([0.0, 0.1, 0.5]), st.sampled_from([Diary, LateDiary]), st.sampled_from([3, 1_000_000]))
def test_every_row_is_told_what_a_loop_over_its_events_would_tell_it(pattern, hold, method, entries_at_once):
    recordings = recordings_of(pattern)
    method.made.clear()
    with mock.patch.object(events, "ENTRIES", entries_at_once):
        track = drive(recordings, method, report_hz=5.0, hold_s=hold)
    row = 0
    for r in recordings:
        for target in range(len(r.targets)):
            told, late = one_by_one(r, target, np.arange(6) / 5, hold, 0.0, method is LateDiary)
            assert method.made[0].told[row] == told
            assert (track.late[row], track.used[row] + track.refused[row]) == (late, len(told))
            assert track.refused[row] == sum(value > 8 for *_, value in told)
            row += 1


@settings(max_examples=30, deadline=None)
@given(trials, st.sampled_from([0.0, 0.1]))
def test_rows_in_one_call_and_one_by_one_are_the_same_to_the_last_bit(pattern, hold):
    recordings = recordings_of(pattern)
    together = drive(recordings, hold_s=hold)
    prior, row = prior_of(recordings), 0
    for r in recordings:
        for target in range(len(r.targets)):
            single = drive([samples.only(r, target)], prior=prior.take([row]), hold_s=hold)
            np.testing.assert_array_equal(single.mean[:, 0], together.mean[:, row])
            np.testing.assert_array_equal(single.innovations.nis, together.innovations.nis[together.innovations.row == row])
            assert (single.late[0], single.used[0]) == (together.late[row], together.used[row])
            row += 1


def test_a_site_of_its_own_for_each_trial_changes_no_number():
    reads = [[(0.1 * i, 0.0, i % 3, i % 10) for i in range(trial, 10)] for trial in range(3)]
    shared = [recording(trial, [[0], [1, 2]], reads[trial], [(0.55, 0.0, 1, 2.0)]) for trial in range(3)]
    moved = samples.site().antennas.with_(position=samples.site().antennas.position + 0.01)
    apart = [shared[0], replace(shared[1], site=replace(samples.site(), antennas=moved)), shared[2]]
    together, separate = drive(shared), drive(apart)
    assert [len(d.told) for d in Diary.made] == [6, 4, 2]
    for name in ("mean", "covariance", "status", "trial", "target", "used", "refused", "late"):
        np.testing.assert_array_equal(getattr(together, name), getattr(separate, name))
    assert together.innovations.equals(separate.innovations)


def test_the_kth_events_of_all_rows_go_in_one_call():
    reads = [(0.01 * i + 0.001 * tag + 0.001, 0.0, tag, 1.0) for i in range(10) for tag in range(3)]
    drive([recording(trial, [[0], [1], [2]], reads, []) for trial in range(4)], report_hz=1.0)
    assert Diary.made[0].calls == 10


def test_a_row_that_began_earlier_does_not_keep_the_others_from_its_calls():
    drive([recording(0, [[0], [1]], [(0.1, 0.0, 0, 1.0), (0.6, 0.0, 0, 1.0), (0.7, 0.0, 1, 1.0)], [])], report_hz=2.0)
    assert Diary.made[0].calls == 2


def test_waiting_for_reports_in_flight_loses_none_and_not_waiting_does():
    made = samples.recording(latency=0.2)
    assert drive([made], prior=prior_of([made]), hold_s=0.2).late.sum() == 0
    assert drive([made], prior=prior_of([made]), hold_s=0.0).late.sum() > 10


def test_a_read_a_rounding_error_after_the_report_time_counts_for_it():
    made = recording(0, [[0]], [(0.1 * 3, 0.0, 0, 5.0)], [])
    assert 0.1 * 3 > 3 / 10
    track = drive([made], report_hz=10.0)
    assert track.mean[3, 0, 0] - track.mean[2, 0, 0] > 1


def test_wall_time_is_shared_among_the_rows_of_a_call():
    track = drive([samples.recording()])
    assert (track.update_seconds > 0).all()
    assert np.ptp(track.update_seconds) < track.update_seconds.sum()


def test_an_estimator_that_shows_its_own_array_spoils_no_report():
    made = recording(0, [[0]], [(0.35, 0.0, 0, 5.0)], [])
    track = drive([made])  # Diary.estimate shows self.value, and goes on changing it
    assert len(np.unique(track.mean[:, 0, 0])) == len(track.t)


class Counting(Diary):
    consumes: ClassVar[frozenset[str]] = frozenset({"rounds"})

    def update(self, event):
        rows = zip(event.row, *(getattr(event.data, n) for n in ("t", "round", "antenna", "tag", "queries", "n")), strict=True)
        for row, *entry in rows:
            self.told[row].append(tuple(float(e) for e in entry))
        return UpdateInfo.accepted(len(event))


def test_silence_is_told_to_the_rows_whose_tags_were_asked_and_to_no_other():
    rounds = Rounds(
        round=[0, 0, 1], t_start=[0.0, 0.1, 0.2], t_end=[0.1, 0.2, 0.3], t_arrival=[0.1, 0.2, 0.3], antenna=[0, 1, 0], reader=[0, 0, 0],
        queries=[10, 10, 10], asked=[0, 0, 1],
    )  # fmt: skip
    counts = Counts(round=[0, 1, 0], antenna=[1, 0, 0], tag=[2, 2, 0], n=[7, 3, 4])
    names = np.array(["a", "b"])
    asked = np.zeros((2, len(samples.site().tags)), dtype=bool)
    asked[0, [0, 1, 2]] = asked[1, 2] = True
    made = Recording(
        0, 0.5, samples.site(), {"rounds": rounds, "counts": counts}, Targets(names, names), (np.array([0]), np.array([1, 2])), asked
    )
    Counting.made = []
    drive([made, made], Counting)
    a = [(0.1, 0, 0, 0, 10, 4), (0.2, 0, 1, 0, 10, 0)]
    b = [(0.1, 0, 0, 1, 10, 0), (0.1, 0, 0, 2, 10, 0), (0.2, 0, 1, 1, 10, 0), (0.2, 0, 1, 2, 10, 7), (0.3, 1, 0, 2, 10, 3)]
    assert Counting.made[0].told == [a, b, a, b]


def test_odometry_of_a_body_that_is_no_target_goes_to_nobody():
    drive([recording(trial, [[0], [1]], [], [(0.1, 0.0, -1, 1.0), (0.2, 0.0, 1, 2.0)]) for trial in range(2)])
    assert Diary.made[0].told == [[], [("odometry", 0.2, 2.0)]] * 2


def test_a_count_without_its_round_is_an_error_that_names_it():
    made = samples.recording()
    counts = Counts(round=[999], antenna=[2], tag=[0], n=[1])
    made.streams["counts"] = counts
    with pytest.raises(ValueError, match="round 999 of antenna 2 has a count but is not among the rounds"):
        drive([made], Counting)


class Listener(Diary):
    consumes: ClassVar[frozenset[str]] = frozenset({"reference_reads"})

    def update(self, event):
        assert event.kind == "reference_reads"
        for row, value in zip(event.row, event.data.rssi, strict=True):
            self.told[row].append(value)
        return UpdateInfo.accepted(len(event))


def test_reads_of_reference_tags_go_to_every_row_of_their_recording_only():
    first = recording(0, [[0], [1]], [(0.1, 0.0, 6, 1.0), (0.2, 0.0, 0, 2.0)], [])
    second = recording(1, [[0]], [(0.3, 0.0, 7, 3.0)], [])
    Listener.made = []
    drive([first, second], Listener)
    assert Listener.made[0].told == [[1.0], [1.0], [3.0]]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"report_hz": 0.0}, "report_hz must be above 0"),
        ({"hold_s": -1.0}, "hold_s not below it"),
        ({"prior": prior_of([recording(0, [[0]], [], [])])}, "have 2 targets, the prior 1 rows"),
    ],
)
def test_what_does_not_fit_together_is_refused_in_a_sentence(change, sentence):
    made = [recording(0, [[0], [1]], [], [])]
    with pytest.raises(ValueError, match=sentence):
        drive(made, **change)


def test_recordings_of_different_length_are_refused():
    with pytest.raises(ValueError, match="must last equally long"):
        drive([recording(0, [[0]], [], [], 1.0), recording(1, [[0]], [], [], 2.0)])


def test_a_kind_that_nobody_makes_is_refused_by_name():
    strange = type("Strange", (Diary,), {"consumes": frozenset({"smells"})})
    with pytest.raises(ValueError, match="no stream is known as 'smells'"):
        drive([recording(0, [[0]], [], [])], strange)


def test_a_row_that_begins_late_takes_nothing_older_and_is_not_turned_back():
    made = recording(0, [[0]], [(0.1, 0.0, 0, 1.0), (0.8, 0.0, 0, 2.0)], [])
    track = drive([made], prior=prior_of([made], t=0.5))
    assert (track.late[0], track.used[0]) == (1, 1)


class Watch(SingleTarget):
    """One row: writes down what it is called with."""

    Config: ClassVar[type[Config]] = Config
    consumes: ClassVar[frozenset[str]] = frozenset({"reads"})
    components: ClassVar[tuple[str, ...]] = ("draws",)
    calls: ClassVar[list[tuple]] = []

    def start(self, t, mean, covariance):
        self.draw = self.rng.normal()
        self.calls.append(("start", t, mean.shape, covariance.shape))

    def predict(self, t):
        self.calls.append(("predict", t))

    def update(self, kind, data):
        assert isinstance(data.tag, int)
        self.calls.append(("update", kind, data.t, data.rssi))

    def estimate(self):
        return np.array([self.draw]), np.eye(1), Status.OK


def test_a_method_for_one_target_is_called_with_plain_numbers_and_never_twice_for_one_time():
    Watch.calls.clear()
    track = drive([recording(0, [[0]], [(0.1, 0.0, 0, -50.0), (0.1, 0.0, 0, -51.0)], [], duration=0.2)], Watch, report_hz=10.0)
    assert Watch.calls[0] == ("start", 0.0, (6,), (6, 6))
    assert Watch.calls[1:] == [
        ("predict", 0.1), ("update", "reads", 0.1, -50.0), ("update", "reads", 0.1, -51.0), ("predict", 0.2),
    ]  # fmt: skip
    assert track.used[0] == 2


def test_each_row_of_a_lifted_method_draws_from_its_own_generator_whoever_is_beside_it():
    rows = [recording(trial, [[0], [1]], [], []) for trial in range(2)]
    draws = drive(rows, Watch).mean[0, :, 0]
    assert len(set(draws.tolist())) == 4
    alone = run([samples.only(rows[1], 0)], Watch, Config(), prior_of(rows).take([2]), row_seeds(3, rows, "diary")[[2]])
    assert alone.mean[0, 0, 0] == draws[2]


def test_seeds_depend_on_trial_target_and_estimator_only():
    one, two = recording(0, [[0], [1]], [], []), recording(1, [[0], [1], [2]], [], [])
    seeds = row_seeds(5, [one, two], "pf")
    assert len(set(seeds.tolist())) == 5
    np.testing.assert_array_equal(row_seeds(5, [two], "pf"), seeds[2:])
    assert set(row_seeds(5, [one, two], "other").tolist()).isdisjoint(seeds.tolist())
