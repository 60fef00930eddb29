"""The published guide: its equations one by one against plain numpy, the sum of turns (Eq. 19), and its options."""

import numpy as np
import pytest

from estimators.handheld_paper import HandheldPaper, _moments, _move
from testbed.checks import samples
from testbed.guidance import Actions
from testbed.rng import RowRandom
from testbed.types import Event, Prior

K = 36.288  # rad/m


def guide(rows=2, **config):
    made = HandheldPaper(HandheldPaper.Config(**config), samples.site(), RowRandom(np.arange(rows) + 5))
    made.start(Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1))))
    return made


def act(made, turn=0.0, step=0.0, heard=True, change=np.nan, rows=None):
    rows = np.arange(made.rows) if rows is None else np.array(rows)
    n = len(rows)
    one = np.ones(n)
    made.update(Event("actions", rows, Actions(one, one, one, np.zeros(n), turn * one, step * one, np.full(n, heard), change * one)))


def stepped(made, change=-10.0):
    act(made, step=0.5, change=change)


# ---------------------------------------------------------------- Eq. 19


def test_the_turn_of_a_step_is_the_sum_of_all_turns_since_the_last_one_searches_and_detours_included():
    made = guide(turn_std_deg=0, step_std_m=0, jitter_m=0, resample_below=0)
    act(made)
    stepped(made)
    before = made._cloud[:, 2].copy()
    for turn, heard in ((0.7, False), (np.pi, True), (-0.4, True)):  # advised, a search, a detour that the person tells of
        act(made, turn=turn, heard=heard)
    np.testing.assert_allclose(made.turned, 0.7 + np.pi - 0.4)
    stepped(made)
    np.testing.assert_allclose(made._cloud[:, 2], before + 0.7 + np.pi - 0.4)
    np.testing.assert_array_equal(made.turned, 0.0)


def test_turns_before_the_first_step_do_not_count_for_the_heading_is_anyones_guess_then():
    made = guide()
    act(made, heard=False)
    act(made, turn=np.pi, heard=True)
    np.testing.assert_array_equal(made.turned, 0.0)


def test_turns_of_a_search_can_be_left_out_which_is_the_mistake_that_comes_nearer_to_the_paper():
    made = guide(counted_turns="not_searching")
    act(made)
    stepped(made)
    act(made, turn=0.7, heard=False)
    act(made, turn=np.pi, heard=True)
    np.testing.assert_allclose(made.turned, 0.7)


# ---------------------------------------------------------------- Eq. 20 to 24


def plainly(cloud, weight, noise, turned, step, measured, late=False, circular=False):
    """One row of Eq. 20 to 24 in so many words."""
    x, y, a = cloud
    heading = a + turned + noise[0]
    length = step + noise[1]
    new_x, new_y = x + length * np.cos(heading), y + length * np.sin(heading)
    jittered_x, jittered_y = new_x + noise[2], new_y + noise[3]
    after = np.hypot(jittered_x, jittered_y) if late else np.hypot(new_x, new_y)
    miss = K * (after - np.hypot(x, y)) - measured
    weight = weight / np.maximum(miss**2, 1e-12)
    weight = weight / weight.sum()
    turn = np.angle(np.exp(1j * (np.arctan2(-jittered_y, -jittered_x) - heading)))
    advised = np.angle((weight * np.exp(1j * turn)).sum()) if circular else (weight * turn).sum()
    return np.stack([jittered_x, jittered_y, heading]), weight, advised


