"""Studies in real processes: the same figures in any number of them, and what is left when one of them is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from batch_fakes import figures, scenario, work

from testbed import manifest, pool
from testbed.batch import run
from testbed.scenario import ScenarioError
from testbed.store import read_rows

FAKES = str(Path(__file__).parent / "fakes")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and process groups of POSIX")

PROGRAM = """
import sys
sys.path.insert(0, {fakes!r})
from pathlib import Path
from batch_fakes import scenario, work
from testbed import manifest
from testbed.batch import Interrupted, run

manifest._digest = lambda packages: "-"
if {guard}:
    try:
        run(scenario(trials={trials}), out=Path({out!r}), jobs={jobs}, work=work)
    except Interrupted as stopped:
        print(stopped, file=sys.stderr)
        sys.exit(130)
"""


@pytest.fixture(autouse=True)
def _code_stands_still(monkeypatch):
    monkeypatch.setattr(manifest, "_digest", lambda packages: "-")  # these tests may run while somebody edits it


def same(a, b):
    assert list(a) == list(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def program(tmp_path, seconds=0.4, jobs=2, trials=24, guard="__name__ == '__main__'"):
    """A program that runs fake trials in a process group of its own."""
    path = tmp_path / "program.py"
    path.write_text(PROGRAM.format(fakes=FAKES, out=str(tmp_path / "out"), jobs=jobs, guard=guard, trials=trials))
    environment = {**os.environ, "FAKE_SECONDS": str(seconds)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, str(path)], env=environment, start_new_session=True, **pipes)


def parts(folder):
    return sorted((folder / "parts").glob("*.zip"))


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def children(pid):
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = path.read_text().partition(") ")
        except OSError:
            continue
        if rest.split()[1] == str(pid):
            found.append(int(name.split()[0]))
    return found


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().partition(") ")[2][0] != "Z"
    except OSError:
        return False


def test_two_processes_give_the_same_files_as_one(tmp_path):
    one = run(scenario(trials=18), out=tmp_path / "1", jobs=1, work=work)
    two = run(scenario(trials=18), out=tmp_path / "2", jobs=2, work=work)
    same(one.rows, two.rows)
    for table in ("trials", "world", "failures"):
        assert (tmp_path / "1" / f"{table}.parquet").read_bytes() == (tmp_path / "2" / f"{table}.parquet").read_bytes()


def test_a_worker_that_dies_costs_the_guilty_trial_alone(tmp_path):
    result = run(scenario(trials=7, title="die=3"), out=tmp_path / "a", jobs=2, work=work)
    assert [(f.trial, f.stage) for f in result.failures] == [(3, "worker")]
    assert result.failures[0].error.startswith("worker died")
    undisturbed = run(scenario(trials=7), out=None, work=work).rows
    kept = undisturbed["trial"] != 3
    same(result.rows, {name: column[kept] for name, column in undisturbed.items()})


def test_bad_input_found_in_a_worker_arrives_as_what_it_is():
    with pytest.raises(ScenarioError, match="world: there is no such thing in this world"):
        run(scenario(trials=12, title="input=5"), executors=pool.Workers, work=work)


def test_workers_have_one_thread_for_linear_algebra_and_this_process_has_its_own_back():
    before = os.environ.get("OMP_NUM_THREADS")
    with pool.one_thread_each(), pool.Workers(1) as workers:
        threads = workers.submit(os.getenv, "OMP_NUM_THREADS").result()
    assert threads == "1"
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_killed_in_the_middle_and_resumed_equals_a_run_that_nothing_disturbed(tmp_path):
    out = tmp_path / "out"
    victim = program(tmp_path)
    wait_for(lambda: len(parts(out)) >= 2)
    workers = children(victim.pid)
    victim.kill()
    victim.communicate()
    assert workers
    wait_for(lambda: not any(alive(pid) for pid in workers))  # they end with it
    kept = len(parts(out))
    assert 2 <= kept < 6
    assert not (out / "trials.parquet").exists()

    resumed = run(scenario(trials=24), out=out, resume=True, work=work)
    undisturbed = run(scenario(trials=24), out=None, work=work)
    same(resumed.rows, undisturbed.rows)
    same(read_rows(out), undisturbed.rows)
    assert not resumed.failures


def test_ctrl_c_keeps_what_is_done_and_ends_the_workers(tmp_path):
    out = tmp_path / "out"
    victim = program(tmp_path)
    wait_for(lambda: len(parts(out)) >= 1)
    workers = children(victim.pid)
    os.killpg(victim.pid, signal.SIGINT)  # as a terminal sends it: to the whole group
    printed, said = victim.communicate(timeout=30)
    assert victim.returncode == 130
    assert printed == ""
    assert said.strip().startswith(f"interrupted: {4 * len(parts(out))} of 24 trials are kept in")
    assert "Traceback" not in said
    wait_for(lambda: not any(alive(pid) for pid in workers), seconds=10)
    same(
        run(scenario(trials=24), out=out, resume=True, work=work).rows,
        run(scenario(trials=24), out=None, work=work).rows,
    )


def test_a_program_without_a_main_guard_is_told_so(tmp_path):
    _, said = program(tmp_path, seconds=0, trials=4, guard="True").communicate(timeout=60)
    assert "the worker processes can't start; a script that runs with more than one job must do so under" in said


def test_a_second_run_in_the_same_folder_is_refused_while_the_first_is_at_work(tmp_path):
    first = program(tmp_path, jobs=1)
    wait_for(lambda: len(parts(tmp_path / "out")) >= 1)
    with pytest.raises(Exception, match="another run is writing to"):
        run(scenario(trials=24), out=tmp_path / "out", resume=True, work=work)
    first.kill()
    first.communicate()


def test_the_fakes_are_what_they_seem():
    a, b = figures(1, 0, 2, "ekf"), figures(1, 0, 2, "ukf")
    assert (a["position_error_m.mean"] != b["position_error_m.mean"]).all()
