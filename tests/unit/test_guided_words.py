"""What a guided person reads and hears, and the report of a guided walk."""

import copy
import os
import stat

import numpy as np
import pytest
from typer.testing import CliRunner

import testbed
from testbed import archive, cli_speak
from testbed.archive import StoreError
from testbed.cli import app
from testbed.guided import words
from testbed.guided.record import Walk
from testbed.replay import replay
from testbed.report import cases, figures_guide, grids, player
from testbed.report.figures import Styles
from testbed.report.study import read

DOCUMENT = {
    "name": "led",
    "seed": 5,
    "trials": 1,
    "duration_s": 900,
    "truth_hz": 10,
    "step_hz": 10,
    "world": {"kind": "open_floor", "length_m": 40, "width_m": 40, "posts": 0},
    "actors": [{"id": "user", "kind": "person", "motion": "guided", "guided": {"start_distance_m": 4}}],
    "tags": [{"id": "wanted", "position_m": [20, 20, 1]}],
    "targets": ["wanted"],
    "sensors": [{"id": "reader", "kind": "handheld", "on": "user", "reports": "reads", "wraps_at": "pi"}],
    "estimators": [
        {"id": "none", "kind": "handheld_none"},
        {"id": "better", "kind": "handheld_rb", "stream": {"wraps_at": "pi"}, "particles": 100},
    ],
    "metrics": [{"kind": "guidance"}, {"kind": "phase_steps", "wraps_at": "pi"}],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("guided") / "out"
    testbed.run(copy.deepcopy(DOCUMENT), out=out)
    return out


def walk(*rows):
    """Rows of (kind, t, turn asked, step asked, turn as the person tells it, said)."""
    n = len(rows)
    kind, t, turn, step, informed, said = zip(*rows, strict=True)
    zero = np.zeros(n)
    return Walk(
        kind=kind, began=np.array(t) - 1, t=t, turn_asked=turn, step_asked=step, said=said, informed=informed, x=zero, y=zero,
        heading=zero, range=zero, bearing=zero, length=zero, heard=zero, used=zero, found=[False] * (n - 1) + [True],
    )  # fmt: skip


LED = walk(
    ("start", 1.0, np.nan, 0.0, 0.0, ""),
    ("step", 2.0, np.nan, 0.5, 0.0, ""),
    ("turn", 3.0, 0.6, 0.5, 0.6, ""),
    ("step", 4.0, 0.6, 0.5, 0.0, ""),
    ("turn", 5.0, np.pi, 0.5, np.pi, "No reads."),
    ("turn", 6.0, -0.5, 0.2, 0.9, ""),
    ("step", 7.0, -0.5, 0.2, 0.0, ""),
)


def test_a_turn_and_the_step_after_it_are_one_instruction_and_a_detour_is_answered():
    told = words.instructions(LED)
    assert [one.text for one in told] == [
        "one step",
        "turn left 35°, one step",
        "No reads. Turn round, one step.",
        "turn right 30°, a short step of 20 cm",
        "You are there.",
    ]
    assert [one.t for one in told] == [1.0, 2.0, 4.0, 5.0, 7.0]
    assert told[3].answer == "the person: turn left 50°"
    assert not told[1].answer
    assert "    2.0 s  turn left 35°, one step\n" in words.listing(LED)


# ---------------------------------------------------------------- sound


def speaker(folder, line):
    """A program called like the speaker, in a folder of its own, for PATH."""
    folder.mkdir()
    path = folder / words.SPEAKER
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return f"{folder}{os.pathsep}{os.environ['PATH']}"


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for the speaker is a shell script")
def test_each_instruction_is_said_into_a_file_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", speaker(tmp_path / "bin", 'printf "%s" "$4" > "$2"'))
    path, spoken = words.write(LED, tmp_path / "out", sound=True)
    assert path.read_text(encoding="utf-8") == words.listing(LED)
    assert spoken == 5
    assert (tmp_path / "out" / "instruction-001.wav").read_text() == "turn left 35 degrees, one step"


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for the speaker is a shell script")
def test_a_speaker_that_refuses_is_told_with_its_words(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", speaker(tmp_path / "bin", "echo no voice >&2; exit 3"))
    with pytest.raises(RuntimeError, match="could not say 'one step': no voice"):
        words.speak("one step", tmp_path / "a.wav")


def test_without_the_speaker_there_is_text_alone_and_it_is_said_so(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert not words.speak("one step", tmp_path / "a.wav")
    lines = cli_speak.spoken(run, tmp_path / "out")
    assert len(lines) == 2
    assert all("espeak-ng is not installed" in line for line in lines)
    assert not list((tmp_path / "out").rglob("*.wav"))


def test_the_command_writes_what_every_guide_told(run, tmp_path):
    done = CliRunner().invoke(app, ["speak", str(run), "--out", str(tmp_path / "out"), "--text"])
    assert done.exit_code == 0, done.output
    texts = {path.parent.name: path.read_text(encoding="utf-8") for path in (tmp_path / "out").rglob("instructions.txt")}
    assert set(texts) == {"none", "better"}
    trial = archive.load_trial(archive.place(run, 0, 0))
    assert texts["none"] == words.listing(trial.walk)
    assert texts["better"].endswith("You are there.\n")


def test_a_folder_without_a_guided_person_is_told_so(tmp_path):
    with pytest.raises(StoreError, match="no recording of a guided person"):
        cli_speak.spoken(tmp_path, tmp_path / "out")


def test_a_guided_run_can_not_be_replayed_for_a_guide_makes_its_own_data(run):
    with pytest.raises(StoreError, match="each guide makes its own data"):
        replay(run)


# ---------------------------------------------------------------- the report


@pytest.fixture(scope="module")
def case(run):
    study = read(run)
    return cases.load(study, study.recordings[0])


def test_the_report_has_routes_cloud_instructions_and_phases(run, case):
    found = {drawn.name: drawn for drawn in figures_guide.figures(case, Styles(["none", "better"]), "guide", "Trial 0")}
    assert list(found) == ["guide-routes", "guide-cloud", "guide-told", "guide-stream"]
    assert "better takes the person" in found["guide-cloud"].title, "the control without a filter has no cloud"
    assert "none: " in found["guide-routes"].svg
    assert "better: " in found["guide-routes"].svg
    assert "You are there." in found["guide-told"].svg
    assert "wrapped at π" in found["guide-stream"].caption


def test_phases_in_the_report_lie_on_the_true_motion(case):
    trial = case.trial
    k = int(np.flatnonzero(trial.walk.kind == "step")[0])
    reads = case.reads.take((case.reads.t >= trial.walk.began[k]) & (case.reads.t <= trial.walk.t[k]))
    line, brought = figures_guide._brought(trial, trial.walk, k, reads, np.pi, 0.3)
    assert np.sqrt(((brought - line) ** 2).mean()) == pytest.approx(np.deg2rad(5.5), rel=0.3)
    assert np.ptp(line[np.asarray(reads.t) > trial.walk.t[k] - 0.29]) == pytest.approx(0.0, abs=1e-9), "they stand at the end"


def test_the_player_tells_what_was_told_and_when(case):
    told = words.instructions(case.trial.walk)
    assert player._told(case) == {"t": [one.t for one in told], "text": [one.text for one in told]}


def test_the_results_pool_the_cosine_over_all_steps(run):
    table = grids.results(read(run), 0)
    rows = {row[0].text: row for row in table.rows}
    assert float(rows["guidance cosine (pooled over all steps)"][1].text) <= 1
    assert "steps whose phase slipped (%)" in rows
