"""Bad radio in a scenario file: each mistake is told with its line and column, and with what mends it. No rays are cast."""

from dataclasses import replace

import numpy as np
import pytest

from testbed.quantity import Misplaced
from testbed.radio.regions import REGIONS, hop_table, within_limit
from testbed.scenario import ScenarioError, from_dict, from_text
from testbed.scenario.load import load
from testbed.simulate import Simulator
from worlds.dock_gate import DockGate

TEXT = """\
name: dock
seed: 1
trials: 1
duration_s: 5
world: {kind: dock_gate}
actors:
  - {id: cart, kind: trolley, motion: kinematic, route: {waypoints_m: [[1, 1], [6, 1]]}, tags: [{id: lid, mount: top}]}
sensors:
  - id: portal
    kind: rfid
    antennas:
      - on: gate1
        mount: left_low
      - {id: extra, position_m: [2, 2, 2]}
tags:
  - {id: shelf, position_m: [2.0, 3.0, 1.0]}
"""


def made(text):
    with Simulator(from_text(text, "dock.yaml"), rays=False) as simulator:
        return simulator


def told(text):
    with pytest.raises(ScenarioError) as caught:
        made(text)
    return str(caught.value)


def changed(old, new):
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)


def inside(body_kind, material):
    """(x, y, z) in the middle of a box of some material of the hall's bodies."""
    scene = made(TEXT).scene
    boxes = scene.static_boxes()
    for box in range(len(boxes)):
        if scene.bodies[boxes.body[box]].kind == body_kind and scene.materials[boxes.material[box]] == material:
            return [round(float(x), 4) for x in boxes.center[box]], scene.bodies[boxes.body[box]].name
    raise AssertionError(f"no {body_kind} of {material}")


def test_the_text_is_right():
    simulator = made(TEXT)
    assert simulator.tagged.tags.pattern.tolist() == ["dipole", "dipole"]


@pytest.mark.parametrize(("kind", "material"), [("rack", "steel"), ("gate", "steel"), ("rack", "wood")])
def test_an_antenna_inside_a_body(kind, material):
    place, name = inside(kind, material)
    error = told(changed("[2, 2, 2]", str(place)))
    assert error == (
        f"dock.yaml:14:9 sensors.0.antennas.1: 'extra' is inside {name} ({material}): put it outside, some centimetres off the surface"
    )


def test_an_antenna_inside_the_body_that_carries_it():
    error = told(changed("position_m: [2, 2, 2]", "on: cart, position_m: [0, 0, 0.5]"))
    assert error.startswith("dock.yaml:14:9 sensors.0.antennas.1: 'extra' is inside cart (")


def test_an_antenna_in_a_list_of_one_that_is_no_list():
    place, name = inside("gate", "steel")
    text = TEXT[: TEXT.index("    antennas:")] + f"    antennas: {{position_m: {place}}}\n"
    assert told(text).startswith(f"dock.yaml:11:15 sensors.0.antennas.0: 'portal.1' is inside {name} (steel)")


def test_a_tag_inside_metal_and_one_inside_a_carton():
    place, name = inside("rack", "steel")
    error = told(changed("[2.0, 3.0, 1.0]", str(place)))
    assert error == f"dock.yaml:16:5 tags.0: the tag 'shelf' is inside {name} (steel): put it outside, on the surface or off it"
    goods, _ = inside("rack", "carton")
    assert made(changed("[2.0, 3.0, 1.0]", str(goods))).tagged.tags.id.tolist() == ["lid", "shelf"]


