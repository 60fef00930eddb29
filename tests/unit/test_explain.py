"""Why a tag was read or not: the parts add up to the channel's own numbers, and each reason is found where it was made."""

from dataclasses import replace

import numpy as np
import pytest

from testbed import frames
from testbed.explain import NotThere, Reason, explain, look
from testbed.explain.counts import block_of
from testbed.explain.link import budget
from testbed.explain.wording import verdict
from testbed.geometry import Boxes
from testbed.protocols import Surroundings, Tagged
from testbed.radio.channel import Channel, Fixed
from testbed.radio.diffraction import knife_edge, nu_of_edge
from testbed.radio.materials import MATERIALS, losses
from testbed.scenario import from_dict
from testbed.scene import Body, Scene, Truth
from testbed.sensors.rfid import Rfid
from testbed.types import Tags
from testbed.units import SPEED_OF_LIGHT
from worlds.raycast import BoxCaster

SECONDS = 3.0
STONE = ("concrete", "steel", "carton")
WALL = ("wall", "concrete", (2.9, -5, 0), (3.1, 5, 4))
PLAIN = {"orders": 0, "diffuse": False}


def hall(boxes=(), cart=None):
    """Boxes (body, material, low, high) that stand still; `cart` (low, high) a steel box in the frame of a body that moves."""
    names = list(dict.fromkeys(name for name, *_ in boxes))
    bodies = [Body(name, "wall", frames.IDENTITY) for name in names] + [Body("cart", "trolley", frames.IDENTITY, moving=True)]
    rows = [(names.index(name), STONE.index(material), low, high) for name, material, low, high in boxes]
    rows += [] if cart is None else [(len(names), STONE.index("steel"), *cart)]
    if not rows:
        return Scene(tuple(bodies), Boxes.empty(), STONE, np.array([[-20.0, -20, 0], [20, 20, 6]]))
    body, material, low, high = (np.array(x, dtype=float) for x in zip(*rows, strict=True))
    solid = Boxes((low + high) / 2, np.tile(frames.IDENTITY[3:], (len(rows), 1)), (high - low) / 2, body=body, material=material)
    return Scene(tuple(bodies), solid, STONE, np.array([[-20.0, -20, 0], [20, 20, 6]]))


def around(scene, places=((6.0, 0.0, 1.5),), way=((0.0, 50.0), (0.0, 50.0)), rides=False, pattern="isotropic"):
    """Tags at `places`; the cart goes from the first (x, y) to the last. Tags that ride are placed in the cart's frame."""
    t = np.arange(int(SECONDS * 120) + 1) / 120
    poses = np.tile(frames.IDENTITY, (len(t), 1, 1))
    poses[:, 0, :2] = np.linspace(*way, len(t))
    n = len(places)
    tags = Tags(id=[f"tag{i}" for i in range(n)], gain=np.full(n, 2.0), sensitivity=np.full(n, -19.5), pattern=np.full(n, pattern))
    tagged = Tagged(tags, np.full(n, 0 if rides else -1), np.array([[*p, 1, 0, 0, 0] for p in places], dtype=float))
    caster = BoxCaster(scene, *losses(scene.materials))
    truth = Truth(t=t, poses=poses, bodies=("cart",))
    return Surroundings(scene, truth, tagged, ["cart"], np.arange(n), SECONDS, caster, 7, 0)


def reader(scene, antennas=((0.0, 0.0, 1.5),), **config):
    rules = [{"id": f"a{i}", "position_m": list(p)} for i, p in enumerate(antennas)]
    return Rfid(Rfid.Config.model_validate({"antennas": rules, "channel": PLAIN, "artefacts": "off", **config}), "portal", scene)


def seen(boxes=(), t=1.0, cart=None, antenna=0, tag=0, where=None, **config):
    scene = hall(boxes, cart)
    return look(reader(scene, **config), around(scene, **(where or {})), antenna, tag, t)


# ---------------------------------------------------------------- the sums


FULL = {"channel": {"orders": 1, "diffuse": True, "floor": "concrete"}}
CARTED = {"way": ((3.0, -3.0), (3.0, 3.0)), "places": ((6.0, 0.5, 1.5), (2.0, 1.0, 0.4))}
SHELF = ("shelf", "carton", (3.5, -0.4, 0), (4.2, 0.6, 2.0))


