"""A real block of a tiny scenario: who fails, fails alone; and what is kept comes back bit for bit."""

import pickle
import shutil
from dataclasses import fields

import numpy as np
import pytest

from testbed import archive, worker
from testbed.archive import StoreError, load_recording, load_scene, load_tracks, load_trial
from testbed.columns import Columns
from testbed.plugins import load
from testbed.scenario import ScenarioError, from_dict, override
from testbed.simulate import Simulator
from testbed.worker import Block, run_block, stack

SCENARIO = from_dict(
    {
        "name": "tiny",
        "seed": 5,
        "trials": 4,
        "duration_s": 2,
        "world": {"kind": "open_floor"},
        "actors": [
            {
                "id": "t1",
                "kind": "trolley",
                "motion": "kinematic",
                "route": {"waypoints_m": [[2, 2], [5, 2]]},
                "tags": [{"id": "a", "position_m": [0, 0, 1]}, {"id": "b", "position_m": [0, 0, 1.2]}],
            }
        ],
        "sensors": [{"id": "posts", "kind": "rfid", "antennas": {"on": "post1"}}],
        "estimators": [{"id": "one", "kind": "centroid"}, {"id": "two", "kind": "centroid", "memory_s": 3.25}],
    }
)
TRIALS = (0, 1, 2)


@pytest.fixture(autouse=True)
def _closed():
    yield
    worker.close()


def block(scenario=SCENARIO, trials=TRIALS, **options):
    return Block(pickle.dumps(scenario), 0, trials, **options)


@pytest.fixture(scope="module")
def undisturbed():
    result = run_block(block())
    worker.close()
    assert not result.failures
    return result


def misbehaving(monkeypatch, when):
    """Estimator "two" can't be made where `when(trials)` of the recordings that it is to work on."""
    plain, driven = load("estimators", "centroid"), worker.run

    class Misbehaving(plain):
        trials: frozenset[int] = frozenset()

        def __init__(self, config, site, rng):
            super().__init__(config, site, rng)
            if config.memory_s == 3.25 and when(Misbehaving.trials):
                raise ZeroDivisionError("no good at this")

    def run(recordings, method, *rest, **options):
        Misbehaving.trials = frozenset(r.trial for r in recordings)
        return driven(recordings, method, *rest, **options)

    monkeypatch.setattr(worker, "run", run)
    monkeypatch.setattr(worker, "load", lambda group, name: Misbehaving if name == "centroid" else load(group, name))


def without(rows, trial, estimator=None):
    keep = rows["trial"] != trial
    if estimator:
        keep |= rows["estimator"] != estimator
    return {name: column[keep] for name, column in rows.items()}


def same(a, b, rtol=0.0):
    assert list(a) == list(b)
    for name in a:
        if a[name].dtype.kind == "f":
            np.testing.assert_allclose(a[name], b[name], rtol=rtol, atol=0)
        else:
            np.testing.assert_array_equal(a[name], b[name])


# ---------------------------------------------------------------- rows


def test_a_row_for_every_trial_estimator_and_target(undisturbed):
    rows = undisturbed.rows
    found = list(zip(rows["trial"].tolist(), rows["estimator"].tolist(), rows["target"].tolist(), strict=True))
    assert found == [(t, e, g) for t in TRIALS for e in ("one", "two") for g in ("a", "b")]
    assert set(rows["kind"]) == {"centroid"}
    assert len(set(rows["config"])) == 2
    assert (rows["seed"] == 5).all()
    assert (rows["scenario"] == SCENARIO.hash[:16]).all()
    assert {"position_error_m.mean", "availability", "nees.mean", "time_lost_s.total", "events.used"} <= set(rows)


def test_the_world_and_the_wall_times_are_apart_from_the_rows(undisturbed):
    assert undisturbed.world["trial"].tolist() == list(TRIALS)
    assert any("reads" in name for name in undisturbed.world)
    timings = undisturbed.timings
    assert set(timings["stage"]) == {"simulate", "update"}
    updates = timings["stage"] == "update"
    np.testing.assert_allclose(timings["seconds_per_update"][updates] * timings["updates"][updates], timings["seconds"][updates])
    assert not any("second" in name for name in undisturbed.rows)


