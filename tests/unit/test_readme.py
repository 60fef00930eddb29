"""What the README shows works as it stands there."""

import re
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import testbed
from testbed.scenario import from_text

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def module_of(code, name):
    """The code as an importable module, as if saved under that name."""
    module = types.ModuleType(name)
    sys.modules[name] = module
    exec(compile(code, f"{name}.py", "exec"), module.__dict__)
    return module


def test_the_yaml_and_the_python_are_one_scenario(capsys):
    text = next(b for b in blocks("yaml") if b.startswith("name:"))  # others show a section alone
    code = next(b for b in blocks("python") if "testbed.run" in b)
    assert len(text.splitlines()) <= 13
    assert len(code.splitlines()) <= 13
    names = {}
    exec(compile(code, "README", "exec"), names)
    said = capsys.readouterr().out
    result, other = names["result"], testbed.run(from_text(text))
    assert result.scenario.hash == other.scenario.hash
    np.testing.assert_array_equal(result.rows["position_error_m.mean"], other.rows["position_error_m.mean"])
    assert "mean error m" in said
    assert "holds" in said
    assert "RunResult first: 8 trials" in repr(result)


def test_the_estimator_conforms():
    code = next(b for b in blocks("python") if "SingleTarget" in b)
    testbed.check_estimator(module_of(code, "strongest_antenna_of_the_readme").StrongestAntenna)


def test_the_world_conforms():
    pytest.importorskip("pybullet", reason="the world's check looks at its bodies in pybullet")
    code = next(b for b in blocks("python") if "BaseHall" in b)
    testbed.check_world(module_of(code, "corridor_of_the_readme").Corridor)


@pytest.mark.study  # a trial of a hall with the whole channel
def test_what_explain_is_said_to_print_it_prints():
    command, *lines = re.search(r"```\n\$ testbed (explain .*?)```", TEXT, re.DOTALL)[1].splitlines()
    said = subprocess.run([sys.executable, "-m", "testbed", *command.split()], capture_output=True, text=True, check=True).stdout
    assert [line for line in lines if line not in said.splitlines()] == []


def test_places_and_files_that_it_names_are_there():
    for path in re.findall(r"`((?:testbed|worlds|estimators|scenarios|tests)/[\w/.]*)`", TEXT):
        assert (ROOT / path).exists() or path.startswith("worlds/corridor"), path
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", TEXT):
        assert (ROOT / picture).is_file()


def test_every_command_that_it_names_is_there():
    from typer.main import get_command

    from testbed.cli import app

    known = set(get_command(app).commands)  # pyright: ignore[reportAttributeAccessIssue]  a group
    named = set(
        re.findall(r"`?testbed ([a-z]+)", "\n".join([*blocks("sh"), *re.findall(r"(?<!`)`(testbed [^`\n]*(?:\n[^`]*)?)`(?!`)", TEXT)]))
    )
    assert {"run", "init", "rerun", "replay", "render", "report", "doctor", "scenarios"} <= named
    assert named <= known
