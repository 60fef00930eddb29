"""The demo's table is one and the same, whatever the number of processes, an interruption, or a kill."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pyarrow.parquet as pq
import pytest

pytestmark = pytest.mark.study
RUN = [sys.executable, "-m", "testbed", "run", "dock-gate", "--trials", "8", "--seed", "3", "--keep", "none", "--no-report"]


def assert_same_table(a, b):
    """Every column of both, bit for bit; NaN equals NaN."""
    one, two = (pq.read_table(folder / "trials.parquet") for folder in (a, b))
    assert one.schema.equals(two.schema)
    for name in one.column_names:
        np.testing.assert_array_equal(one[name].to_numpy(), two[name].to_numpy(), err_msg=name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The output folder of an uninterrupted run in one process."""
    folder = tmp_path_factory.mktemp("demo") / "one"
    subprocess.run([*RUN, "--jobs", "1", "--out", folder], check=True, capture_output=True)
    return folder


def test_one_process_and_two_give_identical_values(whole, tmp_path):
    subprocess.run([*RUN, "--jobs", "2", "--out", tmp_path / "two"], check=True, capture_output=True)
    assert_same_table(tmp_path / "two", whole)  # dynamic motion included
    assert pq.read_table(whole / "trials.parquet").num_rows == 8 * 3


def test_killed_in_the_middle_and_resumed_nothing_is_lost_or_doubled(whole, tmp_path):
    out = tmp_path / "killed"
    run = subprocess.Popen([*RUN, "--jobs", "2", "--out", out], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(out.glob("parts/*")) and time.monotonic() < deadline and run.poll() is None:
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert not (out / "trials.parquet").exists()  # it was in the middle
    subprocess.run([*RUN, "--jobs", "2", "--out", out, "--resume"], check=True, capture_output=True)
    assert_same_table(out, whole)
