"""One row of the gate's hidden Markov model against the same step by dense matrices and arrays, and what must hold of any belief."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from estimators import gate_cells as cells

X, Y = (np.arange(-4, 4) + 0.5) * 0.4, np.arange(-2, 3) * 0.4
NX, NY, MIDDLE = len(X), len(Y), 4
OPEN = np.abs(Y) <= 0.5
NEAR = (np.abs(X)[:, None] <= 0.7) & (np.abs(Y)[None] <= 0.5)
SHAPE = (5, 5, NX, NY)
RATES = {"start": 0.07, "stop": 0.05, "turn": 0.11, "rest": 0.2, "band": 0.5}
WAY = {1: (1, 0), 2: (-1, 0), 3: (0, 1), 4: (0, -1)}


def belief(seed):
    p = np.random.default_rng(seed).dirichlet(np.full(np.prod(SHAPE), 0.3)).reshape(SHAPE)
    p[0, 1:] = 0.0  # whoever has stood ever since does not go
    return p / p.sum()


# ---------------------------------------------------------------- by matrices


def switched(p, start, stop, turn, rest, band):
    """History by history, as the model says: motions mix by a 5 x 5 matrix; who sets out changes history, and so does who has rested."""
    p, flux = p.copy(), np.zeros(5)
    mix = np.zeros((5, 5))
    mix[0, 0], mix[0, 1:] = 1.0, stop  # to stand, from each way of going
    mix[1:, 1:] = turn / 3 + np.eye(4) * (1 - stop - turn - turn / 3)
    outside = (X < 0)[:, None] & np.ones((1, NY), dtype=bool)
    far = np.broadcast_to((np.abs(X) >= band)[:, None], (NX, NY))
    for h in range(5):
        stood = p[h, 0].copy()
        p[h] = np.einsum("ab,bij->aij", mix, p[h])
        if h == 0:
            p[1, 1:] += 0.25 * start * np.where(outside, stood, 0.0)
            p[3, 1:] += 0.25 * start * np.where(outside, 0.0, stood)
        else:
            p[h, 1:] += 0.25 * start * stood
        p[h, 0] -= start * stood
        if h:
            gone = np.where(far, rest * p[h, 0], 0.0)
            p[h, 0] -= gone
            p[0, 0] += gone
            ends = {1: ("pass", "in"), 2: ("uturn", "in"), 3: ("out", "pass"), 4: ("out", "uturn")}[h]
            for end, where in zip(ends, (outside, ~outside), strict=True):
                flux[{"in": 1, "out": 2, "pass": 3, "uturn": 4}[end]] += gone[where].sum()
    return p, flux


def moves(m, jump):
    """(cells, cells): from where to where one step of motion m leads."""
    dx, dy = WAY[m]
    matrix = np.zeros((NX * NY, NX * NY))
    for i in range(NX):
        for j in range(NY):
            a, b = i + dx, j + dy
            blocked = not (0 <= a < NX and 0 <= b < NY) or ({i, a} == {MIDDLE - 1, MIDDLE} and not OPEN[j])
            matrix[i * NY + j, i * NY + j] = 1.0 if blocked else 1.0 - jump
            if not blocked:
                matrix[a * NY + b, i * NY + j] = jump
    return matrix


def gone(p, jump_x, jump_y):
    p = p.copy()
    for h in range(1, 5):
        for m in WAY:
            p[h, m] = (moves(m, jump_x if m < 3 else jump_y) @ p[h, m].ravel()).reshape(NX, NY)
    for h in (1, 3):
        p[h + 1] += p[h] * NEAR
        p[h] *= ~NEAR
    return p


def ring(turn, sigma, outlier):
    """A normal on a ring of length π: all its windings."""
    if sigma > 1.2:
        return np.full(np.shape(turn), 1 / np.pi)
    windings = norm.pdf(np.asarray(turn)[..., None] + np.pi * np.arange(-8, 9), scale=sigma).sum(axis=-1)
    return (1 - outlier) * windings + outlier / np.pi


@pytest.mark.parametrize("seed", range(6))
def test_setting_out_stopping_turning_and_resting_are_as_by_matrices(seed):
    p, flux = belief(seed), np.zeros(5)
    wanted, ended = switched(p, **RATES)
    cells.switch(p, X, *RATES.values(), flux)
    np.testing.assert_allclose(p, wanted, atol=1e-12)
    np.testing.assert_allclose(flux, ended, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_going_is_as_by_matrices(seed):
    p = belief(seed)
    wanted = gone(p, 0.3, 0.2)
    cells.go(p, NEAR, OPEN, MIDDLE, 0.3, 0.2)
    np.testing.assert_allclose(p, wanted, atol=1e-12)


@pytest.mark.parametrize("turn", [np.nan, 0.02, 1.3, -2.9, 3.1])
def test_a_read_is_weighed_as_by_arrays(turn):
    p, rng = belief(3), np.random.default_rng(5)
    expected, toward = rng.normal(-60, 8, (NX, NY)), rng.uniform(-0.9, 0.9, (NX, NY, 2))
    k, dt, speed, spread, sigma, weight, share = 36.0, 0.05, 0.9, 0.2, 6.0, 0.4, 0.6
    level = np.exp(-0.5 * weight * np.minimum(((-58 - expected) / sigma) ** 2, 9.0))
    factor = np.repeat(level[None], 5, axis=0)
    if not np.isnan(turn):
        factor[0] *= ring(turn, 0.2, 0.1) ** share
        for m, way in WAY.items():
            # who goes towards the antenna by v shortens the distance there and back: phase, which falls with it, rises by k v dt
            factor[m] *= ring(turn - k * dt * speed * toward @ way, np.hypot(0.2, k * spread * dt), 0.1) ** share
    wanted = p * factor
    total = wanted.sum()
    work = np.empty((5, NX, NY))
    found = cells.weigh(p, expected, -58.0, weight, sigma, turn, dt, toward, k, 0.2, speed, spread, 0.1, share, work)
    np.testing.assert_allclose(p, wanted / total, atol=2e-7)  # a normal on a ring by its two nearest windings
    assert found == pytest.approx(np.log(total), abs=1e-6)


def test_silence_is_weighed_as_by_arrays():
    p = belief(2)
    missed = np.log(np.random.default_rng(1).uniform(0.2, 1.0, (3, NX, NY)))
    last, now, lull = np.array([np.nan, 4.9, 3.0]), 5.0, 0.5  # never heard; heard just now, so that it says nothing; long ago
    wanted = p * np.exp(missed[0] + missed[2])
    cells.hush(p, missed, last, now, lull, np.empty((1, NX, NY)))
    np.testing.assert_allclose(p, wanted / wanted.sum(), atol=1e-12)


@pytest.mark.parametrize("sigma", [0.1, 0.5, 1.0, 1.19, 2.0])
def test_the_density_on_the_ring_integrates_to_one(sigma):
    u = np.linspace(-np.pi / 2, np.pi / 2, 2001)
    density = np.array([cells.ring(v, sigma, 0.15) for v in u])
    assert np.trapezoid(density, u) == pytest.approx(1.0, abs=0.02)


# ---------------------------------------------------------------- what must hold


@given(seed=st.integers(0, 10_000), rates=st.lists(st.floats(0.0, 0.3), min_size=6, max_size=6))
@settings(max_examples=60, deadline=None)
def test_no_step_makes_or_loses_probability(seed, rates):
    p, flux = belief(seed), np.zeros(5)
    cells.switch(p, X, rates[0], rates[1], rates[2], rates[3], 0.5, flux)
    assert p.sum() == pytest.approx(1.0, abs=1e-12)
    cells.go(p, NEAR, OPEN, MIDDLE, rates[4], rates[5])
    assert p.sum() == pytest.approx(1.0, abs=1e-12)
    assert (p >= 0).all()
    assert (flux >= 0).all()
    assert flux.sum() <= 1.0
    cells.turn_page(p, X)
    assert p.sum() == pytest.approx(1.0, abs=1e-12)
    assert p[1:3, :, MIDDLE:].sum() + p[3:, :, :MIDDLE].sum() == 0.0  # all that has set out has done so where it is


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_gate_seen_in_a_mirror_swaps_in_and_out(seed):
    """x -> -x: histories 1, 2 and 3, 4, and motions 1 and 2, change places, and nothing else."""
    p = belief(seed)

    def mirrored(p):
        return p[[0, 3, 4, 1, 2]][:, [0, 2, 1, 3, 4]][:, :, ::-1]

    q, flux, other = mirrored(p).copy(), np.zeros(5), np.zeros(5)
    for state, ended in ((p, flux), (q, other)):
        cells.switch(state, X, *RATES.values(), ended)
        cells.go(state, NEAR, OPEN, MIDDLE, 0.3, 0.2)
    np.testing.assert_allclose(q, mirrored(p), atol=1e-12)
    np.testing.assert_allclose(other[[0, 2, 1, 3, 4]], flux, atol=1e-12)
    assert cells.crossed(q, X, 0.5) == pytest.approx(cells.crossed(p, X, 0.5)[::-1], abs=1e-12)


def test_nobody_goes_through_the_wall():
    p = np.zeros(SHAPE)
    p[1, 1, :MIDDLE, ~OPEN] = 1.0
    p /= p.sum()
    for _ in range(50):
        cells.go(p, NEAR, OPEN, MIDDLE, 0.4, 0.4)
    assert p[:, :, MIDDLE:].sum() == 0.0
    assert cells.crossed(p, X, 0.0) == (0.0, 0.0)


def test_who_goes_in_advances_by_a_binomial_number_of_cells():
    p = np.zeros(SHAPE)
    p[1, 1, 0, 2] = 1.0
    for _ in range(4):
        cells.go(p, np.zeros_like(NEAR), OPEN, MIDDLE, 0.25, 0.25)
    np.testing.assert_allclose(p[1, 1, :5, 2], np.array([81, 108, 54, 12, 1]) / 256)


def test_a_tag_heard_for_the_first_time_is_anywhere_and_has_set_out_where_it_is():
    p = np.zeros(SHAPE)
    cells.begin(p, X, 0.2)
    assert p.sum() == pytest.approx(1.0)
    assert p[0].sum() == pytest.approx(0.8)
    np.testing.assert_allclose(p.sum(axis=(0, 1)), 1 / (NX * NY))
    assert p[1, :, MIDDLE:].sum() == p[3, :, :MIDDLE].sum() == 0.0
    assert cells.crossed(p, X, 0.0) == (0.0, 0.0)
