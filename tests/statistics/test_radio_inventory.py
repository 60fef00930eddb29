"""Inventory rounds against a second simulation, written tag by tag from the standard, and against closed forms and real readers' rates.

Fixed seeds. Comparisons of means are at 5 standard errors (false alarm below 1e-5 in all); of spreads as said at each.
"""

import numpy as np
import pytest

from testbed.radio.inventory import STEP, hearing, inventory
from testbed.radio.profiles import PROFILES, profile, slots
from testbed.rng import keys_of, mix

SECONDS = 60.0


def run(name, ports, tags, seconds=SECONDS, seed=1, heard=None, asked=None, persistence=1.0, **changes):
    """A reader and tags that all hear all of its ports all the time, unless `heard` says otherwise."""
    if heard is None:
        antenna, tag = np.repeat(np.arange(ports), tags), np.tile(np.arange(tags), ports)
        heard = hearing(ports, 1, seconds, antenna, np.zeros(len(antenna), dtype=int), tag)
    keys = keys_of([f"a{i}" for i in range(ports)]), keys_of([f"t{i}" for i in range(tags)])
    asked = np.ones(tags, dtype=bool) if asked is None else asked
    return inventory(profile(name, **changes), heard, seconds, mix(seed), *keys, asked, np.full(tags, persistence))


class Tag:
    """A tag's own view of a round: a slot counter that it counts down."""

    def __init__(self, rng):
        self.rng, self.counter, self.done = rng, None, False

    def pick(self, q):
        if not self.done:
            self.counter = int(self.rng.integers(1 << q))


def one_round(tags, q, times, rng):
    """(seconds, reads in order of time, collisions): the interrogator's side, one command at a time."""
    crowd = [Tag(rng) for _ in range(tags)]
    seconds, level, reads, collisions = times.query, float(q), [], 0
    while True:
        for tag in crowd:
            tag.pick(q)
        quiet, left = True, 1 << q
        while left:
            answers = [tag for tag in crowd if not tag.done and tag.counter == 0]
            seconds += (times.empty, times.success, times.collision)[min(len(answers), 2)]
            if not answers:
                level = max(0.0, level - STEP)
            elif len(answers) == 1:
                answers[0].done = True
                reads.append(seconds)
            else:
                quiet, level, collisions = False, level + STEP, collisions + 1
            left -= 1
            for tag in crowd:
                tag.counter -= 1  # who collided waits for the next frame
            if int(level + 0.5) != q:
                break
        else:
            if quiet:
                return seconds, reads, collisions
        q = int(level + 0.5)
        seconds += times.adjust


@pytest.mark.parametrize("tags", [1, 2, 5, 16, 50])
def test_rounds_have_the_mean_and_the_spread_of_a_simulation_tag_by_tag(tags):
    rng = np.random.default_rng(tags)
    p = profile("r420", between_rounds=0.0)
    q = max(0, int(np.floor(np.log2(tags) + 0.5)))  # what the reader expects after a round in which it read them all
    rounds = [one_round(tags, q, slots(p.link), rng) for _ in range(400 if tags > 5 else 1500)]
    other, met = np.array([r[0] for r in rounds]), np.array([r[2] for r in rounds])
    got = run("r420", 2, tags, seconds=200.0 if tags > 5 else 60.0, between_rounds=0.0, longest_visit=100.0)
    ours = (got.end - got.start)[4:-1]
    assert (np.bincount(got.visit, minlength=len(got.start))[4:-1] == tags).all()
    error = np.hypot(ours.std() / np.sqrt(len(ours)), other.std() / np.sqrt(len(other)))
    assert ours.mean() == pytest.approx(other.mean(), abs=5 * error + 1e-12)
    # the standard error of a spread is about its own size over √(2n), more for long tails: 25 % is beyond 5 sigma
    assert ours.std() == pytest.approx(other.std(), rel=0.25, abs=1e-12)
    collisions = got.collisions[4:-1]
    error = np.hypot(collisions.std() / np.sqrt(len(collisions)), met.std() / np.sqrt(len(met)))
    assert collisions.mean() == pytest.approx(met.mean(), abs=5 * error + 1e-12)


def test_reads_in_a_fixed_time_have_the_spread_of_a_simulation_tag_by_tag():
    rng, p, tags, window, many = np.random.default_rng(3), profile("fx7500", between_rounds=0.0), 30, 0.04, 500
    other = [sum(t <= window for t in one_round(tags, 5, slots(p.link), rng)[1]) for _ in range(many)]
    # the first visit of each of many readers: later ones expect what they found before
    setting = {"between_rounds": 0.0, "longest_visit": window, "start_q": 5}
    ours = np.array([(run("fx7500", 2, tags, seconds=0.06, seed=s, **setting).visit == 0).sum() for s in range(many)])
    error = np.hypot(ours.std(), np.std(other)) / np.sqrt(many)
    assert ours.mean() == pytest.approx(np.mean(other), abs=5 * error)
    assert ours.std() == pytest.approx(np.std(other), rel=0.2)


def test_the_first_slot_reads_what_slotted_aloha_reads():
    # in its first slot, before Q has moved: one answer, with probability n/L (1 - 1/L)^(n-1) for n tags in L slots
    tags, q = 16, 4
    times = slots(PROFILES["sargas"].link)
    first = [run("sargas", 2, tags, seconds=0.05, seed=seed, start_q=q, between_rounds=0.0).t.min() for seed in range(800)]
    hit = np.abs(np.array(first) - (0.01 + times.query + times.success)) < 1e-9
    p = tags / 2**q * (1 - 1 / 2**q) ** (tags - 1)
    assert hit.mean() == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / len(hit)))