@pytest.mark.parametrize(("late", "circular"), [(False, False), (True, False), (False, True)])
def test_a_step_is_as_the_equations_say(late, circular):
    draws = np.random.default_rng(3)
    cloud = draws.normal(-5, 3, (4, 3, 40))
    weight = draws.uniform(0.5, 1.5, (4, 40))
    noise, turned, measured = draws.normal(0, 0.1, (4, 4, 40)), draws.uniform(-3, 3, 4), draws.uniform(-18, 18, 4)
    expected = [plainly(cloud[b], weight[b], noise[b], turned[b], 0.5, measured[b], late, circular) for b in range(4)]
    advised = _move(cloud, weight, noise, turned, np.full(4, 0.5), measured, K, late, circular)
    for b, (c, w, a) in enumerate(expected):
        np.testing.assert_allclose(cloud[b], c, atol=1e-12)
        np.testing.assert_allclose(weight[b], w, rtol=1e-9)
        assert advised[b] == pytest.approx(a, abs=1e-9)


def test_the_phase_grows_with_distance_a_sign_turned_round_prefers_particles_that_go_the_other_way():
    towards = np.array([[[-5.0, -5.0], [0.0, 0.0], [0.0, np.pi]]])  # one particle looks at the tag, one away from it
    for sign, better in ((1, 0), (-1, 1)):
        cloud, weight = towards.copy(), np.full((1, 2), 0.5)
        _move(cloud, weight, np.zeros((1, 4, 2)), np.zeros(1), np.full(1, 0.5), np.array([-0.5 * K * sign]), K, False, False)
        assert weight[0, better] > 0.999


def test_a_step_whose_phase_is_not_known_moves_the_cloud_and_weighs_nobody():
    made = guide(resample_below=0)
    act(made)
    stepped(made)
    weight = made._weight.copy()
    place = made._cloud.copy()
    made._stepped(np.arange(2), np.full(2, 0.5), np.full(2, np.nan), np.zeros(2), np.zeros(2, dtype=bool))
    np.testing.assert_allclose(made._weight, weight, rtol=1e-12)
    assert not np.allclose(made._cloud, place)


def test_the_first_cloud_lies_in_one_quadrant_and_looks_within_a_quarter_turn_of_the_tag():
    made = guide(rows=3, particles=500)
    x, y, a = made._cloud.transpose(1, 0, 2)
    assert ((x <= 0) & (x >= -14) & (y <= 0) & (y >= -14)).all()
    off = np.angle(np.exp(1j * (np.arctan2(-y, -x) - a)))
    assert (np.abs(off) <= np.pi / 2 + 1e-9).all()
    assert np.ptp(off) > 3.0


def test_resampling_follows_the_effective_number():
    never, always = guide(resample_below=0), guide(resample_below=1)
    for made in (never, always):
        act(made)
        stepped(made)
    assert np.ptp(never._weight) > 0
    np.testing.assert_allclose(always._weight, 1 / 100)


def test_the_belief_is_the_clouds_in_the_persons_frame():
    draws = np.random.default_rng(5)
    cloud, weight = draws.normal(0, 4, (2, 3, 30)), draws.uniform(0.1, 1, (2, 30))
    weight /= weight.sum(axis=1, keepdims=True)
    mean, covariance = _moments(cloud, weight)
    for b in range(2):
        x, y, a = cloud[b]
        seen = np.stack([np.cos(a) * -x + np.sin(a) * -y, -np.sin(a) * -x + np.cos(a) * -y])
        np.testing.assert_allclose(mean[b], seen @ weight[b])
        np.testing.assert_allclose(covariance[b], np.cov(seen, aweights=weight[b], ddof=0))


def test_a_rows_guide_does_not_depend_on_its_company():
    many, one = guide(rows=3, particles=50), HandheldPaper(HandheldPaper.Config(particles=50), samples.site(), RowRandom([7]))
    one.start(Prior(np.zeros(1), np.zeros((1, 6)), np.eye(6)[None]))
    for made in (many, one):
        act(made)
        for k in range(6):
            stepped(made, change=-15.0 + k)
            act(made, turn=0.1 * k)
    np.testing.assert_allclose(many._cloud[2], one._cloud[0], rtol=1e-9)
    assert many.suggest().aim[2] == pytest.approx(one.suggest().aim[0], abs=1e-9)
