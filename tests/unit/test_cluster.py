"""A cluster: a real scheduler with two worker processes, one of which is killed in mid-run; a Slurm that is a script."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from batch_fakes import scenario, work

from testbed import batch, cluster, manifest, pool
from testbed.archive import place
from testbed.batch import run
from testbed.cluster import ClusterError, connected, profile_of
from testbed.scenario import ScenarioError, load

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

NOBODY = frozenset[str]()


def same(a, b):
    assert list(a) == list(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


@pytest.fixture(autouse=True)
def _code_stands_still(monkeypatch):
    """These tests may run while somebody edits it: the code is no part of the versions, here and in the workers."""
    for module in (manifest, batch):
        monkeypatch.setattr(module, "packages", lambda scenario: NOBODY)


@pytest.fixture(scope="module")
def scheduler():
    """Two processes with two threads each, so that a worker might mix up two tasks if it were not careful."""
    os.environ["FAKE_SECONDS"] = "0.05"
    with distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None, processes=True) as found:
        found.wait_for_workers(2)
        yield found
    del os.environ["FAKE_SECONDS"]


def pids(scheduler):
    with distributed.Client(scheduler.scheduler_address, set_as_default=False) as client:
        return sorted(client.run(os.getpid).values())


def test_a_worker_that_is_killed_costs_nothing(scheduler, tmp_path):
    one = scenario(trials=120, seed=11)
    before = pids(scheduler)
    killed = []

    def kill():
        while not list((tmp_path / "a" / "parts").glob("*.zip")):
            time.sleep(0.01)
        os.kill(before[0], signal.SIGKILL)
        killed.append(len(list((tmp_path / "a" / "parts").glob("*.zip"))))

    thread = threading.Thread(target=kill)
    thread.start()
    result = run(one, out=tmp_path / "a", keep="first:3", cluster=scheduler.scheduler_address, work=work)
    thread.join()
    undisturbed = run(one, out=tmp_path / "b", keep="first:3", work=lambda b: work(b))
    same(result.rows, undisturbed.rows)
    same(result.world, undisturbed.world)
    assert (tmp_path / "a" / "trials.parquet").read_bytes() == (tmp_path / "b" / "trials.parquet").read_bytes()
    assert not result.failures
    assert [place(tmp_path / "a", 0, t).is_dir() for t in range(4)] == [True, True, True, False]
    assert len(list((tmp_path / "a" / "parts").glob("*.zip"))) > killed[0]  # it was in mid-run
    assert before[0] not in pids(scheduler)


@pytest.mark.study
def test_a_trial_that_kills_its_workers_is_the_only_one_lost(scheduler):
    with distributed.Client(scheduler.scheduler_address, set_as_default=False) as client:
        client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    result = run(scenario(trials=7, title="die=5"), cluster=scheduler.scheduler_address, work=work)
    assert [(f.trial, f.stage) for f in result.failures] == [(5, "worker")]
    kept = run(scenario(trials=7), work=work).rows
    same(result.rows, {name: column[kept["trial"] != 5] for name, column in kept.items()})


@pytest.mark.study
def test_bad_input_found_there_arrives_as_what_it_is(scheduler):
    with pytest.raises(ScenarioError, match="world: there is no such thing in this world"):
        run(scenario(trials=12, title="input=5"), cluster=scheduler.scheduler_address, work=work)


@pytest.mark.study
def test_a_real_scenario_gives_the_same_values_for_one_two_and_a_cluster(scheduler, tmp_path):
    one = load("empty-floor", {"trials": 8, "duration_s": 2})
    found = [
        run(one, out=tmp_path / "1"),
        run(one, out=tmp_path / "2", jobs=2),
        run(one, out=tmp_path / "c", cluster=scheduler.scheduler_address, shared=f"file://{tmp_path}/shared"),
    ]
    for other in found[1:]:
        same(other.rows, found[0].rows)
        same(other.world, found[0].world)
    files = [sorted(p.relative_to(tmp_path / n) for p in (tmp_path / n / "recordings").rglob("*")) for n in ("1", "c")]
    assert files[0] == files[1]
    assert not list((tmp_path / "shared").rglob("*.parquet"))  # they were brought home


# ---------------------------------------------------------------- what is refused


def block(folder=None, keep=()):
    from testbed.worker import Block

    return Block(b"", 0, (0,), folder, keep)


def test_a_worker_with_other_libraries_or_code_is_refused():
    mine = manifest.made_with(NOBODY)
    with pytest.raises(ClusterError, match=r"the worker on .* has other numpy .*, not 1\.0: install the same there"):
        cluster._run_task(work, [block()], (NOBODY, {**mine, "numpy": "1.0"}, ""))
    with pytest.raises(ClusterError, match="has other code, not the one that this run started with"):
        cluster._run_task(work, [block()], (NOBODY, {**mine, "code": "x"}, ""))


def test_a_worker_that_cannot_see_the_folder_says_so_unless_nothing_is_kept(tmp_path):
    with pytest.raises(ClusterError, match=r"can't see .*: choose --out on a disk that all share"):
        cluster._check_folder(block(tmp_path, (0,)))
    cluster._check_folder(block(tmp_path))
    cluster._check_folder(block())


@pytest.mark.parametrize("address", ["localhost", "http://a:1", ""])
def test_what_is_no_cluster_is_told(address):
    with pytest.raises(ClusterError, match=r"no cluster .*: it is tcp://HOST:PORT"), connected(address, NOBODY):
        pass


def test_where_nobody_answers_it_is_told(monkeypatch):
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    with (
        pytest.raises(pool.CannotStart, match=r"no scheduler answers at tcp://127\.0\.0\.1:9 within 0\.2 s"),
        connected("tcp://127.0.0.1:9", NOBODY),
    ):
        pass


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "can't be read"),
        ("[1, 2]", "a mapping is wanted"),
        ("a: [", "is no YAML"),
        ("{jobs: 0}", "jobs is a number above 0, not 0"),
        ("{jobs: many}", "jobs is a number above 0, not 'many'"),
    ],
)
def test_a_bad_profile_is_named(tmp_path, text, why):
    path = tmp_path / "profile.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ClusterError, match=f"profile.yaml.*{why}"):
        profile_of(path)


def test_without_the_extra_it_is_told_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ClusterError, match=r"a cluster needs dask: pip install 'warehouse-radio-testbed\[cluster\]'"),
        connected("tcp://a:1", NOBODY),
    ):
        pass


# ---------------------------------------------------------------- Slurm

SBATCH = """#!/bin/sh
echo "$@" >> "{folder}/asked"
cp "$1" "{folder}/job.sh"  # as Slurm does: the script is taken away when sbatch returns
sh "{folder}/job.sh" > "{folder}/worker.log" 2>&1 &
echo $! >> "{folder}/pids"
echo "Submitted batch job 17"
"""


@pytest.mark.study
def test_slurm_is_asked_for_workers_by_a_profile(tmp_path, monkeypatch):
    for name, text in {"sbatch": SBATCH.format(folder=tmp_path), "scancel": "#!/bin/sh\nexit 0\n"}.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent / "fakes"))
    profile = tmp_path / "profile.yaml"
    profile.write_text(f"{{cores: 1, processes: 1, memory: 1GB, jobs: 1, wait_s: 90, interface: lo, local_directory: {tmp_path}}}\n")
    result = run(scenario(trials=12), cluster=f"slurm:{profile}", work=work)
    same(result.rows, run(scenario(trials=12), work=work).rows)
    assert len((tmp_path / "asked").read_text().splitlines()) == 1
