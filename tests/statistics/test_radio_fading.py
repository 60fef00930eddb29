"""The diffuse field: its K, its correlation in space, over carriers and past moving bodies. Fixed seeds; false alarms are stated."""

import numpy as np
import pytest

from testbed.radio.diffuse import DELAY, OPEN_K, REACH, STIR, WAVES, Field, Stir, rice_factor, weight_of
from testbed.units import SPEED_OF_LIGHT

F = 866.3e6
WAVELENGTH = SPEED_OF_LIGHT / F
ANTENNA = np.array([0.0, 0.0, 3.0])


def at(field, places, frequency=F, stir=None):
    return field.at(np.tile(ANTENNA, (len(places), 1)), places, frequency, stir)


def scattered(n, seed=0, size=40.0):
    """Places so far apart that they fade alone: n of them in a cube of `size` m."""
    return np.random.default_rng(seed).uniform(0, size, (n, 3))


@pytest.mark.parametrize("clear", [1.0, 0.5, 0.35, 0.0])
def test_k_comes_back_from_the_moments_of_the_power(clear):
    # K from the variance of the power (Greenstein et al., IEEE Commun. Lett. 3 (1999)). Over 20,000 independent places γ = var/mean²
    # has a standard error below 0.03 whatever K; 5 sigma: false alarm 2e-6 in all
    k = float(rice_factor(clear))
    places = scattered(20_000)
    distance = np.linalg.norm(places - ANTENNA, axis=1)
    h = np.sqrt(k / (k + 1)) * np.exp(-2j * np.pi * distance / WAVELENGTH) + np.sqrt(1 / (k + 1)) * at(Field(3, 0, F), places)
    power = np.abs(h) ** 2
    gamma = power.var() / power.mean() ** 2
    assert power.mean() == pytest.approx(1.0, abs=5 * np.sqrt(gamma / 20_000) + 0.01)
    of_finitely_many_waves = (1 / (k + 1)) ** 2 / WAVES
    assert gamma == pytest.approx((2 * k + 1) / (k + 1) ** 2 - of_finitely_many_waves, abs=5 * 0.03)
    if k > 1:
        root = np.sqrt(1 - gamma)
        assert 10 * np.log10(root / (1 - root)) == pytest.approx(10 * np.log10(k), abs=0.5)


def test_k_is_that_of_the_specification():
    assert 10 * np.log10(rice_factor(1.0)) == pytest.approx(10.0)
    assert 3.0 <= 10 * np.log10(rice_factor(0.35)) <= 10 * np.log10(rice_factor(0.5)) <= 6.0
    assert rice_factor(0.0) == 0.0
    assert rice_factor(1.0, 4.0) == 4.0
    assert OPEN_K == 10.0


def test_the_field_is_complex_gaussian():
    # fourth moment 2 - 1/P, skew-free: standard errors of 0.03 and 0.007 over 20,000 places; 5 sigma
    d = at(Field(5, 1, F), scattered(20_000))
    assert (np.abs(d) ** 4).mean() == pytest.approx(2 - 1 / WAVES, abs=0.15)
    assert abs(d.mean()) < 5 / np.sqrt(20_000)
    assert abs((d**2).mean()) < 5 * np.sqrt(2 / 20_000)


