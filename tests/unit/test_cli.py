"""The command as its users meet it: exit codes, what goes to stdout, what it says of mistakes."""

import json
import subprocess
import sys
import textwrap

import pytest

SCENARIO = """
    name: quick
    seed: 3
    trials: 2
    duration_s: 4
    world: {kind: open_floor}
    actors:
      - {id: t1, kind: trolley, motion: kinematic, route: {waypoints_m: [[1, 1], [6, 1]]}, tags: [{id: lid, mount: top}]}
    sensors:
      - {id: posts, kind: rfid, antennas: {on: "post*"}}
    estimators:
      - {kind: centroid}
"""


@pytest.fixture
def quick(tmp_path):
    path = tmp_path / "quick.yaml"
    path.write_text(textwrap.dedent(SCENARIO))
    return path


def command(*words, cwd, code=0, before=""):
    """Run in a process of its own, as from a shell; `before` is Python to run first. Without the report, which has tests of its own."""
    words = (*words, "--no-report") if words[0] == "run" else words
    script = f"{before}\nfrom testbed.cli import main\nmain({[str(w) for w in words]!r})"
    done = subprocess.run([sys.executable, "-c", script], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == code, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def test_json_on_stdout_and_nothing_else(quick, tmp_path):
    document = json.loads(command("run", quick, "--json", "--jobs", "0", cwd=tmp_path).stdout)
    assert document["scenario"] == "quick"
    assert document["points"][0]["estimators"]["centroid"]["position_error_m"]["n"] == 2
    assert document["ok"] is True


def test_a_table_for_people_and_an_output_folder(quick, tmp_path):
    done = command("run", quick, "--jobs", "0", cwd=tmp_path)
    assert "mean error m" in done.stdout
    assert "±" in done.stdout
    folder = tmp_path / "runs" / "quick"
    assert {"manifest.json", "trials.parquet", "timings.parquet", "log.jsonl", "recordings"} <= {f.name for f in folder.iterdir()}
    assert "2 of 2 trials" in done.stderr


def test_a_second_run_takes_a_folder_of_its_own_and_out_is_not_overwritten(quick, tmp_path):
    for _ in range(2):
        command("run", quick, "--jobs", "0", "--trials", "1", cwd=tmp_path)
    assert (tmp_path / "runs" / "quick-2").is_dir()
    refused = command("run", quick, "--jobs", "0", "--out", "runs/quick", cwd=tmp_path, code=2)
    assert "--force" in refused.stderr
    command("run", quick, "--jobs", "0", "--trials", "1", "--out", "runs/quick", "--force", cwd=tmp_path)


def test_an_expectation_that_does_not_hold_is_exit_1_with_its_line(quick, tmp_path):
    quick.write_text(quick.read_text() + "expect:\n  centroid: {position_error_m: {mean: {max: 0.001}}}\n")
    done = command("run", quick, "--jobs", "0", cwd=tmp_path, code=1)
    assert "quick.yaml:14: centroid.position_error_m.mean <= 0.001: got" in done.stdout


def test_a_crashed_trial_is_exit_3_and_the_rest_is_kept(quick, tmp_path):
    break_it = textwrap.dedent("""
        from testbed.simulate import Simulator
        whole = Simulator.trial
        def trial(self, index, seed=None):
            if index == 1:
                raise RuntimeError("the trolley caught fire")
            return whole(self, index, seed)
        Simulator.trial = trial
    """)
    done = command("run", quick, "--jobs", "0", "--json", cwd=tmp_path, code=3, before=break_it)
    document = json.loads(done.stdout)
    assert document["failures"][0]["error"] == "RuntimeError: the trolley caught fire"
    assert document["points"][0]["estimators"]["centroid"]["position_error_m"]["n"] == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "dok-gate"), "dock-gate"),
        (("run", "quick.yaml", "--set", "wrld.kind=x"), "did you mean world"),
        (("run", "quick.yaml", "--jobs", "many"), "--jobs takes a number"),
        (("run", "quick.yaml", "--resume"), "--resume needs --out"),
        (("run", "quick.yaml", "--keep", "some"), "which recordings to keep"),
        (("run", "quick.yaml", "--estimator", "centroit"), "did you mean centroid"),
        (("run", "quick.yaml", "--trials", "1000000000"), "trials"),
        (("replay", "nowhere"), "no output folder"),
        (("rerun", "nowhere", "--trial", "1"), "nowhere"),
        (("plugins", "estimator"), "did you mean estimators"),
        (("rnu",), "No such command"),
        (("init", "quick.yaml"), "is there already"),
    ],
)
def test_bad_input_is_exit_2_with_one_sentence(quick, tmp_path, words, message):
    done = command(*words, cwd=tmp_path, code=2)
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_what_only_the_hall_can_tell_is_told_before_a_folder_is_made(quick, tmp_path):
    quick.write_text(quick.read_text().replace('on: "post*"', 'on: "gate*"'))
    assert "no body is named 'gate*'" in command("run", quick, cwd=tmp_path, code=2).stderr
    assert not (tmp_path / "runs").exists()


