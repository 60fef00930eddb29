"""Work that costs nothing, importable by spawned workers: figures from counters, misbehaviour on request.

A scenario's title asks for it: "die=5" ends the process in trial 5, "fail=5" records a failure, "input=5" raises a ScenarioError,
"interrupt=5" raises KeyboardInterrupt. The environment's FAKE_SECONDS is how long a trial takes.
"""

from __future__ import annotations

import os
import pickle
import time

import numpy as np

from testbed import archive
from testbed.rng import Counter, keys_of
from testbed.scenario import from_dict, load
from testbed.simulate import Simulator
from testbed.worker import Block, BlockResult, Failure, stack

TARGETS = ("tag1", "tag2")


def scenario(trials=10, title="", seed=3, estimators=("ekf", "ukf"), expect=None, sweep=None, **changes):
    """A scenario that loads and is never simulated."""
    document = {
        "name": "fake",
        "title": title,
        "seed": seed,
        "trials": trials,
        "duration_s": 1,
        "world": {"kind": "open_floor"},
        "estimators": [{"id": id, "kind": "ekf"} for id in estimators],
        **({"expect": expect} if expect else {}),
        **({"sweep": sweep} if sweep else {}),
        **changes,
    }
    return from_dict(document)


def wishes(title):
    return dict(word.split("=") for word in title.split())


def work(block: Block) -> BlockResult:
    one = pickle.loads(block.scenario)
    wish = wishes(one.title)
    rows, world, timings, failures = [], [], [], []
    for trial in block.trials:
        time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
        if wish.get("die") == str(trial):
            os._exit(9)
        if wish.get("interrupt") == str(trial):
            raise KeyboardInterrupt
        if wish.get("input") == str(trial):
            raise one.problem(("world",), "there is no such thing in this world")
        if wish.get("fail") == str(trial):
            failures.append(Failure(block.point, trial, "", "simulate", "ValueError: on request", "a traceback"))
            continue
        if block.folder is not None and trial in block.keep:
            archive.place(block.folder, block.point, trial).mkdir(parents=True, exist_ok=True)
        world.append({"point": np.array([block.point]), "trial": np.array([trial]), "line_of_sight": np.array([0.5])})
        ids = [section.id for section in one.estimators if block.only is None or section.id in block.only]
        rows += [figures(one.seed, int(one.duration_s) - 1, trial, id) | {"point": np.full(len(TARGETS), block.point)} for id in ids]
        timings.append({"point": np.array([block.point]), "trial": np.array([trial]), "seconds": np.array([time.perf_counter()])})
    return BlockResult(block.point, block.trials, stack(rows), stack(world), stack(timings), tuple(failures))


def warm(_):
    """Import and compile what a real trial needs, and leave time for other processes to take their share."""
    with Simulator(load("empty-floor", {"trials": 1, "duration_s": 1})) as simulator:
        simulator.trial(0)
    time.sleep(0.05)


def figures(seed, point, trial, estimator):
    """A trial's figures are those of its scenario, wherever in a sweep it stands: `point` is the duration in whole seconds less one."""
    draws = Counter(seed, trial, f"{estimator}.{point}")
    n = len(TARGETS)
    keys = {"point": np.full(n, point), "trial": np.full(n, trial), "estimator": np.full(n, estimator), "target": np.array(TARGETS)}
    return {**keys, "position_error_m.mean": draws.uniform(keys_of(TARGETS)), "availability": np.ones(n)}
