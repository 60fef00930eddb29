"""What is shipped works where nothing else is: the built wheel in an empty environment, run from another folder."""

import json
import os
import subprocess
import sys
import textwrap
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.study


def checked(*words, cwd, codes=(0,)):
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run([*map(str, words)], cwd=cwd, capture_output=True, text=True, env=clean)
    assert done.returncode in codes, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    checked(sys.executable, "-m", "build", "--wheel", "--outdir", folder, ROOT, cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The bin folder of an environment that holds the wheel and what it needs."""
    place = tmp_path_factory.mktemp("empty") / "venv"
    checked(sys.executable, "-m", "venv", place, cwd=place.parent)
    checked(place / "bin" / "pip", "install", "--quiet", wheel, cwd=place.parent)
    return place / "bin"


def test_the_wheel_holds_four_packages_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert tops == {"testbed", "worlds", "estimators", "scenarios"}
    assert "scenarios/demo/dock-gate.yaml" in names
    assert {f"testbed/report/template/{name}" for name in ("report.html", "report.css", "player.js")} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_a_scenario_runs_by_name_from_another_folder(installed, tmp_path):
    # two trials are too few for what the scenario claims of its means: exit 1 is as good as 0 here
    out = checked(installed / "testbed", "run", "dock-gate", "--trials", "2", "--json", cwd=tmp_path, codes=(0, 1))
    document = json.loads(out)  # nothing but the document is on stdout
    assert document["trials"] == 2
    assert not document["failures"]
    assert document["points"][0]["estimators"]["ekf"]["position_error_m"]["n"] == 2
    assert (tmp_path / "runs" / "dock-gate" / "report.html").is_file()


def test_the_doctor_finds_nothing_broken(installed, tmp_path):
    assert "BROKEN" not in checked(installed / "testbed", "doctor", cwd=tmp_path)


def test_an_estimator_pasted_from_the_readme_and_installed_runs_by_name(installed, tmp_path):
    blocks = (ROOT / "README.md").read_text().split("```")
    code = next(b.removeprefix("python\n") for b in blocks if b.startswith("python") and "SingleTarget" in b)
    project = next(b.removeprefix("toml\n") for b in blocks if b.startswith("toml") and "testbed.estimators" in b)
    module = project.split('"')[-2].split(":")[0]
    (tmp_path / f"{module}.py").write_text(code)
    (tmp_path / "pyproject.toml").write_text(project)
    checked(installed / "pip", "install", "--quiet", tmp_path, cwd=tmp_path)
    name = project.split("[project.entry-points")[1].splitlines()[1].split("=")[0].strip()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "s.yaml").write_text(
        textwrap.dedent(f"""
            name: pasted
            seed: 1
            trials: 2
            duration_s: 6
            world: {{kind: open_floor}}
            actors:
              - {{id: t1, kind: trolley, motion: kinematic, route: {{waypoints_m: [[1, 1], [6, 1]]}}, tags: [{{id: lid, mount: top}}]}}
            sensors:
              - {{id: posts, kind: rfid, antennas: {{on: "post*"}}}}
            estimators:
              - {{kind: {name}}}
            """)
    )
    document = json.loads(checked(installed / "testbed", "run", "s.yaml", "--jobs", "2", "--json", cwd=elsewhere))
    figures = document["points"][0]["estimators"][name]["position_error_m"]
    assert figures["n"] == 2
    assert 0 < figures["mean"] < 5
