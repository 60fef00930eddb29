"""Files of strangers that mean harm, or are broken: refused in one sentence. What no one thought of: read or refused, never a traceback."""

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from testbed.quantity import FileMissing, UnusableFile
from testbed.scenario import DataMissing, ScenarioError, from_dict
from testbed.simulate import Simulator
from worlds.building_map import BuildingMap
from worlds.grid import Grid
from worlds.importers import collada as collada_module
from worlds.importers import files, mesh_files
from worlds.importers.cells import octile, pgm
from worlds.importers.collada import collada
from worlds.importers.files import WorldFileError, xml
from worlds.importers.mesh_files import load_mesh, obj, stl
from worlds.importers.solids import solids
from worlds.occupancy import Occupancy
from worlds.sdf import Sdf

FILES = Path(__file__).parents[1] / "files" / "worlds"
WRAP = '<sdf version="1.6"><model name="m">{}</model></sdf>'
SHAPE = '<link name="l"><collision name="c"><geometry>{}</geometry></collision></link>'


def sdf_of(folder, content):
    (folder / "w.sdf").write_text(content)
    return Sdf(Sdf.Config(path=str(folder / "w.sdf"))).scene([])


def house_of(folder, old, new):
    text = (FILES / "house.building.yaml").read_text()
    assert old in text
    (folder / "b.yaml").write_text(text.replace(old, new))
    return BuildingMap(BuildingMap.Config(path=str(folder / "b.yaml"))).scene([])


def map_of(folder, old="", new="", image=None):
    text = (FILES / "map.yaml").read_text()
    (folder / "map.yaml").write_text(text.replace(old, new) if old else text)
    shutil.copy(FILES / "map.pgm", folder / "map.pgm")
    return Occupancy(Occupancy.Config(path=str(folder / "map.yaml"), image=image)).scene([])


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize(
    "uri", ["model://../../etc", "model:///etc", "model://..", "model://a/../../..", "model://a\\..\\b", "model://C:/x", "model://"]
)
def test_an_include_can_t_leave_the_world_s_folders(tmp_path, uri):
    with pytest.raises(WorldFileError, match=r"leads out of|is no path inside"):
        sdf_of(tmp_path, WRAP.format(f"<include><uri>{uri}</uri></include>"))


@pytest.mark.parametrize(
    "uri", ["../../../etc/passwd.stl", "/etc/passwd.stl", "model://crate/../../../x.stl", "file:///etc/x.stl", "a/../../x.obj"]
)
def test_a_mesh_can_t_lie_outside_of_the_world_s_folders(tmp_path, uri):
    (tmp_path / "models" / "crate").mkdir(parents=True)
    with pytest.raises(WorldFileError, match=r"leads out of|is no path inside"):
        sdf_of(tmp_path, WRAP.format(SHAPE.format(f"<mesh><uri>{uri}</uri></mesh>")))


def test_a_link_out_of_the_folder_is_followed_and_refused(tmp_path):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "x.stl").write_text("solid x\nendsolid x\n")
    (tmp_path / "world").mkdir()
    (tmp_path / "world" / "x.stl").symlink_to(tmp_path / "secret" / "x.stl")
    with pytest.raises(WorldFileError, match="leads out of world/"):
        sdf_of(tmp_path / "world", WRAP.format(SHAPE.format("<mesh><uri>x.stl</uri></mesh>")))


def test_a_map_s_image_can_t_lie_elsewhere(tmp_path):
    with pytest.raises(WorldFileError, match="leads out of"):
        map_of(tmp_path, "map.pgm", "../../secret.pgm")
    with pytest.raises(WorldFileError, match=r"there is no 'other\.pgm' beside it; name the grey map that there is"):
        map_of(tmp_path, "map.pgm", "other.pgm")
    assert len(map_of(tmp_path, "map.pgm", "other.png", image="map.pgm").boxes) == 5


def test_only_models_of_the_folder_are_included(tmp_path):
    for uri in ("https://fuel.gazebosim.org/x", "file:///etc", "x"):
        with pytest.raises(WorldFileError, match="only model:// names are included"):
            sdf_of(tmp_path, WRAP.format(f"<include><uri>{uri}</uri></include>"))
    with pytest.raises(WorldFileError, match="there is no model 'model://nobody' in"):
        sdf_of(tmp_path, WRAP.format("<include><uri>model://nobody</uri></include>"))


