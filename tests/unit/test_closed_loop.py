"""The closed loop: pairing by action, batched as one by one, detours, what is kept, and what a guided scenario must have."""

import copy
import functools
import json
import pickle

import numpy as np
import pytest

from estimators.handheld_guide import MISDECLARED, NO_ANSWER, NO_READS
from testbed import archive, batch, worker
from testbed.guided.ears import PlainEar
from testbed.guided.log import along
from testbed.guided.section import GuidedWalk
from testbed.guided.walkers import Walkers, started
from testbed.guided.words import instructions
from testbed.metrics.guidance import Guidance
from testbed.metrics.phase_steps import PhaseSteps
from testbed.scenario import ScenarioError, from_dict
from testbed.sensors.handheld import HandheldConfig
from testbed.worker import Block, run_block

DOCUMENT = {
    "name": "led",
    "seed": 5,
    "trials": 6,
    "block": 3,
    "duration_s": 900,
    "truth_hz": 10,
    "step_hz": 10,
    "world": {"kind": "open_floor", "length_m": 40, "width_m": 40, "posts": 0},
    "actors": [{"id": "user", "kind": "person", "motion": "guided", "guided": {"start_distance_m": 5}}],
    "tags": [{"id": "wanted", "position_m": [20, 20, 1]}],
    "targets": ["wanted"],
    "sensors": [{"id": "reader", "kind": "handheld", "on": "user"}],
    "estimators": [{"id": "paper", "kind": "handheld_paper", "particles": 30}, {"id": "none", "kind": "handheld_none"}],
    "metrics": [{"kind": "guidance"}, {"kind": "phase_steps"}],
}


def changed(**parts):
    document = copy.deepcopy(DOCUMENT)
    for path, value in parts.items():
        where, names = document, path.split("__")
        for name in names[:-1]:
            where = where[int(name) if name.isdigit() else name]
        where[names[-1]] = value
    return from_dict(document)


@pytest.fixture(autouse=True)
def _closed():
    yield
    worker.close()


def block(scenario, trials=(0, 1, 2), **options):
    return run_block(Block(pickle.dumps(scenario), 0, trials, **options))


def figures(result, estimator, name):
    mine = result.rows["estimator"] == estimator
    return dict(zip(result.rows["trial"][mine].tolist(), result.rows[name][mine].tolist(), strict=True))


def test_a_block_leads_everybody_to_the_tag_and_writes_a_row_a_trial_and_guide():
    result = block(changed())
    assert not result.failures
    assert len(result.rows["trial"]) == 6
    assert result.rows["found"].all()
    assert (result.rows["steps"] >= 8).all()
    np.testing.assert_allclose(result.world["start_distance_m"], 5.0)
    every = result.rows["turns"] - result.rows["steps"] + 1  # turns of a search
    assert (every >= 0).all()


def test_trials_together_and_alone_give_the_same_numbers():
    scenario = changed()
    together = block(scenario)
    alone = [block(scenario, (n,)) for n in (0, 1, 2)]
    for estimator in ("paper", "none"):
        for name in ("steps", "turns", "distance_m", "cosine.mean"):
            mine = figures(together, estimator, name)
            for one in alone:
                for trial, value in figures(one, estimator, name).items():
                    assert mine[trial] == pytest.approx(value, abs=1e-9, nan_ok=True)


def test_another_guide_in_the_scenario_changes_nothing_for_the_first():
    both, one = block(changed()), block(changed(estimators=DOCUMENT["estimators"][:1]))
    assert figures(both, "paper", "distance_m") == figures(one, "paper", "distance_m")


def walks(scenario, **options):
    with pytest.MonkeyPatch.context() as patch:
        found = {}
        original = archive.save

        def save(folder, trial, tracks, scene, tagged, guides=None):
            found[next(iter(tracks))] = trial.walk
            for id, (own, _) in (guides or {}).items():
                found[id] = own.walk
            return original(folder, trial, tracks, scene, tagged, guides)

        patch.setattr(archive, "save", save)
        block(scenario, (0,), keep=(0,), **options)
    return found


