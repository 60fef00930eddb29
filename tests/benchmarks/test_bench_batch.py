"""What several processes bring, and what handing work out costs: two processes against one, tasks of a second against tasks of a block."""

import os
import sys
import time
from pathlib import Path

import pytest

from testbed import pool
from testbed.batch import run
from testbed.scenario import load

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "fakes"))

WANTED = 1.7
ROUNDS = 2


def seconds(jobs, trials):
    """Wall time of a study with its processes started already (that costs about as much as 100 light trials, once)."""
    one = load("empty-floor", {"trials": trials, "duration_s": 4})
    begun = []
    made = pool.results

    def results(*args):
        begun.append(time.perf_counter())
        return made(*args)

    class Ready(pool.Workers):
        def __init__(self, count):
            super().__init__(count)
            list(self.map(_warm, range(4 * count)))
            begun.append(time.perf_counter())

    run(one, jobs=jobs, executors=Ready)
    return time.perf_counter() - begun[-1]


def _warm(_):
    """Import and compile what a trial needs."""
    from testbed import worker
    from testbed.simulate import Simulator

    with Simulator(load("empty-floor", {"trials": 1, "duration_s": 1})) as simulator:
        simulator.trial(0)
    time.sleep(0.05)
    return worker.__name__


@pytest.mark.benchmark
def test_two_processes_are_at_least_1_7_times_as_fast_as_one(benchmark):
    if pool.cores() < 2:
        pytest.skip("there is one core only")
    if os.getloadavg()[0] > 0.7 * pool.cores():
        pytest.skip(f"the machine is busy (load {os.getloadavg()[0]:.1f}): a ratio of processes would say nothing")
    found = [(seconds(1, 60), seconds(2, 60)) for _ in range(ROUNDS)]
    one, two = (min(times) for times in zip(*found, strict=True))
    benchmark.extra_info["peer"] = "the same study in one worker process"
    benchmark.extra_info["ratio"] = round(one / two, 3)
    benchmark.pedantic(lambda: None, rounds=1)
    assert one / two >= WANTED
