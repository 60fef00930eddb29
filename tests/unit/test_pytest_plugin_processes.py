import importlib.util
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from small_scenario import EXPECT, SMALL

from testbed.pytest_nodes import Outcome, _once
from testbed.scenario import find, load

pytest_plugins = ["pytester"]

SENTENCE = r"one\.yaml:22: centroid\.position_error_m\.p95: got \d\.\d\d, want <= 0\.01 \(95 % interval -?\d+\.\d\d(-| to )\d+\.\d\d\)"
OTHERS = ("-p", "no:benchmark", "-p", "no:hypothesispytest", "-p", "no:xdist")


def test_breaking_a_claim_of_the_demo_fails_at_its_line_with_the_measured_value(pytester):
    demo = find("demo/dock-gate")
    claim = next(c for c in load(demo).expect if c.subject == "ekf" and c.bound == "max")
    lines = demo.read_text().splitlines()
    broken = lines[claim.line - 1].replace(f"{{max: {claim.value:g}}}", "{max: 0.001}", 1)
    assert broken != lines[claim.line - 1]
    lines[claim.line - 1] = broken
    (pytester.mkdir("demo") / "dock.yaml").write_text("\n".join(lines))
    pytester.makefile(".ini", pytest="[pytest]\ntestbed_scenarios = demo\n")
    result = pytester.runpytest_subprocess(*OTHERS, "--testbed-trials=2", "-k", claim.column)
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    figure = claim.text.partition(" ")[0].replace(".", r"\.")
    number = r"\d+\.\d{3}"
    result.stdout.re_match_lines([rf"^demo/dock\.yaml:{claim.line}: {figure}: got {number}, want <= 0\.001 \(95 % interval .*\)$"])


def test_the_scenarios_of_the_house_are_collected_by_its_own_settings():
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "scenarios"]
    ids = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.splitlines()
    files = {id.partition("::")[0] for id in ids if "::" in id and not id.endswith("::runs")}
    house = [f"scenarios/{folder}/{path.name}" for folder in ("demo", "smoke") for path in (root / "scenarios" / folder).glob("*.yaml")]
    assert files >= set(house)
    assert {Path(name).stem for name in files} >= {"dock-gate", "aisle-forklift", "empty-floor", "parked-only", "silent-tags"}


NOTE_RUNS = """
import os
from testbed import batch
run = batch.run

def counted(scenario, **options):
    with open("runs.txt", "a") as file:
        file.write(f"{scenario.name} {os.getpid()}\\n")
    return run(scenario, **options)

batch.run = counted
"""

# a worker alone on a busy machine could take all items before the other one is up
WAIT_FOR_BOTH = """
import os, pathlib, time

def pytest_collection_finish(session):
    if worker := os.environ.get("PYTEST_XDIST_WORKER"):
        pathlib.Path(f"up-{worker}").touch()

def pytest_runtest_setup(item):
    end = time.monotonic() + 60
    while len(list(pathlib.Path().glob("up-*"))) < 2 and time.monotonic() < end:
        time.sleep(0.01)
"""


@pytest.mark.skipif(importlib.util.find_spec("xdist") is None, reason="pytest-xdist is not installed")
@pytest.mark.parametrize(
    "dist", ["load", *(pytest.param(d, marks=pytest.mark.study) for d in ("each", "loadgroup", "loadscope", "loadfile", "worksteal"))]
)
def test_under_xdist_each_scenario_runs_once(pytester, dist):
    pytester.makefile(".ini", pytest="[pytest]\ntestbed_scenarios = scenarios\n")
    folder = pytester.mkdir("scenarios")
    for name in ("one", "two"):
        (folder / f"{name}.yaml").write_text((SMALL + EXPECT).replace("name: small", f"name: {name}"))
    pytester.makeconftest(NOTE_RUNS + WAIT_FOR_BOTH)
    temporary = pytester.mkdir("temporary")
    pytester._monkeypatch.setenv("TMPDIR", str(temporary))
    spread = ("--maxschedchunk=1",) if dist == "load" else ()
    result = pytester.runpytest_subprocess("-n2", f"--dist={dist}", *spread, "-v")
    each = 2 if dist == "each" else 1
    result.assert_outcomes(passed=6 * each, failed=2 * each)
    assert sorted(line.split()[0] for line in (pytester.path / "runs.txt").read_text().splitlines()) == ["one", "two"]
    result.stdout.re_match_lines([f".*{SENTENCE}"])
    assert {line[:5] for line in result.outlines if line.startswith("[gw")} == {"[gw0]", "[gw1]"}
    assert not list(temporary.glob("testbed-*"))


def test_one_of_several_runs_and_the_others_wait_and_read(tmp_path):
    ran, start = [], threading.Barrier(4)

    def run():
        ran.append(1)
        time.sleep(0.1)
        return Outcome(trouble="as it was")

    def worker(_):
        start.wait()
        return _once(tmp_path, "dock.yaml", run)

    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(worker, range(4)))
    assert found == [Outcome(trouble="as it was")] * 4
    assert ran == [1]
    assert _once(tmp_path, "other.yaml", lambda: Outcome()) == Outcome()


def test_a_run_that_was_broken_off_is_made_by_the_next(tmp_path):
    def broken():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _once(tmp_path, "dock.yaml", broken)
    assert _once(tmp_path, "dock.yaml", lambda: Outcome(trouble="whole")) == Outcome(trouble="whole")


LIST_MODULES = """
import sys

def pytest_sessionfinish():
    with open("modules.txt", "w") as file:
        file.write("\\n".join(sys.modules))
"""


def test_a_run_that_collects_no_scenario_imports_nothing_but_the_plug_in(pytester):
    pytester.makefile(".ini", pytest="[pytest]\ntestbed_scenarios = scenarios\n")
    (pytester.mkdir("scenarios") / "notes.txt").write_text("none yet")
    (pytester.path / "some.yaml").write_text("a: 1")
    pytester.makeconftest(LIST_MODULES)
    loaded = []
    for options in ((), ("-p", "no:testbed")):
        pytester.runpytest_subprocess("-W", "ignore", *options)
        loaded.append(set(Path("modules.txt").read_text().split()))
    added = {name for name in loaded[0] - loaded[1] if name.partition(".")[0] not in sys.stdlib_module_names}
    assert added == {"testbed", "testbed.pytest_plugin"}