def test_a_block_is_a_function_of_what_it_is_given(undisturbed):
    same(run_block(block()).rows, undisturbed.rows)


def test_one_by_one_agrees_with_together(undisturbed):
    same(stack([run_block(block(trials=(t,))).rows for t in TRIALS]), undisturbed.rows, rtol=1e-9)


def test_rows_under_rows_fill_what_one_of_them_lacks():
    found = stack([{}, {"t": np.array([1]), "x": np.array([2.0])}, {"t": np.array([2]), "y": np.array(["a"])}])
    np.testing.assert_array_equal(found["x"], [2.0, np.nan])
    assert found["y"].tolist() == ["", "a"]
    assert found["t"].tolist() == [1, 2]
    assert stack([]) == {}


# ---------------------------------------------------------------- failures


def test_a_trial_that_cannot_be_simulated_is_lost_alone(monkeypatch, undisturbed):
    made = Simulator.trial
    opened = []

    class Fragile(Simulator):
        def __init__(self, scenario):
            super().__init__(scenario)
            opened.append(self)

        def trial(self, index, seed=None):
            if index == 1:
                raise RuntimeError("the wheels came off\nall four")
            return made(self, index, seed)

    monkeypatch.setattr(worker, "Simulator", Fragile)
    result = run_block(block())
    [failure] = result.failures
    assert (failure.trial, failure.estimator, failure.stage) == (1, "", "simulate")
    assert failure.error == "RuntimeError: the wheels came off"
    assert "in trial" in failure.traceback
    same(result.rows, without(undisturbed.rows, 1), rtol=1e-9)
    assert len(opened) == 2  # the world that failed is not used again


def test_a_world_that_cannot_be_made_fails_every_trial_and_raises_nothing(monkeypatch):
    def broken(scenario):
        raise MemoryError("no room for a world")

    monkeypatch.setattr(worker, "Simulator", broken)
    result = run_block(block())
    assert [(f.trial, f.error) for f in result.failures] == [(t, "MemoryError: no room for a world") for t in TRIALS]
    assert result.rows == {}


def test_an_estimator_that_fails_on_one_trial_loses_that_one_alone(monkeypatch, undisturbed):
    misbehaving(monkeypatch, lambda trials: 1 in trials)
    result = run_block(block())
    assert [(f.trial, f.estimator, f.stage, f.error) for f in result.failures] == [
        (1, "two", "estimate", "ZeroDivisionError: no good at this")
    ]
    assert "ZeroDivisionError" in result.failures[0].traceback
    same(result.rows, without(undisturbed.rows, 1, "two"), rtol=1e-9)


def test_an_estimator_that_fails_only_in_company_is_remarked_upon(monkeypatch, undisturbed):
    misbehaving(monkeypatch, lambda trials: len(trials) > 1)
    result = run_block(block())
    assert not result.failures
    assert result.notes == ("two fails on trials 0 to 2 together and on none alone: ZeroDivisionError: no good at this",)
    same(result.rows, undisturbed.rows, rtol=1e-9)


def test_a_metric_that_fails_loses_that_estimators_rows_alone(monkeypatch, undisturbed):
    real, asked = worker.score, []

    def score(track, trial, metrics):
        asked.append(trial.recording.trial)
        if asked.count(2) == 1 and asked[-1] == 2:
            raise KeyError("no such truth")
        return real(track, trial, metrics)

    monkeypatch.setattr(worker, "score", score)
    result = run_block(block())
    assert [(f.trial, f.estimator, f.stage) for f in result.failures] == [(2, "one", "score")]
    same(result.rows, without(undisturbed.rows, 2, "one"))


def test_bad_input_is_no_trials_failure():
    astray = override(SCENARIO, {"sensors.posts.antennas.on": "nowhere"})
    with pytest.raises(ScenarioError, match="nowhere"):
        run_block(block(astray))


# ---------------------------------------------------------------- recordings


