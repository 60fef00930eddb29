"""A figure depends on the contents of the files that its world is made of: another map, model, image or log is another study."""

import os

import pytest
from batch_fakes import scenario, work

from testbed import pool
from testbed.batch import run
from testbed.identity import contents, keys_of
from testbed.scenario import from_dict
from testbed.store import read_manifest

OCTILE = "type octile\nheight 3\nwidth 4\nmap\n@@@@\n@..@\n@@@@\n"
BOX = (
    '<sdf version="1.6"><model name="m"><link name="l"><collision name="c"><geometry><box><size>{} 1 1</size></box></geometry></collision>'
    "</link></model></sdf>"
)
WORLD = '<sdf version="1.6"><world name="w"><include><uri>model://m</uri><pose>0 0 0.5 0 0 0</pose></include></world></sdf>'
ROWS = "t,antenna,tag,rssi\n" + "".join(f"{0.1 * i},a,x,-50\n" for i in range(9))


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    monkeypatch.setattr(pool, "MOST_BLOCKS", 1)


def grid(folder):
    (folder / "hall.map").write_text(OCTILE)
    return {"kind": "grid", "path": "hall.map"}, folder / "hall.map", OCTILE.replace("..", ".@")


def occupancy(folder):
    (folder / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    (folder / "map.pgm").write_bytes(b"P5\n2 2\n255\n" + bytes([0, 255, 255, 255]))
    return {"kind": "occupancy", "path": "map.yaml"}, folder / "map.pgm", b"P5\n2 2\n255\n" + bytes([0, 0, 255, 255])


def sdf(folder):
    """The file that changes is not the world's own, but that of a model it includes."""
    (folder / "models" / "m").mkdir(parents=True)
    (folder / "models" / "m" / "model.sdf").write_text(BOX.format(1))
    (folder / "hall.world").write_text(WORLD)
    return {"kind": "sdf", "path": "hall.world"}, folder / "models" / "m" / "model.sdf", BOX.format(2)


def recorded(folder):
    (folder / "log.csv").write_text(ROWS)
    site = {
        "log": {"kind": "tidy_csv"},
        "antennas": [{"id": "a", "position_m": [0, 0, 1]}],
        "tags": [{"id": "x"}],
        "targets": [{"id": "x"}],
    }
    world = {"kind": "recorded", "protocol": "nothing is fitted", "logs": [str(folder / "log.csv")], "site": site}
    return world, folder / "log.csv", ROWS.replace("-50", "-51")


def study(folder, world):
    document = {k: v for k, v in scenario().document.items() if k not in ("actors", "sensors", "tags", "targets")}
    return from_dict({**document, "world": world}, folder=folder)


def put(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


@pytest.mark.parametrize("made", [grid, occupancy, sdf, recorded], ids=lambda m: m.__name__)
def test_another_content_is_another_key_and_the_old_one_is_the_old_key_again(tmp_path, made):
    world, file, other = made(tmp_path)
    one, old = study(tmp_path, world), file.read_bytes()
    first = keys_of(one, {})
    assert keys_of(study(tmp_path, world), {}) == first
    assert file.name in [name for name, _ in contents(one.world)]
    put(file, other)
    second = keys_of(study(tmp_path, world), {})
    assert second.world != first.world
    assert all(second.estimators[id] != key for id, key in first.estimators.items())
    put(file, old)
    assert keys_of(study(tmp_path, world), {}) == first


def test_a_file_that_lies_elsewhere_is_the_same(tmp_path):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    a, b = (study(tmp_path / name, grid(tmp_path / name)[0]) for name in ("here", "there"))
    assert keys_of(a, {}) == keys_of(b, {})


def test_a_changed_map_is_run_again_and_an_unchanged_one_is_not(tmp_path):
    (tmp_path / "maps").mkdir()
    world, file, other = grid(tmp_path / "maps")
    seen = []

    def noted(block):
        seen.append(block.trials[0])
        return work(block)

    def go_on(resume):
        seen.clear()
        run(study(tmp_path / "maps", world), out=tmp_path / "out", resume=resume, keep="none", work=noted)
        return list(seen)

    first = go_on(resume=False)
    assert first
    assert go_on(resume=True) == []
    put(file, other)
    assert go_on(resume=True) == first
    assert read_manifest(tmp_path / "out")["scenario"]["files"] == contents(study(tmp_path / "maps", world).world)


def test_a_world_that_reads_nothing_has_none_and_a_missing_file_is_for_the_world_to_say(tmp_path):
    assert contents(scenario().world) == []
    world, file, _ = grid(tmp_path)
    one = study(tmp_path, world)
    file.unlink()
    assert contents(one.world) == []