# ---------------------------------------------------------------- bombs


def test_entities_and_document_types_are_refused(tmp_path):
    laughs = '<!DOCTYPE s [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><sdf><model name="&b;"/></sdf>'
    for text in (
        laughs,
        '<!DOCTYPE s SYSTEM "file:///etc/passwd"><sdf/>',
        '<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/passwd">]><sdf>&x;</sdf>',
    ):
        with pytest.raises(WorldFileError, match="declares document types or entities"):
            sdf_of(tmp_path, text)
        with pytest.raises(WorldFileError, match="declares document types or entities"):
            collada(text.encode(), "x.dae")


def test_elements_nested_without_end_are_refused():
    with pytest.raises(WorldFileError, match="elements lie in more than 100 others"):
        xml(b"<a>" * 5000 + b"</a>" * 5000, "x")


def test_models_that_include_themselves_or_each_other_often_are_refused(tmp_path, monkeypatch):
    for name, inner in (
        ("self", "<include><uri>model://self</uri></include>"),
        ("wide", "<include><uri>model://wide2</uri></include>" * 60),
        ("wide2", "<include><uri>model://leaf</uri></include>" * 60),
        ("leaf", "<link name='l'/>"),
    ):
        (tmp_path / "models" / name).mkdir(parents=True)
        (tmp_path / "models" / name / "model.sdf").write_text(WRAP.format(inner))
    with pytest.raises(WorldFileError, match="include each other more than 16 deep: does one include itself"):
        sdf_of(tmp_path, WRAP.format("<include><uri>model://self</uri></include>"))
    monkeypatch.setattr("worlds.importers.sdf_file.MAX_MODELS", 2000)
    with pytest.raises(WorldFileError, match="more than 2,000 models with all that they include"):
        sdf_of(tmp_path, WRAP.format("<include><uri>model://wide</uri></include>"))


def test_nodes_of_a_mesh_that_name_each_other_are_refused():
    scene = '<library_visual_scenes><visual_scene id="s"><node id="a">{}</node></visual_scene></library_visual_scenes>'
    with pytest.raises(WorldFileError, match="its nodes name each other more than 20,000 times over"):
        collada(("<COLLADA>" + scene.format('<instance_node url="#a"/>') + "</COLLADA>").encode(), "x.dae")
    with pytest.raises(WorldFileError, match="its nodes name each other more than 20,000 times over"):
        collada(("<COLLADA>" + scene.format('<instance_node url="#a"/>' * 2) + "</COLLADA>").encode(), "x.dae")


def test_files_beyond_the_limits_are_refused(tmp_path, monkeypatch):
    with pytest.raises(WorldFileError, match="over 0 MB, which is more than a file of its kind may hold"):
        load_mesh(FILES / "models/bracket/angle.obj", limit=100)
    monkeypatch.setattr(collada_module, "MAX_TRIANGLES", 5)
    with pytest.raises(WorldFileError, match="more than 5 triangles"):
        collada((FILES / "models/crate/crate.dae").read_bytes(), "crate.dae")
    monkeypatch.setattr(mesh_files, "MAX_TRIANGLES", 5)
    with pytest.raises(WorldFileError, match="more than 5 triangles"):
        load_mesh(FILES / "models/bracket/angle.obj")
    assert files.MAX_MESH <= 50_000_000


def test_an_archive_is_no_mesh(tmp_path):
    zipped = b"PK\x03\x04" + bytes(100)
    for suffix, said in (("dae", "is no XML"), ("stl", "is no STL"), ("zip", "meshes are read from .dae, .stl, .obj, not from .zip")):
        (tmp_path / f"x.{suffix}").write_bytes(zipped)
        with pytest.raises(WorldFileError, match=said):
            load_mesh(tmp_path / f"x.{suffix}")


@pytest.mark.parametrize("head", [b"P5 20001 1 255\n", b"P5 19999 19999 255\n", b"P2 0 5 255\n", b"P5 999999999 999999999 255\n"])
def test_grey_maps_too_large_are_refused_by_their_header(head):
    with pytest.raises(WorldFileError, match="up to 20,000 a side and 25,000,000 in all are read"):
        pgm(head, "m.pgm")


