"""The budget that estimators expect, and the weight of a read."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.measurements import curvature_noise
from estimators.rssi_model import ReadVariance, RssiConfig, RssiModel
from testbed import frames
from testbed.checks import samples
from testbed.units import SPEED_OF_LIGHT

SITE = samples.site()
places = st.tuples(st.floats(-4, 10), st.floats(-4, 9), st.floats(-1, 6)).map(np.array)


def model(site=SITE, **options):
    return RssiModel(RssiConfig(**options), site, "it")


def at(antenna, distance, off=0.0):
    """A point `distance` m from an antenna, `off` rad off its boresight."""
    pose = np.concatenate([SITE.antennas.position[antenna], SITE.antennas.quaternion[antenna]])
    return frames.to_world(pose, np.array([distance * np.cos(off), distance * np.sin(off), 0.0]))


def level(point, antenna, tag=0, **options):
    return float(model(**options).expected(point[None], np.array([antenna]), np.array([tag]))[0])


def test_on_boresight_it_is_friis_there_and_back():
    wavelength = SPEED_OF_LIGHT / np.mean(SITE.frequencies)
    for distance in (1.0, 4.0):
        softened = np.hypot(distance, 0.1)
        friis = 20 * np.log10(wavelength / (4 * np.pi * softened))
        straight = distance / softened  # the cosine is softened, too
        n = np.log(0.5) / np.log(np.cos(np.deg2rad(34.0)))
        floor = 10**-1.8
        pattern = 10 * np.log10(floor + (1 - floor) * straight**n)
        expected = 29.0 + 2 * (6.0 + pattern - 3.0) + 2 * 2.0 - 8.0 + 2 * friis
        assert level(at(2, distance), 2) == pytest.approx(expected, abs=1e-9)


def test_near_the_antenna_the_softening_is_a_tenth_of_a_db_at_half_a_metre():
    gap = level(at(0, 0.5), 0, near_m=0.01, use_pattern=False) - level(at(0, 0.5), 0, use_pattern=False)
    assert gap == pytest.approx(40 * np.log10(np.hypot(0.5, 0.1) / np.hypot(0.5, 0.01)), abs=1e-9)
    assert gap < 0.35


def test_ten_times_as_far_is_forty_db_less_or_what_the_exponent_says():
    for exponent in (4.0, 2.7):
        gap = level(at(0, 1.0), 0, near_m=0.01, path_loss_exponent=exponent) - level(
            at(0, 10.0), 0, near_m=0.01, path_loss_exponent=exponent
        )
        assert gap == pytest.approx(10 * exponent, abs=0.01)


def test_half_the_beam_width_off_costs_three_db_each_way_and_behind_the_floor():
    on, off, behind = (level(at(1, 3.0, a), 1, near_m=0.01) for a in (0.0, np.deg2rad(34.0), np.pi))
    assert on - off == pytest.approx(6.0, abs=0.15)
    assert on - behind == pytest.approx(2 * 18.0, abs=1e-3)


def test_without_the_pattern_all_directions_are_alike():
    around = [level(at(1, 3.0, a), 1, use_pattern=False) for a in (0.0, 1.0, 3.0)]
    np.testing.assert_allclose(around, around[0], atol=1e-9)


def test_a_reference_level_replaces_the_budget():
    assert level(at(3, 1.0), 3, reference_dbm=-41.5, near_m=0.01, use_pattern=False) == pytest.approx(-41.5, abs=1e-3)
    no_carriers = replace(SITE, frequencies=np.empty(0))
    model(no_carriers, reference_dbm=-40.0)
    with pytest.raises(ValueError, match=r"it: the site names no carrier frequencies .* set reference_dbm"):
        model(no_carriers)


def test_a_tags_own_gain_counts_twice():
    gains = replace(SITE, tags=SITE.tags.with_(gain=np.arange(len(SITE.tags)) * 1.0))
    point = np.tile([2.0, 2.0, 1.0], (2, 1))
    weak, strong = model(gains).expected(point, np.zeros(2, dtype=int), np.array([1, 4]))
    assert strong - weak == pytest.approx(6.0)


def test_a_dipole_is_expected_as_it_is_in_the_mean_over_all_directions():
    dipoles = replace(SITE, tags=SITE.tags.with_(pattern=np.array(["isotropic", "dipole"] + ["isotropic"] * (len(SITE.tags) - 2))))
    point, antenna = np.tile([2.0, 2.0, 1.0], (2, 1)), np.zeros(2, dtype=int)
    plain, turned = model(dipoles).expected(point, antenna, np.array([0, 1]))
    cosine = (np.arange(200_000) + 0.5) / 100_000 - 1  # all directions are alike where their cosine is uniform
    field = np.cos(np.pi / 2 * cosine) / np.sqrt(1 - cosine**2)
    assert turned - plain == pytest.approx(2 * np.mean(20 * np.log10(field)), abs=0.01)
    told = model(dipoles, orientation_loss_db=1.5).expected(point, antenna, np.array([0, 1]))
    np.testing.assert_allclose(told, plain - 3.0)


def test_antennas_on_bodies_and_sites_without_antennas_are_refused_by_name():
    carried = replace(SITE, antennas=SITE.antennas.with_(carrier=np.array(["", "forklift", "", ""])))
    with pytest.raises(ValueError, match="it: the place of southeast is not known, it is carried"):
        model(carried)
    with pytest.raises(ValueError, match="it: the site has no antennas"):
        model(replace(SITE, antennas=SITE.antennas.take(np.arange(0))))


@settings(max_examples=150)
@given(places, st.integers(0, 3), st.booleans(), st.floats(1.5, 6))
def test_the_gradient_is_that_of_finite_differences(point, antenna, use_pattern, exponent):
    it = model(use_pattern=use_pattern, path_loss_exponent=exponent)
    which, tag = np.array([antenna]), np.array([0])
    r = point - SITE.antennas.position[antenna]
    cosine = frames.rotate(SITE.antennas.quaternion[antenna], np.array([1.0, 0, 0])) @ r / np.linalg.norm(r + 1e-12)
    if abs(cosine) < 1e-3:
        return  # the edge of the lobe, where the second derivative jumps
    value, gradient = it.linearised(point[None], which, tag)
    assert value == it.expected(point[None], which, tag)
    h = 1e-5 * max(0.1, np.linalg.norm(r))
    steps = np.concatenate([np.eye(3), -np.eye(3)]) * h
    moved = it.expected((point + steps)[None], which, tag)[0]
    np.testing.assert_allclose(gradient[0], (moved[:3] - moved[3:]) / (2 * h), rtol=1e-5, atol=1e-5)


@settings(max_examples=100)
@given(places, st.integers(0, 3), st.booleans())
def test_one_link_in_plain_numbers_is_the_same_model(point, antenna, use_pattern):
    it = model(use_pattern=use_pattern)
    value, gradient = it.linearised(point[None], np.array([antenna]), np.array([2]))
    link = it.link(antenna, 2)
    assert link.expected(point) == pytest.approx(value[0], abs=1e-11)
    np.testing.assert_allclose(link.gradient(point), gradient[0], rtol=1e-10, atol=1e-11)


def test_it_is_finite_everywhere_the_antenna_itself_included():
    for width in (1.0, 68.0, 179.0, 360.0):
        wide = replace(SITE, antennas=SITE.antennas.with_(beamwidth=np.full(4, np.deg2rad(width))))
        points = np.concatenate([SITE.antennas.position[:1], SITE.antennas.position[:1] + 1e-9 * np.eye(3), [[1e9, -1e9, 1e9]]])
        value, gradient = model(wide).linearised(points, np.zeros(5, dtype=int), np.zeros(5, dtype=int))
        assert np.isfinite(value).all()
        assert np.isfinite(gradient).all()
        assert all(np.isfinite(part).all() for part in model(wide).quadratic(points, np.zeros(5, dtype=int), np.zeros(5, dtype=int)))


def test_many_points_of_an_entry_are_its_points_one_by_one():
    it, rng = model(), np.random.default_rng(2)
    points, antenna, tag = rng.uniform(0, 5, (6, 13, 3)), rng.integers(0, 4, 6), rng.integers(0, 5, 6)
    together = it.expected(points, antenna, tag)
    for k in range(13):
        np.testing.assert_array_equal(together[:, k], it.expected(points[:, k], antenna, tag))


def test_curvature_without_a_pattern_is_the_hessian_of_the_logarithm():
    it, point = model(use_pattern=False), np.array([[2.0, 1.0, 1.5], [0.3, 0.2, 2.4]])
    r = point - SITE.antennas.position[0]
    s2 = (r**2).sum(axis=1)[:, None, None] + 0.01
    exact = -(40 / np.log(10)) * (np.eye(3) / s2 - 2 * r[:, :, None] * r[:, None, :] / s2**2)
    which = np.zeros(2, dtype=int)
    level, gradient, hessian = it.quadratic(point, which, which)
    np.testing.assert_allclose(hessian, exact, rtol=1e-3, atol=1e-3)
    for mine, straight in zip((level, gradient), it.linearised(point, which, which), strict=True):
        np.testing.assert_array_equal(mine, straight)


def test_curvature_noise_is_the_variance_of_a_parabola():
    rng = np.random.default_rng(3)
    hessian, root = rng.normal(size=(1, 3, 3)), rng.normal(size=(1, 3, 3))
    hessian, covariance = hessian + hessian.transpose(0, 2, 1), root @ root.transpose(0, 2, 1)
    x = rng.multivariate_normal(np.zeros(3), covariance[0], 400_000)
    parabola = 0.5 * np.einsum("ni,ij,nj->n", x, hessian[0], x)
    # relative standard error of the sample variance is below 0.6 % here: 4 % is beyond six of them
    assert curvature_noise(hessian, covariance)[0] == pytest.approx(parabola.var(), rel=0.04)


def weights(tau=0.2, sigma=4.0):
    return ReadVariance(RssiConfig(correlation_s=tau, sigma_db=sigma), rows=2, antennas=3)


def test_the_first_read_of_each_antenna_and_row_counts_in_full():
    it = weights()
    row, antenna, t = np.array([0, 1]), np.array([2, 2]), np.array([1.0, 1.0])
    np.testing.assert_allclose(it.of(row, antenna, t), 16.0)
    it.took(row[:1], antenna[:1], t[:1])
    after = it.of(row, antenna, t + 0.01)
    assert after[0] > 100
    assert after[1] == pytest.approx(16.0)
    assert it.of(np.array([0]), np.array([1]), np.array([1.01]))[0] == pytest.approx(16.0)


def test_a_read_given_twice_counts_as_good_as_nothing_and_stays_finite():
    it = weights()
    it.took(np.array([0]), np.array([0]), np.array([1.0]))
    twice = it.of(np.array([0]), np.array([0]), np.array([1.0]))[0]
    assert 1e4 * 16 < twice < np.inf


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_a_fast_stream_gives_one_independent_read_in_two_correlation_times(rate):
    it, information = weights(tau=0.1), 0.0
    for k in range(int(rate * 10)):
        t = np.array([k / rate])
        information += 1 / it.of(np.array([0]), np.array([0]), t)[0]
        it.took(np.array([0]), np.array([0]), t)
    assert information * 16.0 == pytest.approx(10 / 0.2, rel=0.05)


def test_that_is_the_variance_of_a_mean_of_correlated_numbers():
    """(1 + ρ) / (1 - ρ) against the exact variance of the mean of a long AR(1) series."""
    n, dt, tau = 4000, 0.02, 0.2
    rho = np.exp(-dt / tau)
    lags = np.arange(1, n)
    exact = 16.0 / n * (1 + 2 * ((1 - lags / n) * rho**lags).sum())
    it = weights(tau)
    it.took(np.array([0]), np.array([0]), np.array([0.0]))
    assert it.of(np.array([0]), np.array([0]), np.array([dt]))[0] / n == pytest.approx(exact, rel=0.01)


def test_without_correlation_every_read_counts_in_full():
    it = weights(tau=0.0)
    it.took(np.array([0]), np.array([0]), np.array([1.0]))
    assert it.of(np.array([0]), np.array([0]), np.array([1.0]))[0] == 16.0
