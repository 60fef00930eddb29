"""Map matching: many runs in one call against one call a run, the grid's kernels against the same sums by numpy, and a whole study.

What the study and a run of the grid take is said in seconds of this process, and asserted as a ratio: the grid against the paper's filter.
"""

from time import process_time

import numpy as np
import pytest
from road_recordings import W3, made, tracked, trials

from estimators.mapmatch_grid import MapmatchGrid
from estimators.roads_grid import Cells
from testbed.roads import RoadGraph

pytestmark = pytest.mark.benchmark

RUNS = 16


def seconds(call, rounds=3):
    """The least time of this process, which other programs on the machine don't lengthen."""
    found = []
    for _ in range(rounds):
        begun = process_time()
        call()
        found.append(process_time() - begun)
    return min(found)


@pytest.fixture(scope="module")
def runs():
    found = trials(RUNS, duration_s=40)
    for kind in ("mapmatch_particles", "mapmatch_grid"):  # compiles
        tracked(found[:1], kind)
    return found


@pytest.mark.parametrize(("kind", "least"), [("mapmatch_particles", 3.0), ("mapmatch_grid", 1.3)])
def test_runs_together_are_faster_than_one_by_one(benchmark, runs, kind, least):
    alone = seconds(lambda: [tracked([one], kind) for one in runs])
    together = seconds(lambda: tracked(runs, kind))
    benchmark.extra_info["times as fast"] = alone / together
    benchmark.pedantic(lambda: tracked(runs, kind), rounds=1)
    assert alone / together > least


def by_numpy(graph, cells, mass, share):
    """A shift by arrays: what leaves each edge is gathered over the edges that lead into the next."""
    moved = np.empty_like(mass)
    moved[1:] = mass[:-1]
    come = np.zeros(graph.edges)
    ways = np.diff(graph.first)
    np.add.at(come, graph.onward, np.repeat(mass[cells.first[1:] - 1] / ways, ways))
    moved[cells.first[:-1]] = come
    return (1 - share) * mass + share * moved


def test_the_grid_s_step_is_faster_than_by_numpy(benchmark):
    graph, rows = RoadGraph(W3), np.arange(8)
    one = made(MapmatchGrid, rows=8)
    cells = Cells.of(graph, 0.5)
    heading, kappa = np.zeros(8), np.full(8, 2.0)

    def kernels():
        one.move(rows, np.full(8, 5.0), np.full(8, 0.1))
        one.weigh(rows, heading, kappa, np.full(8, 0.1))

    def arrays():
        likelihood = np.exp(2.0 * (np.cos(graph.direction) - 1))[cells.edge]
        for b in rows:
            for k in range(7):
                for share in (0.98, 0.02):
                    one.mass[b, k] = by_numpy(graph, cells, one.mass[b, k], share)
            one.mass[b] *= likelihood
            one.mass[b] /= one.mass[b].sum()

    kernels()
    own, peer = seconds(lambda: [kernels() for _ in range(50)]), seconds(lambda: [arrays() for _ in range(50)])
    benchmark.extra_info["times as fast"] = peer / own
    benchmark(kernels)
    assert peer / own > 2.0


def test_what_the_whole_study_takes_on_two_cores(benchmark, runs):
    share = 0.12  # of 100 runs at each of five κ_P

    def study():
        made_here = trials(round(100 * share))
        for kappa in (10.0, 5.0, 1.0, 0.5, 0.1):
            tracked(made_here, "mapmatch_particles", kappa=kappa)

    spent = seconds(study, rounds=1)
    benchmark.extra_info["seconds on two cores"] = spent / share / 2
    benchmark.pedantic(lambda: None, rounds=1)
    # to be 60 s at most


def test_a_run_of_the_grid_costs_no_more_than_a_few_of_the_paper_s_particles(benchmark, runs):
    block = trials(10)  # as a study has them: a run alone is mostly the driver's time for each event
    spent = seconds(lambda: tracked(block, "mapmatch_grid"), rounds=2) / len(block)
    particles = seconds(lambda: tracked(block, "mapmatch_particles"), rounds=2) / len(block)
    benchmark.extra_info |= {"seconds a run": spent, "times the particles": spent / particles}  # to be 0.3 s at most
    benchmark.pedantic(lambda: None, rounds=1)
    assert spent / particles < 4