def test_a_tag_inside_the_metal_that_carries_it():
    simulator = made(TEXT)
    scene = simulator.scene
    steel = scene.boxes.take((scene.boxes.body == scene.moving[0]) & (scene.boxes.material == scene.materials.index("steel")))
    text = changed("{id: lid, mount: top}", f"{{id: lid, position_m: {steel.center[0].tolist()}}}")
    assert told(text).startswith("dock.yaml:7:97 actors.0.tags.0: the tag 'lid' is inside cart (steel)")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    antennas:\n      - on: gate1\n        mount: left_low\n      - {id: extra, position_m: [2, 2, 2]}\n", "    antennas: []\n",
         "dock.yaml:11:15 sensors.0.antennas: needs at least 1 items"),
        ("on: gate1", "on: gate9", "dock.yaml:12:9 sensors.0.antennas.0: no body is named 'gate9', did you mean gate"),
        ("left_low", "lefty", "dock.yaml:12:9 sensors.0.antennas.0: 'gate1' offers 0 antenna mounts that fit 'lefty'"),
        ("id: extra,", "id: gate1.left_low,", "dock.yaml:14:9 sensors.0.antennas.1: the antenna 'gate1.left_low' would be there twice"),
        ("mount: left_low", "mount: left_low\n        yaw_deg: 30", "sensors.0.antennas.0: yaw_deg belongs to an antenna with position_m"),
        ("[2, 2, 2]}", "[2, 2, 2], polarisation: eliptical}", "'eliptical' is none of circular, linear"),
        ("id: shelf,", "id: shelf, model: monza_5,", "dock.yaml:16:5 tags.0: unknown tag model 'monza_5', did you mean monza_4?"),
        ("id: shelf,", "id: lid,", "dock.yaml:7:97 actors.0.tags.0: the id 'lid' is given twice, first at dock.yaml:16:5 tags.0"),
        ("    kind: rfid\n", "    kind: rfid\n    channel: {floor: lino}\n", "dock.yaml:11:22 sensors.0.channel.floor: nobody knows"),
        ("    kind: rfid\n", "    kind: rfid\n    power_dbm: 31\n",
         "dock.yaml:13:9 sensors.0.antennas.0: it radiates 37 dBm EIRP (31 dBm and 6 dBi), over the limit of 35.15 dBm (ETSI EN 302 208"),
        ("    kind: rfid\n", "    kind: rfid\n    carriers_mhz: [865.7, 902.75]\n",
         "dock.yaml:11:27 sensors.0.carriers_mhz.1: 902.75 MHz is no carrier of the region 'etsi': the nearest is 867.5"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_place(old, new, message):
    assert message in told(changed(old, new))


@pytest.mark.parametrize(("body", "place"), [("gate1", "dock.yaml:5:8 world"), ("cart", "dock.yaml:7:5 actors.0")])
def test_a_material_that_nobody_knows_is_its_bodys(monkeypatch, body, place):
    whole = DockGate.scene

    def scene(self, actors):
        made = whole(self, actors)
        number = [b.name for b in made.bodies].index(body)
        material = np.where(made.boxes.body == number, len(made.materials), made.boxes.material)
        return replace(made, materials=(*made.materials, "steal"), boxes=made.boxes.with_(material=material))

    monkeypatch.setattr(DockGate, "scene", scene)
    assert told(TEXT) == f"{place}: unknown material 'steal', did you mean steel?"


# ---------------------------------------------------------------- patterns


def with_pattern(pattern):
    return changed("[2, 2, 2]}", f"[2, 2, 2], pattern: {pattern}}}")


def test_a_pattern_in_the_file_is_that_of_its_antenna_alone():
    antennas = made(with_pattern("{angle_deg: [0, 30, 180], gain_db: [0, -3, -20]}")).sensors[0].antennas()
    assert antennas.pattern[1, [0, 15, 30, 105, 180]].tolist() == [0, -1.5, -3, -11.5, -20]
    assert antennas.pattern[0].tolist() != antennas.pattern[0].tolist()  # NaN: cos^n
    assert antennas.front_to_back.tolist() == [18, 20]
    assert antennas.beamwidth[1] == pytest.approx(2 * 30 * 0.017453, rel=0.01)


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("{angle_deg: [0, 30, 180], gain_db: [0, -3]}", "pattern: angle_deg and gain_db go together, and there are 3 angles and 2 gains"),
        ("{angle_deg: [0, 30], gain_db: [0, -3]}", "ends at 30°: go on to 180, or say with beyond_db"),
        ("{angle_deg: [0, 180], gain_db: [6, -3]}", "gain_db is relative to boresight"),
        ("{angle_deg: [0, x], gain_db: [6, -3]}", "dock.yaml:14:69 sensors.0.antennas.1.pattern.angle_deg.1: "),
        ("{csv: none.csv}", "there is no folder to look for 'none.csv' in"),
        ("{csv: a.csv, gain_db: [0]}", "csv brings angle_deg and gain_db: give one or the other"),
        ("{}", "wants two angles at least"),
        ("{angle_deg: [0, 180], gain_db: [0, -3]}, beamwidth_deg: 70", "beamwidth_deg is of an antenna without a table"),
    ],
)
def test_what_is_wrong_with_a_pattern(pattern, message):
    error = told(with_pattern(pattern))
    assert error.startswith("dock.yaml:14:")
    assert message in error


