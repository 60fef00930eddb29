"""The published source of detection counts, against its own formulas by other means. Fixed seeds; false alarms are stated."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import betaln, gammaln

from testbed.radio.logistic_beta import DeadZoneConfig, beta_of, blocks, counts, dead, mean, residual, variance
from testbed.rng import Counter

QUERIES = 10
PAPER = DeadZoneConfig()


def keys(n, antennas=4, tags=3):
    i = np.arange(n)
    return (i % antennas).astype(np.uint64), i // (antennas * tags), (i // antennas % tags).astype(np.uint64) + np.uint64(50)


def test_figures_of_the_paper():
    assert mean(5.906, 0.0) == pytest.approx(0.5, abs=1e-3)
    assert mean(2.0, np.pi / 2) == pytest.approx(0.16, abs=0.01)  # degrees: in radians a patch would have no directivity
    d = np.linspace(0.0, 12.0, 200)
    c = (-0.04453125, 0.034375, -0.003125, 0.0, -1.388889e-5)
    written_out = c[0] + c[1] * d + c[2] * d**2
    inside = (written_out > 0) & (d <= 10)
    np.testing.assert_allclose(variance(d, 0.0)[inside], written_out[inside], atol=1e-12)
    assert (variance(d, 0.0)[~inside] == 0).all()
    assert variance(5.5, np.deg2rad(59.9)) > 0 == variance(5.5, np.deg2rad(61.0))


def test_the_variance_is_one_that_a_beta_distribution_can_have():
    d, a = np.meshgrid(np.linspace(0.1, 15, 150), np.linspace(-np.pi, np.pi, 91))
    m, v = mean(d, a), variance(d, a)
    assert (v <= 0.6 * m * (1 - m) + 1e-15).all()
    alpha, beta = beta_of(m[v > 0], v[v > 0])
    assert (alpha > 0).all()
    assert (beta > 0).all()
    np.testing.assert_allclose(alpha / (alpha + beta), m[v > 0])
    np.testing.assert_allclose(alpha * beta / (alpha + beta) ** 2 / (alpha + beta + 1), v[v > 0])


def mass(d, a):
    """P(n), Eq. 7, by logarithms of the Beta function."""
    n, (alpha, beta) = np.arange(QUERIES + 1), beta_of(mean(d, a), variance(d, a))
    log = gammaln(QUERIES + 1) - gammaln(n + 1) - gammaln(QUERIES - n + 1) + betaln(n + alpha, QUERIES - n + beta) - betaln(alpha, beta)
    share = PAPER.alpha / (PAPER.alpha + PAPER.beta)
    return (1 - share) * np.exp(log) + share * (n == 0)


@pytest.mark.parametrize(("d", "degrees"), [(3.0, 0.0), (5.5, 20.0), (7.0, 0.0), (5.0, 45.0)])
def test_counts_are_distributed_as_published(d, degrees):
    # χ² over the counts, cells of 5 or more expected: each test fails by chance once in 10,000
    n = 20_000
    got = blocks(np.full(n, d), np.full(n, np.deg2rad(degrees)), 0.0, QUERIES, PAPER, Counter(5, 1, "x"), keys(n))
    expected = n * mass(d, np.deg2rad(degrees))
    assert expected.sum() == pytest.approx(n, rel=1e-9)
    wide = expected >= 5
    seen = np.bincount(got, minlength=QUERIES + 1)
    statistic = ((seen - expected)[wide] ** 2 / expected[wide]).sum()
    assert statistic < stats.chi2(wide.sum() - 1).ppf(1 - 1e-4)


def test_without_spread_counts_are_binomial():
    # variance 0 beyond 10 m: χ² at 1e-4
    n, d = 20_000, 10.5
    m = float(mean(d, 0.0))
    got = counts(np.full(n, m), np.zeros(n), QUERIES, Counter(5, 2, "x"), keys(n))
    expected = n * stats.binom(QUERIES, m).pmf(np.arange(QUERIES + 1))
    wide = expected >= 5
    assert ((np.bincount(got, minlength=QUERIES + 1) - expected)[wide] ** 2 / expected[wide]).sum() < stats.chi2(wide.sum() - 1).ppf(
        1 - 1e-4
    )


def test_without_shelves_the_counts_are_those_of_the_pure_generator_seed_for_seed():
    n = 3000
    rng = np.random.default_rng(1)
    d, a, k = rng.uniform(1, 12, n), rng.uniform(-2, 2, n), keys(n)
    draws = Counter(9, 0, "sensors.portal.detection")
    pure = counts(mean(d, a), variance(d, a), QUERIES, draws, k)
    alive = draws.uniform(3, *k) < 1 - stats.beta(0.9, 17.1).ppf(draws.uniform(2, *k))
    assert np.array_equal(blocks(d, a, np.zeros(n), QUERIES, PAPER, draws, k), pure * alive)
    shelves = np.where(np.arange(n) % 3 == 0, 1.0, 0.0)
    behind = blocks(d, a, shelves, QUERIES, PAPER, draws, k)
    assert (behind[shelves == 1] == 0).all()
    assert np.array_equal(behind[shelves == 0], (pure * alive)[shelves == 0])  # p isn't lowered as well


def test_the_dead_flags_of_one_readers_antennas_are_uncorrelated():
    # 20,000 rounds: a correlation has a standard error of 0.007; 6 pairs at 5 sigma: false alarm 4e-6
    n = 20_000
    draws, rounds = Counter(2, 0, "x"), np.arange(n)
    flags = []
    for antenna in range(4):
        k = np.full(n, antenna, np.uint64), rounds, np.full(n, 7, np.uint64)
        flags.append(dead(0.0, residual(DeadZoneConfig(alpha=2, beta=2), draws, *k), draws, k))
    correlation = np.corrcoef(flags) - np.eye(4)
    assert np.abs(correlation).max() < 5 / np.sqrt(n)
    assert np.mean(flags) == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(4 * n))


def test_geometry_and_the_residual_close_a_way_together():
    # P(dead) = 1 - (1 - g)(1 - E r): 20,000 draws, 5 sigma
    n = 20_000
    k = keys(n)
    draws = Counter(3, 0, "x")
    for g in (0.0, 0.3, 0.9, 1.0):
        flags = dead(np.full(n, g), residual(PAPER, draws, *k), draws, k)
        p = 1 - (1 - g) * (1 - 0.9 / 18)
        assert flags.mean() == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / n) + 1e-12)


def test_scopes_share_their_draw_and_nothing_else():
    k = keys(240)
    draws = Counter(4, 0, "x")
    shared = {"count": 240, "round": 80, "antenna": 4, "run": 1}
    for scope, different in shared.items():
        r = residual(DeadZoneConfig(scope=scope), draws, *k)
        assert r.shape == (240,)
        assert len(np.unique(r)) == different, scope
    by_antenna = residual(DeadZoneConfig(scope="antenna"), draws, *k)
    assert all(len(np.unique(by_antenna[k[0] == a])) == 1 for a in range(4))


def test_a_persistent_scope_has_the_same_mean_and_clumps():
    # over 2,000 runs the mean of r is 0.05, standard error 0.001; the counts of one run agree with each other
    r = np.array([residual(DeadZoneConfig(scope="run"), Counter(6, i, "x"), *keys(12)) for i in range(2000)])
    assert r.mean() == pytest.approx(0.05, abs=5 * 0.0012)
    assert (r == r[:, :1]).all()


def test_a_block_draws_by_its_own_keys_alone():
    n = 100
    d, k, draws = np.full(n, 5.0), keys(n), Counter(1, 0, "x")
    whole = blocks(d, 0 * d, 0.0, QUERIES, PAPER, draws, k)
    some = np.arange(30, 60)
    part = blocks(d[some], 0 * d[some], 0.0, QUERIES, PAPER, draws, tuple(x[some] for x in k))
    assert np.array_equal(part, whole[some])
