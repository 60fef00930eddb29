"""The Kalman updates against textbook algebra, one row at a time."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, multivariate_normal

from estimators import kalman
from estimators.motion import ConstantVelocity, MotionConfig


def rows_of(rng, b, n):
    root = rng.normal(size=(b, n, n))
    return rng.normal(size=(b, n)), root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)


def noise_of(rng, e, m):
    root = rng.normal(size=(e, m, m))
    return root @ root.transpose(0, 2, 1) + 0.5 * np.eye(m)


def textbook(mean, covariance, y, h, r):
    s = h @ covariance @ h.T + r
    gain = covariance @ h.T @ np.linalg.inv(s)
    keep = np.eye(len(mean)) - gain @ h
    return mean + gain @ y, keep @ covariance @ keep.T + gain @ r @ gain.T, s


NO_GATE = [kalman.gate_limits("none", m) for m in range(6)]


@pytest.mark.parametrize(("n", "m"), [(6, 1), (6, 3), (12, 5), (2, 2), (1, 1)])
def test_extended_update_of_vectors_is_the_textbooks_on_the_rows_asked_for_only(n, m):
    rng = np.random.default_rng(n * 10 + m)
    mean, covariance = rows_of(rng, 7, n)
    was, rows = (mean.copy(), covariance.copy()), np.array([1, 4, 5])
    y, h, r = rng.normal(size=(3, m)), rng.normal(size=(3, m, n)), noise_of(rng, 3, m)
    info = kalman.extended_update(mean, covariance, rows, y, h, r, NO_GATE[m])
    for e, row in enumerate(rows):
        x, p, s = textbook(was[0][row], was[1][row], y[e], h[e], r[e])
        np.testing.assert_allclose(mean[row], x, atol=1e-11)
        np.testing.assert_allclose(covariance[row], p, atol=1e-11)
        assert info.nis[e] == pytest.approx(y[e] @ np.linalg.solve(s, y[e]), rel=1e-10)
        assert info.log_likelihood[e] == pytest.approx(multivariate_normal(np.zeros(m), s).logpdf(y[e]), rel=1e-10)
    others = np.setdiff1d(np.arange(7), rows)
    np.testing.assert_array_equal(mean[others], was[0][others])
    np.testing.assert_array_equal(covariance[others], was[1][others])
    assert info.used.all()
    assert (info.dof == m).all()


@pytest.mark.parametrize("m", [1, 3, 5])
def test_unscented_update_of_a_linear_measurement_is_the_extended_one(m):
    rng = np.random.default_rng(m)
    mean, covariance = rows_of(rng, 4, 6)
    mean2, covariance2 = mean.copy(), covariance.copy()
    rows, y, h, r = np.arange(4), rng.normal(size=(4, m)), rng.normal(size=(4, m, 6)), noise_of(rng, 4, m)
    for weights in (
        kalman.Weights.merwe(6, 1.0, 0.0, 0.0),
        kalman.Weights.merwe(6, 0.3, 2.0, 0.0),
        kalman.Weights.merwe(6, 0.5, 2.0, -3.0),
    ):
        a, b, c, d = mean.copy(), covariance.copy(), mean2.copy(), covariance2.copy()
        points = kalman.sigma_points(a, b, rows, weights)
        innovation = y[:, None] - np.einsum("epn,emn->epm", points - mean[:, None], h)
        one = kalman.unscented_update(a, b, rows, points, innovation, r, weights, NO_GATE[m])
        two = kalman.extended_update(c, d, rows, y, h, r, NO_GATE[m])
        np.testing.assert_allclose(a, c, atol=1e-9)
        np.testing.assert_allclose(b, d, atol=1e-9)
        np.testing.assert_allclose(one.nis, two.nis, rtol=1e-9)


def test_components_not_measured_are_left_out():
    rng = np.random.default_rng(3)
    mean, covariance = rows_of(rng, 1, 6)
    y, h, r = rng.normal(size=(1, 4)), rng.normal(size=(1, 4, 6)), noise_of(rng, 1, 4)
    seen = [0, 2]
    x, p, _ = textbook(mean[0], covariance[0], y[0, seen], h[0, seen], r[0][np.ix_(seen, seen)])
    y[0, [1, 3]] = np.nan, np.inf
    a, b = mean.copy(), covariance.copy()
    assert kalman.extended_update(a, b, np.array([0]), y, h, r, NO_GATE[4]).dof[0] == 2
    np.testing.assert_allclose(a[0], x, atol=1e-12)
    np.testing.assert_allclose(b[0], p, atol=1e-12)
    weights = kalman.Weights.merwe(6, 1.0, 0.0, 0.0)
    a, b = mean.copy(), covariance.copy()
    points = kalman.sigma_points(a, b, np.array([0]), weights)
    innovation = y[:, None] - np.einsum("epn,emn->epm", points - mean[:, None], h)
    assert kalman.unscented_update(a, b, np.array([0]), points, innovation, r, weights, NO_GATE[4]).dof[0] == 2
    np.testing.assert_allclose(a[0], x, atol=1e-11)
    np.testing.assert_allclose(b[0], p, atol=1e-11)


def test_nothing_measured_changes_nothing_and_says_so():
    rng = np.random.default_rng(4)
    mean, covariance = rows_of(rng, 2, 6)
    was = mean.copy(), covariance.copy()
    info = kalman.extended_update(
        mean, covariance, np.arange(2), np.full((2, 1), np.nan), np.ones((2, 1, 6)), np.ones((2, 1, 1)), NO_GATE[1]
    )
    assert not info.used.any()
    assert (info.dof == 0).all()
    assert np.isnan(info.nis).all()
    np.testing.assert_array_equal(mean, was[0])
    np.testing.assert_array_equal(covariance, was[1])


def test_the_gate_refuses_what_lies_beyond_its_probability_and_nothing_else():
    limits = kalman.gate_limits(0.99, 2)
    np.testing.assert_allclose(limits[1:], chi2.ppf(0.99, [1, 2]))
    mean, covariance = np.zeros((2, 6)), np.tile(np.eye(6), (2, 1, 1))
    h = np.zeros((2, 1, 6))
    h[:, 0, 0] = 1.0
    edge = np.sqrt(2.0 * chi2.ppf(0.99, 1))  # innovation variance 1 + 1
    info = kalman.extended_update(
        mean, covariance, np.arange(2), np.array([[edge * 0.999], [edge * 1.001]]), h, np.ones((2, 1, 1)), limits[:2]
    )
    assert info.used.tolist() == [True, False]
    assert (mean[1] == 0).all()
    assert mean[0, 0] == pytest.approx(edge * 0.999 / 2)


def test_sigma_points_carry_mean_and_covariance_and_lie_on_lower_cholesky_columns():
    rng = np.random.default_rng(6)
    mean, covariance = rows_of(rng, 3, 6)
    weights = kalman.Weights.merwe(6, 0.7, 2.0, 1.0)
    points = kalman.sigma_points(mean, covariance, np.array([2, 0]), weights)
    lower = np.linalg.cholesky(weights.spread * covariance[2])
    np.testing.assert_allclose(points[0, 1:7], mean[2] + lower.T, atol=1e-12)
    np.testing.assert_allclose(points[0, 7:], mean[2] - lower.T, atol=1e-12)
    apart = points - mean[[2, 0]][:, None]
    np.testing.assert_allclose(np.einsum("p,epi->ei", weights.mean, points), mean[[2, 0]], atol=1e-12)
    np.testing.assert_allclose(np.einsum("p,epi,epj->eij", weights.covariance, apart, apart), covariance[[2, 0]], atol=1e-10)


def test_sigma_points_that_would_collapse_are_refused():
    with pytest.raises(ValueError, match="kappa must be above -6 for a state of 6 components, it is -6"):
        kalman.Weights.merwe(6, 1.0, 0.0, -6.0)


@settings(max_examples=60, deadline=None)
@example(seed=1, doubt=6.0, noise=-9.0)
@example(seed=1, doubt=6.0, noise=-12.0)
@given(st.integers(0, 2**32 - 1), st.floats(-9, 6), st.floats(-12, 3))
def test_covariances_stay_symmetric_and_positive_however_far_doubt_and_noise_lie_apart(seed, doubt, noise):
    rng = np.random.default_rng(seed)
    mean, covariance = rows_of(rng, 3, 6)
    covariance *= 10.0**doubt
    weights = kalman.Weights.merwe(6, 1.0, 0.0, 0.0)
    for step in range(20):
        h, r = rng.normal(size=(3, 2, 6)), np.tile(np.diag([10.0**noise] * 2), (3, 1, 1))
        y = rng.normal(size=(3, 2)) * 10.0 ** (doubt / 2)
        if step % 2:
            points = kalman.sigma_points(mean, covariance, np.arange(3), weights)
            innovation = y[:, None] - np.einsum("epn,emn->epm", points - mean[:, None], h)
            kalman.unscented_update(mean, covariance, np.arange(3), points, innovation, r, weights, NO_GATE[2])
        else:
            kalman.extended_update(mean, covariance, np.arange(3), y, h, r, NO_GATE[2])
        assert np.isfinite(mean).all()
        np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
        np.linalg.cholesky(covariance)


@pytest.mark.parametrize("method", ["extended", "unscented"])
def test_a_prior_that_is_certain_of_something_can_be_updated(method):
    certain = np.diag([1.0, 1.0, 0.0, 0.25, 0.25, 0.0])
    mean, covariance, rows, weights = np.zeros((1, 6)), certain[None].copy(), np.array([0]), kalman.Weights.merwe(6, 1.0, 0.0, 0.0)
    h = np.ones((1, 1, 6))
    if method == "extended":
        info = kalman.extended_update(mean, covariance, rows, np.ones((1, 1)), h, np.ones((1, 1, 1)), NO_GATE[1])
    else:
        points = kalman.sigma_points(mean, covariance, rows, weights)
        innovation = 1.0 - np.einsum("epn,emn->epm", points, h)
        info = kalman.unscented_update(mean, covariance, rows, points, innovation, np.ones((1, 1, 1)), weights, NO_GATE[1])
    assert info.used[0]
    x, p, _ = textbook(np.zeros(6), certain, np.ones(1), h[0], np.eye(1))
    np.testing.assert_allclose(mean[0], x, atol=1e-7)
    np.testing.assert_allclose(covariance[0], p, atol=1e-7)
    np.linalg.cholesky(covariance[0])


@pytest.mark.parametrize("spoilt", [1e308, -1e308, 1e200])
def test_an_absurd_number_is_refused_rather_than_believed_to_infinity(spoilt):
    mean, covariance = np.zeros((1, 6)), np.eye(6)[None].copy()
    h = np.full((1, 1, 6), 1e150)
    info = kalman.extended_update(mean, covariance, np.array([0]), np.array([[spoilt]]), h, np.ones((1, 1, 1)), NO_GATE[1])
    assert not info.used[0] or np.isfinite(mean).all()
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()


@pytest.mark.parametrize("noise", [0.0, -1.0])
def test_a_noise_without_extent_does_no_harm(noise):
    mean, covariance = np.zeros((1, 6)), np.eye(6)[None].copy()
    kalman.extended_update(mean, covariance, np.array([0]), np.ones((1, 1)), np.zeros((1, 1, 6)), np.full((1, 1, 1), noise), NO_GATE[1])
    np.testing.assert_array_equal(covariance[0], np.eye(6))
    np.testing.assert_array_equal(mean, 0.0)


# ---------------------------------------------------------------- motion

WHITE = MotionConfig(acceleration_density_m2ps3=0.3)
PIECEWISE = MotionConfig(process_noise="piecewise_acceleration", acceleration_std_mps2=0.4)


@pytest.mark.parametrize("config", [WHITE, PIECEWISE])
@pytest.mark.parametrize(("axes", "targets"), [(3, 1), (2, 1), (3, 2)])
def test_prediction_in_place_is_f_p_ft_plus_q_with_each_rows_own_interval(config, axes, targets):
    motion, rng = ConstantVelocity(config, axes, targets), np.random.default_rng(8)
    mean, covariance = rows_of(rng, 4, motion.n)
    was, dt = (mean.copy(), covariance.copy()), np.array([0.1, 0.0, 2.5, 1e-3])
    motion.advance(mean, covariance, dt)
    for row in range(4):
        f, q = motion.matrices(dt[row])
        np.testing.assert_allclose(mean[row], f @ was[0][row], atol=1e-12)
        np.testing.assert_allclose(covariance[row], f @ was[1][row] @ f.T + q, atol=1e-11)
    np.testing.assert_array_equal(covariance[1], was[1][1])  # a row whose time stands still is not touched
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))


def test_process_noise_has_the_form_of_the_books():
    dt, block = 0.5, np.eye(3)
    f, q = ConstantVelocity(PIECEWISE).matrices(dt)
    np.testing.assert_allclose(q, np.kron([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]], 0.16 * block))
    np.testing.assert_allclose(f, np.kron([[1, dt], [0, 1]], block))
    _, q = ConstantVelocity(WHITE).matrices(dt)
    np.testing.assert_allclose(q, np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], 0.3 * block))


@given(st.floats(0.01, 3), st.floats(0.01, 0.99))
def test_white_acceleration_does_not_care_how_time_is_cut(dt, share):
    rng = np.random.default_rng(1)
    mean, covariance = rows_of(rng, 1, 6)
    once, twice = (mean.copy(), covariance.copy()), (mean.copy(), covariance.copy())
    motion = ConstantVelocity(WHITE)
    motion.advance(*once, np.array([dt]))
    motion.advance(*twice, np.array([dt * share]))
    motion.advance(*twice, np.array([dt - dt * share]))
    np.testing.assert_allclose(twice[0], once[0], atol=1e-11)
    np.testing.assert_allclose(twice[1], once[1], atol=1e-10)


def test_piecewise_acceleration_does_care_which_is_why_it_is_not_the_default():
    assert MotionConfig().process_noise == "white_acceleration"
    motion, ends = ConstantVelocity(PIECEWISE), []
    for steps in (1, 10):
        mean, covariance = np.zeros((1, 6)), np.zeros((1, 6, 6))
        for _ in range(steps):
            motion.advance(mean, covariance, np.array([1.0 / steps]))
        ends.append(covariance[0, 3, 3])
    assert ends[0] == pytest.approx(10 * ends[1])