def test_octile_maps_too_large_or_not_as_told_are_refused(tmp_path):
    good = (FILES / "arena.map").read_text()
    for old, new, said in (
        ("height 10", "height 900000", "up to 20,000 a side"),
        ("height 10", "height 11", "11 rows are wanted, 10 are there"),
        ("width 16", "width 15", ":5: a row of 15 cells is wanted"),
        ("TT", "T?", r":8: '\?' is no cell"),
        ("type octile", "typo", "is no octile map"),
        ("width 16", "width -1", "height and width are not told"),
    ):
        with pytest.raises(WorldFileError, match=said):
            octile(good.replace(old, new, 1), "a.map")
    (tmp_path / "a.map").write_text(good)
    (tmp_path / "w.map").write_text("type octile\nheight 1\nwidth 200\nmap\n" + "@" * 200 + "\n")
    wide = Grid(Grid.Config(path=str(tmp_path / "w.map"), cell_m=100))
    with pytest.raises(WorldFileError, match="farther than 10 km"):
        wide.scene([])


def test_yaml_with_aliases_tags_or_depth_is_refused(tmp_path):
    for text, said in (
        ("a: &x [1]\nb: *x\n", r"repeats a part by \*x"),
        ("a: !!python/object/apply:os.system ['true']\n", "is no YAML|is no plain YAML"),
        ("[" * 60 + "]" * 60, "values lie in more than 40 others"),
        ("a: [", "b.yaml:.*is no YAML"),
        ("- 1\n", "a mapping is wanted, not"),
    ):
        (tmp_path / "b.yaml").write_text(text)
        with pytest.raises(WorldFileError, match=said):
            BuildingMap(BuildingMap.Config(path=str(tmp_path / "b.yaml"))).scene([])


# ---------------------------------------------------------------- numbers that are none


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ("1e9 0 0 0 0 0", "numbers up to ±10000 are wanted, not 1e\\+09"),
        ("nan 0 0 0 0 0", "not nan"),
        ("inf 0 0 0 0 0", "not inf"),
        ("1 2 3", "6 numbers are wanted, not 3"),
        ("one 0 0 0 0 0", "is not numbers"),
    ],
)
def test_absurd_poses_are_refused(tmp_path, pose, said):
    with pytest.raises(WorldFileError, match=said):
        sdf_of(tmp_path, WRAP.format(f"<pose>{pose}</pose>" + SHAPE.format("<box><size>1 1 1</size></box>")))


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ("<box><size>1 0 1</size></box>", "must be above 0"),
        ("<box><size>-1 1 1</size></box>", "must be above 0"),
        ("<box/>", "3 numbers are wanted, not 0"),
        ("<sphere><radius>1e300</radius></sphere>", "numbers up to"),
        ("<mesh><uri>x.stl</uri><scale>0 1 1</scale></mesh>", "a scale of 0 leaves nothing"),
        ("<mesh><uri>x.stl</uri></mesh>", "there is no mesh 'x.stl'"),
        ("<mesh><uri>x.stl</uri><submesh/></mesh>", "a submesh is not read"),
    ],
)
def test_absurd_shapes_are_refused(tmp_path, shape, said):
    with pytest.raises(WorldFileError, match=said):
        sdf_of(tmp_path, WRAP.format(SHAPE.format(shape)))