def test_guides_are_paired_by_the_start_and_by_the_number_of_the_action(tmp_path):
    found = walks(changed(), folder=tmp_path)
    paper, none = found["paper"], found["none"]
    for name in ("x", "y", "heading", "heard"):
        assert getattr(paper, name)[0] == getattr(none, name)[0]
    errors = {}
    for id, walk in found.items():
        turn = walk.kind == "turn"
        before = np.roll(walk.heading, 1)
        error = np.angle(np.exp(1j * (walk.heading - before - walk.informed)))[turn]
        errors[id] = error
        slip = (walk.length - walk.step_asked)[walk.kind == "step"]
        errors[id + "-step"] = slip
    n = min(len(errors["paper"]), len(errors["none"]))
    np.testing.assert_allclose(errors["paper"][:n], errors["none"][:n], atol=1e-12)
    m = min(len(errors["paper-step"]), len(errors["none-step"]))
    np.testing.assert_allclose(errors["paper-step"][:m], errors["none-step"][:m], atol=1e-12)


def test_what_is_kept_of_every_guide_comes_back(tmp_path):
    block(changed(), (0,), folder=tmp_path, keep=(0,))
    place = archive.place(tmp_path, 0, 0)
    trial, tracks, guides = archive.load_trial(place), archive.load_tracks(place), archive.load_guides(place)
    assert list(tracks) == ["paper"]
    assert list(guides) == ["none"]
    walk = trial.walk
    assert walk.found[-1]
    assert not walk.found[:-1].any()
    poses = trial.truth.pose(trial.truth.index("user"), walk.t)
    np.testing.assert_allclose(poses[1:-1, :2], np.stack([walk.x, walk.y], axis=1)[1:-1], atol=0.12)
    assert tracks["paper"].components == ("x", "y")
    assert tracks["paper"].particles.shape[2] > 0
    assert len(trial.recording.streams["actions"]) == len(walk)


def test_the_way_between_actions_is_straight_and_ends_where_they_end(tmp_path):
    walk = walks(changed(), folder=tmp_path)["none"]
    poses = along(walk, walk.t)
    np.testing.assert_allclose(poses[:, :2], np.stack([walk.x, walk.y], axis=1), atol=1e-9)


def test_the_same_run_gives_the_same_table_whatever_the_jobs_and_after_an_interruption(tmp_path):
    scenario = changed()
    one = batch.run(scenario, jobs=1)
    two = batch.run(scenario, jobs=2, out=tmp_path / "run")
    for name, column in one.rows.items():
        np.testing.assert_array_equal(column, two.rows[name])
    (tmp_path / "run" / "parts").joinpath(sorted(p.name for p in (tmp_path / "run" / "parts").iterdir())[0]).unlink()
    again = batch.run(scenario, out=tmp_path / "run", resume=True)
    for name, column in one.rows.items():
        np.testing.assert_array_equal(column, again.rows[name])
    json.dumps(again.document(), allow_nan=False)
    once = batch.rerun(tmp_path / "run", 0, 4)
    assert once.rows["steps"].tolist() == one.rows["steps"][one.rows["trial"] == 4].tolist()


def test_detours_are_told_to_the_guide(tmp_path):
    walk = walks(changed(actors__0__guided={"start_distance_m": 5, "detour_probability": 1.0, "detour_deg": 40}), folder=tmp_path)["none"]
    turn = walk.kind == "turn"
    off = walk.informed[turn] - walk.turn_asked[turn]
    assert (np.abs(off) <= np.deg2rad(40) + 1e-9).all()
    assert np.ptp(off) > 0.3


