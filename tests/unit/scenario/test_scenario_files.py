"""Scenario files: found by path or name, read within limits, and read without waking what they don't need."""

import subprocess
import sys

import pytest

from testbed.scenario import ScenarioError, find, from_text, listing, load
from testbed.scenario.problems import Problem

VALID = "name: dock\ntitle: 'A dock: with a gate'\nseed: 1\ntrials: 2\nduration_s: 10\nworld: {kind: hall}\n"


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """A folder of scenarios in place of those that ship."""
    folder = tmp_path / "shipped"
    for name, text in {"demo/dock-gate": VALID, "demo/aisles": "name: aisles\n", "papers/trolley": VALID, "smoke/trolley": "a: ["}.items():
        path = folder / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr("importlib.resources.files", lambda package: folder)
    return folder


def told(name):
    with pytest.raises(ScenarioError) as caught:
        load(name)
    return str(caught.value)


def test_a_scenario_is_found_by_its_name_with_or_without_its_folder(shipped):
    assert find("demo/dock-gate") == find("dock-gate") == shipped / "demo/dock-gate.yaml"


def test_a_file_that_exists_goes_before_a_name(shipped, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dock-gate").write_text("x")
    assert find("dock-gate").read_text() == "x"


def test_all_that_ship_are_listed_with_their_titles(shipped):
    assert [(name, title) for name, title, _ in listing()] == [
        ("demo/aisles", ""), ("demo/dock-gate", "A dock: with a gate"), ("papers/trolley", "A dock: with a gate"), ("smoke/trolley", "")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("dok-gate", "dok-gate: no such file or scenario, did you mean dock-gate?"),
        ("demo/dock_gate", "demo/dock_gate: no such file or scenario, did you mean demo/dock-gate?"),
        ("dock-gat.yaml", "dock-gat.yaml: no such file or scenario, did you mean dock-gate?"),
        ("zzz", "zzz: no such file or scenario; `testbed scenarios` lists those that ship"),
        ("trolley", "trolley: several scenarios have this name: papers/trolley, smoke/trolley"),
        ("a\0b", "no such file or scenario"),
        ("x" * 5000, "no such file or scenario"),
        ("", "no such file or scenario"),
    ],
)
def test_what_is_not_there_is_told_with_what_was_meant(shipped, name, sentence):
    assert sentence in told(name)


def test_a_folder_is_no_scenario_but_may_hold_some(shipped):
    assert told(shipped / "demo").endswith("a folder, not a scenario; it holds aisles.yaml, dock-gate.yaml")


def test_errors_name_the_file_as_it_is_seen_from_here(fakes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dock.yaml").write_text(VALID + "seeds: 3\n")
    for name in ("dock.yaml", str(tmp_path / "dock.yaml"), tmp_path / "dock.yaml"):
        assert told(name) == "dock.yaml:7:1 seeds: extra field, did you mean seed?"


def test_a_file_is_read_with_its_text_and_path_kept(fakes, tmp_path):
    path = tmp_path / "dock.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + VALID.encode())  # an editor's byte order mark
    s = load(path, ["trials=7"])
    assert (s.text, s.path, s.trials, s.document["trials"]) == (VALID, path, 7, 7)
    assert s == from_text(VALID, sets=["trials=7"])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"name: d\xe9pot\n", "dock.yaml:1:8: not UTF-8 text: the byte 0xe9 can't be read"),
        (VALID.encode("utf-16"), "dock.yaml:1:1: not UTF-8 text"),
        (b"#" * 1_000_001, "dock.yaml: over 1 MB: too large for a scenario"),
        (b"", "dock.yaml:1: the file is empty"),
        (b"name: x\x00y\n", "dock.yaml:1: the character"),
    ],
)
def test_a_file_that_can_be_no_scenario_is_refused_in_a_sentence(tmp_path, monkeypatch, content, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dock.yaml").write_bytes(content)
    assert sentence in told("dock.yaml")


def test_an_endless_file_is_read_no_further_than_the_limit():
    assert "over 1 MB" in told("/dev/zero") or "no such file" in told("/dev/zero")


def test_a_problem_is_a_line_with_as_much_of_its_place_as_there_is():
    assert str(Problem("dock.yaml", 9, 5, "sensors.0.rate_hz", "extra field")) == "dock.yaml:9:5 sensors.0.rate_hz: extra field"
    assert str(Problem("tags.csv", 7, None, "", "x")) == "tags.csv:7: x"
    assert str(Problem("<dict>", None, None, "seed", "missing")) == "<dict> seed: missing"


def test_reading_scenarios_wakes_no_heavy_library():
    heavy = ("numba", "scipy.stats", "pybullet", "matplotlib", "pyarrow", "pint", "filterpy", "cv2")
    code = f"import sys, testbed.scenario as s; s.starter(); s.listing(); print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "kind", ["this", "os:system", "os.system", "testbed.cli", "../estimators/ekf", "__init__", "ekf.py", "", "x" * 10_000]
)
@pytest.mark.parametrize("group", ["estimators", "sensors"])
def test_a_kind_is_a_registered_name_and_nothing_that_could_be_imported(kind, group):
    with pytest.raises(ScenarioError) as caught:
        from_text(VALID + f"{group}: [{{kind: '{kind}'}}]\n", "dock.yaml")
    assert f"dock.yaml:7:{len(group) + 11} {group}.0.kind: no {group[:-1]} named" in str(caught.value)
    assert "this" not in sys.modules
    assert len(str(caught.value)) < 2000
