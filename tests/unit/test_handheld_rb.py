"""The Rao-Blackwellised guide: a step in so many words, both branches, silence as data, the exploring rule."""

import numpy as np
import pytest

from estimators.handheld_rb import DIRECTIONS, OUT_OF_REACH, STEEPEST, HandheldRb, _density, _go
from testbed.checks import samples
from testbed.guidance import Actions
from testbed.rng import RowRandom
from testbed.types import Event, Prior

SLIP = 0.1 / np.sqrt(2)


def guide(rows=1, **config):
    made = HandheldRb(HandheldRb.Config(**config), samples.site(), RowRandom(np.arange(rows) + 5))
    made.start(Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1))))
    return made


def act(made, turn=0.0, step=0.0, heard=True, change=np.nan):
    n = made.rows
    one = np.ones(n)
    made.update(
        Event("actions", np.arange(n), Actions(one, one, one, np.zeros(n), turn * one, step * one, np.full(n, heard), change * one))
    )


def go(place, bearing, further, drawn=0.5, slip=0.0, other=0.0, step=0.5, noise=0.0, wrong=0.0):
    """One particle's step: range, bearing and weight afterwards."""
    r, a, w = np.array([[place]]), np.array([[bearing]]), np.ones((1, 1))
    us, ns = np.array([[drawn]]), np.array([[[slip], [other]]])
    _go(r, a, w, us, ns, np.array([step]), np.array([further]), np.array([noise]), SLIP, wrong)
    return r[0, 0], a[0, 0], w[0, 0]


def t4(z):
    return 0.375 * (1 + z * z / 4) ** -2.5


def test_a_step_straight_at_the_tag_shortens_the_range_and_keeps_the_bearing():
    r, a, w = go(5.0, 0.0, -0.5)
    assert (r, a) == (pytest.approx(4.5), pytest.approx(0.0))
    assert w == pytest.approx(t4(0.0) / SLIP, rel=1e-6)


@pytest.mark.parametrize(("place", "bearing", "slip"), [(5.0, 0.6, 0.0), (3.0, -1.0, 1.3), (1.2, 2.0, -0.7)])
def test_the_range_is_the_measured_one_and_the_step_follows_from_it(place, bearing, slip):
    length = 0.55
    x, y = place * np.cos(bearing) - length, place * np.sin(bearing) - SLIP * slip
    new = np.hypot(x, y)
    drawn = 0.0 if x > 0 else 1.0  # takes the branch that really was
    r, a, w = go(place, bearing, new - place, drawn=drawn, slip=slip)
    assert r == pytest.approx(new)
    assert a == pytest.approx(np.arctan2(y, x))
    both = t4(0.05 / SLIP) + t4((place * np.cos(bearing) + abs(x) * np.sign(x) - 0.5) / SLIP)
    assert w == pytest.approx(min(new / abs(x), STEEPEST) * both / SLIP, rel=1e-6)


def test_a_tag_that_may_have_been_passed_is_kept_on_both_sides():
    ahead, passed = (go(0.5, 0.1, -0.38, drawn=d) for d in (0.0, 0.999999))
    assert abs(ahead[1]) < np.pi / 2 < abs(passed[1])
    assert ahead[2] == passed[2]


def test_where_the_phase_puts_the_tag_nowhere_a_particle_nearly_dies_and_stays_finite():
    for further in (-5.5, -0.9):  # nearer than nothing, and nearer than the line it walks along
        r, a, w = go(5.0, np.pi / 2, further)
        assert np.isfinite([r, a, w]).all()
        assert OUT_OF_REACH * 0.99 <= w < 1e-2


def test_without_a_phase_the_step_alone_moves_the_particles():
    r, a, w = go(5.0, 0.0, np.nan, other=0.0)
    assert (r, a, w) == (pytest.approx(4.5), pytest.approx(0.0), 1.0)


def test_the_density_is_students():
    z = np.linspace(-300, 300, 2_000_001)
    assert np.trapezoid([_density(v) for v in z[::20]], z[::20]) == pytest.approx(1.0, abs=1e-3)


def test_silence_says_that_the_tag_is_behind_and_an_answer_that_it_is_in_front():
    for heard, front in ((True, 0.95), (False, 0.05)):
        made = guide(particles=3000)
        act(made, heard=heard)
        share = (made._weight * (np.abs(made._bearing) < np.pi / 2)).sum()
        assert abs(share - front) < 0.06


def test_a_tag_that_answers_all_round_makes_silence_and_answers_tell_nothing():
    made = guide(particles=200, beam_deg=None)
    before = made._weight.copy()
    act(made, heard=True)
    np.testing.assert_allclose(made._weight, before, rtol=1e-12)


def test_the_rule_maximises_mean_plus_spread_and_without_exploring_goes_straight():
    made = guide(particles=400)
    draws = np.random.default_rng(2)
    made._bearing = np.where(draws.random((1, 400)) < 0.55, 0.9, -0.9) + 0.05 * draws.normal(size=(1, 400))
    made._weight = np.full((1, 400), 1 / 400)
    grid = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS - np.pi
    cosines = np.cos(made._bearing[0][None] - grid[:, None])
    made._rule(np.arange(1))
    best = grid[np.argmax(cosines.mean(axis=1) + cosines.std(axis=1))]
    assert made._told[0] == pytest.approx(best)
    assert abs(made._told[0]) > 0.8, "exploring chooses one of the two sides"
    straight = guide(particles=400, explore=0)
    straight._bearing, straight._weight = made._bearing, made._weight
    straight._rule(np.arange(1))
    assert abs(straight._told[0]) < 0.5, "the mean lies between them"


def test_steps_become_short_near_the_tag_and_never_too_short():
    made = guide(particles=50)
    made._range[:] = 0.3
    assert made._length()[0] == pytest.approx(0.3)
    made._range[:] = 0.01
    assert made._length()[0] == pytest.approx(0.15)
    made._range[:] = 9.0
    assert made._length()[0] == 0.5


def test_a_walk_past_the_tag_is_understood():
    """People without errors walk by a tag 2 m to one side: afterwards their guides look back to it, 2 m off.

    One guide's mean strays by 0.35 m, that of twenty by 0.08 m: 0.3 m is missed by chance less often than once in 1,000 builds.
    """
    made = guide(rows=20, particles=2000, turn_std_deg=3, step_std_m=0.02)
    act(made)
    x = np.arange(0, 5.01, 0.5)
    ranges = np.hypot(3.0 - x, 2.0)
    for further in np.diff(ranges):
        act(made, step=0.5, change=made.wavenumber * further)
    lateral = np.abs(made._range * np.sin(made._bearing))
    assert (made._weight * lateral).sum(axis=1).mean() == pytest.approx(2.0, abs=0.3)
    assert ((made._weight * np.cos(made._bearing)).sum(axis=1) < 0).all()
