"""The pieces of the map-matching filters: what tables of errors can't see.

Statistical tests use fixed seeds and state their false-alarm probability.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from road_recordings import W3, made, nowhere, step
from scipy.stats import binom, chi2

from estimators.mapmatch_grid import MapmatchGrid
from estimators.mapmatch_particles import MapmatchParticles
from estimators.mapmatch_particles_bias import MapmatchParticlesBias
from estimators.roads_cloud import even_spacing
from estimators.roads_grid import Cells, move_grid, shift
from estimators.roads_map import RoadMap, drive, nearest, rounding_saves, split, summarise_cloud, weigh_cloud
from testbed.geometry import Roads
from testbed.roads import RoadGraph, project

GRAPH = RoadGraph(W3)
MAP = RoadMap.of(GRAPH)
METHODS = (MapmatchParticles, MapmatchGrid, MapmatchParticlesBias)


# ---------------------------------------------------------------- the start


def test_particles_begin_evenly_along_the_segments():
    one = made(MapmatchParticles)
    cloud = one.cloud
    segment = GRAPH.segment[cloud.edge[0]]
    forward = np.where(cloud.edge[0] < 26, cloud.offset[0], GRAPH.length[cloud.edge[0]] - cloud.offset[0])
    along = np.concatenate([[0.0], np.cumsum(GRAPH.length[:26])])[segment] + forward
    np.testing.assert_allclose(along, (np.arange(300) + 0.5) * 216 / 300, atol=1e-9)


def test_directions_are_split_by_a_fair_coin():
    edges = made(MapmatchParticles, rows=50).cloud.edge
    forward = int((edges < 26).sum())
    assert 1e-6 < binom.cdf(forward, 15_000, 0.5) < 1 - 1e-6  # false alarm 2e-6
    per_row = (edges < 26).sum(axis=1)
    assert per_row.std() > 3  # a coin for each particle, not every second one


def test_one_way_roads_are_begun_in_their_direction():
    roads = Roads(np.array([[0, 0], [4, 0], [4, 3]]), np.array([[0, 1], [1, 2], [2, 0]]), np.array([True, True, True]))
    assert set(made(MapmatchParticles, roads=roads).cloud.edge[0]) == {0, 1, 2}


@pytest.mark.parametrize("method", METHODS)
def test_a_prior_says_where_to_begin_and_which_way(method):
    one = made(method, prior=nowhere(x=3.0, y=0.2, std=0.7, vx=-2.0), start="prior")
    estimate = one.estimate()
    np.testing.assert_allclose(estimate.mean[0], [3.0, 0.0], atol=0.4)
    step(one, 0.5, 2.0, np.pi)
    assert one.estimate().mean[0, 0] < 2.6  # along the prior's velocity, westwards


def test_spacing_is_even_over_pieces_of_any_length():
    piece, offset = even_spacing(np.array([1.0, 0.25, 3.0]), 17)
    along = np.array([0.0, 1.0, 1.25])[piece] + offset
    np.testing.assert_allclose(np.diff(along), 4.25 / 17)


# ---------------------------------------------------------------- moving


def test_ways_on_at_a_node_are_taken_equally_often():
    # χ² over 40,000 crossings of every edge's end, false alarm 1e-6
    uniform = np.random.default_rng(2).random(40_000)
    statistic, freedom = 0.0, 0
    for edge in range(52):
        found = np.array([drive(MAP, edge, GRAPH.length[edge] + 0.5, split(u)[1])[0] for u in uniform[:2000]])
        ways = GRAPH.onward[GRAPH.first[edge] : GRAPH.first[edge + 1]]
        count = np.array([(found == w).sum() for w in ways])
        assert count.sum() == len(found)
        statistic += ((count - count.mean()) ** 2 / count.mean()).sum()
        freedom += len(ways) - 1
    assert statistic < chi2.ppf(1 - 1e-6, freedom)


def test_what_exceeds_an_edge_is_carried_on_over_several_nodes():
    edge, offset = drive(MAP, 0, 6.0 + 9.0 + 0.7, 0.999)  # a whole edge is left behind on the way
    assert GRAPH.length[edge] > 0
    assert offset == pytest.approx(15.7 - 6.0 - GRAPH.length[GRAPH.onward[GRAPH.first[0] : GRAPH.first[1]]].max(), abs=9)
    assert drive(MAP, 0, 6.0, 0.5) == (0, 6.0)  # at the end, not beyond it


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 51), st.floats(0, 60), st.floats(0, 1, exclude_max=True))
def test_a_particle_ends_on_an_edge_that_its_way_leads_to(edge, far, turns):
    end, offset = drive(MAP, edge, far, turns)
    assert 0 <= offset <= GRAPH.length[end]
    # walk back: the distance that the edges between took is what is missing
    reach, frontier = {(edge, 0.0)}, {(edge, 0.0)}
    while frontier:
        nxt = {(int(w), d + GRAPH.length[e]) for e, d in frontier for w in GRAPH.onward[GRAPH.first[e] : GRAPH.first[e + 1]] if d < far}
        frontier = {(w, round(d, 6)) for w, d in nxt if d <= far} - reach
        reach |= frontier
    assert any(e == end and abs(d + offset - far) < 1e-4 for e, d in reach)


def test_the_two_halves_of_a_uniform_are_uniform_and_unrelated():
    u = np.random.default_rng(3).random(50_000)
    a, b = np.array([split(x) for x in u]).T
    cells = np.bincount((10 * a).astype(int) * 10 + (10 * b).astype(int), minlength=100)
    assert ((cells - 500) ** 2 / 500).sum() < chi2.ppf(1 - 1e-6, 99)  # false alarm 1e-6


def test_an_offset_never_falls_below_nought():
    one = made(MapmatchParticles)
    one.cloud.offset[:] = 0.05
    one.move(np.array([0]), np.array([-9.0]), np.array([0.1]))
    assert (one.cloud.offset == 0).all()
    one.move(np.array([0]), np.array([0.0]), np.array([0.1]))
    assert (one.cloud.offset >= 0).all()
    assert 0.4 < (one.cloud.offset == 0).mean() < 0.6  # half of the noise pushes back


def test_the_noise_of_a_step_is_uniform_with_the_width_that_is_asked_for():
    one = made(MapmatchParticles, particles=20_000, spread_mps=2.0)
    one.cloud.edge[:], one.cloud.offset[:] = 2, 4.0
    one.move(np.array([0]), np.array([2.0]), np.array([0.1]))
    moved = one.cloud.offset[0] - 4.2
    half = np.sqrt(3) * 2.0 * 0.1
    assert np.abs(moved).max() <= half + 1e-6
    assert abs(moved.std() / 0.2 - 1) < 5 * np.sqrt(0.2 / 20_000)  # five sigma of a uniform's deviation: false alarm 6e-7


def test_rounded_corners_save_what_the_fillets_of_the_map_s_turns_do():
    square = Roads(np.array([[0, 0], [8, 0], [8, 8], [0, 8]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    assert rounding_saves(RoadGraph(square), 1.6) == pytest.approx((2 - np.pi / 2) * 1.6 / 8)  # 0.43 r at each right angle
    assert rounding_saves(RoadGraph(square), 100.0) == pytest.approx((2 - np.pi / 2) * 4 / 8)  # no fillet takes more than half a leg
    ahead = Roads(np.array([[0, 0], [8, 0], [16, 0]]), np.array([[0, 1], [1, 2]]))
    assert rounding_saves(RoadGraph(ahead), 1.6) == 0  # straight on, and round at the ends
    assert 0.05 < rounding_saves(GRAPH, 1.6) < 0.43 * 1.6 * 26 / 216  # as if every way on were a turn


@pytest.mark.parametrize("method", METHODS)
def test_a_vehicle_that_rounds_its_corners_covers_more_road_than_it_drives(method):
    lap = Roads(np.array([[0, 0], [20, 0], [20, 20], [0, 20]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]), np.ones(4, dtype=bool))
    plain, told = (made(method, roads=lap, prior=nowhere(x=2.0, std=0.1, vx=2.0), start="prior", turn_radius_m=r) for r in (0.0, 2.0))
    for one in (plain, told):
        for k in range(1, 51):
            step(one, k / 10, 2.0, 0.0)
    covered = [one.estimate().mean[0, 0] - 2.0 for one in (plain, told)]
    assert covered[0] == pytest.approx(10.0, abs=0.6)
    assert covered[1] - covered[0] == pytest.approx(10.0 * 0.43 * 2 / 20, abs=0.25)


# ---------------------------------------------------------------- weighing


def test_weights_are_von_mises_likelihoods_and_keep_their_sum():
    one = made(MapmatchParticles, kappa=1.0)
    before = one.cloud.weight.copy()
    told, cosine = one.weigh(np.array([0]), np.array([0.3]), np.array([1.0]), np.array([0.1]))
    expected = before * np.exp(np.cos(0.3 - GRAPH.direction[one.cloud.edge]) - 1)
    np.testing.assert_allclose(one.cloud.weight, expected / expected.sum(), rtol=1e-12)
    assert one.cloud.weight.sum() == pytest.approx(1.0)
    assert told[0] == pytest.approx(np.log(expected.sum()))
    assert cosine[0] == pytest.approx((before * np.cos(0.3 - GRAPH.direction[one.cloud.edge])).sum())


def test_a_likelihood_with_one_axis_alone_would_not_tell_east_from_west():
    one = made(MapmatchParticles, kappa=1.0)
    one.weigh(np.array([0]), np.array([0.0]), np.array([1.0]), np.array([0.1]))
    east, west = (one.cloud.weight[0][np.cos(GRAPH.direction[one.cloud.edge[0]]) * sign > 0.9].mean() for sign in (1, -1))
    assert east / west == pytest.approx(np.exp(2.0))


def test_weights_that_all_vanish_are_equal_again():
    edge, weight = np.zeros((1, 4), dtype=np.int64), np.full((1, 4), 0.25)
    told, agreement = np.empty(1), np.empty(1)
    weigh_cloud(MAP, np.array([0]), edge, weight, np.array([4]), np.array([np.pi]), np.array([1e5]), told, agreement)
    np.testing.assert_allclose(weight, 0.25)


def test_the_place_is_the_weighted_mean_projected_on_the_nearest_road():
    draws = np.random.default_rng(4)
    edge, share = draws.integers(0, 52, (3, 40)), draws.random((3, 40))
    offset, weight = share * GRAPH.length[edge], draws.random((3, 40))
    weight /= weight.sum(axis=1, keepdims=True)
    mean, covariance, close = np.empty((3, 2)), np.empty((3, 2, 2)), np.empty(3)
    summarise_cloud(MAP, np.arange(3), edge, offset, weight, np.full(3, 40), 5.0, False, mean, covariance, close)
    place = GRAPH.position(edge, offset)
    middle = np.einsum("bn,bni->bi", weight, place)
    segment, foot, _ = project(W3, middle)
    np.testing.assert_allclose(mean, foot)
    assert [nearest(MAP, *p)[0] for p in middle] == segment.tolist()
    apart = place - mean[:, None]
    np.testing.assert_allclose(covariance, np.einsum("bn,bni,bnj->bij", weight, apart, apart))
    np.testing.assert_allclose(close, (weight * (np.hypot(*apart.transpose(2, 0, 1)) <= 5.0)).sum(axis=1))


def test_resampling_comes_after_the_estimate_and_only_below_half():
    one = made(MapmatchParticles, kappa=3.0)
    step(one, 0.1, 0.0, 0.0)  # three quarters of the weights nearly vanish
    assert np.ptp(one.cloud.weight) == 0  # resampled
    before = one.estimate().mean.copy()
    looked = one.summary(np.array([0]))[0]
    assert not np.allclose(before, looked)  # what was told is the mean before
    mild = made(MapmatchParticles, kappa=0.05)
    step(mild, 0.1, 0.0, 0.0)
    assert np.ptp(mild.cloud.weight) > 0


# ---------------------------------------------------------------- the grid


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_a_shift_conserves_mass_and_follows_the_network(share, seed):
    cells = Cells.of(GRAPH, 0.5)
    mass = np.random.default_rng(seed).random(len(cells.edge))
    matrix = np.zeros((len(mass), len(mass)))  # the same by a table of where each cell leads
    for c, e in enumerate(cells.edge):
        if c + 1 < cells.first[e + 1]:
            matrix[c + 1, c] = 1.0
        else:
            ways = GRAPH.onward[GRAPH.first[e] : GRAPH.first[e + 1]]
            matrix[cells.first[ways], c] = 1 / len(ways)
    expected = (1 - share) * mass + share * (matrix @ mass)
    moved = mass.copy()
    shift(cells, moved, share, np.empty(52))
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    assert moved.sum() == pytest.approx(mass.sum())


@pytest.mark.parametrize("cell", [0.5, 0.1])
def test_mass_moves_as_far_as_the_odometer_says_and_widens_by_its_noise(cell):
    long = RoadGraph(Roads(np.array([[0, 0], [400, 0]]), np.array([[0, 1]])))
    cells, bias = Cells.of(long, cell), np.array([-0.2, 0.3])
    mass = np.zeros((1, 2, len(cells.edge)))
    mass[0, :, int(50 / cell)] = 1.0
    remainder, waiting = np.zeros((1, 2)), np.zeros((1, 2))
    for _ in range(500):
        move_grid(cells, np.array([0]), mass, remainder, waiting, bias, cell, np.array([2.0]), np.array([0.1]), 0.6)
    start = (int(50 / cell) + 0.5) * cell
    for k in range(2):
        mean = (mass[0, k] * cells.middle).sum()
        assert mean + remainder[0, k] == pytest.approx(start + (2.0 - bias[k]) * 50, abs=1e-6)
        variance = (mass[0, k] * (cells.middle - mean) ** 2).sum() + waiting[0, k] * cell**2
        assert variance == pytest.approx(500 * 0.06**2, rel=1e-6)
        assert abs(remainder[0, k]) <= cell / 2


def test_a_standing_vehicle_does_not_move_the_grid():
    one = made(MapmatchGrid, bias_range_mps=0.0, biases=1)
    before = one.mass.copy()
    for k in range(50):
        one.move(np.array([0]), np.array([0.0]), np.array([0.1]))
        assert one.mass.sum() == pytest.approx(1.0), k
    np.testing.assert_array_equal(one.mass, before)
