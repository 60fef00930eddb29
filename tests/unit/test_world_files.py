"""Worlds from files: what each file of tests/files/worlds becomes, body by body; units, axes, poses in poses, mounts, rays through gaps."""

import json
from pathlib import Path

import numpy as np
import pytest

from testbed import frames
from testbed.manifest import describe, rebuilt
from testbed.radio.materials import losses
from testbed.roads import RoadGraph
from testbed.scenario import from_dict
from testbed.simulate import Simulator
from testbed.solid import mesh_holder
from worlds.building_map import BuildingMap
from worlds.grid import Grid
from worlds.importers.cells import pgm, rectangles
from worlds.importers.collada import collada
from worlds.importers.files import WorldFileError
from worlds.importers.hall import plain_names
from worlds.importers.mesh_files import load_mesh, obj, stl
from worlds.importers.solids import cylinder, is_closed, oriented, shells, solids, sphere, volume
from worlds.occupancy import Occupancy
from worlds.sdf import Sdf

FILES = Path(__file__).parents[1] / "files" / "worlds"
NOBODY = np.zeros((1, 0, 7))


def sdf(path="hall.sdf", **config):
    return Sdf(Sdf.Config(path=str(FILES / path), **config))


def seen(world, start, end):
    """(names of bodies crossed, lengths inside) on one segment."""
    scene = world.scene([])
    caster = world.caster(scene, "boxes", *losses(scene.materials))
    found = caster.crossings(np.array([start], float), np.array([end], float), NOBODY, np.zeros(1, dtype=int))
    return [scene.bodies[b].name for b in scene.piece_body[found.box]], found.length


# ---------------------------------------------------------------- SDF


def test_an_sdf_world_becomes_bodies_boxes_and_meshes():
    hall = sdf(kinds={"*wall": "wall"}, materials={"rack": "steel", "stack": "carton"}, material="wood")
    scene = hall.scene([])
    assert [b.name for b in scene.bodies] == ["rack", "stack", "bracket", "tank", "north_wall"]
    assert [b.kind for b in scene.bodies] == ["model", "model", "model", "model", "wall"]
    np.testing.assert_array_equal(np.bincount(scene.boxes.body, minlength=5), [2, 2, 0, 0, 1])
    np.testing.assert_array_equal(scene.meshes.body, [2, 2, 3])
    np.testing.assert_array_equal(scene.meshes.closed, [True, False, True])
    assert {scene.materials[m] for m in scene.boxes.material[scene.boxes.body == 1]} == {"carton"}
    np.testing.assert_allclose(scene.bounds, [[0, 2, 0], [10, 8.1, 3]], atol=1e-9)
    assert hall.notes() == [
        "5 bodies: 5 boxes, and 2 solid meshes of 148 triangles",
        "1 mesh is not watertight, with entry loss alone: bracket (1)",
        "left out: <plane> (1)",
    ]


def test_poses_in_poses_units_and_the_axis_that_is_up():
    scene = sdf().scene([])
    boxes = scene.static_boxes()
    crates = boxes.take(boxes.body == 1)  # centimetres and y up: 120 along x, 80 across, 100 high
    np.testing.assert_allclose(crates.center[np.argsort(crates.center[:, 2])], [[7, 5, 0.5], [7, 5, 1.5]], atol=1e-12)
    reach = np.abs(frames.matrix(crates.quaternion)) @ crates.half[..., None]
    np.testing.assert_allclose(reach[..., 0], [[0.6, 0.4, 0.5]] * 2, atol=1e-12)
    posts = boxes.take(boxes.body == 0)  # the rack is turned by a quarter: what was along x is along y
    np.testing.assert_allclose(posts.center, [[3, 2.05, 1], [3, 3.95, 1]], atol=1e-12)


def test_rays_pass_between_the_uprights_and_through_what_is_really_open():
    assert seen(sdf(), [2, 3, 1.0], [4, 3, 1.0])[0] == []
    names, length = seen(sdf(), [2, 2.05, 1.0], [4, 2.05, 1.0])
    assert names == ["rack"]
    assert length[0] == pytest.approx(0.8)
    # the bracket's angle is turned by a quarter about (7, 2): it fills x 6..7 of y 2..2.2 no more, and x 6.8..7 of y 2..3
    assert seen(sdf(), [6.4, 1.5, 0.5], [6.4, 3.5, 0.5])[1] == pytest.approx([0.2])
    assert seen(sdf(), [6.0, 2.6, 0.5], [6.7, 2.6, 0.5])[0] == []
    assert seen(sdf(), [6.0, 2.6, 0.5], [7.5, 2.6, 0.5])[1] == pytest.approx([0.2])


