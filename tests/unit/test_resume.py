"""Going on by content: what is done stays done, what changed is run again, whatever it is that changed."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from batch_fakes import scenario, work

from testbed import archive, identity, pool, worker
from testbed.api import scenario_of
from testbed.batch import run
from testbed.identity import keys_of, sources
from testbed.scenario import from_dict, load
from testbed.store import read_manifest, read_rows

LIBRARIES = {"numpy": "2"}


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    monkeypatch.setattr(pool, "MOST_BLOCKS", 1)


@pytest.fixture
def noting():
    """The work of the fakes, and what it was asked for: (point, first trial, estimators)."""
    seen = []

    def noted(block):
        seen.append((block.point, block.trials[0], block.only))
        return work(block)

    noted.seen = seen
    return noted


def same(a, b):
    assert list(a) == list(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def go_on(folder, one, noting, keep="none"):
    """Resume as `one`: the same tables as a run from scratch, of which only `noting.seen` was worked on."""
    noting.seen.clear()
    found = run(one, out=folder, resume=True, keep=keep, work=noting)
    fresh = run(one, work=work)
    same(found.rows, fresh.rows)
    same(found.world, fresh.world)
    same(read_rows(folder), fresh.rows)
    return noting.seen


# ---------------------------------------------------------------- scenarios


def test_an_estimator_that_is_added_runs_alone(tmp_path, noting):
    run(scenario(), out=tmp_path, keep="none", work=work)
    three = scenario(estimators=("ekf", "new", "ukf"))
    assert go_on(tmp_path, three, noting) == [(0, t, ("new",)) for t in (0, 4, 8)]
    assert go_on(tmp_path, three, noting) == []


def test_an_estimator_that_is_set_otherwise_runs_alone_and_set_back_is_found_again(tmp_path, noting):
    def tuned(sigma):
        return from_dict({**scenario().document, "estimators": [{"id": "ekf", "kind": "ekf", "sigma_db": sigma}, {"kind": "ukf"}]})

    run(tuned(2), out=tmp_path, keep="none", work=work)
    assert go_on(tmp_path, tuned(3), noting) == [(0, t, ("ekf",)) for t in (0, 4, 8)]
    assert go_on(tmp_path, tuned(2), noting) == []


def test_another_order_of_estimators_is_another_order_of_rows_and_no_work(tmp_path, noting):
    run(scenario(), out=tmp_path, keep="none", work=work)
    assert go_on(tmp_path, scenario(estimators=("ukf", "ekf")), noting) == []
    assert go_on(tmp_path, scenario(estimators=("ukf",)), noting) == []


def test_what_changes_the_trials_runs_all_again(tmp_path, noting):
    run(scenario(), out=tmp_path, keep="none", work=work)
    assert go_on(tmp_path, scenario(duration_s=2), noting) == [(0, t, None) for t in (0, 4, 8)]


def test_a_sweep_may_grow_in_the_middle_and_its_recordings_follow(tmp_path, noting):
    run(scenario(trials=4, sweep={"duration_s": [1, 3]}), out=tmp_path, keep="first:1", work=work)
    mark = archive.place(tmp_path, 1, 0) / "mark"
    mark.touch()
    grown = scenario(trials=4, sweep={"duration_s": [1, 2, 3]})
    assert go_on(tmp_path, grown, noting, keep="first:1") == [(1, 0, None)]
    assert (archive.place(tmp_path, 2, 0) / "mark").exists()
    assert not (archive.place(tmp_path, 1, 0) / "mark").exists()
    less = scenario(trials=4, sweep={"duration_s": [3]})
    assert go_on(tmp_path, less, noting, keep="first:1") == []
    assert (archive.place(tmp_path, 0, 0) / "mark").exists()
    assert len(list((tmp_path / "recordings").iterdir())) == 1


def test_fewer_trials_are_a_smaller_table_and_the_others_are_found_again(tmp_path, noting):
    run(scenario(trials=12), out=tmp_path, keep="none", work=work)
    assert go_on(tmp_path, scenario(trials=8), noting) == []
    assert go_on(tmp_path, scenario(trials=12), noting) == []


def test_a_block_with_a_recording_is_not_made_by_halves(tmp_path, noting):
    run(scenario(), out=tmp_path, keep="first:1", work=work)
    stale = archive.place(tmp_path, 0, 5)  # as if it had failed
    stale.mkdir()
    added = scenario(estimators=("ekf", "ukf", "new"))
    assert go_on(tmp_path, added, noting, keep="first:1") == [(0, 0, None), (0, 4, None), (0, 8, ("new",))]
    assert not stale.exists()


def test_a_trial_whose_worker_died_is_tried_again(tmp_path, noting):
    def dying(block):
        result = work(block)
        return replace(result, failures=tuple(replace(f, stage="worker") for f in result.failures))

    died = run(scenario(title="fail=5"), out=tmp_path, keep="none", work=dying)
    assert [f.stage for f in died.failures] == ["worker"]
    again = run(scenario(title="fail=5"), out=tmp_path, keep="none", resume=True, work=noting)
    assert noting.seen == [(0, 4, None)]
    assert [f.stage for f in again.failures] == ["simulate"]  # which is the trial's own fault
    assert go_on(tmp_path, scenario(title="fail=5"), noting) == []


# ---------------------------------------------------------------- code


@pytest.fixture
def code(monkeypatch):
    """Lets the sources of a module change: code("estimators.ekf") from then on."""
    read = identity._read
    touched = set()

    def changed(path, name):
        digest, imported = read(path, name)
        return (digest + "changed" if name in touched else digest), imported

    def touch(*names):
        touched.clear()
        touched.update(names)
        sources.cache_clear()

    monkeypatch.setattr(identity, "_read", changed)
    yield touch
    sources.cache_clear()


def test_changed_code_of_an_estimator_runs_that_one_again(tmp_path, noting, code):
    def two():
        return from_dict({**scenario().document, "estimators": [{"kind": "ekf"}, {"kind": "centroid"}]})

    run(two(), out=tmp_path, keep="none", work=work)
    code("estimators.centroid")
    assert go_on(tmp_path, two(), noting) == [(0, t, ("centroid",)) for t in (0, 4, 8)]
    code("estimators.centroid", "testbed.report.page", "testbed.cli", "testbed.batch")
    assert go_on(tmp_path, two(), noting) == []
    code("estimators.centroid", "worlds.open_floor")
    assert go_on(tmp_path, two(), noting) == [(0, t, None) for t in (0, 4, 8)]


@pytest.mark.parametrize(
    ("module", "changes"),
    [
        ("testbed.report.page", set()),
        ("testbed.cli", set()),
        ("estimators.grid", set()),
        ("estimators.ukf", {"ukf"}),
        ("estimators.kalman", {"ekf", "ukf"}),
        ("testbed.estimate", {"ekf", "ukf", "centroid"}),
        ("testbed.metrics.position_error", {"ekf", "ukf", "centroid"}),
        ("testbed.radio.coupling", {"ekf", "ukf", "centroid", "world"}),
        ("worlds.dock_gate", {"ekf", "ukf", "centroid", "world"}),
    ],
)
def test_a_module_changes_the_keys_of_what_rests_on_it(code, module, changes):
    demo = load("dock-gate")
    before = keys_of(demo, LIBRARIES)
    code(module)
    after = keys_of(demo, LIBRARIES)
    found = {id for id in before.estimators if before.estimators[id] != after.estimators[id]}
    assert found | ({"world"} if before.world != after.world else set()) == changes


def test_a_guided_scenarios_estimators_stand_and_fall_together(code):
    guided = load("handheld-table1")
    before = keys_of(guided, LIBRARIES)
    assert set(before.estimators.values()) == {before.world}
    code("testbed.closed_loop")
    assert keys_of(guided, LIBRARIES).world != before.world


def test_a_title_and_what_is_expected_change_no_key():
    plain = keys_of(scenario(), LIBRARIES)
    other = keys_of(scenario(title="a=1", trials=3, expect={"ekf": {"availability": {"min": 0.5}}}), LIBRARIES)
    assert (plain.world, plain.estimators) == (other.world, other.estimators)


def test_another_library_is_another_key():
    assert keys_of(load("dock-gate"), {"numpy": "2"}) != keys_of(load("dock-gate"), {"numpy": "3"})


def test_imports_are_found_wherever_they_stand(tmp_path, monkeypatch):
    package = tmp_path / "keyed"
    package.mkdir()
    texts = {
        "__init__": "def late():\n    from keyed import unused\n",
        "root": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from keyed import typed\nelse:\n    from . import plain\n",
        "plain": "def f():\n    try:\n        import keyed.deep as d\n    except ImportError:\n        from keyed.other import thing\n",
        **dict.fromkeys(("deep", "other", "typed", "unused"), "x = 1\n"),
    }
    for name, text in texts.items():
        (package / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    before = sources(("keyed.root",))
    for name, counts in {"deep": True, "other": True, "plain": True, "typed": False, "unused": False}.items():
        path = package / f"{name}.py"
        path.write_text(texts[name] + "y = 2\n")
        _forget()
        assert (sources(("keyed.root",)) != before) is counts, name
        path.write_text(texts[name])
        _forget()
    sys.modules.pop("keyed", None)


def _forget():
    for remembered in (identity.sources, identity._read, identity._path):
        remembered.cache_clear()


# ---------------------------------------------------------------- real ones, and rows


def test_a_real_study_goes_on_with_another_estimator_as_if_it_had_been_there(tmp_path):
    sets = {"trials": 5, "duration_s": 2}
    one = load("empty-floor", sets)
    run(scenario_of(one, estimators=["ukf"]), out=tmp_path / "a", keep="none")
    worker.close()
    grown = run(one, out=tmp_path / "a", keep="none", resume=True)
    fresh = run(one, out=tmp_path / "b", keep="none")
    same(grown.rows, fresh.rows)
    same(grown.world, fresh.world)
    assert (tmp_path / "a" / "trials.parquet").read_bytes() == (tmp_path / "b" / "trials.parquet").read_bytes()


def test_rows_say_which_versions_made_them_and_the_manifest_what_these_are(tmp_path):
    result = run(load("empty-floor", {"trials": 1, "duration_s": 1}), out=tmp_path, keep="none")
    [digest] = set(result.rows["versions"].tolist())
    manifest = read_manifest(tmp_path)
    assert manifest["written_by"] == {digest: manifest["versions"]}