def adds_up(path):
    """The decibels of a path are those of its term, the obstacles' those of the way through, and the less of both ways is taken."""
    parts = path.gains.total_db + path.reflection_db + path.share_db - path.spread_db - path.passage.loss_db
    assert parts == pytest.approx(path.level_db, abs=1e-9)
    assert sum(o.loss_db for o in path.passage.obstacles) == pytest.approx(path.passage.through_db, abs=1e-9)
    assert min(path.passage.through_db + path.passage.shade_db, path.passage.round_db) == pytest.approx(path.passage.loss_db, abs=1e-9)


@pytest.mark.parametrize("t", [0.0, 1.2, 1.5, 2.9])
@pytest.mark.parametrize("pattern", ["isotropic", "dipole"])
def test_the_parts_add_up_to_what_the_channel_answers(t, pattern):
    scene = hall([SHELF, ("rear", "steel", (9, -4, 0), (9.1, 4, 4))], cart=((-0.3, -0.5, 0.2), (0.3, 0.5, 1.8)))
    sensor, here = reader(scene, **FULL), around(scene, pattern=pattern, **CARTED)
    b = budget(sensor, here, 0, 0, t)
    radio = sensor.radio(here.caster, here.tagged, limit=False)
    channel = Channel(radio, Fixed(radio), here.truth, here.root, here.trial)
    link = np.zeros(1, int), np.zeros(1, int), np.array([t])
    answer = channel.respond(*link, sensor.carrier(here, link[0], link[2]))
    total = b.direct.term + b.diffuse + sum(path.term for path in b.reflections)
    assert abs(total - answer.h[0]) < 1e-9 * abs(answer.h[0])
    assert b.h == pytest.approx(answer.h[0], rel=1e-9)
    received, forward, reverse = sensor.margins(answer, link[0], link[1], here.tagged)
    assert (b.reader_dbm, b.forward_db, b.reverse_db) == pytest.approx((received[0], forward[0], reverse[0]), abs=1e-9)
    assert b.reflections
    for path in (b.direct, *b.reflections):
        adds_up(path)


def test_a_free_path_by_hand():
    b = seen().budget
    wavelength = SPEED_OF_LIGHT / b.carrier_hz
    free = 20 * np.log10(wavelength / (4 * np.pi * 6.0))
    assert b.total_db == pytest.approx(free + 6 + 2 - 10 * np.log10(2), abs=1e-9)
    assert b.tag_dbm == pytest.approx(29 + b.total_db)
    assert b.reader_dbm == pytest.approx(29 + 2 * b.total_db - 8)
    assert b.forward_db == pytest.approx(b.tag_dbm + 19.5)
    assert np.isinf(b.k_db)
    assert b.direct.passage.way == "clear"


def test_gains_of_a_linear_antenna_and_a_dipole_are_told_apart():
    scene = hall()
    sensor = reader(scene)
    sensor._antennas = sensor.antennas().with_(polarisation=np.array(["linear"]))
    here = around(scene, places=((4.0, 3.0, 1.5),), pattern="dipole")
    gains = look(sensor, here, 0, 0, 1.0).budget.direct.gains
    line = sensor.radio(here.caster, here.tagged, limit=False).lines(np.zeros(1, int), np.zeros(1, int))
    assert gains.total_db == pytest.approx(line.gain[0], abs=1e-9)
    assert gains.off_boresight_deg == pytest.approx(np.rad2deg(np.arctan2(3, 4)))
    along = 3 / 5  # the dipole lies along y
    assert gains.orientation_db == pytest.approx(20 * np.log10(np.cos(np.pi / 2 * along) / np.sqrt(1 - along**2)), abs=1e-9)
    assert gains.polarisation_db < -10  # the field stands upright, the dipole lies


def test_a_reflection_names_its_face_its_angle_and_what_stands_on_its_legs():
    box = ("rear", "steel", (-1, 3, 0), (8, 3.1, 4))
    post = ("post", "carton", (1.4, 1.3, 0), (1.6, 1.7, 4))  # on the way to the wall, clear of the straight line
    b = seen([box, post], channel={"orders": 1, "diffuse": False, "floor": None}).budget
    wall = next(path for path in b.reflections if path.by == "rear")
    assert wall.length_m == pytest.approx(np.hypot(6, 6))
    assert wall.incidence_deg == pytest.approx(45)
    assert wall.point_m == pytest.approx((3, 3, 1.5))
    assert wall.reflection_db == pytest.approx(0)
    assert {o.body for o in wall.passage.obstacles} == {"post"}
    assert wall.passage.obstacles[0].at_m == pytest.approx(1.4 * np.sqrt(2), abs=1e-3)  # legs end 0.1 mm off the face
    assert not b.direct.passage.obstacles