def test_a_person_gives_up_after_the_steps_they_are_ready_to_take():
    result = block(changed(actors__0__guided={"start_distance_m": 30, "most_steps": 7}))
    assert (result.rows["steps"] == 7).all()
    assert not result.rows["found"].any()


def test_a_tag_that_never_answers_ends_the_walk_in_words(tmp_path):
    scenario = changed(sensors__0__beam_deg=1e-6)
    walk = walks(scenario, folder=tmp_path)["paper"]
    assert not (walk.kind == "step").any()
    assert (walk.kind == "turn").sum() == 11  # with the first listening a dozen times without an answer
    assert np.isnan(walk.aim).all()
    assert instructions(walk)[-1].text == NO_ANSWER


def test_a_reader_that_wraps_otherwise_than_declared_ends_the_walk_in_words(tmp_path):
    """The reader wraps at π, the guide is told 2π: the walk ends after the first step, and no direction was ever given."""
    guides = [{"id": "paper", "kind": "handheld_paper"}, {"id": "none", "kind": "handheld_rb"}]
    scenario = changed(sensors=[{"kind": "handheld", "on": "user", "reports": "reads", "wraps_at": "pi"}], estimators=guides)
    for walk in walks(scenario, folder=tmp_path).values():
        assert (walk.kind == "step").sum() == 1
        assert instructions(walk)[-1].text == MISDECLARED
        assert np.isnan(walk.aim).all()
        assert not walk.found.any()


def test_steps_without_reads_are_told_and_followed_by_no_direction_until_the_tag_is_heard_again(tmp_path):
    sensor = {"kind": "handheld", "on": "user", "reports": "reads", "rate_hz": 2, "beam_deg": None}
    scenario = changed(sensors=[sensor], estimators=[{"id": "rb", "kind": "handheld_rb", "beam_deg": None}], duration_s=120)
    walk = walks(scenario, folder=tmp_path)["rb"]
    empty = (walk.kind == "step") & ~walk.heard
    assert empty.any()
    assert np.isnan(walk.aim[empty]).all()
    assert not walk.trusted[empty].any()
    after = np.flatnonzero(empty[:-1]) + 1
    assert all(str(said).startswith(NO_READS) for said in walk.said[after])


# ---------------------------------------------------------------- what a guided scenario must have


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"sensors": []}, "'user' carries no reader"),
        ({"targets": ["user"]}, "seeks one tag that stands still"),
        ({"estimators": [{"kind": "centroid"}]}, "centroid is no guide"),
        ({"sensors": [{"kind": "handheld", "on": "anna"}]}, "no moving actor is called 'anna'"),
    ],
)
def test_a_guided_scenario_that_can_not_be_one_is_told_so(parts, message):
    with pytest.raises(ScenarioError, match=message):
        block(changed(**parts))


@pytest.mark.parametrize(
    ("actor", "message"),
    [
        ({"motion": "guided"}, "belong together"),
        ({"motion": "kinematic", "guided": {}, "route": {"waypoints_m": [[1, 1], [2, 2]]}}, "belong together"),
        ({"motion": "guided", "guided": {}}, "starts at its position_m, or at start_distance_m"),
        ({"motion": "guided", "guided": {"start_distance_m": 3}, "route": {"waypoints_m": [[1, 1], [2, 2]]}}, "remove its route"),
        ({"motion": "guided", "guided": {"start_distance_m": 3, "step_std": 1}}, "step_std_m"),
    ],
)
def test_an_actor_that_is_guided_says_how(actor, message):
    document = copy.deepcopy(DOCUMENT)
    document["actors"][0] = {"id": "user", "kind": "person", **actor}
    with pytest.raises(ScenarioError, match=message):
        from_dict(document)


# ---------------------------------------------------------------- people and their reader


@functools.cache
def made_people(step_error):
    made = GuidedWalk(start_distance_m=10, step_error=step_error)
    tag, trials = np.zeros((4000, 2)), np.arange(4000)
    start = started(made, 3, trials, "user", tag, np.zeros(2), 0.0)
    return Walkers(made, 3, trials, "user", tag, start)


