"""What all guides say to a person: turns, steps, and sentences where there is no direction."""

import numpy as np
import pytest

from estimators.handheld_guide import MISDECLARED, NO_ANSWER, NO_READS, NOT_TRUSTED
from estimators.handheld_none import HandheldNone
from estimators.handheld_paper import HandheldPaper
from estimators.handheld_rb import HandheldRb
from testbed.checks import samples
from testbed.guidance import Actions, in_words, wrapped
from testbed.rng import RowRandom
from testbed.types import Event, Prior, Reads, Status

GUIDES = [HandheldPaper, HandheldRb, HandheldNone]
K = 4 * np.pi * samples.CARRIERS.mean() / 299_792_458.0


def guide(method, rows=1, **config):
    made = method(method.Config(**config), samples.site(), RowRandom(np.arange(rows) + 5))
    made.start(Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1))))
    return made


def act(made, t=1.0, turn=0.0, step=0.0, heard=True, change=np.nan, began=0.0):
    n = made.rows
    one = np.ones(n)
    made.update(
        Event(
            "actions",
            np.arange(n),
            Actions(t * one, t * one, began * one, np.zeros(n), turn * one, step * one, np.full(n, heard), change * one),
        )
    )


def feed(made, t, phase, channel=None):
    for i in range(len(t)):
        reads = Reads([t[i]], [t[i]], [0], [0], [0 if channel is None else channel[i]], phase=[phase[i]])
        made.update(Event("reads", np.array([0]), reads))


def walked(t, start=6.0, speed=0.5):
    """The phases of a straight walk towards the tag, wrapped at 2π."""
    return np.mod(-K * (start - speed * t) + 1.0, 2 * np.pi)


@pytest.mark.parametrize("method", GUIDES)
def test_who_hears_the_tag_steps_at_once_and_turns_after_the_step(method):
    made = guide(method)
    act(made)
    first = made.suggest()
    assert np.isnan(first.turn[0])
    assert first.step[0] == 0.5
    assert np.isnan(first.aim[0]), "nothing is known of the direction before the first step"
    act(made, step=0.5, change=-15.0)
    after = made.suggest()
    assert np.isfinite(after.turn[0])
    assert after.step[0] > 0
    assert after.said[0] == ""


@pytest.mark.parametrize(("method", "turn"), [(HandheldPaper, np.pi), (HandheldRb, np.pi), (HandheldNone, np.pi / 2)])
def test_who_hears_nothing_turns_to_search(method, turn):
    made = guide(method)
    act(made, heard=False)
    assert made.suggest().turn[0] == pytest.approx(turn)
    assert made.estimate().status[0] == Status.LOST


@pytest.mark.parametrize("method", GUIDES)
def test_a_tag_that_never_answers_is_told_in_words_without_a_direction(method):
    made = guide(method, patience=4)
    for _ in range(4):
        act(made, heard=False, turn=1.0)
    advice = made.suggest()
    assert advice.said[0] == NO_ANSWER
    assert np.isnan(advice.turn[0])
    assert advice.step[0] == 0
    assert np.isnan(advice.aim[0])


@pytest.mark.parametrize("method", [HandheldPaper, HandheldRb])
def test_a_step_without_reads_is_told_and_no_direction_is_made_up(method):
    made = guide(method)
    act(made)
    act(made, step=0.5, heard=False)
    advice = made.suggest()
    assert advice.said[0] == NO_READS
    assert np.isnan(advice.aim[0])


@pytest.mark.parametrize("method", [HandheldPaper, HandheldRb])
def test_a_reader_that_wraps_otherwise_than_declared_is_told_and_stays_told(method):
    made = guide(method, stream={"wraps_at": "pi"})
    act(made)
    t = np.linspace(1.0, 2.0, 200)
    feed(made, t, walked(t))
    act(made, t=2.0, began=1.0, step=0.5)
    for _ in range(2):
        advice = made.suggest()
        assert advice.said[0] == MISDECLARED
        assert np.isnan(advice.turn[0])
        assert advice.step[0] == 0
        assert np.isnan(advice.aim[0])
        assert made.estimate().status[0] == Status.LOST
        act(made, t=3.0, began=2.0, step=0.5, change=-10.0)


def test_a_reader_said_to_wrap_at_two_pi_that_wraps_at_pi_is_found_out():
    made = guide(HandheldRb)
    act(made)
    t = np.linspace(1.0, 2.0, 200)
    feed(made, t, np.mod(walked(t), np.pi))
    act(made, t=2.0, began=1.0, step=0.5)
    assert made.suggest().said[0] == MISDECLARED


@pytest.mark.parametrize("method", [HandheldPaper, HandheldRb])
def test_a_step_whose_phase_can_not_be_followed_is_told(method):
    made = guide(method)
    act(made)
    t = np.sort(np.random.default_rng(2).uniform(1.0, 2.0, 300))
    feed(made, t, np.random.default_rng(3).uniform(0, 2 * np.pi, 300))
    act(made, t=2.0, began=1.0, step=0.5)
    assert made.suggest().said[0] == NOT_TRUSTED


def test_reads_of_a_straight_walk_tell_that_the_tag_is_ahead_and_pauses_are_forgotten():
    made = guide(HandheldRb, particles=1000)
    act(made, t=0.9)
    for k in range(6):
        begin = 1.0 + k
        t = np.sort(np.random.default_rng(k).uniform(begin, begin + 1, 250))
        feed(made, t, walked(t))
        act(made, t=begin + 1, began=begin, step=0.5)
        feed(made, np.array([begin + 1.0001]), np.array([0.3]))  # read while standing
        if k < 5:
            act(made, t=begin + 1.001, began=begin + 1, turn=0.0)
    assert abs(made.estimate().mean[0, 1]) < 2.0
    assert made.estimate().mean[0, 0] > 1.0


def test_suggest_and_estimate_are_pure():
    made = guide(HandheldRb, rows=3)
    act(made)
    act(made, step=0.5, change=-12.0)
    a, b = made.suggest(), made.suggest()
    np.testing.assert_array_equal(a.turn, b.turn)
    np.testing.assert_array_equal(made.estimate().mean, made.estimate().mean)


# ---------------------------------------------------------------- in words


@pytest.mark.parametrize(
    ("turn", "step", "said", "told"),
    [
        (np.deg2rad(35), 0.5, "", "turn left 35°, one step"),
        (np.deg2rad(-33.1), 0.5, "", "turn right 35°, one step"),
        (np.pi, 0.5, "", "turn round, one step"),
        (np.deg2rad(2), 0.5, "", "straight ahead, one step"),
        (np.nan, 0.5, "", "one step"),
        (np.deg2rad(90), 0.0, "", "turn left 90°"),
        (np.deg2rad(-20), 0.21, "", "turn right 20°, a short step of 21 cm"),
        (np.nan, 0.0, "The tag does not answer.", "The tag does not answer."),
        (np.pi, 0.5, "No reads.", "No reads. Turn round, one step."),
    ],
)
def test_instructions_in_words(turn, step, said, told):
    assert in_words(turn, step, said) == told


def test_angles_wrap():
    np.testing.assert_allclose(wrapped(np.array([0.0, np.pi, -np.pi, 3 * np.pi / 2, 7.0])), [0, -np.pi, -np.pi, -np.pi / 2, 7 - 2 * np.pi])
