"""Studies with figures that cost nothing: order, failures, resuming, worst trials. Real processes are in test_batch_processes.py."""

import errno
import json
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from batch_fakes import figures, scenario, work

from testbed import archive, pool, store
from testbed.batch import Interrupted, blocks_of, run
from testbed.scenario import ScenarioError
from testbed.store import StoreError, read_manifest, read_rows


@pytest.fixture(autouse=True)
def _nobody_pulls_the_plug(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # most of these tests' time otherwise
    monkeypatch.setattr(pool, "MOST_BLOCKS", 1)  # a file for each block


def study(out, one=None, **options):
    return run(one or scenario(), out=out, work=work, **options)


def same(a, b):
    assert list(a) == list(b)
    for name in a:
        assert a[name].dtype.kind == b[name].dtype.kind
        np.testing.assert_array_equal(a[name], b[name])


def once(rows):
    keys = list(zip(*(rows[name].tolist() for name in ("point", "trial", "estimator", "target")), strict=True))
    assert len(set(keys)) == len(keys)
    return set(keys)


def worked_on(path):
    return path.read_text().split("\n")[:-1] if path.exists() else []


def events(folder, name):
    return [line for line in map(json.loads, (folder / "log.jsonl").read_text().splitlines()) if line["event"] == name]


# ---------------------------------------------------------------- blocks and order


def test_blocks_are_of_four_and_more_trials_only_add_to_the_end():
    assert blocks_of(10) == [(0, 1, 2, 3), (4, 5, 6, 7), (8, 9)]
    assert blocks_of(12)[:2] == blocks_of(10)[:2]


def test_every_row_is_there_once_and_in_order(tmp_path):
    rows = study(tmp_path / "a").rows
    expected = [(t, e, g) for t in range(10) for e in ("ekf", "ukf") for g in ("tag1", "tag2")]
    assert list(zip(rows["trial"].tolist(), rows["estimator"].tolist(), rows["target"].tolist(), strict=True)) == expected
    assert rows["position_error_m.mean"][4] == figures(3, 0, 1, "ekf")["position_error_m.mean"][0]


def test_what_is_returned_is_what_is_written_and_what_a_run_without_a_folder_gives(tmp_path):
    written, bare = study(tmp_path / "a"), study(None)
    same(written.rows, read_rows(tmp_path / "a"))
    same(written.rows, bare.rows)
    same(written.world, bare.world)
    assert bare.folder is None


def test_an_executor_of_ones_own_gives_the_same_file(tmp_path):
    study(tmp_path / "a", scenario(trials=30))
    study(tmp_path / "b", scenario(trials=30), jobs=3, executors=ThreadPoolExecutor)
    for table in ("trials", "world", "failures"):
        assert (tmp_path / "a" / f"{table}.parquet").read_bytes() == (tmp_path / "b" / f"{table}.parquet").read_bytes()


def test_points_of_a_sweep_are_run_and_summarised_one_by_one(tmp_path):
    result = study(tmp_path / "a", scenario(trials=5, sweep={"world.length_m": [5, 6, 7]}))
    assert np.unique(result.rows["point"]).tolist() == [0, 1, 2]
    assert [point["set"] for point in result.document()["points"]] == [{"world.length_m": v} for v in (5, 6, 7)]
    assert all(set(point["estimators"]) == {"ekf", "ukf"} for point in result.document()["points"])


def test_the_document_is_json_and_says_whether_all_is_well(tmp_path):
    claim = {"ekf": {"position_error_m": {"mean": {"max": 1.0}}}, "world": {"line_of_sight": {"min": 0.4}}}
    metrics = [{"kind": "position_error"}, {"kind": "availability"}]
    result = study(tmp_path / "a", scenario(expect=claim, metrics=metrics))
    document = json.loads(json.dumps(result.document(), allow_nan=False))
    assert document["ok"] is result.ok is True
    assert [c["claim"] for c in document["expect"]] == ["ekf.position_error_m.mean <= 1", "world.line_of_sight >= 0.4"]
    assert document["points"][0]["estimators"]["ekf"]["position_error_m"]["n"] == 10
    assert document["points"][0]["world"] == {"line_of_sight": 0.5}


def test_a_claim_that_does_not_hold_is_not_ok(tmp_path):
    assert not study(None, scenario(expect={"ekf": {"position_error_m": {"mean": {"max": 0.0}}}})).ok


def test_a_number_of_jobs_below_one_and_nonsense_to_keep_are_refused(tmp_path):
    with pytest.raises(ValueError, match="jobs must be at least 1"):
        study(tmp_path / "a", jobs=0)
    with pytest.raises(ValueError, match="'some' does not say which recordings to keep"):
        study(tmp_path / "a", keep="some")
    assert not (tmp_path / "a").exists()


# ---------------------------------------------------------------- failures


def test_a_failed_trial_is_listed_and_the_rest_go_on(tmp_path):
    result = study(tmp_path / "a", scenario(title="fail=6"))
    assert not result.ok
    assert [(f.trial, f.stage, f.error) for f in result.failures] == [(6, "simulate", "ValueError: on request")]
    assert {key[1] for key in once(result.rows)} == set(range(10)) - {6}
    assert read_rows(tmp_path / "a", "failures")["traceback"].tolist() == ["a traceback"]
    assert events(tmp_path / "a", "failure")[0]["trial"] == 6
    assert result.summaries[0].statistics["availability"].n == 9


def test_a_run_in_which_everything_fails_still_ends_in_tables_and_failed_claims(tmp_path):
    one = scenario(trials=1, title="fail=0", expect={"ekf": {"availability": {"min": 0.1}}})
    result = study(tmp_path / "a", one)
    assert (len(result.failures), result.summaries, result.ok) == (1, (), False)
    assert "no value" in result.claims[0].note
    assert json.dumps(result.document(), allow_nan=False)
    assert read_rows(tmp_path / "a") == {}


def test_bad_input_found_by_a_worker_stops_the_run(tmp_path):
    with pytest.raises(ScenarioError, match="no such thing in this world"):
        study(tmp_path / "a", scenario(title="input=5"))


def test_interrupted_work_is_kept_and_the_message_says_how_to_go_on(tmp_path):
    with pytest.raises(Interrupted, match=r"interrupted: 4 of 10 trials are kept in .*; continue with --resume"):
        study(tmp_path / "a", scenario(title="interrupt=5"))
    assert len(list((tmp_path / "a" / "parts").iterdir())) == 1
    with pytest.raises(StoreError, match="not finished, --resume finishes it"):
        read_rows(tmp_path / "a")
    with pytest.raises(Interrupted, match="nothing is kept"):
        study(None, scenario(title="interrupt=5"))


# ---------------------------------------------------------------- resuming


@pytest.fixture
def whole(tmp_path):
    """The rows of a run that nothing disturbed."""
    return study(tmp_path / "whole").rows


def part(folder, trial):
    [path] = (folder / "parts").glob(f"trial-{trial:07d}-*.zip")
    return path


@pytest.fixture
def stopped(tmp_path, monkeypatch):
    """A run that stopped after its first two blocks, and the file that notes what is worked on from then on."""
    folder, noted = tmp_path / "stopped", tmp_path / "noted"
    study(folder)
    part(folder, 8).unlink()
    for table in ("trials", "world", "timings", "failures"):
        (folder / f"{table}.parquet").unlink()

    def noting(block):
        with noted.open("a") as file:
            file.writelines(f"{trial}\n" for trial in block.trials)
        return work(block)

    return folder, noted, noting


def test_resuming_makes_what_is_missing_and_nothing_else(stopped, whole):
    folder, noted, noting = stopped
    same(run(scenario(), out=folder, resume=True, work=noting).rows, whole)
    assert worked_on(noted) == ["8", "9"]


def test_resuming_what_is_finished_makes_nothing(stopped, whole):
    folder, noted, noting = stopped
    study(folder, resume=True)
    same(run(scenario(), out=folder, resume=True, work=noting).rows, whole)
    assert worked_on(noted) == []


@pytest.mark.parametrize(
    "damage",
    [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:2000] + bytes([b[2000] ^ 1]) + b[2001:], lambda b: b[:-1]],
    ids=["half", "empty", "one bit", "one byte short"],
)
def test_a_damaged_part_is_never_read_as_whole_and_runs_again(stopped, whole, damage):
    folder, noted, noting = stopped
    hit = part(folder, 4)
    hit.write_bytes(damage(hit.read_bytes()))
    same(run(scenario(), out=folder, resume=True, work=noting).rows, whole)
    assert worked_on(noted) == ["4", "5", "6", "7", "8", "9"]
    assert events(folder, "damaged part")[0]["part"] == hit.name


