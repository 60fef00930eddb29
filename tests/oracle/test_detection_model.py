"""The estimators' observation model against quadrature of its definition, and its table against the exact path."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import integrate, stats
from scipy.special import betaln, gammaln

from estimators import detection_model
from estimators.detection_model import DetectionModel, DetectionModelConfig, degrees_off, looked_up
from testbed.radio import logistic_beta

MODEL = DetectionModel(DetectionModelConfig())
N = 10
PLACES = [(0.5, 0.0), (3.0, 50.0), (5.5, 20.0), (7.0, 0.0), (9.8, 0.0), (4.0, 120.0)]


def test_the_printed_check_and_degrees_not_radians():
    assert MODEL.mean(5.906, 0.0) == pytest.approx(0.5, abs=1e-4)
    assert MODEL.mean(2.0, 90.0) == pytest.approx(0.156, abs=0.005)


@pytest.mark.parametrize("queries", [1, 10, 40])
def test_probabilities_sum_to_one_everywhere(queries):
    d, angle = np.meshgrid(np.linspace(0, 60, 121), np.linspace(0, 180, 37))
    for shut in (0.0, 0.3, 1.0):
        total = sum(np.exp(MODEL.log_mass(n, queries, d, angle, shut)) for n in range(queries + 1))
        np.testing.assert_allclose(total, 1.0, atol=1e-10)


def test_the_variance_is_always_below_that_of_a_coin():
    d, angle = np.meshgrid(np.linspace(0, 30, 301), np.linspace(0, 180, 361))
    m, v = MODEL.mean(d, angle), MODEL.spread(d, angle)
    assert (v < m * (1 - m)).all()
    assert (v / (m * (1 - m))).max() == pytest.approx(0.591, abs=0.002)  # so that the guard at 0.6 never acts
    assert (v[d > 9.5] == 0).all()


@pytest.mark.parametrize(("d", "angle"), PLACES)
def test_mass_is_the_integral_of_its_definition(d, angle):
    """Eq. 6 by quadrature over p, averaged over λ ~ Beta(0.9, 17.1) by quadrature as well."""
    m, v = float(MODEL.mean(d, angle)), float(MODEL.spread(d, angle))
    dead = stats.beta(0.9, 17.1)
    share = integrate.quad(lambda x: dead.sf(x), 0, 1)[0]  # E λ
    for n in (0, 1, 5, 10):
        if v > 0:
            p = stats.beta(m * (m * (1 - m) / v - 1), (1 - m) * (m * (1 - m) / v - 1))
            # over the distribution function, in which the integrand has no poles
            alive = integrate.quad(lambda u, p=p, n=n: stats.binom.pmf(n, N, p.ppf(u)), 0, 1, limit=100, epsabs=1e-10)[0]
        else:
            alive = stats.binom.pmf(n, N, m)  # zero variance is Binomial(N, m), not p = 0
        assert np.exp(MODEL.log_mass(n, N, d, angle)) == pytest.approx((1 - share) * alive + share * (n == 0), rel=2e-5, abs=1e-9)


def test_the_product_is_the_quotient_of_beta_functions():
    d, angle = np.random.default_rng(4).uniform([2, 0], [9, 50], (500, 2)).T
    m, v = MODEL.mean(d, angle), MODEL.spread(d, angle)
    d, angle, m, v = (x[v > 1e-3] for x in (d, angle, m, v))
    a, b = m * (m * (1 - m) / v - 1), (1 - m) * (m * (1 - m) / v - 1)
    for n in range(N + 1):
        log = betaln(n + a, N - n + b) - betaln(a, b) + gammaln(N + 1) - gammaln(n + 1) - gammaln(N - n + 1)
        np.testing.assert_allclose(MODEL.log_alive(n, N, d, angle), log, rtol=1e-9, atol=1e-9)


def test_two_pieces_of_code_agree_on_the_published_model():
    """The generator's formulas and the estimators' are written apart; here they are set side by side."""
    d, angle = np.meshgrid(np.linspace(0.1, 25, 200), np.linspace(0, 180, 91))
    np.testing.assert_allclose(MODEL.mean(d, angle), logistic_beta.mean(d, np.deg2rad(angle)), rtol=1e-12)
    np.testing.assert_allclose(MODEL.spread(d, angle), logistic_beta.variance(d, np.deg2rad(angle)), atol=1e-14)


def test_the_fast_angle_is_an_arc_cosine():
    cosine = np.concatenate([np.linspace(-1, 1, 20_001), [-1.0 - 1e-12, 1.0 + 1e-12]])
    found = np.array([degrees_off(c) for c in cosine])
    np.testing.assert_allclose(found, np.rad2deg(np.arccos(np.clip(cosine, -1, 1))), atol=5e-6)


def drawn(rng, size, reach, widest):
    """Places (d, degrees) and the counts that the model has there."""
    d, angle = rng.uniform(0, reach, size), rng.uniform(0, widest, size)
    m, v = MODEL.mean(d, angle), MODEL.spread(d, angle)
    p, wide = m.copy(), v > 0
    strength = m[wide] * (1 - m[wide]) / v[wide] - 1
    p[wide] = rng.beta(m[wide] * strength, (1 - m[wide]) * strength)
    return d, angle, rng.binomial(N, p)


def test_the_table_is_the_exact_path_to_two_thousandths_at_its_99th_percentile():
    table = MODEL.table(N)
    d, angle, n = drawn(np.random.default_rng(3), 40_000, 14.0, 180.0)
    found = np.empty(len(d))
    for k in range(N + 1):
        found[n == k] = looked_up(table[k], d[n == k], angle[n == k])
    off = np.abs(found - MODEL.log_mass(n, N, d, angle))
    assert np.percentile(off, 99) <= 2e-3
    assert np.percentile(off, 99.9) <= 2e-2


def test_the_lines_of_the_table_lie_where_the_variance_is_clipped():
    lines = np.linspace(0, detection_model.FAR, detection_model.LINES_D)
    degrees = np.linspace(0, 180, detection_model.LINES_THETA)
    for edge in (1.5, 9.5):
        assert np.abs(lines - edge).min() < 1e-9
    assert np.abs(degrees - 60.0).min() < 1e-9


def test_beyond_its_end_the_table_goes_straight_on():
    d = np.array([28.0, 45.0, 60.0])
    got = looked_up(MODEL.table(N)[2], d, np.zeros(3))
    np.testing.assert_allclose(got, MODEL.log_mass(2, N, d, 0.0), rtol=1e-3)


def test_impossible_parameters_are_refused():
    for wrong in (
        {"dead_alpha": -1},
        {"dead_beta": 0},
        {"dead_alpha": 100.0, "dead_beta": 1e-3},
        {"largest_share": 1.0},
        {"logit": [0, -1, 0]},
    ):
        with pytest.raises(ValidationError):
            DetectionModelConfig.model_validate(wrong)
    with pytest.raises(ValueError, match="0 queries"):
        MODEL.table(0)