@pytest.mark.parametrize(
    ("name", "ports", "tags", "low", "high"),
    [("r420", 1, 1, 60, 80), ("fx7500", 2, 3, 175, 210), ("fx7500", 2, 4, 190, 230), ("sargas", 1, 1, 280, 320)],
)
def test_rates_of_real_readers(name, ports, tags, low, high):
    assert low <= len(run(name, ports, tags).t) / SECONDS <= high


def test_four_ports_of_an_r420_come_round_in_a_sixth_of_a_second():
    got = run("r420", 4, 1)
    assert np.median(np.diff(got.start[got.antenna == 2])) == pytest.approx(0.17, abs=0.01)
    assert 30e-3 <= np.median(np.diff(got.start)) <= 50e-3


def test_sixty_tags_read_each_other_down():
    alone, crowd = run("r420", 1, 1), run("r420", 1, 60)
    per_tag = np.bincount(crowd.tag, minlength=60) / SECONDS
    assert per_tag.max() < 0.1 * len(alone.t) / SECONDS
    assert per_tag.min() > 0.8 * per_tag.max()  # evenly


def test_every_tag_is_read_once_in_each_round_and_in_no_order():
    got = run("r420", 2, 8)
    whole = np.arange(len(got.start) - 1)
    reads = [got.tag[got.visit == v] for v in whole[:200]]
    assert all(sorted(r) == list(range(8)) for r in reads)
    # the first read of a round is anybody's: 200 rounds of 8 tags, a count's sigma is 4.7; 5 sigma
    firsts = np.bincount([r[0] for r in reads], minlength=8)
    assert np.abs(firsts - 25).max() < 5 * 4.7
    assert (np.diff(got.t) > 0).all()
    assert ((got.t > got.start[got.visit]) & (got.t <= got.end[got.visit])).all()


def test_visits_take_turns_number_themselves_and_are_there_without_tags():
    got = run("r420", 3, 0)
    assert len(got.t) == 0
    assert np.array_equal(got.antenna, np.arange(len(got.start)) % 3)
    assert np.array_equal(got.number, np.arange(len(got.start)) // 3)
    assert (got.start[1:] >= got.end[:-1]).all()
    assert got.end[-1] <= SECONDS
    assert len(run("r420", 0, 0).start) == 0


def test_a_tag_that_cannot_answer_changes_nothing_for_the_others():
    antenna, tag = np.repeat([0, 1], 3), np.tile([0, 1, 2], 2)
    heard = hearing(2, 1, SECONDS, antenna, np.zeros(6, dtype=int), tag)
    three, four = run("r420", 2, 3, heard=heard), run("r420", 2, 4, heard=heard)
    assert np.array_equal(three.t, four.t)
    assert np.array_equal(three.tag, four.tag)


def test_a_tag_answers_only_while_it_hears():
    cells = 60
    cell = np.arange(20, 40)
    heard = hearing(1, cells, 1.0, np.zeros(20, dtype=int), cell, np.zeros(20, dtype=int))
    got = run("r420", 1, 1, heard=heard)
    assert 20.0 <= got.t.min() < 20.1
    assert 39.9 < got.t.max() < 40.1


def test_a_tag_that_select_leaves_out_is_never_read():
    got = run("r420", 1, 5, asked=np.array([True, False, True, False, True]))
    assert sorted(set(got.tag)) == [0, 2, 4]
    assert len(got.silenced) == 0  # the sensor knows whom Select leaves out


@pytest.mark.parametrize(("session", "every"), [(1, 2.0), (2, None)])
def test_a_single_target_silences_a_tag_until_its_flag_falls_back(session, every):
    got = run("r420", 2, 1, session=session, dual_target=False, persistence=2.0)
    if every is None:
        assert len(got.t) == 1  # its power keeps the flag
    else:
        assert np.diff(got.t).min() >= every
        assert np.diff(got.t).max() < every + 0.1
    read, silent = set(got.visit), {int(v) for v, _ in got.silenced}
    assert read.isdisjoint(silent)
    assert len(read | silent) == len(got.start)  # in every visit it was read or not asked


def test_a_flag_of_session_two_falls_back_without_power():
    heard = hearing(1, 60, 1.0, np.zeros(2, dtype=int), np.array([5, 30]), np.zeros(2, dtype=int))
    got = run("r420", 1, 1, heard=heard, session=2, dual_target=False, persistence=3.0)
    assert len(got.t) == 2
    assert got.t[1] >= 30.0


def test_session_zero_forgets_when_the_port_changes():
    got = run("r420", 2, 3, session=0, dual_target=False)
    assert len(got.silenced) == 0
    assert (np.bincount(got.visit)[:-1] == 3).all()


def test_seeds_repeat_and_differ():
    a, again, b = (run("r420", 1, 6, seconds=3.0, seed=s) for s in (1, 1, 2))
    assert np.array_equal(a.t, again.t)
    assert not np.array_equal(a.t[:20], b.t[:20])


def test_an_unknown_profile_is_answered_with_the_nearest_name():
    with pytest.raises(ValueError, match="did you mean r420"):
        profile("r42")
