"""`testbed explain` as its users meet it: of a scenario, of a run, as JSON, and asked about what isn't there."""

import json

import pytest

from testbed import api
from testbed.cli import main

SCENARIO = """
name: gate
seed: 3
trials: 2
duration_s: 2
world: {kind: open_floor}
actors:
  - {id: t1, kind: trolley, motion: kinematic, route: {waypoints_m: [[1, 1], [6, 1]]}, tags: [{id: lid, mount: top}]}
sensors:
  - {id: posts, kind: rfid, antennas: {on: "post*"}}
estimators:
  - {kind: centroid}
"""
QUESTION = ("--tag", "lid", "--antenna", "post1.low", "--time", "1.0")


@pytest.fixture
def gate(tmp_path):
    path = tmp_path / "gate.yaml"
    path.write_text(SCENARIO)
    return path


def command(capsys, *words, code=0):
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    found = capsys.readouterr()
    assert left.value.code == code, found
    return found


def test_the_verdict_comes_first_then_the_tables(gate, capsys):
    lines = command(capsys, "explain", gate, *QUESTION).out.splitlines()
    assert lines[0].startswith(("read", "not read"))
    assert lines[0].endswith(".")
    assert lines[1].startswith("gate, trial 0: tag lid, antenna post1.low of posts, 1 s, 86")
    text = "\n".join(lines)
    for part in (
        "free space dB",
        "direct",
        "floor, ",
        "diffuse, K",
        "forward: the tag gets",
        "reverse: the reader gets",
        "reader: session 1",
    ):
        assert part in text


def test_one_json_document_with_the_same_verdict(gate, capsys):
    said = command(capsys, "explain", gate, *QUESTION).out.splitlines()[0]
    document = json.loads(command(capsys, "explain", gate, *QUESTION, "--json").out)
    assert document["verdict"] == said
    assert document["budget"]["forward_db"] == pytest.approx(document["budget"]["tag_dbm"] - document["budget"]["tag_needs_dbm"])
    assert document["budget"]["direct"]["passage"]["way"] in ("clear", "through", "round")
    assert document["serving"]["selected"] is True
    assert document["reason"]


def test_a_run_is_explained_from_its_folder_and_a_setting_can_be_tried(gate, tmp_path, capsys):
    folder = tmp_path / "run"
    api.run(gate, trials=1, out=folder)
    of_run = json.loads(command(capsys, "explain", folder, *QUESTION, "--json").out)
    assert of_run == json.loads(command(capsys, "explain", gate, *QUESTION, "--json").out)
    weak = json.loads(command(capsys, "explain", folder, *QUESTION, "--set", "sensors.posts.power_dbm=-20", "--json").out)
    assert weak["reason"] == "too little power at the tag"
    assert weak["budget"]["forward_db"] == pytest.approx(of_run["budget"]["forward_db"] - 49)


def test_what_is_not_there_is_told_in_one_sentence(gate, tmp_path, capsys):
    assert command(capsys, "explain", gate, "--tag", "lit", *QUESTION[2:], code=2).err == "no tag is named 'lit'; the nearest is 'lid'\n"
    wrong = command(capsys, "explain", gate, *QUESTION[:5], "7", code=2)
    assert wrong.err == "7 s is outside the trial, which lasts from 0 to 2 s\n"
    assert wrong.out == ""
    assert "manifest.json" in command(capsys, "explain", tmp_path, *QUESTION, code=2).err
