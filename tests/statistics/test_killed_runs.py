"""A run killed at any moment, from its first file to its last table, and gone on with: the same tables, and nothing left half made."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from batch_fakes import scenario, work

from testbed import identity, manifest, pool
from testbed.batch import run

FAKES = Path(__file__).parents[1] / "unit" / "fakes"
PARTS = 12  # of 24 blocks, two in a task

PROGRAM = """
import sys
sys.path.insert(0, {fakes!r})
from pathlib import Path
from batch_fakes import scenario, work
from testbed import identity, manifest, pool
from testbed.batch import run

manifest._digest = lambda packages: "-"
identity.sources = lambda roots: "-"
pool.MOST_BLOCKS = 2
if __name__ == "__main__":
    one = scenario(trials=48, sweep={{"duration_s": [1, 2]}})
    run(one, out=Path({out!r}), jobs={jobs}, keep="first:2,worst:2", work=work)
"""


@pytest.fixture(autouse=True)
def _code_stands_still(monkeypatch):
    """As in the program: somebody may be editing it."""
    monkeypatch.setattr(manifest, "_digest", lambda packages: "-")
    monkeypatch.setattr(identity, "sources", lambda roots: "-")
    monkeypatch.setattr(pool, "MOST_BLOCKS", 2)


def begun(folder, jobs):
    """A run of 96 trials of 15 ms in a process of its own, in `folder`/out."""
    folder.mkdir()
    path = folder / "program.py"
    path.write_text(PROGRAM.format(fakes=str(FAKES), out=str(folder / "out"), jobs=jobs))
    environment = {**os.environ, "FAKE_SECONDS": "0.015"}
    return subprocess.Popen([sys.executable, str(path)], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def finished(folder, resume):
    one = scenario(trials=48, sweep={"duration_s": [1, 2]})
    return run(one, out=folder, keep="first:2,worst:2", resume=resume, work=work)


def tables(folder):
    """All that a run leaves, wall times aside, to the last bit."""
    found = {name: (folder / f"{name}.parquet").read_bytes() for name in ("trials", "world", "failures")}
    return found | {"recordings": sorted(str(p.relative_to(folder)) for p in (folder / "recordings").rglob("trial-*"))}


@pytest.mark.study
@pytest.mark.skipif(os.name != "posix", reason="kill -9")
def test_killed_at_ten_random_moments_and_gone_on_with_it_is_the_same(tmp_path, capsys):
    """The moments are counted in what is done by then, so that a busy machine is killed as early or late as an idle one."""
    moments = random.Random(20)
    finished(tmp_path / "whole", resume=False)
    expected = tables(tmp_path / "whole")
    kept = []
    for i in range(10):
        wanted, then = moments.randrange(-1, PARTS + 1), moments.random() * 0.08
        home = tmp_path / f"run{i}"
        victim = begun(home, jobs=1 + i % 2)
        while victim.poll() is None and not (home / "out" / "manifest.json").exists():
            time.sleep(0.002)
        while victim.poll() is None and len(list((home / "out" / "parts").glob("*.zip"))) < wanted:
            time.sleep(0.002)
        time.sleep(then)
        victim.kill()
        victim.wait()
        kept.append(len(list((home / "out" / "parts").glob("*.zip"))))
        again = finished(home / "out", resume=True)
        assert tables(home / "out") == expected, i
        assert not again.failures
        assert not list((home / "out").rglob("*.part"))
    with capsys.disabled():
        print(f"\nkilled with so many parts kept: {kept}")  # noqa: T201
    assert len(np.unique(kept)) > 3  # the moments were not all alike