def people(step_error="ring"):
    return copy.deepcopy(made_people(step_error))  # their keys take a second to make


def test_people_start_in_any_direction_at_their_distance():
    made = people()
    rows = np.arange(4000)
    np.testing.assert_allclose(made.range(rows), 10.0)
    assert abs(np.exp(1j * made.bearing(rows)).mean()) < 0.06  # 4 standard errors: false alarm below 1 in 10,000


@pytest.mark.parametrize(("error", "along_std"), [("ring", 0.1 / np.sqrt(2)), ("axis", 0.1)])
def test_steps_err_as_the_paper_says(error, along_std):
    made, rows = people(step_error=error), np.arange(4000)
    before, heading = made.place.copy(), made.heading.copy()
    made.step(rows, np.full(4000, 0.5))
    moved = made.place - before
    ahead = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
    assert ahead.mean() == pytest.approx(0.5, abs=5 * along_std / np.sqrt(4000))
    assert ahead.std() == pytest.approx(along_std, rel=0.08)
    np.testing.assert_allclose(made.distance, np.hypot(*moved.T))


def test_turns_err_by_their_deviation_and_take_their_time():
    made, rows = people(), np.arange(4000)
    before = made.heading.copy()
    made.turn(rows, np.full(4000, 1.0))
    error = np.angle(np.exp(1j * (made.heading - before - 1.0)))
    assert error.std() == pytest.approx(np.deg2rad(11.5), rel=0.06)
    assert (made.t > 0.3).all()
    assert (made.turns == 1).all()


def test_the_phase_of_a_step_is_that_of_the_change_of_range_and_noise():
    made, rows = people(), np.arange(4000)
    ear = PlainEar(HandheldConfig(on="user"), 3, np.arange(4000), "reader", made)
    before, started_at = made.place.copy(), made.range(rows)
    made.step(rows, np.full(4000, 0.5))
    heard = ear.walked(made, rows, before, np.zeros(4000))
    wavenumber = 4 * np.pi * 865.7e6 / 299_792_458.0
    assert wavenumber == pytest.approx(36.288, abs=1e-3)
    error = heard.change - wavenumber * (made.range(rows) - started_at)
    assert error.std() == pytest.approx(np.deg2rad(5.5), rel=0.06)
    assert abs(error.mean()) < 5 * np.deg2rad(5.5) / np.sqrt(4000)


def test_a_reflection_disturbs_the_phase_by_less_than_half_a_turn_a_step_and_follows_it():
    made, rows = people(), np.arange(4000)
    plain, mirrored = (
        PlainEar(HandheldConfig(on="user", phase_std_deg=0, reflection=r), 3, np.arange(4000), "reader", made) for r in (0, 0.9)
    )
    before = made.place.copy()
    made.step(rows, np.full(4000, 0.5))
    apart = np.abs(mirrored.walked(made, rows, before, rows * 0.0).change - plain.walked(made, rows, before, rows * 0.0).change)
    assert 0.05 < np.median(apart) < np.pi
    assert apart.max() < 4 * np.pi


def test_the_tag_answers_within_the_beam_and_with_none_all_round():
    made, rows = people(), np.arange(4000)
    narrow = PlainEar(HandheldConfig(on="user", beam_deg=68), 3, rows, "reader", made).heard(made, rows, rows)
    np.testing.assert_array_equal(narrow.answers, np.abs(made.bearing(rows)) < np.deg2rad(34))
    assert PlainEar(HandheldConfig(on="user", beam_deg=None), 3, rows, "reader", made).heard(made, rows, rows).answers.all()


def test_metrics_of_a_walk_without_a_guided_person_have_no_value():
    for metric in (Guidance, PhaseSteps):
        assert metric.on_request
        assert metric(metric.Config()).columns
