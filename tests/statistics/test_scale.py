"""Many light trials: memory stays flat, and next to nothing of the time goes into handing work out and keeping its results.

In CI 400 trials; TESTBED_SCALE_TRIALS=10000 makes the whole of it.
"""

import os
import resource
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from testbed import pool
from testbed.batch import run
from testbed.scenario import from_dict

TRIALS = int(os.environ.get("TESTBED_SCALE_TRIALS", "400"))
PAGE = resource.getpagesize()

LIGHT = {
    "name": "light",
    "seed": 1,
    "trials": TRIALS,
    "duration_s": 2,
    "world": {"kind": "open_floor"},
    "actors": [
        {
            "id": "t",
            "kind": "trolley",
            "motion": "kinematic",
            "route": {"waypoints_m": [[1, 1], [6, 1]]},
            "tags": [{"id": "a", "mount": "top"}],
        }
    ],
    "sensors": [{"id": "posts", "kind": "rfid", "antennas": {"on": "post1"}, "channel": {"orders": 0, "diffuse": False, "edges": False}}],
    "estimators": [{"kind": "centroid"}],
    "metrics": [{"kind": "position_error"}],
}


class Watch(threading.Thread):
    """Resident memory of this process and its children, twice a second, bytes."""

    def __init__(self):
        super().__init__(daemon=True)
        self.seen, self.over = [], threading.Event()

    def run(self):
        while not self.over.wait(0.5):
            self.seen.append((time.perf_counter(), sum(map(_resident, [os.getpid(), *_children(os.getpid())]))))


def _resident(pid):
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE
    except OSError:
        return 0


def _children(pid):
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += [int(child) for child in (task / "children").read_text().split()]
    return found


def _of_children():
    """Processor time of children that have ended, s: whatever else the machine does, it is what they cost."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


@pytest.mark.study
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="memory is read from /proc")
def test_memory_is_flat_and_scheduling_costs_next_to_nothing(tmp_path, monkeypatch, capsys):
    run(from_dict({**LIGHT, "trials": 4}), out=tmp_path / "warm", jobs=1, keep="none")  # to import costs the same for one trial
    busy = []
    learn = pool._Queue.learn
    monkeypatch.setattr(pool._Queue, "learn", lambda queue, done, seconds: (busy.append((seconds, len(done))), learn(queue, done, seconds)))
    watch = Watch()
    watch.start()
    mine, theirs, begun = time.process_time(), _of_children(), time.perf_counter()
    result = run(from_dict(LIGHT), out=tmp_path / "out", jobs=2, keep="none")
    spent, mine, theirs = time.perf_counter() - begun, time.process_time() - mine, _of_children() - theirs
    watch.over.set()
    working = sum(seconds for seconds, _ in busy)
    memory = np.array([m for _, m in watch.seen])
    half = len(memory) // 2
    figures = {
        "trials": TRIALS,
        "seconds": spent,
        "largest MB in all": memory.max() / 1e6,
        "growth over the second half, MB": (memory[half:].max() - memory[half]) / 1e6,
        "this process's processor time by that of the workers": mine / theirs,
        "time of two processes not spent in work, start included": 1 - working / (2 * spent),
        "blocks in a task, median": float(np.median([n for _, n in busy])),
    }
    with capsys.disabled():
        print("\n" + "; ".join(f"{name}: {value:.4g}" for name, value in figures.items()))  # noqa: T201
    assert len(np.unique(result.rows["trial"])) == TRIALS
    assert not result.failures
    assert memory.max() < 1.5e9
    assert memory[half:].max() - memory[half] < 60e6
    assert mine / theirs < 0.05