# ---------------------------------------------------------------- the reasons


def test_a_wall_between_is_named_with_its_loss_and_without_it_the_tag_is_read():
    shut, free = seen([WALL], where={"places": ((9.0, 0.0, 1.5),)}), seen(where={"places": ((9.0, 0.0, 1.5),)})
    (wall,) = shut.budget.direct.passage.obstacles
    stone = MATERIALS["concrete"]
    assert (wall.body, wall.material, wall.moving) == ("wall", "concrete", False)
    assert wall.inside_m == pytest.approx(0.2)
    assert wall.loss_db == pytest.approx(stone.entry_db + 0.2 * stone.per_metre_db)
    assert shut.budget.total_db == pytest.approx(free.budget.total_db - wall.loss_db)
    assert shut.reason is Reason.ASLEEP
    assert free.reason is Reason.READ
    said = verdict(shut)
    assert said.startswith(f"not read: the tag gets {shut.budget.tag_dbm:.1f} dBm, {-shut.budget.forward_db:.1f} dB less than wakes it")
    assert f"wall (concrete) takes {wall.loss_db:.0f} dB" in said
    assert said.endswith("Move wall, or the antenna to where it sees the tag.")
    assert verdict(free).startswith("read: ")


def test_of_several_things_in_the_way_the_one_that_takes_most_is_named():
    box = ("box", "carton", (4.0, -5, 0), (4.1, 5, 4))
    e = seen([box, WALL], where={"places": ((9.0, 0.0, 1.5),)})
    obstacles = e.budget.direct.passage.obstacles
    assert [o.body for o in obstacles] == ["wall", "box"]  # in order of the path
    assert f"wall (concrete) takes {obstacles[0].loss_db:.0f} dB of the {sum(o.loss_db for o in obstacles):.0f} dB" in verdict(e)


def test_over_an_edge_the_wave_goes_round_and_both_ways_are_told():
    plate = ("plate", "steel", (2.99, -9, 0), (3.01, 9, 1.7))
    passage = seen([plate]).budget.direct.passage
    edge = float(knife_edge(nu_of_edge(0.2, 3.0, 3.0, 0.346)))
    assert passage.way == "round"
    assert passage.through_db == pytest.approx(40)
    assert passage.round_db == passage.loss_db == pytest.approx(edge, abs=0.5)
    assert passage.detour_m > 0
    assert 0 < passage.clear < 0.5


def test_what_stands_close_to_the_line_is_named():
    plate = ("plate", "steel", (2.99, -9, 0), (3.01, 9, 1.4))
    passage = seen([plate]).budget.direct.passage
    assert passage.obstacles == ()
    assert passage.beside == ("plate",)
    assert passage.loss_db == pytest.approx(passage.shade_db)
    assert passage.shade_db > 1


def test_a_moving_body_in_the_way():
    setting = {"cart": ((-0.3, -0.5, 0), (0.3, 0.5, 4)), "where": {"way": ((3.0, -3.0), (3.0, 3.0)), "places": ((9.0, 0.0, 1.5),)}}
    before, during = seen(t=0.2, **setting), seen(t=1.5, **setting)
    assert before.reason is Reason.READ
    assert during.reason is Reason.ASLEEP
    assert [(o.body, o.moving) for o in during.budget.direct.passage.obstacles] == [("cart", True)]
    assert verdict(during).endswith("It is free when cart has passed.")


def test_a_tag_behind_its_own_carrier_is_not_told_to_wait():
    riding = {"way": ((6.0, 0.0), (6.0, 0.0)), "places": ((0.45, 0.0, 1.5),), "rides": True}
    e = seen(cart=((-0.4, -1.5, 0), (0.4, 1.5, 4)), where=riding, power_dbm=27)
    assert e.reason is Reason.ASLEEP
    assert e.budget.direct.passage.obstacles[0].holds_tag
    assert "The tag is on cart: put it on a side that the antenna sees" in verdict(e)


