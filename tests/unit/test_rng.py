"""Randomness by name and counter. Statistical tests use fixed seeds; their false-alarm probability is stated at each."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from testbed.rng import Counter, RowRandom, key_of, mix, stream


def test_a_name_has_one_stream_and_another_name_another():
    a, again, b = (stream(7, 3, name).random(4) for name in ("portal", "portal", "portal2"))
    assert np.array_equal(a, again)
    assert not np.array_equal(a, b)


def test_trial_and_root_both_matter():
    draws = {stream(root, trial, "x").random() for root in (1, 2) for trial in (1, 2)}
    assert len(draws) == 4


def test_another_process_gives_the_same_numbers():
    code = "from testbed.rng import *; print(stream(7, 3, 'portal').random(), Counter(7, 3, 'p').uniform(5, 6), key_of('t1'))"
    out = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout for _ in range(2)]
    here = f"{stream(7, 3, 'portal').random()} {Counter(7, 3, 'p').uniform(5, 6)} {key_of('t1')}\n"
    assert out == [here, here]


def test_a_counter_draw_depends_on_its_own_indices_alone():
    draws = Counter(1, 2, "fade")
    grid = draws.normal(np.arange(50)[:, None], np.arange(40))
    assert np.array_equal(grid[7:9, 5:30], draws.normal(np.arange(7, 9)[:, None], np.arange(5, 30)))
    assert grid[3, 4] == draws.normal(3, 4)


def test_counters_are_not_interchangeable():
    draws = Counter(1, 2, "fade")
    assert draws.bits(3, 4) != draws.bits(4, 3)
    assert draws.bits(0) != draws.bits(0, 0)


def test_negative_and_unsigned_counters_are_taken():
    assert mix(5, np.int64(-1)) == mix(5, np.uint64(2**64 - 1))


@pytest.mark.parametrize("axis", [0, 1])
def test_uniform_draws_are_uniform_along_each_counter(axis):
    # Kolmogorov-Smirnov, 2 x 20 tests at 1e-5 each: false alarm 4e-4
    grid = Counter(11, 0, "u").uniform(np.arange(20)[:, None], np.arange(20_000))
    lines = grid if axis else Counter(11, 0, "u").uniform(np.arange(20_000)[:, None], np.arange(20)).T
    assert min(stats.kstest(line, "uniform").pvalue for line in lines) > 1e-5


def test_neighbouring_counters_are_uncorrelated():
    # each correlation of n samples is N(0, 1/n): 3 tests at 5 sigma, false alarm 2e-6
    z = Counter(5, 1, "n").normal(np.arange(400)[:, None], np.arange(400))
    n = z.size
    for a, b in [(z[:-1], z[1:]), (z[:, :-1], z[:, 1:]), (z[:-1, :-1], z[1:, 1:])]:
        assert abs((a * b).mean()) < 5 / np.sqrt(n)


def test_every_bit_of_the_output_is_fair():
    # 64 binomial tests of 2^16 draws at 5 sigma: false alarm 4e-5
    bits = Counter(3, 3, "b").bits(np.arange(2**16))
    ones = ((bits[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)).sum(axis=0).astype(np.int64)
    assert np.all(np.abs(ones - 2**15) < 5 * np.sqrt(2**14))


def test_normal_draws_are_normal():
    # Kolmogorov-Smirnov at 1e-5
    assert stats.kstest(Counter(1, 1, "z").normal(np.arange(100_000)), "norm").pvalue > 1e-5


def test_rows_draw_the_same_alone_or_in_company():
    together = RowRandom([10, 20, 30])
    first = together.normal(4)
    second = together.normal(2, rows=np.array([0, 2]))
    alone = RowRandom([30])
    assert np.array_equal(alone.normal(4)[0], first[2])
    assert np.array_equal(alone.normal(2)[0], second[1])
    assert not np.array_equal(first[0], first[1])


def test_a_row_does_not_repeat_itself():
    rows = RowRandom([10])
    assert len(np.unique(np.concatenate([rows.uniform(100)[0] for _ in range(10)]))) == 1000


def test_a_row_has_an_ordinary_generator():
    assert RowRandom([1, 2]).generator(1).random() == RowRandom([2]).generator(0).random()
