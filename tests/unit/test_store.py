"""The output folder: what it refuses, what it replaces, what a disk's complaint sounds like. Resuming is in test_batch.py."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest
from batch_fakes import scenario, work

from testbed import pool, store
from testbed.batch import run
from testbed.identity import Keys
from testbed.manifest import describe, differences, rebuilt, refused, short
from testbed.store import Store, StoreError, read_manifest, read_rows
from testbed.worker import BlockResult, Failure

MANIFEST = describe(scenario(), "none", ["testbed", "run"])
KEYS = Keys("w0", {"ekf": "e0"})
OTHER = Keys("w1", {"ekf": "e1"})


def result(trials=(0, 1, 2, 3), point=0):
    n = len(trials)
    rows = {"point": np.full(n, point), "trial": np.array(trials), "estimator": np.full(n, "ekf"), "x": np.linspace(0, 1, n)}
    failure = Failure(point, trials[0], "ekf", "estimate", "ValueError: ä\nb", "line 1\nline 2")
    return BlockResult(point, tuple(trials), rows, {}, {}, (failure,), ("a remark",))


def snapshot(folder):
    return {path.relative_to(folder): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


def refusing(code):
    def act(*args, **options):
        raise OSError(code, "said the system")

    return act


# ---------------------------------------------------------------- what is in it


def test_the_manifest_is_there_before_anything_else_and_says_what_runs(tmp_path):
    with Store(tmp_path / "a", MANIFEST):
        pass
    found = read_manifest(tmp_path / "a")
    assert found == json.loads(json.dumps(MANIFEST))
    assert {"scenario", "seed", "trials", "points", "estimators", "command", "versions", "platform"} <= set(found)
    assert set(found["versions"]) >= {"python", "numpy", "scipy", "pybullet", "testbed", "code"}


def test_a_scenario_comes_back_from_its_manifest():
    swept = scenario(sweep={"world.length_m": [5, 6]}, expect={"ekf": {"availability": {"min": 0.5}}})
    again = rebuilt(json.loads(json.dumps(describe(swept, "none"))))
    assert again.hash == swept.hash
    assert [p.scenario.hash for p in again.points()] == [p.scenario.hash for p in swept.points()]
    assert [claim.text for claim in again.expect] == [claim.text for claim in swept.expect]


def test_a_block_comes_back_as_it_was_put(tmp_path):
    with Store(tmp_path / "a", MANIFEST) as open_store:
        open_store.put([result()], KEYS, ["ekf"])
        found = open_store.find(0, (0, 1, 2, 3), KEYS).result
        assert open_store.find(0, (4, 5), KEYS).result is None
        assert open_store.find(0, (0, 1, 2, 3), OTHER).result is None
    assert found is not None
    assert (found.trials, found.failures, found.notes) == (result().trials, result().failures, result().notes)
    for name, column in result().rows.items():
        np.testing.assert_array_equal(found.rows[name], column)


def test_tables_are_in_order_of_point_and_trial_whatever_the_order_of_blocks(tmp_path):
    blocks = [(1, (0, 1)), (0, (4, 5)), (0, (0, 1, 2, 3))]
    with Store(tmp_path / "a", MANIFEST) as open_store:
        for point, trials in blocks:
            open_store.put([result(trials, point)], [KEYS, OTHER][point], ["ekf"])
        open_store.merge(blocks, [KEYS, OTHER])
    rows = read_rows(tmp_path / "a")
    assert list(zip(rows["point"].tolist(), rows["trial"].tolist(), strict=True)) == [(0, t) for t in range(6)] + [(1, 0), (1, 1)]
    assert read_rows(tmp_path / "a", "failures")["error"].tolist() == ["ValueError: ä\nb"] * 3


def test_tables_are_not_put_together_with_a_part_missing(tmp_path):
    with Store(tmp_path / "a", MANIFEST) as open_store:
        open_store.put([result()], KEYS, ["ekf"])
        with pytest.raises(StoreError, match="the results of point 0, trials 4 to 5 are missing"):
            open_store.merge([(0, (0, 1, 2, 3)), (0, (4, 5))], [KEYS])
    assert not (tmp_path / "a" / "trials.parquet").exists()


def test_wall_times_are_in_a_table_of_their_own(tmp_path):
    run(scenario(), out=tmp_path / "a", work=work)
    assert "seconds" in read_rows(tmp_path / "a", "timings")
    assert not any("second" in name for table in ("trials", "world", "failures") for name in read_rows(tmp_path / "a", table))


# ---------------------------------------------------------------- what it refuses


def test_results_are_not_overwritten_without_being_told_to(tmp_path):
    run(scenario(), out=tmp_path / "a", work=work)
    before = snapshot(tmp_path / "a")
    with pytest.raises(StoreError, match="holds results already: continue them with --resume, replace them with --force"):
        run(scenario(seed=9), out=tmp_path / "a", work=work)
    assert snapshot(tmp_path / "a") == before


def test_force_replaces_the_run_whole_and_leaves_what_is_not_of_it(tmp_path):
    run(scenario(trials=12), out=tmp_path / "a", work=work)
    (tmp_path / "a" / "notes.txt").write_text("mine")
    run(scenario(trials=5, seed=9), out=tmp_path / "a", force=True, work=work)
    assert set(read_rows(tmp_path / "a")["trial"]) == set(range(5))
    assert len(list((tmp_path / "a" / "parts").iterdir())) == 2
    assert (tmp_path / "a" / "notes.txt").read_text() == "mine"
    assert len((tmp_path / "a" / "log.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize("options", [{}, {"force": True}, {"resume": True}])
def test_a_folder_of_something_else_is_left_alone(tmp_path, options):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StoreError, match="is not empty and holds no run: choose another folder"):
        Store(tmp_path, MANIFEST, **options)
    assert snapshot(tmp_path) == {Path("thesis.tex"): b"years of work"}


def test_an_empty_folder_will_do_and_so_will_one_of_a_run_killed_before_it_began(tmp_path):
    Store(tmp_path, MANIFEST).close()
    (tmp_path / "manifest.json").replace(tmp_path / ".manifest.json.77.part")
    Store(tmp_path, MANIFEST).close()
    assert not list(tmp_path.glob(".*"))


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(StoreError, match="a is a file: choose another folder"):
        Store(tmp_path / "a", MANIFEST)
    with pytest.raises(StoreError, match=r"can't start a run in .*not a directory"):
        Store(tmp_path / "a" / "b", MANIFEST)


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS])
def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path, monkeypatch, code):
    monkeypatch.setattr(Path, "mkdir", refusing(code))
    with pytest.raises(
        StoreError, match=r"can't start a run in .*: it can't be written \(said the system\): choose another folder with --out"
    ):
        Store(tmp_path / "a", MANIFEST)


def test_a_full_disk_in_the_middle_keeps_what_was_finished(tmp_path, monkeypatch):
    written = store._write
    puts = []

    def filling(path, content):
        if path.parent.name == "parts" and len(puts) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        puts.extend([path] if path.parent.name == "parts" else [])
        written(path, content)

    monkeypatch.setattr(pool, "MOST_BLOCKS", 1)
    with monkeypatch.context() as patch:
        patch.setattr(store, "_write", filling)
        with pytest.raises(StoreError, match="the disk is full; what was finished is kept: free some space, then continue with --resume"):
            run(scenario(trials=20), out=tmp_path / "a", work=work)
    assert len(list((tmp_path / "a" / "parts").iterdir())) == 2
    resumed = run(scenario(trials=20), out=tmp_path / "a", resume=True, work=work)
    np.testing.assert_array_equal(resumed.rows["trial"], run(scenario(trials=20), work=work).rows["trial"])


def test_a_write_that_fails_half_way_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "x"
    store._write(path, b"old")
    monkeypatch.setattr(store.os, "fsync", refusing(errno.EIO))
    with pytest.raises(OSError, match="said the system"):
        store._write(path, b"new")
    assert snapshot(tmp_path) == {Path("x"): b"old"}


def test_two_runs_do_not_write_to_one_folder(tmp_path):
    with Store(tmp_path / "a", MANIFEST):
        for options in ({"resume": True}, {"force": True}):
            with pytest.raises(StoreError, match=r"another run is writing to .* at this moment"):
                Store(tmp_path / "a", MANIFEST, **options)
    Store(tmp_path / "a", MANIFEST, resume=True).close()


@pytest.mark.parametrize("reader", [read_manifest, read_rows])
def test_reading_what_is_no_run_says_so(tmp_path, reader):
    with pytest.raises(StoreError, match="there is no"):
        reader(tmp_path)


def test_a_damaged_table_is_named(tmp_path):
    run(scenario(), out=tmp_path / "a", work=work)
    (tmp_path / "a" / "trials.parquet").write_bytes(b"PAR1 and nothing more")
    with pytest.raises(StoreError, match=r"trials\.parquet: is no readable Parquet"):
        read_rows(tmp_path / "a")


# ---------------------------------------------------------------- sameness


def test_a_manifest_continues_itself_and_one_of_fewer_trials():
    assert differences(MANIFEST, MANIFEST) == ""
    assert differences(describe(scenario(trials=4), "all", ["other", "words"]), MANIFEST) == ""
    assert refused(describe(scenario(duration_s=4, estimators=("ukf",)), "all"), MANIFEST) == ""
    assert set(MANIFEST["written_by"]) == {short(MANIFEST["versions"])}


def test_everything_that_differs_is_in_the_sentence():
    other = describe(scenario(seed=1, duration_s=3, estimators=("ukf",)), "none")
    assert differences(MANIFEST, other) == "the scenario differs in duration_s, estimators; the seed was 3 and is 1"
    assert refused(MANIFEST, other) == "the seed was 3 and is 1"