def test_a_tag_that_was_read_is_silenced_with_one_target_and_goes_on_with_two():
    once = seen(t=1.0, reader={"session": 2, "dual_target": False})
    assert once.reason is Reason.SILENCED
    assert once.serving.last_read_s < 0.5
    assert not once.serving.now.asked
    assert "the flag of session 2 keeps it from being asked" in verdict(once)
    assert seen(t=1.0, reader={"session": 2, "dual_target": True}).reason is Reason.READ


def test_select_leaves_it_out():
    e = seen(reader={"select": "pallet*"})
    assert e.reason is Reason.NOT_SELECTED
    assert not e.serving.now.asked
    assert verdict(e) == "not read: Select lets only pallet* through, so the tag is never asked. Put its id under select."
    assert seen(reader={"select": "tag*"}).reason is Reason.READ


def test_an_antenna_that_is_not_served_at_that_time():
    two = {"antennas": ((0.0, 0.0, 1.5), (0.0, 0.5, 1.5))}
    scene = hall()
    sensor, here = reader(scene, **two), around(scene)
    rounds = sensor.diary(here).rounds
    visit = int(np.flatnonzero(rounds.antenna == 1)[5])
    t = float((rounds.t_start[visit] + rounds.t_end[visit]) / 2)
    other, own = look(sensor, here, 0, 0, t), look(sensor, here, 1, 0, t)
    assert other.reason is Reason.NOT_SERVED
    assert other.serving.now is None
    assert other.serving.elsewhere == "a1"
    assert other.serving.before.end_s < t < other.serving.after.start_s
    assert verdict(other).startswith("read in a0's visit before (")
    assert f"at {t:g} s itself the reader was serving a1. The link itself holds" in verdict(other)
    missed = replace(other, serving=replace(other.serving, before=replace(other.serving.before, reads_s=(), able=False)))
    assert "the reader was serving a1, not a0; not read (too weak to take part) in its visit before" in verdict(missed)
    assert "It serves 2 antennas in turn" in verdict(missed)
    assert own.reason is Reason.READ
    assert own.serving.now.start_s <= t <= own.serving.now.end_s


def test_a_reader_that_hears_less_than_the_tag_needs():
    e = seen(where={"places": ((10.0, 0.0, 1.5),)}, reader={"sensitivity_dbm": -50})
    assert e.reason is Reason.UNHEARD
    assert e.budget.forward_db > 0 > e.budget.reverse_db
    assert "the tag wakes, but the reader gets" in verdict(e)


def test_too_many_tags_for_a_visit():
    places = [(4.0, -1 + 0.02 * i, 1.5) for i in range(100)]
    scene = hall()
    short = {"profile": "fx7500", "longest_visit_s": 0.02}
    sensor, here = reader(scene, antennas=((0.0, 0.0, 1.5), (0.0, 0.5, 1.5)), reader=short), around(scene, places=places)
    visit = sensor.diary(here).rounds
    t = float((visit.t_start[4] + visit.t_end[4]) / 2)
    found = [look(sensor, here, int(visit.antenna[4]), tag, t) for tag in (0, 30, 60, 99)]
    e = next(f for f in found if f.reason is not Reason.READ)
    assert e.reason is Reason.NO_SLOT
    assert e.serving.now.others_able == 99
    assert 0 < e.serving.now.others_read < 50
    assert e.serving.now.collisions > 0
    assert "99 other tags could answer" in verdict(e)


def test_a_link_that_comes_free_after_the_visit_began():
    setting = {"cart": ((-0.3, -0.5, 0), (0.3, 0.5, 4)), "where": {"way": ((3.0, -3.0), (3.0, 3.0)), "places": ((9.0, 0.0, 1.5),)}}
    e = seen(t=1.9, reader={"step_s": 1.0}, **setting)  # who takes part was settled for 1 to 2 s at 1.5 s, when the cart stood between
    assert e.reason is Reason.LATE
    assert not e.serving.now.able
    assert "the link was too weak for it to take part" in verdict(e)


def test_an_answer_that_the_link_did_not_carry():
    e = seen()
    lost = replace(e.serving.now, reads_s=(), lost_s=(1.01,))
    e = replace(e, serving=replace(e.serving, now=lost))
    assert e.reason is Reason.FADED
    assert "it answered at 1.010 s" in verdict(e)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ({"where": {"places": ((0.5, 7.0, 1.5),)}}, "off the antenna's boresight, which takes"),
        ({"where": {"places": ((16.0, 0.0, 1.5),)}}, "nothing is in the way, it is 16.0 m off. An antenna within about"),
        ({"where": {"places": ((11.0, 0.0, 1.5),)}, "power_dbm": 26}, "dB more power would do, and the region allows 3.1"),
        ({"where": {"places": ((1.0, 6.0, 1.5),), "pattern": "dipole"}, "antennas": ((1.0, 0.0, 1.5),)}, "which takes"),
    ],
)
def test_what_takes_most_is_said(setting, says):
    e = seen(**setting)
    assert e.reason is Reason.ASLEEP
    assert says in verdict(e)


