"""Streams of wrapped phases followed over a step: exact without noise, robust with it, honest where it can't be done."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.phase_stream import PhaseStream, StreamConfig, misdeclared
from testbed.types import Reads

CARRIERS = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])
C = 299_792_458.0


def step(rate=300, speed=0.5, length=0.5, period=2 * np.pi, noise=0.0, wrong=0.0, hops=False, sign=1, seed=1, away=False, lost=None):
    """(t, phase, channel, duration, true change) of a step of `length` m straight at a tag 5 m off, or away from it."""
    draws = np.random.default_rng(seed)
    duration = length / speed
    t = np.sort(draws.uniform(0, duration, draws.poisson(rate * duration)))
    if lost is not None:
        t = t[(t < lost[0]) | (t > lost[1])]
    distance = 5.0 + (speed if away else -speed) * t
    table = CARRIERS if hops else CARRIERS[:1]
    channel = draws.integers(0, len(table), 100)[(t / 0.2).astype(int)]
    phase = -4 * np.pi * table[channel] / C * distance + draws.uniform(0, 7, 4)[channel] + noise * draws.normal(size=len(t))
    bad = draws.random(len(t)) < wrong
    phase = np.where(bad, draws.uniform(0, 7, len(t)), phase)
    change = 4 * np.pi * table.mean() / C * length * (1 if away else -1)
    return t, np.mod(sign * phase, period), channel, duration, change


def followed(t, phase, channel, duration, change, hops=False, **config):
    stream = PhaseStream(StreamConfig(**config), CARRIERS if hops else CARRIERS[:1])
    stream.start(1)
    for i in range(len(t)):
        stream.take(np.array([0]), Reads([t[i]], [t[i]], [0], [0], [channel[i]], phase=[phase[i]]))
    return stream.change(np.array([0]), np.zeros(1), np.array([duration]))


@pytest.mark.parametrize("away", [False, True])
@pytest.mark.parametrize(("period", "wraps_at"), [(np.pi, "pi"), (2 * np.pi, "2pi")])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_clean_step_is_followed_exactly_whatever_the_readers_period_and_sign(period, wraps_at, sign, away):
    made = step(period=period, sign=sign, away=away)
    found = followed(*made, wraps_at=wraps_at, sign=sign)
    assert found.trusted[0]
    assert found.change[0] == pytest.approx(made[-1], abs=1e-6)


def test_the_wrong_sign_turns_the_change_round():
    made = step()
    assert followed(*made, sign=-1).change[0] == pytest.approx(-made[-1], abs=1e-6)


@pytest.mark.parametrize("hops", [False, True])
def test_noise_and_outliers_cost_little(hops):
    errors = []
    for seed in range(30):
        made = step(noise=0.1, wrong=0.05, hops=hops, seed=seed, period=np.pi)
        found = followed(*made, hops=hops, wraps_at="pi")
        errors.append(found.change[0] - made[-1] if found.trusted[0] else np.nan)
    errors = np.array(errors)
    assert np.isfinite(errors).mean() > 0.9
    assert np.nanmax(np.abs(errors)) < np.pi / 2, "a slip that is trusted"
    assert np.nanstd(errors) < 0.25


def plainly(t, phase, period):
    """What everybody tries first: unwrap neighbour by neighbour, take the last less the first."""
    unwrapped = np.unwrap(phase, period=period)
    return -(unwrapped[-1] - unwrapped[0])


def test_a_plain_unwrap_slips_in_half_of_the_steps_where_this_one_does_not():
    slips = {"plain": 0, "followed": 0}
    for seed in range(60):
        made = step(noise=0.1, wrong=0.05, speed=1.0, period=np.pi, seed=seed)
        slips["plain"] += abs(plainly(made[0], made[1], np.pi) - made[-1]) > np.pi / 2
        slips["followed"] += not abs(followed(*made, wraps_at="pi").change[0] - made[-1]) < np.pi / 2
    assert slips["plain"] >= 20
    assert slips["followed"] <= 1


def test_a_gap_in_the_reads_and_few_reads_are_not_trusted():
    assert not followed(*step(lost=(0.3, 0.7))).trusted[0]
    assert not followed(*step(rate=8)).trusted[0]
    assert followed(*step(rate=100)).trusted[0]


def test_noise_alone_is_not_trusted():
    t, _, channel, duration, change = step()
    noise = np.random.default_rng(4).uniform(0, 2 * np.pi, len(t))
    assert not followed(t, noise, channel, duration, change).trusted[0]


def test_no_reads_make_no_change():
    found = followed(np.empty(0), np.empty(0), np.empty(0, dtype=int), 1.0, 0.0)
    assert found.reads[0] == 0
    assert np.isnan(found.change[0])
    assert not found.trusted[0]


def test_reads_without_a_phase_are_left_out():
    stream = PhaseStream(StreamConfig(), CARRIERS)
    stream.start(1)
    assert not stream.take(np.array([0]), Reads([0.1], [0.1], [0], [0], [0])).any()


def test_rows_keep_their_reads_apart_and_forget_them_alone():
    stream = PhaseStream(StreamConfig(), CARRIERS[:1])
    stream.start(2)
    one, two = step(seed=1), step(seed=2, away=True)
    for made, row in ((one, 0), (two, 1)):
        for t, phase in zip(made[0], made[1], strict=True):
            stream.take(np.array([row]), Reads([t], [t], [0], [0], [0], phase=[phase]))
    found = stream.change(np.array([0, 1]), np.zeros(2), np.full(2, 1.0))
    np.testing.assert_allclose(found.change, [one[-1], two[-1]], atol=1e-6)
    assert stream.change(np.array([0]), np.zeros(1), np.ones(1)).reads[0] == 0


@given(period=st.sampled_from([np.pi, 2 * np.pi]), seed=st.integers(0, 1000), speed=st.floats(0.2, 1.5))
@settings(max_examples=30, deadline=None)
def test_a_reader_that_wraps_as_declared_is_never_accused(period, seed, speed):
    made = step(period=period, noise=0.1, wrong=0.05, seed=seed, speed=speed)
    assert not misdeclared(made[1], period)


def test_a_reader_that_wraps_otherwise_is_found_out():
    assert misdeclared(step(period=2 * np.pi)[1], np.pi)
    assert misdeclared(step(period=np.pi)[1], 2 * np.pi)
    still = np.full(100, 0.4) + 0.01 * np.sin(np.arange(100))
    assert not misdeclared(still, 2 * np.pi), "who stands still says nothing about the wrap"
