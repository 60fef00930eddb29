"""A million reads of a log before any estimator: against csv.DictReader, which only cuts the same file into cells."""

import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from testbed.logs import read_log
from testbed.logs.site import checked_site

READS = 1_000_000
SITE = {
    "log": {"kind": "sllurp_csv"},
    "region": "fcc",
    "antennas": [{"id": f"a{i}", "port": i, "position_m": [i, 0, 1]} for i in range(1, 5)],
}
MOST_MB = 400  # that reading may add to the process: the file is 80 MB, the columns are 50


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "million.csv"
    random = np.random.default_rng(1)
    t = 1_700_000_000_000_000 + np.cumsum(random.integers(100, 3000, READS))
    columns = (
        t,
        random.integers(1, 5, READS),
        -random.integers(40, 80, READS),
        random.integers(0, 200, READS),
        random.integers(0, 4096, READS),
    )
    with path.open("w") as file:
        file.write("timestamp,reader,antenna,rssi,epc,phase_angle,channel_index\n")
        file.writelines(
            f"{t},r1,{a},{s}.5,b'3008{e:020x}',{p},{1 + p % 50}\n" for t, a, s, e, p in zip(*(c.tolist() for c in columns), strict=True)
        )
    return path


@pytest.mark.benchmark
def test_a_million_reads_twice_as_fast_as_cutting_them_into_cells(log, benchmark):
    begun = time.perf_counter()
    found = benchmark.pedantic(read_log, (log, checked_site(SITE)), rounds=1, iterations=1)
    ours = time.perf_counter() - begun
    begun = time.perf_counter()
    with log.open(newline="") as file:
        rows = sum(1 for _ in csv.DictReader(file))
    theirs = time.perf_counter() - begun
    benchmark.extra_info.update(reads_per_s=round(READS / ours), dict_reader_per_s=round(READS / theirs))
    assert len(found.reads) == rows == READS
    assert theirs / ours > 1.5


PEAK = """
import json, re, sys
from testbed.logs import read_log
from testbed.logs.site import checked_site
from testbed.logs.formats import sllurp_csv
site = checked_site(json.loads(sys.argv[2]))
peak = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read()).group(1))
before = peak()
read_log(sys.argv[1], site)
print((peak() - before) / 1024)
"""


@pytest.mark.benchmark
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of a process's memory is read from /proc")
def test_what_a_million_reads_take_in_memory_is_bounded(log, benchmark):
    done = subprocess.run([sys.executable, "-c", PEAK, str(log), json.dumps(SITE)], capture_output=True, text=True, check=True)
    benchmark.pedantic(lambda: None, rounds=1)
    benchmark.extra_info.update(more_mb=round(float(done.stdout)))
    assert float(done.stdout) < MOST_MB