# ---------------------------------------------------------------- the trial is the run's own


def test_visits_hold_the_reads_and_the_silence_of_the_streams():
    scene = hall([SHELF], cart=((-0.3, -0.5, 0.2), (0.3, 0.5, 1.8)))
    single = {"session": 1, "dual_target": False}
    sensor, here = reader(scene, antennas=((0.0, 0.0, 1.5), (0.0, 0.5, 1.5)), reader=single, **FULL), around(scene, **CARTED)
    sensed, diary = sensor.sense(here, 0), sensor.diary(here)
    rounds, counts = sensed.streams["rounds"], sensed.streams["counts"]
    assert rounds.equals(diary.rounds)
    assert np.array_equal(sensed.asked_sets, diary.sets)
    for v in range(0, len(rounds), len(rounds) // 4):
        e = look(sensor, here, int(rounds.antenna[v]), 0, float(rounds.t_start[v] + rounds.t_end[v]) / 2)
        mine = (counts.round == rounds.round[v]) & (counts.tag == 0)
        assert len(e.serving.now.reads_s) == counts.n[mine].sum()
        assert e.serving.now.asked == sensed.asked_sets[rounds.asked[v], 0]


def test_counts_of_the_published_model_are_explained_by_their_own_draws():
    scene = hall([SHELF])
    sensor = reader(scene, detection={"kind": "logistic_beta", "period_s": 0.05, "offset_s": [0.01, 0.04]})
    here = around(scene, places=((6.0, 0.0, 1.5), (4.0, 2.0, 1.5)))
    sensed = sensor.sense(here, 0)
    rounds, counts = sensed.streams["rounds"], sensed.streams["counts"]
    found = {True: 0, False: 0}
    for v in range(0, len(rounds), 3):
        for tag in (0, 1):
            block = block_of(sensor, here, 0, tag, float(rounds.t_start[v]) + 0.001)
            assert block.count == counts.n[(counts.round == rounds.round[v]) & (counts.tag == tag)].sum()
            assert block.end_s == pytest.approx(rounds.t_end[v])
            found[block.dead] += 1
    assert min(found.values()) > 0
    shut, free = (look(sensor, here, 0, tag, 1.0) for tag in (0, 1))
    assert shut.block.geometry > 0.5 > free.block.geometry
    assert shut.reason is None
    assert verdict(shut).startswith(("not read: a dead zone held", "read: ", "not read: none of"))


# ---------------------------------------------------------------- questions about what isn't there

TROLLEY = {"id": "t1", "kind": "trolley", "motion": "kinematic", "route": {"waypoints_m": [[1, 1], [6, 1]]}}
SCENARIO = {
    "name": "t", "seed": 5, "trials": 2, "duration_s": 2, "world": {"kind": "open_floor"},
    "actors": [{**TROLLEY, "tags": [{"id": "lid", "mount": "top"}]}],
    "sensors": [{"id": "posts", "kind": "rfid", "antennas": {"on": "post*"}}],
}  # fmt: skip


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"tag": "ldi"}, "no tag is named 'ldi'; the nearest is 'lid'"),
        ({"antenna": "pots1"}, "no antenna of an rfid reader is named 'pots1'; the nearest is 'post1"),
        ({"t": 2.1}, "2.1 s is outside the trial, which lasts from 0 to 2 s"),
        ({"t": -0.1}, "-0.1 s is outside the trial"),
        ({"t": float("nan")}, "nan s is outside the trial"),
        ({"trial": 2}, "there is no trial 2: the scenario has 2, counted from 0"),
        ({"point": 1}, "there is no point 1: the scenario has 1"),
    ],
)
def test_what_is_not_there_is_said_with_the_nearest(asked, says):
    question = {"tag": "lid", "antenna": "post1.low", "t": 1.0, **asked}
    with pytest.raises(NotThere, match="^" + says.replace(".", r"\.")):
        explain(from_dict(SCENARIO), **question)