def test_a_part_is_what_it_holds_and_not_what_it_is_called(stopped, whole):
    folder, noted, noting = stopped
    part(folder, 0).replace(part(folder, 4))
    same(run(scenario(), out=folder, resume=True, work=noting).rows, whole)
    assert sorted(map(int, worked_on(noted))) == list(range(4, 10))


def test_files_left_half_written_are_swept_away(stopped, whole):
    folder, _, _ = stopped
    (folder / "parts" / ".trial-0000008-0000009.0123.zip.123.part").write_bytes(b"half")
    rough = folder / "recordings" / "point-0000" / ".trial-000001.99.part"
    (rough / "truth").mkdir(parents=True)
    same(study(folder, resume=True).rows, whole)
    assert not list(folder.rglob("*.part"))


def test_an_interrupted_merge_is_made_up_for(stopped, whole, monkeypatch):
    folder, noted, noting = stopped
    written = store._write

    def full(path, content):
        if path.name == "world.parquet":
            raise OSError(errno.ENOSPC, "No space left on device")
        written(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(store, "_write", full)
        with pytest.raises(StoreError, match="the disk is full; what was finished is kept: free some space, then continue with --resume"):
            run(scenario(), out=folder, resume=True, work=noting)
    noted.unlink()
    same(run(scenario(), out=folder, resume=True, work=noting).rows, whole)
    assert worked_on(noted) == []


def test_more_trials_extend_a_run_and_equal_one_that_had_them_from_the_start(stopped, tmp_path):
    folder, noted, noting = stopped
    study(folder, resume=True)
    extended = run(scenario(trials=18), out=folder, resume=True, work=noting)
    same(extended.rows, study(tmp_path / "long", scenario(trials=18)).rows)
    assert sorted(map(int, worked_on(noted))) == list(range(8, 18))  # the last block had two trials, and has four now
    assert read_manifest(folder)["trials"] == 18


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (scenario(seed=4), "the seed was 3 and is 4"),
        (scenario(name="other"), "it is of the scenario fake, not of other"),
    ],
    ids=["seed", "name"],
)
def test_another_study_is_not_continued_and_the_reason_is_given(stopped, other, why):
    folder, _, _ = stopped
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(StoreError, match=f"can't be continued: {why}"):
        study(folder, other, resume=True)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_expectations_may_change_between_run_and_resume(stopped):
    folder, _, _ = stopped
    result = study(folder, scenario(expect={"ekf": {"availability": {"min": 0.5}}}), resume=True)
    assert [claim.ok for claim in result.claims] == [True]


