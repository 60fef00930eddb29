"""Whole studies of a scenario that ships: the same in one process and in two, again from the manifest, after a kill."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from testbed import archive
from testbed.batch import rerun, run
from testbed.keep import Keep, predict_size
from testbed.scenario import load
from testbed.store import StoreError, load_tracks, load_trial, read_rows

NAME, SETS = "empty-floor", {"trials": 6, "duration_s": 3}


def same(a, b):
    assert list(a) == list(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def figures(rows):
    """All but which code made them: somebody may be editing it between two processes."""
    return {name: column for name, column in rows.items() if name != "versions"}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("real") / "one"
    return run(load(NAME, SETS), out=folder, keep="first:2,worst:1")


def test_nothing_fails_and_every_row_is_there(study):
    assert not study.failures
    estimators = [section.id for section in study.scenario.estimators]
    assert list(zip(study.rows["trial"].tolist(), study.rows["estimator"].tolist(), strict=True)) == [
        (t, e) for t in range(6) for e in estimators
    ]


def test_two_processes_give_the_same_values_as_one(study, tmp_path):
    two = run(load(NAME, SETS), out=tmp_path / "two", jobs=2)
    same(two.rows, study.rows)
    assert (tmp_path / "two" / "trials.parquet").read_bytes() == (study.folder / "trials.parquet").read_bytes()
    assert (tmp_path / "two" / "world.parquet").read_bytes() == (study.folder / "world.parquet").read_bytes()


def test_any_trial_comes_out_again_from_the_manifest(study):
    again = rerun(study.folder, 0, 1)
    assert not again.failures
    same(again.rows, {name: column[study.rows["trial"] == 1] for name, column in study.rows.items()})
    kept = archive.place(study.folder, 0, 1)
    assert again.trial.truth.poses.tobytes() == load_trial(kept).truth.poses.tobytes()
    for id, track in load_tracks(kept).items():
        assert again.tracks[id].mean.tobytes() == track.mean.tobytes()


def test_a_trial_or_point_that_is_not_in_the_run_is_refused(study, tmp_path):
    with pytest.raises(ValueError, match="the run has 6 trials, counted from 0: there is no trial 6"):
        rerun(study.folder, 0, 6)
    with pytest.raises(ValueError, match="the run has 1 points, counted from 0: there is no point 1"):
        rerun(study.folder, 1, 0)
    with pytest.raises(StoreError, match="holds no run"):
        rerun(tmp_path, 0, 0)


def test_the_size_of_recordings_is_predicted_to_a_factor_of_three(study):
    kept = [path for path in (study.folder / "recordings").rglob("*") if path.is_file()]
    trials = len(list((study.folder / "recordings" / "point-0000").iterdir()))
    size = sum(path.stat().st_size for path in kept) / trials
    assert 1 / 3 < predict_size(study.scenario, Keep(first=1)) / size < 3


@pytest.mark.skipif(os.name != "posix", reason="kill -9")
def test_killed_and_resumed_by_the_command_equals_a_run_that_nothing_disturbed(study, tmp_path):
    out = tmp_path / "out"
    sets = [word for name, value in SETS.items() for word in ("--set", f"{name}={value}")]
    command = [sys.executable, "-m", "testbed", "run", NAME, *sets, "--jobs", "1", "--out", str(out)]
    victim = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while not list(out.glob("parts/*.zip")) and time.monotonic() < end:
        time.sleep(0.005)
    victim.kill()
    victim.wait()
    kept = len(list(out.glob("parts/*.zip")))  # one, unless this process was kept waiting
    assert kept
    finished = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=120, check=False)
    assert finished.returncode in (0, 1), finished.stderr
    assert f"{min(4 * kept, 6)} of them there already" in finished.stderr
    same(figures(read_rows(out)), figures(study.rows))
