import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from testbed import frames
from testbed.geometry import Boxes, Mounts
from testbed.protocols import ActorPlan
from worlds.actors.forklift import Forklift
from worlds.actors.trolley import Trolley
from worlds.aisles import Aisles
from worlds.dock_gate import DIVIDE, DockGate
from worlds.open_floor import OpenFloor
from worlds.parts import MATERIALS, TAGS_ACROSS, Builder, GateSize, RackSize, carton, floor_pose, gate, pallet_stack, rack, tray, wall


def make_rack(fill, liquid=0.0, seed=1, **size):
    return rack("r", floor_pose(0, 0), RackSize(**size), fill, liquid, np.random.default_rng(seed))


def count(part, material):
    return int((part.boxes.material == MATERIALS.index(material)).sum())


def looks(part):
    return frames.rotate(part.mounts.quaternion, np.array([1.0, 0.0, 0.0]))


def enters(part, start, direction, reach):
    """Whether a ray of length `reach` m meets a box of the part (axis-parallel ones, by slabs)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = part.boxes.center - part.boxes.half, part.boxes.center + part.boxes.half
        a, b = (low - start) / direction, (high - start) / direction
    near, far = np.nanmax(np.minimum(a, b), axis=1), np.nanmin(np.maximum(a, b), axis=1)
    beside = ((direction == 0) & ((start < low) | (start > high))).any(axis=1)
    return bool(((near <= far) & (far > 0) & (near < reach) & ~beside).any())


def test_an_empty_rack_is_steel_and_boards():
    part = make_rack(fill=0.0, bays=3, levels=3)
    assert count(part, "steel") == 4 * 2 + 3 * 2 * 2  # uprights in front and back; two beams for each bay and shelf
    assert count(part, "wood") == 3 * 2
    assert len(part.boxes) == 20 + 6


def test_every_bay_of_a_full_rack_is_loaded_and_an_average_one_as_often_as_it_says():
    goods = [MATERIALS.index(m) for m in ("rack_bay", "carton", "liquid_pallet")]
    full = make_rack(fill=1.0, liquid=0.2, bays=5, levels=4)
    pitch, size = 2.8, RackSize(bays=5, levels=4)
    for bay in range(5):
        left = -size.length / 2 + bay * pitch
        for level in range(4):
            here = (np.abs(full.boxes.center[:, 0] - left - pitch / 2 - 0.05) < pitch / 2) & (
                np.abs(full.boxes.center[:, 2] - (level + 0.5) * 1.5) < 0.75
            )
            assert np.isin(full.boxes.material[here], goods).any()
    bays_used = [
        len({(round(x), round(z)) for x, z in p.boxes.center[p.boxes.material == goods[0]][:, [0, 2]]})
        for p in (make_rack(0.5, seed=s, bays=40, levels=5) for s in range(4))
    ]
    # 800 places, a quarter of them packed full: 200 ± 4 standard deviations (false alarm 6e-5)
    assert abs(sum(bays_used) - 200) < 4 * np.sqrt(800 * 0.25 * 0.75)


def test_liquid_alone_where_all_is_liquid():
    part = make_rack(fill=1.0, liquid=1.0)
    assert count(part, "liquid_pallet") > 0
    assert count(part, "carton") == count(part, "rack_bay") == 0


def test_rack_mounts_are_grouped_by_bay_and_face_the_front():
    part = make_rack(fill=0.7, bays=2, levels=3)
    assert sorted(set(part.mounts.group)) == ["bay1", "bay2"]
    assert list(part.mounts.name[:2]) == ["bay1.1", "bay1.2"]
    assert len(part.mounts) == 2 * 3 * TAGS_ACROSS
    np.testing.assert_allclose(looks(part), np.tile([0.0, -1.0, 0.0], (len(part.mounts), 1)), atol=1e-12)
    assert (part.mounts.position[:, 1] < -RackSize().depth / 2).all()


def test_the_same_seed_makes_the_same_rack_and_another_one_another():
    assert make_rack(0.6).boxes.equals(make_rack(0.6).boxes)
    assert not make_rack(0.6).boxes.equals(make_rack(0.6, seed=2).boxes)


@settings(max_examples=30, deadline=None)
@given(st.floats(1.0, 4.0), st.floats(2.0, 4.0), st.floats(0.0, 1.0))
def test_gate_antennas_look_across_the_passage_low_ones_back_and_high_ones_ahead(width, height, toe):
    part = gate("g", floor_pose(0, 0), GateSize(width, height, toe=toe))
    look = dict(zip(part.mounts.name, looks(part), strict=True))
    place = dict(zip(part.mounts.name, part.mounts.position, strict=True))
    for side, sign in (("left", 1), ("right", -1)):
        assert sign * place[f"{side}_low"][1] > 0
        for level, ahead in (("low", -1), ("high", 1)):
            np.testing.assert_allclose(look[f"{side}_{level}"], [ahead * np.sin(toe), -sign * np.cos(toe), 0], atol=1e-12)
        np.testing.assert_allclose(look[f"top_{side}"], [0, 0, -1], atol=1e-12)
    inside = np.abs(part.boxes.center[:, 1]) - part.boxes.half[:, 1]
    assert inside[:2].min() == pytest.approx(width / 2)  # the passage is clear


def test_a_wall_is_open_where_its_doors_are_and_closed_above_them():
    part = wall("w", (0, 0), (10, 0), 4.0, openings=[(2, 4), (6, 7)], door_height=3.0)
    through = np.array([0.0, 1.0, 0.0])

    def closed(x, z):
        return enters(part, np.array([x, -1.0, z]), through, 2.0)

    assert [closed(x, 1.0) for x in (1, 3, 5, 6.5, 9)] == [True, False, True, False, True]
    assert closed(3, 3.5)
    assert closed(6.5, 3.5)
    with pytest.raises(ValueError, match="w: openings must be ascending and lie within 10 m"):
        wall("w", (0, 0), (10, 0), 4.0, openings=[(6, 7), (2, 4)])
    with pytest.raises(ValueError, match="openings"):
        wall("w", (0, 0), (10, 0), 4.0, openings=[(9, 11)])


@pytest.mark.parametrize(
    "part",
    [
        gate("g", floor_pose(0, 0), GateSize()),
        wall("w", (0, 0), (8, 0), 4.0, antennas=3),
        tray("t", (0, 0), (8, 0), 4.0, antennas=3),
        pallet_stack("p", floor_pose(0, 0)),
        carton("c", floor_pose(0, 0)),
        make_rack(1.0),
    ],
    ids=lambda p: p.kind,
)
def test_mounts_look_away_from_the_surface_that_is_just_behind_them(part):
    for position, look, use in zip(part.mounts.position, looks(part), part.mounts.use, strict=True):
        assert enters(part, position, -look, 0.08) or use == "antenna"  # an antenna may be toed in: its back is further off
        assert not enters(part, position, look, 0.3)


def test_a_box_wants_ordered_corners():
    with pytest.raises(ValueError, match="a box of wood wants its corners ordered"):
        Builder().box("wood", (0, 0, 1), (1, 1, 0))


@settings(max_examples=30, deadline=None)
@given(st.floats(0.4, 2), st.floats(0.4, 1.5), st.floats(0.6, 2.2), st.floats(0, 1), st.booleans())
def test_a_trolley_of_any_size_is_sound(length, width, height, load, pusher):
    actor = Trolley(Trolley.Config(length_m=length, width_m=width, height_m=height, load=load, pusher=pusher))
    boxes, _ = actor.boxes()
    assert boxes.center[:, 0].max() + 0.01 < length
    assert ("person" in {MATERIALS[m] for m in boxes.material}) == pusher
    chassis = actor.chassis()
    assert chassis.com[0] == pytest.approx(length / 2 - 0.12)


def test_more_load_is_more_cartons_higher_up():
    def top(load):
        boxes, _ = Trolley(Trolley.Config(load=load)).boxes()
        mine = boxes.material == MATERIALS.index("carton")
        return (boxes.center + boxes.half)[mine, 2].max(initial=0.2)

    assert top(0.0) < top(0.3) < top(0.6) < top(1.0) < 1.7


@pytest.mark.parametrize(("load", "material"), [("none", None), ("cartons", "carton"), ("liquid", "liquid_pallet")])
def test_a_forklift_carries_what_it_says(load, material):
    actor = Forklift(Forklift.Config(load=load))
    carried = {MATERIALS[m] for m in actor.boxes()[0].material} & {"carton", "liquid_pallet"}
    assert carried == ({material} if material else set())
    assert (actor.chassis().mass > 3000) == (load != "none")


@pytest.mark.parametrize(
    ("config", "sentence"),
    [
        ({"gates": 4}, "4 gates need a hall 16 m wide, width_m is 12"),
        ({"parked_trolleys": 11}, "parked_trolleys: 11 asked for, beside 2 gates there is room for 8"),
        ({"antenna_high_m": 2.7}, "the antennas must hang below the crossbar"),
        ({"rack_levels": 4, "height_m": 4.5}, "4 levels of 1.5 m don't fit under height_m 4.5"),
        ({"gates": 0}, "greater than or equal to 1"),
        ({"fill": 1.2}, "less than or equal to 1"),
        ({"gate": 1}, "Extra inputs are not permitted"),
    ],
)
def test_a_dock_that_can_not_be_built_is_refused_in_a_sentence(config, sentence):
    with pytest.raises(ValidationError, match=sentence):
        DockGate.Config(**config)


def test_parked_trolleys_stand_beside_the_doors_and_leave_the_passages_free():
    scene = DockGate(DockGate.Config(parked_trolleys=8)).scene([])
    parked = [b for b in scene.bodies if b.name.startswith("parked")]
    gates = [b for b in scene.bodies if b.kind == "gate"]
    assert [b.name for b in parked] == [f"parked{i}" for i in range(1, 9)]
    assert len(gates) == 2
    for trolley in parked:
        assert min(abs(trolley.pose[1] - g.pose[1]) for g in gates) > 1.6 + 0.35  # half a door and half a trolley
        assert abs(trolley.pose[0] - DIVIDE) < 1
    first = [abs(b.pose[1] - gates[0].pose[1]) for b in parked]
    assert first == sorted(first)
    assert {int(b.pose[0] > DIVIDE) for b in parked[:2]} == {0, 1}


def test_a_parked_trolley_more_changes_nothing_else_of_the_hall():
    few, many = (DockGate(DockGate.Config(parked_trolleys=n)).scene([]) for n in (3, 4))
    named = {b.name: b.pose for b in many.bodies}
    assert set(named) - {b.name for b in few.bodies} == {"parked4"}
    assert all(np.array_equal(b.pose, named[b.name]) for b in few.bodies)
    rack_boxes = [s.boxes.take(np.isin(s.boxes.body, [i for i, b in enumerate(s.bodies) if b.kind == "rack"])) for s in (few, many)]
    assert np.array_equal(rack_boxes[0].center, rack_boxes[1].center)


def test_zones_tell_inside_from_outside():
    zones = DockGate(DockGate.Config()).scene([]).zones
    located = zones.locate([[2.0, 3.0, 0.5], [8.0, 3.0, 0.5], [30.0, 3.0, 0.5]])
    assert [str(zones.name[i]) if i >= 0 else None for i in located] == ["outside", "inside", None]


def test_aisles_are_as_wide_as_they_say_and_their_roads_run_down_the_middle():
    hall = Aisles(Aisles.Config(aisles=3, aisle_width_m=2.4))
    scene = hall.scene([])
    roads = hall.roads()
    assert roads is not None
    racks = {b.name: i for i, b in enumerate(scene.bodies) if b.kind == "rack"}
    static = scene.static_boxes()
    for aisle in range(3):
        below = static.take(static.body == racks[f"rack{2 * aisle + 1}"])
        above = static.take(static.body == racks[f"rack{2 * aisle + 2}"])
        top, bottom = (below.center + below.half)[:, 1].max(), (above.center - above.half)[:, 1].min()
        assert bottom - top == pytest.approx(2.4, abs=1e-9)
        np.testing.assert_allclose(roads.nodes[[2 * aisle, 2 * aisle + 1], 1], (top + bottom) / 2)


def test_posts_look_at_the_middle_of_the_floor():
    scene = OpenFloor(OpenFloor.Config(posts=8, length_m=10, width_m=6)).scene([])
    pose = scene.rest_poses()[scene.mounts.body]
    place = frames.to_world(pose, scene.mounts.position)
    look = frames.rotate(frames.multiply(pose[:, 3:], scene.mounts.quaternion), np.array([1.0, 0.0, 0.0]))
    to_middle = np.array([5.0, 3.0, 1.0]) - place
    angle = np.arccos(np.clip((look * to_middle).sum(axis=1) / np.linalg.norm(to_middle, axis=1), -1, 1))
    assert np.degrees(angle).max() < 1.5
    assert len(place) == 16


class Oddity:
    def boxes(self):
        return Boxes(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3))), ("adamantium",)

    def mounts(self):
        return Mounts.empty()


def test_an_unknown_material_is_refused_with_the_actor_named():
    plan = ActorPlan("odd", "oddity", "parked", Oddity(), None, floor_pose(1, 1))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="actor odd is made of 'adamantium', a material nobody knows"):
        OpenFloor(OpenFloor.Config()).scene([plan])


def test_actors_may_list_their_materials_in_their_own_order():
    class Shuffled(Oddity):
        def boxes(self):
            boxes, _ = super().boxes()
            return boxes.with_(material=np.array([1])), ("wood", "glass")

    plan = ActorPlan("x", "x", "parked", Shuffled(), None, floor_pose(1, 1))  # type: ignore[arg-type]
    scene = OpenFloor(OpenFloor.Config(posts=0)).scene([plan])
    assert scene.materials[scene.boxes.material[0]] == "glass"
