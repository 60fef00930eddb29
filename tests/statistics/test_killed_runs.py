"""A run killed at any moment, from its first import to its last table, and gone on with: the same tables, and nothing done twice."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

FAKES = Path(__file__).parents[1] / "unit" / "fakes"

PROGRAM = """
import os, sys
sys.path.insert(0, {fakes!r})
from pathlib import Path
from batch_fakes import scenario, work
from testbed import manifest, identity
from testbed.batch import run

manifest._digest = lambda packages: "-"
identity.sources = lambda roots: "-"
if __name__ == "__main__":
    Path({out!r}).parent.joinpath("begun").touch()
    run(scenario(trials=48, sweep={{"duration_s": [1, 2]}}), out=Path({out!r}), jobs=2, keep="first:2,worst:2", resume=True, work=work)
    Path({out!r}).parent.joinpath("done").touch()
"""


def begin(folder, name, seconds):
    path = folder / f"{name}.py"
    path.write_text(PROGRAM.format(fakes=str(FAKES), out=str(folder / name / "out")))
    (folder / name).mkdir(exist_ok=True)
    environment = {**os.environ, "FAKE_SECONDS": str(seconds)}
    return subprocess.Popen([sys.executable, str(path)], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def tables(folder):
    names = ("trials", "world", "failures")
    return {name: (folder / f"{name}.parquet").read_bytes() for name in names} | {
        "recordings": sorted(str(p.relative_to(folder)) for p in (folder / "recordings").rglob("trial-*"))
    }


@pytest.mark.study
@pytest.mark.skipif(os.name != "posix", reason="kill -9")
def test_killed_at_ten_random_moments_and_gone_on_with_it_is_the_same(tmp_path, capsys):
    moments = random.Random(20)
    whole = begin(tmp_path, "whole", 0.01)
    started = time.monotonic()
    while not (tmp_path / "whole" / "begun").exists():
        assert whole.poll() is None, whole.stderr.read().decode()
        time.sleep(0.01)
    began = time.monotonic()
    assert whole.wait(timeout=300) == 0
    length, lead = time.monotonic() - began, began - started
    expected = tables(tmp_path / "whole" / "out")
    kept = []
    for i in range(10):
        victim = begin(tmp_path, f"run{i}", 0.01)
        time.sleep(lead + moments.random() * length)
        victim.kill()
        victim.communicate()
        out = tmp_path / f"run{i}" / "out"
        kept.append(len(list(out.glob("parts/*.zip"))))
        again = begin(tmp_path, f"run{i}", 0)
        assert again.wait(timeout=300) == 0, again.stderr.read().decode()
        assert tables(out) == expected, i
        assert not list(out.rglob("*.part"))
    with capsys.disabled():
        print(f"\na run of {length:.1f} s was killed with so many parts kept: {kept}")  # noqa: T201
    assert len(np.unique(kept)) > 2  # the moments were not all alike
