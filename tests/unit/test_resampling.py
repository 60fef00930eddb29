"""Resampling: shares, edges and sizes. Statistical tests state their false-alarm probability."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chi2

from estimators.resampling import effective_number, kld_size, multinomial, systematic, systematic_sizes

WEIGHTS = arrays(np.float64, (3, 7), elements=st.floats(0, 1)).filter(lambda w: (w.sum(axis=1) > 1e-6).all())
UNIFORMS = arrays(np.float64, (3,), elements=st.floats(0, 1, exclude_max=True))


@settings(max_examples=200, deadline=None)
@given(WEIGHTS, UNIFORMS, st.integers(1, 40))
def test_each_particle_has_its_share_of_heirs_within_one(weight, uniform, size):
    chosen = systematic(weight, uniform, size)
    heirs = np.stack([np.bincount(row, minlength=7) for row in chosen])
    share = size * weight / weight.sum(axis=1, keepdims=True)
    assert chosen.shape == (3, size)
    assert (np.abs(heirs - share) < 1 + 1e-9).all()
    assert not heirs[weight == 0].any()
    assert (np.diff(chosen, axis=1) >= 0).all()


@settings(max_examples=50, deadline=None)
@given(WEIGHTS, UNIFORMS)
def test_rows_are_independent_and_scale_does_not_matter(weight, uniform):
    whole = systematic(weight, uniform)
    for b in range(3):
        np.testing.assert_array_equal(systematic(weight[b : b + 1], uniform[b : b + 1])[0], whole[b])
    np.testing.assert_array_equal(systematic(4.0 * weight, uniform), whole)


def test_systematic_is_unbiased():
    # the mean number of heirs over evenly spread shifts is the share exactly, but for the 1/1000 between two shifts
    weight = np.tile([0.05, 0.5, 0.15, 0.3], (1000, 1))
    chosen = systematic(weight, (np.arange(1000) + 0.5) / 1000, 7)
    heirs = np.stack([(chosen == i).sum(axis=1) for i in range(4)], axis=1).mean(axis=0)
    np.testing.assert_allclose(heirs, 7 * weight[0], atol=2e-3)


def test_sizes_of_rows_may_differ():
    weight = np.tile([0.1, 0.2, 0.7], (2, 1))
    found = systematic_sizes(weight, np.array([0.3, 0.3]), np.array([2, 5]))
    np.testing.assert_array_equal(found[0], [*systematic(weight[:1], np.array([0.3]), 2)[0], -1, -1, -1])
    np.testing.assert_array_equal(found[1], systematic(weight[1:], np.array([0.3]), 5)[0])


def test_multinomial_choices_follow_the_weights():
    weight = np.array([[0.1, 0.0, 0.6, 0.3]])
    draws = 20_000
    heirs = np.bincount(multinomial(weight, np.random.default_rng(1).random((1, draws)))[0], minlength=4)
    assert heirs[1] == 0
    there = weight[0] > 0
    expected = draws * weight[0, there]
    statistic = ((heirs[there] - expected) ** 2 / expected).sum()
    assert statistic < chi2.ppf(1 - 1e-6, 2)  # false alarm 1e-6


def test_the_effective_number_counts_equal_weights():
    np.testing.assert_allclose(effective_number(np.array([[1, 1, 1, 1], [0, 5, 0, 0], [2, 2, 0, 0]])), [4, 1, 2])


def test_kld_size_is_the_chi_squared_quantile():
    bins = np.array([2, 10, 100, 1000])
    # Fox's Eq. 5 before the approximation: χ²(k - 1) quantile over 2 ε
    exact = chi2.ppf(0.99, bins - 1) / (2 * 0.05)
    np.testing.assert_allclose(kld_size(bins, 0.05, 0.99), exact, rtol=0.03)
    np.testing.assert_array_equal(kld_size(np.array([0, 1]), 0.05, 0.99), [1, 1])


@pytest.mark.parametrize("row", [[0.0, 0.0], [np.nan, 1.0], [-0.1, 1.0], [np.inf, 1.0]])
def test_weights_that_are_none_are_refused_with_their_row(row):
    with pytest.raises(ValueError, match="row 1: weights must not be negative"):
        systematic(np.array([[0.5, 0.5], row]), np.array([0.1, 0.1]))


def test_draws_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"one uniform a row, shape \(1,\)"):
        systematic(np.ones((1, 3)), np.zeros(3))
    with pytest.raises(ValueError, match=r"shape \(rows, particles\)"):
        systematic(np.ones(3), np.zeros(3))
    with pytest.raises(ValueError, match="a distance above 0"):
        kld_size(np.array([3]), 0.0, 0.9)
