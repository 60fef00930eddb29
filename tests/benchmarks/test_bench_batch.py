"""What several processes bring: two against one."""

import os
import time

import pytest
from batch_fakes import warm

from testbed import pool
from testbed.batch import run
from testbed.scenario import load as scenario

WANTED = 1.7
ROUNDS = 4  # the least of them: what others do on the machine only lengthens
PATIENCE_S = 120


def seconds(jobs, trials):
    """Wall time of a study in processes that are there already: to start them costs what 30 such trials do, once."""
    ready = []

    class Ready(pool.Workers):
        def __init__(self, count):
            super().__init__(count)
            list(self.map(warm, range(4 * count)))
            ready.append(time.perf_counter())

    run(scenario("empty-floor", {"trials": trials, "duration_s": 4}), jobs=jobs, executors=Ready)
    return time.perf_counter() - ready[0]


def busy():
    """The load, once it has fallen below what leaves two cores free or the patience is at its end."""
    end = time.monotonic() + PATIENCE_S
    while os.getloadavg()[0] > 0.5 * pool.cores() and time.monotonic() < end:
        time.sleep(5)
    return os.getloadavg()[0]


@pytest.mark.benchmark
def test_two_processes_are_at_least_1_7_times_as_fast_as_one(benchmark):
    if pool.cores() < 2:
        pytest.skip("there is one core only")
    if (load := busy()) > 0.7 * pool.cores():
        pytest.skip(f"the machine is busy (load {load:.1f}): a ratio of processes would say nothing")
    found = [(seconds(1, 64), seconds(2, 64)) for _ in range(ROUNDS)]
    one, two = (min(times) for times in zip(*found, strict=True))
    benchmark.extra_info["peer"] = "the same study in one worker process"
    benchmark.extra_info["ratio"] = round(one / two, 3)
    benchmark.pedantic(lambda: None, rounds=1)
    assert one / two >= WANTED
