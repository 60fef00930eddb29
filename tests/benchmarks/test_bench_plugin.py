"""What the pytest plug-in costs those who don't use it: a run of pytest with it against one without it."""

import resource
import subprocess
import sys

import pytest

ALLOWED_S = 0.050
ROUNDS = 15
LEAN = ("-p", "no:benchmark", "-p", "no:hypothesispytest", "-p", "no:xdist")  # others' time would hide what is looked for


def _pytest(folder, *options):
    """Processor time in s of a run of one empty test, in a process of its own: wall time varies by more than what is looked for."""
    before = _spent()
    subprocess.run([sys.executable, "-m", "pytest", "-q", *LEAN, *options], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return _spent() - before


def _spent():
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


@pytest.mark.benchmark
def test_the_plug_in_adds_at_most_50_ms_to_a_run_without_scenarios(benchmark, tmp_path):
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_nothing.py").write_text("def test_nothing(): pass\n")
    (tmp_path / "some.yaml").write_text("a: 1\n")
    without = ("-p", "no:testbed")
    for options in ((), without):  # let both have their caches
        _pytest(tmp_path, *options)
    found = [(_pytest(tmp_path), _pytest(tmp_path, *without)) for _ in range(ROUNDS)]
    here, peer = (min(times) for times in zip(*found, strict=True))  # whatever else the machine does only adds
    benchmark.extra_info["peer"] = "pytest -p no:testbed"
    benchmark.extra_info["added_ms"] = round(1000 * (here - peer), 1)
    benchmark.extra_info["ratio"] = round(here / peer, 3)
    benchmark.pedantic(_pytest, args=(tmp_path,), rounds=3)
    assert here - peer <= ALLOWED_S