@pytest.fixture
def beside(tmp_path):
    """Writes a scenario with a table beside it and gives the file."""

    def save(table, pattern="{csv: patch.csv}"):
        (tmp_path / "patch.csv").write_text(table)
        (tmp_path / "dock.yaml").write_text(with_pattern(pattern))
        return tmp_path / "dock.yaml"

    return save


def test_a_pattern_from_a_table_is_the_same_as_one_in_the_file(beside):
    scenario = load(beside("gain_db, angle_deg\n0,0\n-3,30\n\n-20,90\n", "{csv: patch.csv, beyond_db: -22}"))
    written = from_text(with_pattern("{angle_deg: [0, 30, 90], gain_db: [0, -3, -20], beyond_db: -22}"), "dock.yaml")
    assert scenario.sensors[0].config == written.sensors[0].config
    assert scenario.hash == written.hash


def test_a_scenario_with_a_table_is_read_again_without_its_folder(beside):
    scenario = load(beside("angle_deg,gain_db\n0,0\n180,-20\n"))
    assert from_dict(scenario.document).sensors[0].config == scenario.sensors[0].config
    assert scenario.document["files"] == {"patch.csv": "angle_deg,gain_db\n0,0\n180,-20\n"}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("angle,gain\n0,0\n", "patch.csv:1: a pattern's columns are angle_deg,gain_db, not 'angle,gain'"),
        ("angle_deg,gain_db\n0,0\n30,low\n", "patch.csv:3: an angle from 0 to 180 and a gain from -200 to 0 dB are wanted, not '30,low'"),
        ("angle_deg,gain_db\n0,0\n30\n", "patch.csv:3: an angle from 0 to 180 and a gain from -200 to 0 dB are wanted, not '30'"),
        ("angle_deg,gain_db\n0,0\n30,nan\n", "patch.csv:3: an angle from 0 to 180"),
        ("angle_deg,gain_db\n0,0\n30,1e999\n", "patch.csv:3: an angle from 0 to 180"),
        ("angle_deg,gain_db\n0,0\n20,-9\n10,-3\n", "angle_deg must ascend, and 10 follows 20"),
        ("angle_deg,gain_db\n0,0\n180,-999\n", "patch.csv:3: an angle from 0 to 180"),
        ('angle_deg,gain_db\n"0,0\n', "not a table of values with commas"),
        ("", "patch.csv:1: a pattern's columns are"),
        ("angle_deg,gain_db\n" + "".join(f"{k / 100},0\n" for k in range(10_002)), "patch.csv:10002: over 10,000 rows"),
    ],
)
def test_what_is_wrong_with_a_table_of_a_pattern(beside, table, message):
    with pytest.raises(ScenarioError) as caught:
        load(beside(table))
    error = str(caught.value)
    assert "dock.yaml:14:" in error
    assert message in error
    assert len(error) < 400


def test_a_table_must_lie_beside_the_scenario(beside):
    with pytest.raises(ScenarioError, match="outside the scenario's folder"):
        load(beside("", "{csv: ../patch.csv}"))


# ---------------------------------------------------------------- regions


def test_a_hop_table_is_the_regions_or_a_choice_from_it_in_the_order_given():
    assert hop_table("etsi").tolist() == REGIONS["etsi"].carriers.tolist()
    assert hop_table("fcc", [927.25, 902.75]).tolist() == [927.25e6, 902.75e6]


@pytest.mark.parametrize(
    ("region", "chosen", "place", "message"),
    [
        ("etsi", [865.7, 902.75], 1, "902.75 MHz is no carrier of the region 'etsi': the nearest is 867.5 (it has 4, from 865.7 to 867.5)"),
        ("fcc", [865.7], 0, "the nearest is 902.75 (it has 50, from 902.75 to 927.25)"),
        ("etsi", [865.9], 0, "the nearest is 865.7"),
        ("etsi", [865.7, 866.3, 865.7], 2, "865.7 MHz comes twice"),
        ("etsi", [], None, "no carrier is left"),
    ],
)
def test_a_carrier_outside_the_region_has_its_place(region, chosen, place, message):
    with pytest.raises(Misplaced) as caught:
        hop_table(region, chosen)
    assert message in str(caught.value)
    assert caught.value.place == ("carriers_mhz",) + (() if place is None else (place,))


def test_the_limit_of_power_says_what_would_be_allowed():
    within_limit("etsi", 29.15, 6.0)
    within_limit("fcc", 30.0, 6.0)
    with pytest.raises(ValueError, match=r"it radiates 36 dBm EIRP .* over the limit of 35.15 dBm .*: at most 29.15 dBm go"):
        within_limit("etsi", 30.0, 6.0)