def identical(a, b):
    """Equal to the last bit, through dataclasses, tuples, dictionaries and arrays."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert (a.dtype.kind, a.shape) == (b.dtype.kind, b.shape)
        assert a.tolist() == b.tolist() if a.dtype.kind == "U" else a.tobytes() == b.tobytes()
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            identical(x, y)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            identical(a[key], b[key])
    elif isinstance(a, Columns) or hasattr(a, "__dataclass_fields__"):
        for f in fields(a):
            identical(getattr(a, f.name), getattr(b, f.name))
    else:
        assert a == b or (a != a and b != b)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    run_block(block(folder=folder, keep=(1,)))
    worker.close()
    return folder


def test_only_what_was_asked_for_is_kept(kept):
    assert [path.name for path in (kept / "recordings" / "point-0000").iterdir()] == ["trial-000001"]


def test_a_trial_comes_back_to_the_last_bit(kept):
    with Simulator(SCENARIO) as simulator:
        trial, scene, tagged = simulator.trial(1), simulator.scene, simulator.tagged
    place = archive.place(kept, 0, 1)
    identical(load_trial(place), trial)
    identical(load_recording(place), trial.recording)
    identical(load_scene(place), (scene, tagged))


def test_tracks_come_back_and_score_as_they_did(kept, undisturbed):
    place = archive.place(kept, 0, 1)
    tracks = load_tracks(place)
    assert list(tracks) == ["one", "two"]
    metrics = {s.id: load("metrics", s.kind)(s.config) for s in SCENARIO.metrics}
    again = worker.score(tracks["two"], load_trial(place), metrics)
    mask = (undisturbed.rows["trial"] == 1) & (undisturbed.rows["estimator"] == "two")
    for name, column in again.items():
        np.testing.assert_array_equal(column, undisturbed.rows[name][mask])


def test_what_estimators_got_is_readable_without_the_truth_and_holds_none_of_it(kept, tmp_path):
    place = tmp_path / "copy"
    shutil.copytree(archive.place(kept, 0, 1), place)
    shutil.rmtree(place / "truth")
    shutil.rmtree(place / "tracks")
    identical(load_recording(place), load_recording(archive.place(kept, 0, 1)))
    for path in (place / "recording").iterdir():
        assert b"testbed.scene:Truth" not in path.read_bytes()
    with pytest.raises(StoreError, match="can't be read"):
        load_trial(place)


def test_a_trial_in_which_an_estimator_fails_is_kept_with_the_tracks_there_are(monkeypatch, tmp_path):
    misbehaving(monkeypatch, lambda trials: 2 in trials)
    run_block(block(folder=tmp_path, keep_failed=True))
    assert [path.name for path in (tmp_path / "recordings" / "point-0000").iterdir()] == ["trial-000002"]
    assert list(load_tracks(archive.place(tmp_path, 0, 2))) == ["one"]


def test_a_recording_is_replaced_as_a_whole(kept, tmp_path):
    place = archive.place(tmp_path, 0, 1)
    (place / "tracks").mkdir(parents=True)
    (place / "tracks" / "old.parquet").write_bytes(b"")
    run_block(block(folder=tmp_path, keep=(1,)))
    assert list(load_tracks(place)) == ["one", "two"]
    assert [path.name for path in place.parent.iterdir()] == ["trial-000001"]


def test_a_missing_or_damaged_recording_is_named(kept, tmp_path):
    with pytest.raises(StoreError, match="there is no recording"):
        load_trial(tmp_path / "nowhere")
    place = tmp_path / "copy"
    shutil.copytree(archive.place(kept, 0, 1), place)
    (place / "recording" / "stream.reads.parquet").write_bytes(b"PAR1")
    with pytest.raises(StoreError, match=r"can't be read: .*stream\.reads\.parquet"):
        load_recording(place)


def test_a_disk_that_refuses_a_recording_leaves_nothing_half_written(monkeypatch, tmp_path):
    def full(value, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive.tables, "write", full)
    with pytest.raises(StoreError, match=r"can't write the recording .*: No space left on device"):
        run_block(block(folder=tmp_path, keep=(1,)))
    assert not list((tmp_path / "recordings" / "point-0000").iterdir())
