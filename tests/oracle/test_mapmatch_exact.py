"""The grid filter against independent ways to the exact posterior: dense matrices, a finer grid, and a cloud of very many particles."""

import numpy as np
import pytest
from road_recordings import by_hand, nowhere, tracked, trials

from estimators.mapmatch_grid import MapmatchGrid
from testbed.estimate import run
from testbed.geometry import Roads
from testbed.roads import RoadGraph
from testbed.types import Status

NODES = [[0, 0], [6, 0], [6, 4], [0, 4], [9, 4]]
SEGMENTS = [[0, 1], [1, 2], [2, 3], [3, 0], [2, 4]]


def forward(graph, cell, heading, kappa):
    """(K, C): the forward algorithm over cells of directed edges, one cell a step, with the transition as a dense matrix."""
    count = np.round(graph.length / cell).astype(int)
    first = np.concatenate([[0], np.cumsum(count)])
    edge = np.repeat(np.arange(graph.edges), count)
    step = np.zeros((first[-1], first[-1]))
    for c, e in enumerate(edge):
        if c + 1 < first[e + 1]:
            step[c, c + 1] = 1.0
            continue
        ways = [w for w in range(graph.edges) if graph.tail[w] == graph.head[e] and w != graph.back[e]] or [graph.back[e]]
        step[c, first[ways]] = 1 / len(ways)
    belief, found = np.full(first[-1], 1 / first[-1]), []
    for phi in heading:
        belief = belief @ step * np.exp(kappa * np.cos(phi - graph.direction[edge]))
        belief /= belief.sum()
        found.append(belief)
    return np.array(found)


def test_without_noise_the_grid_is_the_forward_algorithm_on_matrices():
    # one cell a step, so that no remainder is left and every step is a matrix: a hidden Markov model written out
    draws = np.random.default_rng(8)
    t = np.arange(1, 61) / 10
    heading = draws.uniform(-np.pi, np.pi, len(t))
    recording = by_hand(NODES, SEGMENTS, t, 5.0, heading)
    config = MapmatchGrid.Config(cell_m=0.5, biases=1, bias_range_mps=0.0, noise_mps=0.0, carried_per_s=0.0, kappa=2.0, place="mean")
    graph = RoadGraph(Roads(np.array(NODES), np.array(SEGMENTS)))
    kept = []

    class Spy(MapmatchGrid):
        def renew(self, rows):
            kept.append(self.mass[0, 0].copy())

    run([recording], Spy, config, nowhere(), np.array([1], dtype=np.uint64))
    expected = forward(graph, 0.5, heading, kappa=2.0)
    np.testing.assert_allclose(np.array(kept)[-len(t) :], expected, atol=1e-12)


def rms(a, b, chosen):
    return float(np.sqrt(((a.mean - b.mean)[chosen] ** 2).sum(axis=-1).mean()))


@pytest.fixture(scope="module")
def runs():
    return trials(2, duration_s=60)


def test_a_grid_four_times_finer_says_the_same_once_both_track(runs):
    coarse = tracked(runs, "mapmatch_grid", place="mean")
    fine = tracked(runs, "mapmatch_grid", place="mean", cell_m=0.125)
    both = (coarse.status == Status.OK) & (fine.status == Status.OK)
    assert both.mean() > 0.4
    assert rms(coarse, fine, both) < 0.5  # m: a coarse cell


@pytest.mark.study
def test_over_whole_runs_a_grid_four_times_finer_is_hardly_better():
    made = trials(8)
    tracks = [tracked(made, "mapmatch_grid", cell_m=cell, biases=biases) for cell, biases in ((0.5, 7), (0.125, 7), (0.125, 28))]
    truth = np.concatenate([r.target_states(tracks[0].t)[..., :2] for r in made], axis=1)
    error = [np.hypot(*np.moveaxis(one.mean - truth, -1, 0)).mean(axis=0) for one in tracks]
    # the same runs, so the seeking phase, where errors are large, is the same for all three
    assert abs(np.mean(error[0] - error[1])) < 0.2  # m of 1.2
    assert abs(np.mean(error[0] - error[2])) < 0.2


@pytest.mark.study
def test_very_many_particles_say_what_the_grid_says(runs):
    grid = tracked(runs, "mapmatch_grid", place="mean", cell_m=0.2, biases=21)
    cloud = tracked(runs, "mapmatch_particles_bias", particles_min=40_000, particles_max=40_000, bias_walk_mps=0.003)
    both = (grid.status == Status.OK) & (cloud.status == Status.OK)
    assert both.mean() > 0.4
    assert rms(grid, cloud, both) < 0.5
