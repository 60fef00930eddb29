"""PyBullet behind its door: poses, self-tests, rays, motors, silence, and the same numbers every time."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes
from testbed.scene import Body, Scene

pytest.importorskip("pybullet")

from worlds import bullet, urdf

POSE = np.array([1.0, 2.0, 3.0, *frames.normalise([0.5, 0.2, -0.3, 0.7])])
CUBE = Boxes(center=[[0.0, 0.0, 0.0]], quaternion=[[1.0, 0, 0, 0]], half=[[0.5, 0.5, 0.5]])


@pytest.fixture
def client():
    with bullet.Client() as client:
        yield client


def cart(com=(0.1, 0.0, 0.0), wheels=4):
    """A box on sphere wheels of radius 0.1 m, its origin on the floor."""
    hull = Boxes(center=[[0, 0, 0.3]], quaternion=[[1.0, 0, 0, 0]], half=[[0.5, 0.3, 0.1]])
    parts = [urdf.link("hull", urdf.box_shapes(hull), 20.0, urdf.box_inertia(20.0, [1, 0.6, 0.2]), np.array([0, 0, 0.3]) + com)]
    for i, (x, y) in enumerate([(0.4, 0.3), (0.4, -0.3), (-0.4, 0.3), (-0.4, -0.3)][:wheels]):
        parts.append(urdf.link(f"wheel{i}", [urdf.sphere_shape([0, 0, 0], 0.1)], 1.0, urdf.sphere_inertia(1.0, 0.1)))
        parts.append(urdf.joint(f"axle{i}", "continuous", "hull", f"wheel{i}", [x, y, 0.1, 1, 0, 0, 0], [0, 1, 0]))
    return urdf.robot("cart", parts)


# ---------------------------------------------------------------- poses and bodies


def test_a_loaded_body_stands_at_the_pose_asked_for_whatever_its_centre_of_mass(client):
    handle = client.load(cart(com=(0.2, -0.1, 0.05)), "cart", POSE)
    np.testing.assert_allclose(client.pose(handle), POSE, atol=1e-12)


def test_placing_and_reading_a_pose_are_inverse_and_rays_meet_the_body_there(client):
    handle = client.load(cart(com=(0.2, -0.1, 0.05)), "cart")
    client.place(handle, POSE)
    client.refresh()
    np.testing.assert_allclose(client.pose(handle), POSE, atol=1e-12)
    outside, inside = frames.to_world(POSE, [[-2.0, 0.1, 0.3], [0.0, 0.1, 0.3]])
    hits = client.hits([outside], [inside])
    assert hits.body[0] == handle.uid
    np.testing.assert_allclose(hits.position[0], frames.to_world(POSE, [-0.5, 0.1, 0.3]), atol=1e-3)


def test_a_body_that_was_placed_is_met_there_and_no_longer_where_it_was(client):
    handle = client.load(cart(), "cart")
    client.place(handle, [50.0, 0, 0, 1, 0, 0, 0])
    client.refresh()
    x = np.array([0.0, 0.4, 50.0, 50.4])  # hull and wheel
    end = np.stack([x, [0, 0.3, 0, 0.3], [0.3, 0.1, 0.3, 0.1]], axis=1)
    hits = client.hits(end - np.array([0, 0, 0.45]), end)
    assert hits.body.tolist() == [bullet.NOTHING, bullet.NOTHING, handle.uid, handle.uid]
    assert hits.link.tolist()[2:] == [bullet.BASE, handle.links["wheel0"]]


def test_contacts_of_a_placed_body_are_those_of_the_last_refresh(client):
    """What `refresh` is for; if this fails the engine has changed."""
    client.load_floor()
    handle = client.load(cart(), "cart", [0, 0, 5.0, 1, 0, 0, 0])
    client.place(handle, [0, 0, -0.05, 1, 0, 0, 0])
    assert len(client.contacts(handle).gap) == 0
    client.refresh()
    assert len(client.contacts(handle).gap) >= 4


def test_quaternions_are_w_first(client):
    long = Boxes(center=[[0.0, 0, 0]], quaternion=[[1.0, 0, 0, 0]], half=[[2.0, 0.1, 0.1]])
    client.load_boxes(long, "along y", [0, 0, 0, *frames.from_euler(np.pi / 2)])
    turned = long.with_(quaternion=frames.from_euler(np.pi / 2)[None], center=[[10.0, 0, 0]])
    client.load_boxes(turned, "turned in its compound")
    hits = client.hits(
        [[0.0, 1.5, 5], [1.5, 0, 5], [10.0, 1.5, 5], [11.5, 0, 5]], [[0.0, 1.5, -5], [1.5, 0, -5], [10.0, 1.5, -5], [11.5, 0, -5]]
    )
    assert (hits.body >= 0).tolist() == [True, False, True, False]


def test_a_compound_keeps_all_its_boxes(client):
    """More than the 16 that an array of shapes would keep."""
    n = 200
    row = Boxes(
        center=np.stack([np.arange(n), 0 * np.arange(n), 0 * np.arange(n)], axis=1), quaternion=[[1.0, 0, 0, 0]] * n, half=[[0.3] * 3] * n
    )
    handle = client.load_boxes(row, "row")
    above, between = row.center + np.array([0.0, 0, 5]), np.array([0.5, 0, 0])
    assert (client.hits(above, row.center).body == handle.uid).all()
    assert (client.hits(above + between, row.center + between).body == bullet.NOTHING).all()


def test_static_bodies_become_one_compound_for_each_body_and_material(client):
    boxes = Boxes(
        center=[[0, 0, 0], [2, 0, 0], [4, 0, 0], [0, 0, 0], [0, 0, 0]],
        quaternion=[[1.0, 0, 0, 0]] * 5,
        half=[[0.5] * 3] * 5,
        body=[0, 0, 1, 2, -1],
        material=[0, 1, 1, 0, 1],
    )
    bodies = (
        Body("rack", "rack", np.array([0, 5.0, 0, 1, 0, 0, 0])),
        Body("gate", "gate", frames.IDENTITY),
        Body("van", "van", frames.IDENTITY, moving=True),
    )
    parts = client.load_static(Scene(bodies, boxes, ("steel", "wood"), np.zeros((2, 3))))
    assert sorted((p.handle.name, p.body, p.material) for p in parts) == [
        ("gate/wood", 1, 1),
        ("rack/steel", 0, 0),
        ("rack/wood", 0, 1),
        ("world/wood", -1, 1),
    ]
    by_uid = {p.handle.uid: p.handle.name for p in parts}
    hits = client.hits([[0.0, 5, 9], [2, 5, 9], [4, 0, 9], [0, 0, 9]], [[0.0, 5, 0], [2, 5, 0], [4, 0, 0], [0, 0, 0]])
    assert [by_uid[b] for b in hits.body] == ["rack/steel", "rack/wood", "gate/wood", "world/wood"]
    assert client.name(int(hits.body[0])) == "rack/steel"


def test_a_second_model_of_the_same_name_is_not_answered_with_the_first(client):
    small, large = client.load_boxes(CUBE, "x"), client.load_boxes(CUBE.with_(half=[[3.0] * 3]), "x", [20.0, 0, 0, 1, 0, 0, 0])
    hits = client.hits([[0.0, 0, 9], [20.0, 0, 9]], [[0.0, 0, 0], [20.0, 0, 0]])
    assert hits.body.tolist() == [small.uid, large.uid]
    np.testing.assert_allclose(hits.position[:, 2], [0.5, 3.0])


# ---------------------------------------------------------------- what is refused or noticed


def test_a_body_without_a_shape_is_named(client):
    with pytest.raises(RuntimeError, match="ghost can't be hit by a ray"):
        client.load(urdf.robot("ghost", [urdf.link("base", [], 1.0, [1, 1, 1])]), "ghost")


def test_a_body_whose_shape_the_engine_lost_is_named(client, monkeypatch):
    """A shape number from before a reset gives a body without a shape, and no error."""
    real = client._p.createCollisionShape
    stale = real(client._p.GEOM_BOX, halfExtents=[1, 1, 1], physicsClientId=client._id)
    client.reset()

    class Forgetful:
        def __getattr__(self, name):
            return (lambda *_, **__: stale) if name == "createCollisionShape" else getattr(bullet._pybullet(), name)

    monkeypatch.setattr(client, "_p", Forgetful())
    with pytest.raises(RuntimeError, match="lost box can't be hit by a ray"):
        client.load_box([1, 1, 1], frames.IDENTITY, "lost box")


def test_a_body_under_others_passes_its_self_test(client):
    for height in (3.0, 6.0, 9.0):
        client.load_boxes(CUBE, "above", [0, 0, height, 1, 0, 0, 0])
    client.load_boxes(CUBE, "outside", frames.IDENTITY)
    client.load_box([0.2, 0.2, 0.2], frames.IDENTITY, "inside the other")


def test_a_broken_model_is_refused_with_the_engines_words(client):
    with pytest.raises(ValueError, match=r"(?s)van: PyBullet can't load its model.*XML_ERROR"):
        client.load("<robot", "van")


@pytest.mark.parametrize("pose", [[0, 0, 0, 0, 0, 0, 0], [0, 0, np.nan, 1, 0, 0, 0], [0, 0, 0], [0, 0, 0, 2, 0, 0, 0]])
def test_a_pose_that_is_none_is_refused(client, pose):
    with pytest.raises(ValueError, match="cube: a pose is"):
        client.load_boxes(CUBE, "cube", pose)


@pytest.mark.parametrize("step", [0.0, -1.0, 0.5, np.nan])
def test_a_step_that_is_none_is_refused(step):
    with pytest.raises(ValueError, match="the step must lie in"):
        bullet.Client(step)


def test_a_closed_client_can_be_closed_again():
    client = bullet.Client()
    client.close()
    client.close()


# ---------------------------------------------------------------- rays


@pytest.mark.parametrize(
    "n", [0, 1, bullet.RAYS_PER_CALL - 1, bullet.RAYS_PER_CALL, 2 * bullet.RAYS_PER_CALL, 2 * bullet.RAYS_PER_CALL + 1]
)
def test_no_ray_is_lost_at_any_number_of_rays(client, n):
    handle = client.load_boxes(CUBE, "cube")
    start = np.tile([0.0, 0, 5], (n, 1))
    hits = client.hits(start, np.zeros((n, 3)))
    assert hits.body.tolist() == [handle.uid] * n
    np.testing.assert_allclose(hits.fraction, 0.9)
    np.testing.assert_allclose(hits.normal, np.tile([0.0, 0, 1], (n, 1)))


def test_a_ray_does_not_hit_what_it_starts_in_and_a_miss_says_so(client):
    client.load_boxes(CUBE, "cube")
    hits = client.hits([[0.0, 0, 0], [5, 5, 5]], [[5.0, 0, 0], [6, 6, 6]])
    assert hits.body.tolist() == [bullet.NOTHING, bullet.NOTHING]
    assert hits.fraction.tolist() == [1.0, 1.0]


def test_hits_by_number_are_all_hits(client):
    uids = {client.load_box([0.5, 0.5, 0.5], [x, 0, 0, 1, 0, 0, 0], f"box{x}").uid for x in (0, 2, 4)}
    ray = np.array([[-5.0, 0, 0]]), np.array([[9.0, 0, 0]])
    assert {int(client.hits(*ray, number).body[0]) for number in range(3)} == uids
    assert client.hits(*ray, 3).body[0] == bullet.NOTHING


@pytest.mark.parametrize(
    ("start", "end"), [(np.zeros((2, 3)), np.zeros((3, 3))), (np.zeros(3), np.zeros(3)), ([[0, 0, np.nan]], [[0, 0, 0]])]
)
def test_bad_rays_are_refused(client, start, end):
    with pytest.raises(ValueError, match="rays want"):
        client.hits(start, end)


def test_a_dropped_ray_is_noticed(client, monkeypatch):
    class Dropping:
        def __getattr__(self, name):
            real = getattr(bullet._pybullet(), name)
            return (lambda *args, **kwargs: real(*args, **kwargs)[:-1]) if name == "rayTestBatch" else real

    monkeypatch.setattr(client, "_p", Dropping())
    with pytest.raises(RuntimeError, match="PyBullet answered 2 of 3 rays"):
        client.hits(np.zeros((3, 3)), np.ones((3, 3)))


# ---------------------------------------------------------------- motion


def rolled(client):
    """A cart on the floor, driven for a second; its poses and joints after each tenth."""
    client.reset()
    client.load_floor()
    handle = client.load(cart(), "cart", [0, 0, 0, *frames.from_euler(0.3)])
    client.drive(handle, list(handle.joints), np.full(4, 10.0), 5.0)
    seen = []
    for _ in range(10):
        client.step(24)
        seen.append([*client.pose(handle), *client.joint_states(handle, ["axle0"])[0]])
    return np.array(seen)


def test_wheels_roll_a_cart_forward_without_sinking_or_turning(client):
    seen = rolled(client)
    travelled = np.hypot(seen[-1, 0], seen[-1, 1])
    assert 0.5 < travelled <= 1.0  # 1 m/s after speeding up
    assert np.abs(seen[:, 2]).max() < 1e-3
    np.testing.assert_allclose(frames.yaw_of(seen[:, 3:7]), 0.3, atol=1e-3)
    assert seen[-1, 8] == pytest.approx(10.0, rel=1e-3)


def test_runs_are_bit_identical_after_a_reset_and_in_another_process(client):
    first = rolled(client)
    client.load_boxes(CUBE, "leftover")
    np.testing.assert_array_equal(rolled(client), first)
    code = "import json, test_bullet as t\nwith t.bullet.Client() as c: print(json.dumps(t.rolled(c).tolist()))"
    done = run(code)
    np.testing.assert_array_equal(np.array(json.loads(done.stdout)), first)  # and nothing but JSON on stdout


def test_joints_are_free_unless_driven(client):
    client.load_floor()
    handle = client.load(cart(), "cart")
    client.damping(handle)
    client.set_velocity(handle, [1.0, 0, 0, 0, 0, 0])
    client.step(240)
    assert client.velocity(handle)[0] > 0.8  # the wheels had to be turned; braked ones would have stopped it within 13 cm


def test_a_steered_joint_goes_where_it_is_told(client):
    arm = urdf.robot(
        "arm",
        [
            urdf.link("base", urdf.box_shapes(CUBE), 100.0, [10, 10, 10]),
            urdf.link("hand", [urdf.sphere_shape([0.8, 0, 0], 0.1)], 1.0, [0.1, 0.1, 0.1]),
            urdf.joint("wrist", "revolute", "base", "hand", axis=[0, 0, 1], limit=(-1.0, 1.0)),
        ],
    )
    handle = client.load(arm, "arm", fixed=True)
    client.steer(handle, ["wrist"], [0.5], 50.0)
    client.step(240)
    assert client.joint_states(handle, ["wrist"])[0, 0] == pytest.approx(0.5, abs=1e-3)
    client.place_joint(handle, "wrist", -0.25)
    assert client.joint_states(handle, ["wrist"]).tolist() == [[-0.25, 0.0]]


def test_contacts_name_both_sides_and_how_deep_they_are(client):
    floor, cube = (
        client.load_floor(),
        client.load(urdf.robot("c", [urdf.link("b", urdf.box_shapes(CUBE), 8.0, [1, 1, 1])]), "cube", [0, 0, 0.45, 1, 0, 0, 0]),
    )
    client.load_box([0.1, 0.1, 0.1], [9, 9, 9, 1, 0, 0, 0], "far")
    client.refresh()
    touching = client.contacts(cube)
    assert set(touching.body[:, 1]) == {floor.uid}
    np.testing.assert_allclose(touching.gap, -0.05, atol=1e-6)
    assert len(client.contacts(cube, floor).gap) == len(touching.gap)
    client.place(cube, [0, 0, 5, 1, 0, 0, 0])
    client.refresh()
    assert len(client.contacts(cube).gap) == 0


# ---------------------------------------------------------------- silence, and life without PyBullet


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=os.path.dirname(__file__))


def test_nothing_that_the_engine_prints_reaches_stdout_or_stderr():
    code = """