def test_absurd_meshes_are_refused(tmp_path):
    shape = WRAP.format(SHAPE.format("<mesh><uri>x.obj</uri><scale>1000 1000 1000</scale></mesh>"))
    for text, said in (
        ("v 0 0 0\nv 100 0 0\nv 0 1 0\nf 1 2 3\n", "a corner lies more than 10 km away"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 2\n", "has no surface"),
        ("v 0 0 nan\n", "a corner is not finite"),
        ("v 0 0 0\nf 1 2 9\n", "a corner that is not there"),
        ("v 0 0\n", "x.obj:1: 'v 0 0' is no corner"),
    ):
        (tmp_path / "x.obj").write_text(text)
        with pytest.raises(WorldFileError, match=said):
            sdf_of(tmp_path, shape)
    with pytest.raises(WorldFileError, match="a unit of 0 m is none"):
        collada(b'<COLLADA><asset><unit meter="0"/></asset></COLLADA>', "x.dae")
    with pytest.raises(WorldFileError, match="up_axis is one of"):
        collada(b"<COLLADA><asset><up_axis>UP</up_axis></asset></COLLADA>", "x.dae")


def test_worlds_with_nothing_in_them_or_of_another_kind_are_refused(tmp_path):
    for text, said in (
        ("<sdf/>", "there is no model in it"),
        ("<robot/>", "is no SDF, its root is <robot>"),
        ("", "is no XML"),
        (WRAP.format(""), "nothing of it is above the floor|nothing"),
        ("<sdf><world><include><uri>model://x</uri></include></world></sdf>", "there is no model 'model://x'"),
    ):
        with pytest.raises(UnusableFile, match=said):
            sdf_of(tmp_path, text)
    with pytest.raises(WorldFileError, match="is told in the frame 'other'"):
        sdf_of(tmp_path, WRAP.format('<pose relative_to="other">0 0 0 0 0 0</pose>'))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[0, 1, {distance: [3, 10]}]", "[0, 1, {distance: [3, 100]}]", "its measurements disagree: from 0.02 to 0.2 m a pixel"),
        ("[0, 1, {distance: [3, 10]}]", "[0, 1, {distance: [3, -10]}]", "-10 m over 500 pixels is no scale"),
        ("[0, 1, {distance: [3, 10]}]", "[0, 0, {distance: [3, 10]}]", "10 m over 0 pixels is no scale"),
        ("- [0, 1, {}]", "- [0, 99, {}]", "walls.0: there is no vertex 99, they are 0 to 10"),
        ("- [0, 1, {}]", "- [0, true, {}]", "there is no vertex True"),
        ("- [500, 300, 0, '']", "- [1.0e+300, 300, 0, '']", "vertices.2: a number up to"),
        ("- [500, 300, 0, '']", "- [5.0e+6, 300, 0, '']", "lies more than 10 km away|its measurements disagree"),
        ("- [500, 300, 0, '']", "- [.nan, 300, 0, '']", "vertices.2: a number up to"),
        ("x: 400, y: 150", "x: 4.0e+6, y: 150", "models.0: it lies more than 10 km away"),
        ("reference_image", "wgs84", "not in 'wgs84'"),
        ("levels:\n  L1:", "levels:\n  L0: {}\n  L1:", "say which level is wanted, of L0, L1"),
        ("- [6, 7, {bidirectional", "- [6, 6, {bidirectional", "a lane from vertex 6 to vertex 6 has no length"),
        (
            "      - [8, 7, {bidirectional: [4, false], graph_idx: [2, 0]}]\n",
            "",
            "its lanes are no network .* lanes: false leaves them out",
        ),
    ],
)
def test_building_maps_that_make_no_sense_are_refused(tmp_path, old, new, said):
    with pytest.raises(WorldFileError, match=said):
        house_of(tmp_path, old, new)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("resolution: 0.5", "resolution: 0", "resolution is a number from 0.001 to 100"),
        ("resolution: 0.5", "resolution: .nan", "resolution is a number"),
        ("origin: [-1.0, -2.0, 0.0]", "origin: [1e9, 0, 0]", "origin is x, y and yaw"),
        ("origin: [-1.0, -2.0, 0.0]", "origin: 3", "origin is x, y and yaw"),
        ("occupied_thresh: 0.65", "occupied_thresh: yes", "occupied_thresh is a number"),
        ("image: map.pgm", "image: 3", "it doesn't name its image"),
    ],
)
def test_map_files_that_make_no_sense_are_refused(tmp_path, old, new, said):
    with pytest.raises(WorldFileError, match=said):
        map_of(tmp_path, old, new)


# ---------------------------------------------------------------- in a scenario