def test_models_are_left_out_by_pattern_and_called_by_the_rest_of_their_names():
    assert [b.name for b in sdf(leave_out=["north*", "tank"], drop_prefix="ra").scene([]).bodies] == ["ck", "stack", "bracket"]
    assert plain_names(["a b", "a/b", "a b", ""]) == ["a_b", "a_b_2", "a_b_3", "thing"]


def test_a_model_alone_is_a_world_and_has_mounts_round_it():
    scene = sdf("models/crate/model.sdf").scene([])
    assert [b.name for b in scene.bodies] == ["crate"]
    names = scene.mounts.name.tolist()
    assert names == ["crate.front.1", "crate.left.1", "crate.back.1", "crate.right.1", "crate.top"]
    np.testing.assert_allclose(scene.mounts.position[0], [0.62, 0, 0], atol=1e-9)
    np.testing.assert_allclose(frames.rotate(scene.mounts.quaternion[1], np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-12)


def test_physics_stops_at_a_mesh_and_bullet_s_rays_are_refused_for_it():
    pytest.importorskip("pybullet")
    from worlds.bullet import Client

    hall = sdf()
    scene = hall.scene([])
    with Client() as client:
        parts = client.load_static(scene)
        client.refresh()
        named = {part.handle.uid: scene.bodies[part.body].name for part in parts}
        hits = client.hits([[6.4, 1.5, 0.5], [6.2, 3.0, 0.5]], [[6.4, 3.5, 0.5], [6.2, 2.4, 0.5]])
    assert named[int(hits.body[0])] == "bracket"
    assert int(hits.body[1]) == -1  # in the angle of the bracket, which its hull would fill
    with pytest.raises(ValueError, match="rays: bullet knows boxes alone, and this world has meshes"):
        hall.caster(scene, "bullet", *losses(scene.materials))


# ---------------------------------------------------------------- meshes


def test_shells_are_told_apart_and_judged_one_by_one():
    ball, can = sphere(0.5), cylinder(0.3, 1.0)
    assert is_closed(ball[1])
    assert volume(*ball) == pytest.approx(4 / 3 * np.pi * 0.125)
    assert volume(*can) == pytest.approx(np.pi * 0.09)
    both = np.concatenate([ball[0], can[0] + [3, 0, 0]]), np.concatenate([ball[1], can[1] + len(ball[0])])
    assert sorted(map(len, shells(both[1]))) == sorted([len(ball[1]), len(can[1])])
    found = solids(*both)
    assert len(found.boxes) == 0
    assert found.meshes.closed.tolist() == [True]
    torn = solids(both[0], np.delete(both[1], 5, axis=0))
    assert torn.meshes.closed.tolist() == [True, False]
    assert torn.open == 1


def test_a_shell_with_triangles_turned_at_random_is_turned_one_way_round():
    points, faces = sphere(1.0)
    wrong = np.where(np.random.default_rng(3).random((len(faces), 1)) < 0.5, faces[:, ::-1], faces)
    assert not is_closed(wrong)
    assert is_closed(oriented(wrong))
    assert abs(volume(points, oriented(wrong))) == pytest.approx(volume(points, faces))


def test_a_cuboid_askew_is_a_box_and_a_hole_in_a_block_is_not():
    points, faces = obj(
        b"v 0 0 0\nv 1 0 0\nv 1 2 0\nv 0 2 0\nv 0 0 3\nv 1 0 3\nv 1 2 3\nv 0 2 3\n"
        b"f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf -8 -4 -1 -5\n",
        "b",
    )
    turn = frames.from_euler(0.3, -0.2, 0.7)
    found = solids(frames.rotate(turn, points), faces)
    assert len(found.boxes) == 1
    assert sorted((2 * found.boxes.half[0]).round(9)) == [1, 2, 3]
    np.testing.assert_allclose(found.boxes.center[0], frames.rotate(turn, np.array([0.5, 1.0, 1.5])), atol=1e-12)
    hollow = solids(np.concatenate([4 * points - [1.5, 3, 4.5], points]), np.concatenate([faces, faces[:, ::-1] + 8]))
    assert len(hollow.boxes) == 0
    np.testing.assert_array_equal(mesh_holder([[0.5, 1, 1.5], [-1, -1, -1]], hollow.meshes), [-1, 0])
    leaning = solids(points @ np.array([[1, 0, 0], [0, 1, 0], [0.1, 0, 1]]), faces)
    assert len(leaning.boxes) == 0
    assert leaning.meshes.closed.tolist() == [True]


def test_stl_is_read_as_text_and_as_bytes():
    points, faces = load_mesh(FILES / "models/bracket/lidless.stl")
    assert len(faces) == 10
    record = np.zeros(10, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = points[faces]
    binary = b"solid but binary".ljust(80) + np.uint32(10).tobytes() + record.tobytes()
    np.testing.assert_allclose(stl(binary, "b.stl")[0], points, atol=1e-7)
    found = solids(points, faces)
    assert (len(found.boxes), found.open) == (0, 1)


@pytest.mark.parametrize(("up", "tall"), [("X_UP", 0), ("Y_UP", 1), ("Z_UP", 2)])
def test_collada_s_up_axis_and_unit(up, tall):
    text = (FILES / "models/crate/crate.dae").read_text().replace("Y_UP", up).replace('meter="0.01"', 'meter="0.5"')
    points, faces = collada(text.encode(), "c.dae")
    own = np.array([120, 100, 80]) * 0.5  # along the file's x, y, z
    wanted = {"X_UP": own[[1, 2, 0]], "Y_UP": own[[0, 2, 1]], "Z_UP": own}[up]
    np.testing.assert_allclose(np.ptp(points, axis=0), wanted)
    assert wanted[2] == own[tall]
    assert volume(points, faces) == pytest.approx(np.prod(own))  # the right way round still


def test_collada_s_primitives_and_nodes():
    source = """<COLLADA><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
      <source id="p"><float_array>0 0 0 9 1 0 0 9 1 1 0 9 0 1 0 9</float_array>
        <technique_common><accessor stride="4"/></technique_common></source>
      <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
      <tristrips><input semantic="NORMAL" offset="0"/>
        <input semantic="VERTEX" offset="1" source="#v"/><p>7 0 7 1 7 3 7 2</p></tristrips>
      <trifans><input semantic="VERTEX" offset="0" source="#v"/><p>0 1 2 3</p></trifans>
      <polygons><input semantic="VERTEX" offset="0" source="#v"/><p>0 1 2 3</p></polygons>
      </mesh></geometry></library_geometries>
      <library_nodes><node id="twice"><instance_geometry url="#g"/></node></library_nodes>
      <library_visual_scenes><visual_scene id="s"><node id="a"><translate>5 0 0</translate>
        <rotate>0 0 1 90</rotate><instance_node url="#twice"/>
        <node id="b"><scale>-2 2 2</scale><instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes>
      <scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    points, faces = collada(source.encode(), "n.dae")
    assert len(faces) == 2 * 6
    a, b, c = points[faces].transpose(1, 0, 2)
    area = np.cross(b - a, c - a)[:, 2] / 2
    np.testing.assert_allclose(area, [0.5] * 6 + [2.0] * 6)  # all face up, the mirrored ones too
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[3, -2, 0], [5, 1, 0]], atol=1e-12)


# ---------------------------------------------------------------- maps


def test_a_building_map_becomes_walls_doors_furniture_and_roads():
    house = BuildingMap(BuildingMap.Config(path=str(FILES / "house.building.yaml"), sizes_m={"*Desk": (1.6, 0.8, 0.75)}))
    scene = house.scene([])
    assert [b.name for b in scene.bodies] == ["wall1", "wall2", "wall3", "wall4", "wall5", "Desk", "Desk_2"]
    assert house.level.scale == pytest.approx(0.02)
    assert scene.roads is not None
    graph = RoadGraph(scene.roads)
    assert graph.length[: len(scene.roads.segments)].sum() == pytest.approx(5.0)
    assert not scene.roads.one_way.any()  # there and back apart is both ways
    np.testing.assert_allclose(scene.roads.nodes, [[1, -2.5], [4, -2.5], [4, -4.5]])
    np.testing.assert_allclose(scene.bodies[5].pose[:3], [8, -3, 0])
    assert seen(house, [-1, -2.5, 1], [0.5, -2.5, 1])[0] == []  # the door stands open
    assert seen(house, [-1, -0.5, 1], [0.5, -0.5, 1])[0] == ["wall5"]
    assert seen(house, [8, -2, 0.5], [8, -4, 0.5])[1] == pytest.approx([1.6])
    shut = BuildingMap(BuildingMap.Config(path=str(FILES / "house.building.yaml"), doors="closed", lanes=False))
    assert seen(shut, [-1, -2.5, 1], [0.5, -2.5, 1])[0] == ["front_door"]
    assert shut.scene([]).roads is None
    assert "left out: 1 of 0.6 m that hang together with no others" in house.notes()


def test_an_occupancy_grid_becomes_merged_boxes():
    room = Occupancy(Occupancy.Config(path=str(FILES / "map.yaml")))
    scene = room.scene([])
    assert len(scene.boxes) == 5
    assert 4 * (scene.boxes.half[:, 0] * scene.boxes.half[:, 1]).sum() == pytest.approx(0.25 * (2 * 20 + 2 * 10 + 6))
    np.testing.assert_allclose(scene.bounds, [[-1, -2, 0], [9, 4, 3]])
    assert seen(room, [2.0, 1.5, 1], [5.5, 1.5, 1])[1] == pytest.approx([1.5])  # the pillar, 8 to 11 cells from -1 m
    assert seen(room, [0.6, -0.4, 1], [1.4, -0.4, 1])[0] == []
    afraid = Occupancy(Occupancy.Config(path=str(FILES / "map.yaml"), unknown="full"))
    assert len(seen(afraid, [0.6, -0.6, 1], [1.4, -0.6, 1])[0]) == 1


def test_an_octile_map_becomes_merged_boxes():
    arena = Grid(Grid.Config(path=str(FILES / "arena.map"), cell_m=0.5, height_m=2.0))
    scene = arena.scene([])
    assert len(scene.boxes) == 6
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [8, 5, 2]])
    assert seen(arena, [2, 3, 1], [4, 3, 1])[1] == pytest.approx([1.0])  # trees
    assert seen(arena, [1.5, 1.75, 1], [3, 1.75, 1])[0] == []  # a swamp can be seen over


def test_rectangles_fill_the_cells_once_each():
    rng = np.random.default_rng(4)
    for shape in ((1, 1), (7, 30), (40, 11)):
        full = rng.random(shape) < 0.6
        covered = np.zeros(shape, dtype=int)
        for top, bottom, left, right in rectangles(full):
            covered[top:bottom, left:right] += 1
        np.testing.assert_array_equal(covered, full)
    assert len(rectangles(np.ones((5, 9), dtype=bool))) == 1
    assert len(rectangles(np.eye(6, dtype=bool))) == 6


def test_grey_maps_as_text_bytes_and_words():
    values = np.arange(6).reshape(2, 3)
    assert pgm(b"P2 # a\n3 2\n# b\n5\n0 1 2 3 4 5\n", "a")[0].tolist() == values.tolist()
    assert pgm(b"P5\n3 2\n5\n" + bytes(range(6)), "a")[0].tolist() == values.tolist()
    assert pgm(b"P5 3 2 999\n" + values.astype(">u2").tobytes(), "a")[0].tolist() == values.tolist()
    with pytest.raises(WorldFileError, match="3 x 2 cells are wanted, 5 are there"):
        pgm(b"P5 3 2 255\n12345", "a")


def test_validate_says_what_became_of_a_file(tmp_path, capsys):
    from testbed.cli import main

    text = f"""name: arena
seed: 1
trials: 1
duration_s: 1
world: {{kind: grid, path: {FILES}/arena.map}}
actors: [{{id: m, kind: marker, motion: parked, position_m: [3, 3], tags: [{{id: t, position_m: [0, 0, 1]}}]}}]
sensors: [{{id: r, kind: rfid, antennas: [{{position_m: [3, 5, 1], aim_m: [3, 3, 1]}}]}}]
estimators: [{{kind: centroid}}]
"""
    (tmp_path / "arena.yaml").write_text(text)
    with pytest.raises(SystemExit) as done:
        main(["validate", str(tmp_path / "arena.yaml")])
    said = capsys.readouterr()
    assert done.value.code == 0
    assert said.err == "arena: 56 of 160 cells are full: 6 boxes\n"
    assert "fine: 1 point(s)" in said.out


def test_the_readme_s_pictures_of_worlds_are_there_and_small():
    root = Path(__file__).parents[2]
    named = [f"world-{kind}.webp" for kind in ("sdf", "building-map", "occupancy", "grid")]
    text = (root / "README.md").read_text()
    for name in named:
        assert f"](.readme/{name})" in text
        assert 5_000 < (root / ".readme" / name).stat().st_size < 150_000
    assert "python .readme/pictures_of_worlds.py" in text


def test_a_run_over_a_file_beside_its_scenario_can_be_made_again_from_anywhere(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "arena.map").write_text((FILES / "arena.map").read_text())
    marker = {"id": "m", "kind": "marker", "motion": "parked", "position_m": [3, 3], "tags": [{"id": "t", "position_m": [0, 0, 1]}]}
    reader = {"id": "r", "kind": "rfid", "antennas": [{"position_m": [3, 5, 1], "aim_m": [3, 3, 1]}]}
    document = {"name": "x", "seed": 1, "trials": 1, "duration_s": 1, "world": {"kind": "grid", "path": "arena.map"}}
    document |= {"actors": [marker], "sensors": [reader], "estimators": [{"kind": "centroid"}]}
    scenario = from_dict(document, folder=tmp_path / "here")
    monkeypatch.chdir(tmp_path)
    again = rebuilt(json.loads(json.dumps(describe(scenario, "none"))))
    monkeypatch.chdir("/")
    with Simulator(again, rays=False) as simulator:
        assert len(simulator.scene.boxes) == 6 + 1  # the marker's own
    assert again.hash == scenario.hash