def test_every_mistake_of_a_file_is_shown_at_once_with_its_place(quick, tmp_path):
    quick.write_text(quick.read_text().replace("seed: 3", "sed: 3").replace("kind: centroid", "kind: centroit"))
    lines = command("validate", quick, cwd=tmp_path, code=2).stderr.splitlines()
    assert any(":3:" in line and "did you mean seed" in line for line in lines)
    assert any(":12:" in line and "did you mean centroid" in line for line in lines)


def test_a_kept_recording_is_replayed_to_the_same_figures(quick, tmp_path):
    ran = json.loads(command("run", quick, "--jobs", "0", "--trials", "1", "--json", "--out", "o", cwd=tmp_path).stdout)
    again = json.loads(command("replay", "o", "--json", "--out", "tracks", cwd=tmp_path).stdout)
    error = ran["points"][0]["estimators"]["centroid"]["position_error_m"]["mean"]
    assert again["estimators"]["centroid"]["position_error_m"]["mean"] == pytest.approx(error, abs=1e-9)
    assert (tmp_path / "tracks" / "point-0000.trial-000000.centroid.parquet").is_file()
    other = json.loads(command("replay", "o", "--estimator", "ekf", "--json", cwd=tmp_path).stdout)
    assert list(other["estimators"]) == ["ekf"]


def test_pictures_of_a_run_by_its_cameras(quick, tmp_path):
    pytest.importorskip("pybullet", reason="pictures need pybullet")
    quick.write_text(
        quick.read_text() + "cameras:\n  - {id: hall, at: [start, end], width_px: 160, height_px: 120}\n  - {id: t, follow: t1}\n"
    )
    command("run", quick, "--jobs", "0", "--trials", "1", "--out", "o", cwd=tmp_path)
    said = command("render", "o", "--out", "p", "--camera", "hall", cwd=tmp_path).stdout.split()
    assert said == ["p/hall-start.png", "p/hall-end.png"]
    import cv2

    image = cv2.imread(str(tmp_path / "p" / "hall-end.png"))
    assert image.shape[1] == 160
    assert image.shape[0] >= 120  # the legend is a strip below
    assert image.std() > 10  # something is to be seen
    assert "did you mean hall" in command("render", "o", "--out", "p", "--camera", "hal", cwd=tmp_path, code=2).stderr


def test_a_trial_is_made_again_from_the_manifest(quick, tmp_path):
    command("run", quick, "--jobs", "0", "--out", "o", cwd=tmp_path)
    quick.unlink()
    rows = json.loads(command("rerun", "o", "--trial", "1", "--json", cwd=tmp_path).stdout)["rows"]
    import pyarrow.parquet as pq

    table = pq.read_table(tmp_path / "o" / "trials.parquet").to_pylist()
    assert rows["position_error_m.mean"][0] == next(r for r in table if r["trial"] == 1)["position_error_m.mean"]


def test_without_pybullet_validate_replay_and_kinematic_runs_work(quick, tmp_path):
    block = "import sys; sys.modules['pybullet'] = None"
    command("validate", quick, cwd=tmp_path, before=block)
    command("run", quick, "--jobs", "0", "--trials", "1", "--out", "o", cwd=tmp_path, before=block)
    command("replay", "o", cwd=tmp_path, before=block)
    command("schema", cwd=tmp_path, before=block)
    assert "pybullet is missing" in command("doctor", cwd=tmp_path, before=block).stdout


def test_what_init_writes_is_valid(tmp_path):
    command("init", "mine.yaml", cwd=tmp_path)
    command("validate", "mine.yaml", cwd=tmp_path)
    assert json.loads((tmp_path / "scenario.schema.json").read_text())["type"] == "object"