def test_a_missing_world_is_data_missing_and_a_broken_one_a_mistake_with_its_place(tmp_path):
    marker = {"id": "m", "kind": "marker", "motion": "parked", "position_m": [0, 0], "tags": [{"id": "t", "position_m": [0, 0, 1]}]}
    reader = {"id": "r", "kind": "rfid", "antennas": [{"position_m": [0, 0, 1], "aim_m": [1, 0, 1]}]}
    document = {"name": "x", "seed": 1, "trials": 1, "duration_s": 1, "world": {"kind": "sdf", "path": "gone.sdf"}}
    document |= {"actors": [marker], "sensors": [reader], "estimators": [{"kind": "centroid"}]}
    with (
        pytest.raises(DataMissing, match=r"world: path: there is no file 'gone\.sdf' on this machine"),
        Simulator(from_dict(document, folder=tmp_path)),
    ):
        pass
    (tmp_path / "gone.sdf").write_text("<sdf/>")
    with (
        pytest.raises(ScenarioError, match=r"world: gone\.sdf: there is no model in it") as caught,
        Simulator(from_dict(document, folder=tmp_path)),
    ):
        pass
    assert not isinstance(caught.value, DataMissing)
    with pytest.raises(FileMissing):
        Sdf(Sdf.Config(path="nowhere/at/all.sdf")).scene([])
    with pytest.raises(ScenarioError, match="nobody knows the material 'cheese'"):
        from_dict({**document, "world": {"kind": "sdf", "path": "x", "material": "cheese"}})


# ---------------------------------------------------------------- fuzz: read or refused


def read_or_refused(read, *args):
    """What is read, None where it is refused in one line."""
    refused = ""
    try:
        found = read(*args)
    except UnusableFile as error:
        found, refused = None, str(error)
    assert "\n" not in refused
    assert found is not None or refused
    return found


SEEDS = {
    "dae": (FILES / "models/crate/crate.dae").read_bytes(),
    "obj": (FILES / "models/bracket/angle.obj").read_bytes(),
    "stl": (FILES / "models/bracket/lidless.stl").read_bytes(),
    "map": (FILES / "arena.map").read_bytes(),
    "pgm": (FILES / "map.pgm").read_bytes(),
    "sdf": (FILES / "hall.sdf").read_bytes(),
    "building.yaml": (FILES / "house.building.yaml").read_bytes(),
    "yaml": (FILES / "map.yaml").read_bytes(),
}
ODD = [b"nan", b"-1", b"1e308", b"99999999999", b"", b"<", b"&x;", b"\0", b"\xff", b"'", b"[", b"0", b"#", b"../x", b": ", b"\n"]


@st.composite
def damaged(draw, kind):
    """A file with some pieces cut out, doubled, or put in."""
    content = SEEDS[kind]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(content)))
        width = draw(st.integers(0, 40))
        piece = draw(st.one_of(st.sampled_from(ODD), st.binary(max_size=12), st.just(content[at : at + 2 * width])))
        content = content[:at] + piece + content[at + width :]
    return content


fuzz = settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize(("kind", "read"), [("dae", collada), ("obj", obj), ("stl", stl)], ids=["dae", "obj", "stl"])
@given(data=st.data())
@fuzz
def test_any_mesh_is_read_or_refused(kind, read, data):
    content = data.draw(st.one_of(damaged(kind), st.binary(max_size=200)))
    found = read_or_refused(read, content, f"x.{kind}")
    if found is not None and len(found[1]):
        assert found[1].max() < len(found[0])
        if abs(found[0]).max() < 1e6:
            solids(*found)


@given(data=st.data())
@fuzz
def test_any_map_of_cells_is_read_or_refused(data):
    read_or_refused(pgm, data.draw(st.one_of(damaged("pgm"), st.binary(max_size=60).map(lambda b: b"P2 3 2 9\n" + b))), "x.pgm")
    read_or_refused(octile, data.draw(damaged("map")).decode(errors="replace"), "x.map")


@pytest.mark.parametrize("kind", ["sdf", "building.yaml", "yaml", "map"])
@given(data=st.data())
@fuzz
def test_any_world_is_read_or_refused(tmp_path, kind, data):
    content = data.draw(st.one_of(damaged(kind), st.binary(max_size=100)))
    place = tmp_path / f"x.{kind}"
    place.write_bytes(content)
    world = {"sdf": Sdf, "building.yaml": BuildingMap, "yaml": Occupancy, "map": Grid}[kind]
    more = {"model_path": [str(FILES / "models")]} if kind == "sdf" else {}
    if kind == "yaml":
        shutil.copy(FILES / "map.pgm", tmp_path / "map.pgm")
    scene = read_or_refused(lambda: world(world.Config(path=str(place), **more)).scene([]))
    assert scene is None or (scene.bounds[1] > scene.bounds[0]).all()