@pytest.mark.parametrize("end", ["tag", "antenna"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_correlation_falls_like_a_sinc_at_either_end_and_is_small_from_half_a_wavelength_on(end, axis):
    # over 300 fields (trials), each averaged over 50 places, a correlation of 24 waves has a standard error of 0.2/√300 = 0.012;
    # 5 sigma on 6 × 8 figures: false alarm 3e-5
    steps = np.array([0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.3])
    base = scattered(50, 6)[:, None] + np.zeros((len(steps), 1))
    moved = np.zeros((len(steps), 3))
    moved[:, axis] = steps * WAVELENGTH
    tag, antenna = ((base + moved * (end == name)).reshape(-1, 3) for name in ("tag", "antenna"))
    d = np.array([Field(8, trial, F).at(antenna, tag, F) for trial in range(300)]).reshape(-1, len(steps))
    correlation = np.abs((d[:, :1].conj() * d).mean(axis=0))
    np.testing.assert_allclose(correlation, np.abs(np.sinc(2 * steps)), atol=5 * 0.012)
    assert (correlation[steps >= 0.5] < 0.3).all()
    assert correlation[1] > 0.9


def test_carriers_fade_apart_as_far_as_the_delays_reach():
    # E[D D'*] = 1 / (1 + j 2π Δf τ) for exponential delays; 400 trials, each averaged over 50 places: 5 sigma of 0.2/√400
    offsets = np.array([0.0, 0.6e6, 5e6, 25e6])
    places = np.repeat(scattered(50), len(offsets), axis=0)
    d = np.array([at(Field(9, trial, F), places, np.tile(F + offsets, 50)) for trial in range(400)]).reshape(-1, len(offsets))
    correlation = np.abs((d[:, :1].conj() * d).mean(axis=0))
    np.testing.assert_allclose(correlation, 1 / np.hypot(1, 2 * np.pi * offsets * DELAY), atol=0.05)


def test_rssi_at_one_place_spreads_over_fifty_carriers_as_on_real_readers():
    # the median over 300 trials, with the artefact's 0.5 dB; its standard error is below 0.06 dB, the range far wider
    carriers = 902.75e6 + 0.5e6 * np.arange(50)
    spread = []
    for trial in range(300):
        field = Field(1, trial, carriers.mean())
        h = np.sqrt(10 / 11) + np.sqrt(1 / 11) * at(field, np.tile([3.0, 1.0, 1.0], (50, 1)), carriers)
        spread.append(np.hypot((40 * np.log10(np.abs(h))).std(), 0.5))
    assert np.percentile(spread, 10) > 0.4
    assert 0.6 < np.median(spread) < 1.6
    assert np.percentile(spread, 90) < 2.0


def test_two_tags_side_by_side_fade_alike_and_others_do_not():
    places = np.array([[4.0, 1, 1], [4.01, 1, 1], [9.0, 3, 1]])
    d = np.array([at(Field(2, trial, F), places) for trial in range(1_000)])
    # 1,000 trials: standard error 0.03
    assert abs((d[:, 0].conj() * d[:, 1]).mean()) > 0.9 * (np.abs(d[:, 0]) ** 2).mean()
    assert abs((d[:, 0].conj() * d[:, 2]).mean()) < 0.16


def test_a_draw_is_that_of_the_trial_and_of_the_places_alone():
    places = scattered(50)
    whole = at(Field(1, 4, F), places)
    assert np.array_equal(whole[7:9], at(Field(1, 4, F), places[7:9]))
    assert np.array_equal(whole, at(Field(1, 4, F), places))
    assert not np.allclose(whole, at(Field(1, 5, F), places))
    assert not np.allclose(whole, at(Field(2, 4, F), places))


def stirred(centers, weight, key=7):
    n = len(centers)
    return Stir(link=np.arange(n), key=np.full(n, key, dtype=np.uint64), center=centers, weight=np.full(n, weight))


def test_a_body_in_the_line_takes_part_and_keeps_the_power():
    # the field with and without differs by w; power stays 1 (20,000 places, 5 sigma of 0.01)
    places = scattered(20_000)
    without, with_ = at(Field(3, 0, F), places), at(Field(3, 0, F), places, stir=stirred(scattered(20_000, 1), STIR))
    assert (np.abs(with_) ** 2).mean() == pytest.approx(1.0, abs=0.05)
    assert abs((without.conj() * with_).mean()) == pytest.approx(np.sqrt(1 - STIR**2), abs=0.05)


def test_a_body_that_moves_by_half_a_wavelength_changes_the_field_and_one_that_stands_does_not():
    place = np.tile([4.0, 1.0, 1.0], (3, 1))
    centers = np.array([[2.0, 1, 1], [2.0 + WAVELENGTH / 2, 1, 1], [2.0, 1, 1]])
    d = np.array([at(Field(4, trial, F), place, stir=stirred(centers, STIR)) for trial in range(1_000)])
    assert np.array_equal(d[:, 0], d[:, 2])
    # what the body doesn't touch is 1 - w²; what it does touch decorrelates: 1,000 trials, 5 sigma of 0.03
    assert abs((d[:, 0].conj() * d[:, 1]).mean()) == pytest.approx(1 - STIR**2, abs=0.16)


def test_a_bodys_weight_falls_smoothly_to_nothing():
    excess = np.linspace(0, 2 * REACH, 1001)
    weight = weight_of(excess)
    assert weight[0] == STIR
    assert (weight[excess >= REACH] == 0).all()
    assert (np.diff(weight) <= 0).all()
    assert np.abs(np.diff(weight, 2)).max() < 1e-4