@pytest.mark.parametrize("content", ["{", "[]", '{"format": 2}', '{"format": 1, "scenario": {}}'])
def test_a_damaged_manifest_is_not_continued(stopped, content):
    folder, _, _ = stopped
    (folder / "manifest.json").write_text(content)
    with pytest.raises(StoreError, match=r"can't be continued: (its manifest\.json is damaged|it was written by another version)"):
        study(folder, resume=True)


def test_resuming_where_nothing_is_begins_there(tmp_path, whole):
    same(study(tmp_path / "new", resume=True).rows, whole)


# ---------------------------------------------------------------- recordings


def recorded(folder, point=0):
    return sorted(int(path.name[6:]) for path in (folder / "recordings" / f"point-{point:04d}").glob("trial-*"))


def test_the_first_are_kept_unless_told_otherwise(tmp_path):
    study(tmp_path / "a")
    assert recorded(tmp_path / "a") == [0]
    study(tmp_path / "b", keep="none")
    assert recorded(tmp_path / "b") == []
    study(tmp_path / "c", keep="all")
    assert recorded(tmp_path / "c") == list(range(10))


def test_the_worst_are_known_at_the_end_and_made_again(tmp_path):
    result = study(tmp_path / "a", keep="worst:3")
    error = {t: figures(3, 0, t, "ekf")["position_error_m.mean"].mean() for t in range(10)}
    assert recorded(tmp_path / "a") == sorted(sorted(error, key=lambda t: -error[t])[:3])
    same(result.rows, study(None).rows)
    noted = []
    run(scenario(), out=tmp_path / "a", keep="worst:3", resume=True, work=lambda block: noted.append(block) or work(block))
    assert not noted


def test_a_recording_that_has_gone_is_made_again_and_one_that_cannot_be_is_not_waited_for(tmp_path):
    folder = tmp_path / "a"
    one = scenario(title="fail=1")
    study(folder, one, keep="first:2")
    assert recorded(folder) == [0]
    archive.place(folder, 0, 0).rmdir()
    noted = []
    run(one, out=folder, keep="first:2", resume=True, work=lambda block: noted.append(block.trials) or work(block))
    assert (recorded(folder), noted) == ([0], [(0, 1, 2, 3)])
    run(one, out=folder, keep="first:2", resume=True, work=lambda block: noted.append(block.trials) or work(block))
    assert len(noted) == 1


def test_recordings_that_would_not_fit_are_refused_before_the_start(tmp_path, monkeypatch):
    monkeypatch.setattr(store.Store, "free_bytes", lambda self: 1000)
    with pytest.raises(StoreError, match=r"need about 0\.0 GB, 0\.0 GB are free: keep fewer with --keep"):
        study(tmp_path / "a", keep="all")
    study(tmp_path / "b", keep="none")
