"""The report from the command: written at the end of a run, made again from its folder, and never in the way of the results."""

import json
import subprocess
import sys

import pytest
import report_fakes as fakes
from ruamel.yaml import YAML


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "quick.yaml"
    document = {k: v for k, v in fakes.QUICK.items() if k != "expect"} | {"duration_s": 2, "trials": 2}
    with path.open("w") as file:
        YAML().dump(document, file)
    return path


def command(*words, cwd, code=0, before=""):
    """Run in a process of its own; `before` is Python to run first."""
    without_camera = "from testbed.report import page, album\npage.album = lambda *_, **__: album.Album(note='No camera pictures here.')\n"
    typed = [str(w) for w in words]
    started = f"import sys\nsys.argv = {['/home/me/bin/testbed', *typed]!r}\n"
    script = f"{started}{without_camera}{before}\nfrom testbed.cli import main\nmain({typed!r})"
    done = subprocess.run([sys.executable, "-c", script], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == code, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def test_a_run_ends_with_its_report_and_it_can_be_made_again(scenario, tmp_path):
    done = command("run", scenario, "--jobs", "1", cwd=tmp_path)
    path = tmp_path / "runs" / "quick" / "report.html"
    assert "report in runs/quick/report.html" in done.stdout
    made = path.read_text()
    path.unlink()
    again = command("report", "runs/quick", "--open", "no", cwd=tmp_path)
    assert again.stdout == "runs/quick/report.html\n"
    assert path.read_text() == made
    assert "quick.yaml --jobs 1" in made  # the command, as it was typed


def test_a_report_that_fails_is_told_in_a_sentence_and_the_run_is_whole(scenario, tmp_path):
    breaks = "from testbed.report import page\ndef fail(*_): raise ZeroDivisionError('no room for labels')\npage.floor_plan = fail\n"
    done = command("run", scenario, "--jobs", "1", "--json", cwd=tmp_path, before=breaks)
    assert json.loads(done.stdout)["trials"] == 2
    assert "the report could not be made (ZeroDivisionError: no room for labels); the results are whole" in done.stderr
    assert "testbed report runs/quick tries again" in done.stderr
    assert (tmp_path / "runs" / "quick" / "trials.parquet").is_file()
    again = command("report", "runs/quick", cwd=tmp_path, code=1, before=breaks)
    assert "Traceback" in again.stderr  # an error of the report itself keeps its traceback


def test_folders_and_words_that_make_no_sense_are_refused(tmp_path):
    assert "holds no run" in command("report", tmp_path, cwd=tmp_path, code=2).stderr
    assert "--open takes yes, no or auto, not 'maybe'" in command("report", tmp_path, "--open", "maybe", cwd=tmp_path, code=2).stderr