from worlds import bullet
print("before", bullet.version() != "", bullet.numpy_enabled() in (True, False))
with bullet.Client() as c:
    try:
        c.load('<robot name="x"><link name="b"/></robot>', "warned of and empty")
    except RuntimeError as error:
        print("error")
print("after")
"""
    done = run(code)
    assert done.stdout == "before True True\nerror\nafter\n"
    assert done.stderr == ""


def test_what_python_prints_stays_in_order_around_a_capture():
    code = """
import os
from worlds.captured import captured
print("a", end="")
with captured() as said:
    os.write(1, b"printed")
    said.seek(0)
    text = said.read()
print("b", text)
"""
    done = run(code)
    assert done.stdout == "ab printed\n"


def test_importing_worlds_needs_no_pybullet_and_its_lack_is_told_in_one_sentence():
    code = """
import sys
sys.modules["pybullet"] = None
import worlds.bullet, worlds.urdf, worlds.raycast, worlds.bullet_rays
try:
    worlds.bullet.Client()
except ImportError as error:
    print(error)
"""
    done = run(code)
    assert done.returncode == 0, done.stderr
    assert "pip install 'warehouse-radio-testbed[sim]'" in done.stdout
    assert "Python 3.11" in done.stdout
    assert done.stdout.count("\n") == 1


# ---------------------------------------------------------------- URDF text


def test_roll_pitch_yaw_give_back_the_rotation_also_straight_up_and_down():
    rng = np.random.default_rng(2)
    turns = [*frames.normalise(rng.normal(size=(50, 4))), frames.from_euler(0.3, np.pi / 2, 0.4), frames.from_euler(0.3, -np.pi / 2, 0.4)]
    for q in turns:
        roll, pitch, yaw = urdf.rpy(q)
        np.testing.assert_allclose(frames.matrix(frames.from_euler(yaw, pitch, roll)), frames.matrix(q), atol=1e-9)


def test_inertia_of_solids():
    np.testing.assert_allclose(urdf.box_inertia(12.0, [1, 2, 3]), [13.0, 10.0, 5.0])
    np.testing.assert_allclose(urdf.sphere_inertia(10.0, 0.5), [1.0, 1.0, 1.0])


def test_names_are_escaped_and_numbers_checked():
    assert 'name="a &amp; b"' in urdf.robot("a & b", [])
    with pytest.raises(ValueError, match="finite"):
        urdf.sphere_shape([0, 0, np.inf], 1.0)
    with pytest.raises(ValueError, match="at least one box"):
        urdf.compound("void", Boxes.empty())
    with pytest.raises(ValueError, match="needs limits"):
        urdf.joint("j", "revolute", "a", "b")
