"""The box caster on cases that one can work out by hand, and on what holds for any scene."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed import frames
from testbed.geometry import WORLD, Boxes
from testbed.scene import Body, Scene
from worlds.boxtree import forest
from worlds.ray_kernels import SURFACE, WIDTH
from worlds.raycast import BoxCaster

IDENTITY = frames.IDENTITY
ENTRY, PER_METRE = np.array([3.0, 1.0]), np.array([10.0, 0.0])
NO_POSES = np.zeros((1, 0, 7))


def scene_of(center, half=(0.5, 0.5, 0.5), quaternion=None, material=0, body=0, bodies=None):
    center = np.asarray(center, dtype=float).reshape(-1, 3)
    n = len(center)
    quaternion = np.tile(IDENTITY[3:], (n, 1)) if quaternion is None else np.broadcast_to(quaternion, (n, 4))
    boxes = Boxes(
        center=center,
        quaternion=quaternion,
        half=np.broadcast_to(half, (n, 3)),
        body=np.broadcast_to(body, n),
        material=np.broadcast_to(material, n),
    )
    return Scene(bodies or (Body("thing", "thing", IDENTITY),), boxes, ("wet", "thin"), np.array([[-9.0] * 3, [9.0] * 3]))


def caster_of(*args, **kwargs):
    return BoxCaster(scene_of(*args, **kwargs), ENTRY, PER_METRE)


def one(caster, start, end):
    """Count and loss of a single segment by what stands still."""
    found = caster.static(np.array([start], dtype=float), np.array([end], dtype=float))
    return int(found.count[0]), float(found.loss[0])


def moving_thing(*args, n=1, **kwargs):
    bodies = tuple(Body(f"m{i}", "thing", IDENTITY, moving=True) for i in range(n))
    return caster_of(*args, bodies=bodies, **kwargs)


def test_a_box_takes_its_entry_loss_and_its_loss_per_metre_inside():
    assert one(caster_of([0, 0, 0]), (-2, 0, 0), (2, 0, 0)) == (1, pytest.approx(3.0 + 10.0 * 1.0, abs=1e-12))
    assert one(caster_of([0, 0, 0], material=1), (-2, 0, 0), (2, 0, 0)) == (1, 1.0)


def test_a_diagonal_runs_through_the_whole_diagonal():
    assert one(caster_of([0, 0, 0]), (-1, -1, -1), (2, 2, 2)) == (1, pytest.approx(3.0 + 10.0 * np.sqrt(3), abs=1e-12))


def test_only_the_part_between_the_ends_counts():
    caster = caster_of([0, 0, 0])
    assert one(caster, (0, 0, 0), (2, 0, 0)) == (1, pytest.approx(3 + 10 * 0.5))
    assert one(caster, (-2, 0, 0), (0.25, 0, 0)) == (1, pytest.approx(3 + 10 * 0.75))
    assert one(caster, (-0.25, 0, 0), (0.25, 0, 0)) == (1, pytest.approx(3 + 10 * 0.5))
    assert one(caster, (-2, 0, 0), (-0.6, 0, 0)) == (0, 0.0)
    assert one(caster, (0.6, 0, 0), (2, 0, 0)) == (0, 0.0)


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((-2, 0, 0), (-0.5, 0, 0)),  # ends on a face
        ((0.5, 0.1, 0), (3, 0.1, 0)),  # starts on a face
        ((-2, 0.5, 0), (2, 0.5, 0)),  # runs within a face
        ((-2, 0.5, 0.5), (2, 0.5, 0.5)),  # runs along an edge
        ((-2, 0.5, 0), (2, 0.5 + 1e-10, 0)),  # within a face but for rounding
        ((-2, 0.5 - 2e-10, 0), (2, 0.5 - 2e-10, 0)),  # the same on the other side
        ((-2, 0.5 - 1e-10, 0), (2, 0.5 - 3e-10, 0)),  # the same, not quite parallel
        ((-2, 0, 0), (-0.5 + 5e-10, 0, 0)),  # ends in a face but for rounding
        ((0, 1, 0), (1, 0, 0)),  # touches an edge
        ((1.5, 0, 0), (0, 1.5, 1.5 - 1e-12)),  # touches a corner
        ((0.2, 0.2, 0.2), (0.2, 0.2, 0.2)),  # is a point inside
        ((0.2, 0.2, 0.2), (0.2, 0.2, 0.2 + SURFACE / 2)),  # is shorter than a surface is thick
    ],
)
def test_touching_is_no_crossing(start, end):
    assert one(caster_of([0, 0, 0]), start, end) == (0, 0.0)


def test_a_micrometre_below_the_surface_is_a_crossing():
    caster = caster_of([0, 0, 0])
    assert one(caster, (-2, 0.5 - 1e-6, 0), (2, 0.5 - 1e-6, 0)) == (1, pytest.approx(13.0))
    assert one(caster, (0, 1, 0), (1 - 1e-6, 0, 0))[0] == 1
    assert one(caster, (-2, 0, 0), (-0.5 + 1e-6, 0, 0))[0] == 1
    assert one(caster, (0, 0, 0), (1e-6, 0, 0)) == (1, pytest.approx(3.0 + 10.0 * 1e-6, abs=1e-12))


def test_boxes_that_share_a_face_or_a_place_are_all_counted():
    side_by_side = caster_of([[0, 0, 0], [1, 0, 0], [1, 0, 0]])
    found = side_by_side.crossings(np.array([[-2.0, 0, 0]]), np.array([[4.0, 0, 0]]), NO_POSES, np.zeros(1, dtype=int))
    assert found.box.tolist() == [0, 1, 2]
    np.testing.assert_allclose(found.enter, [1.5, 2.5, 2.5])
    np.testing.assert_allclose(found.length, [1.0, 1.0, 1.0])


def test_a_row_of_five_thousand_boxes_is_counted_to_the_last():
    n = 5000  # more than one block of the topmost level, whatever its width
    caster = caster_of(np.stack([np.arange(n), 0 * np.arange(n), 0 * np.arange(n)], axis=1), half=(0.25, 0.25, 0.25))
    assert n > WIDTH**3
    assert one(caster, (-1, 0, 0), (n, 0, 0)) == (n, pytest.approx(n * (3.0 + 10.0 * 0.5)))
    assert one(caster, (n, 0.3, 0), (-1, 0.3, 0)) == (0, 0.0)


def test_a_box_without_thickness_and_a_hall_without_boxes_stop_nothing():
    assert one(caster_of([0, 0, 0], half=(0.5, 0.5, 0.0)), (0, 0, -1), (0.1, 0.2, 1)) == (0, 0.0)
    assert one(caster_of(np.zeros((0, 3))), (0, 0, -1), (0.1, 0.2, 1)) == (0, 0.0)
    assert caster_of(np.zeros((0, 3))).inside(np.zeros((2, 3))).tolist() == [-1, -1]


def test_boxes_of_the_world_and_of_a_body_at_rest_stand_where_they_should():
    bodies = (Body("rack", "rack", np.array([5.0, 0, 0, *frames.from_euler(np.pi / 2)])),)
    caster = caster_of([[1, 0, 0], [1, 0, 0]], half=(0.5, 0.1, 0.1), body=[WORLD, 0], bodies=bodies)
    assert one(caster, (-3, 0, 0), (3, 0, 0)) == (1, pytest.approx(13.0))  # the world's lies along x
    assert one(caster, (5, -3, 0), (5, 3, 0)) == (1, pytest.approx(13.0))  # the rack's lies along y
    assert caster.inside(np.array([[1.4, 0, 0], [5, 1.4, 0], [6.4, 0, 0]])).tolist() == [0, 1, -1]


def test_a_turned_box_is_as_thick_as_it_looks():
    caster = caster_of([0, 0, 0], quaternion=frames.from_euler(np.pi / 4))
    assert one(caster, (-2, 0, 0), (2, 0, 0)) == (1, pytest.approx(3 + 10 * np.sqrt(2)))


def test_moving_bodies_are_met_at_the_pose_of_each_segments_instant():
    caster = moving_thing([0, 0, 1], half=(0.5, 0.1, 0.1))
    poses = np.array([[[0.0, 0, 0, *frames.from_euler(0.0)]], [[0, 0, 0, *frames.from_euler(np.pi / 2)]], [[7, 0, 0, 1, 0, 0, 0]]])
    start, end = np.tile([-3.0, 0, 1], (3, 1)), np.tile([3.0, 0, 1], (3, 1))
    found = caster.moving(start, end, poses, np.array([1, 2, 0]))
    assert found.count.tolist() == [1, 0, 1]
    np.testing.assert_allclose(found.loss, [3 + 10 * 0.2, 0, 3 + 10 * 1.0])
    assert caster.static(start, end).count.tolist() == [0, 0, 0]


def test_a_hundred_moving_bodies_are_all_met():
    n = 100  # more than one word of 32 bits
    caster = moving_thing(np.zeros((n, 3)), half=(0.1, 0.1, 0.1), body=np.arange(n), n=n)
    poses = np.tile(IDENTITY, (2, n, 1))
    poses[0, :, 0] = np.arange(n)
    poses[1, :, 1] = 5.0 + np.arange(n)
    start, end = np.array([[-1.0, 0, 0], [-1.0, 0, 0]]), np.array([[200.0, 0, 0], [200.0, 0, 0]])
    assert caster.moving(start, end, poses, np.array([0, 1])).count.tolist() == [n, 0]
    assert caster.crossings(start, end, poses, np.array([0, 1])).box.tolist() == list(range(n))


def test_a_moving_body_without_boxes_is_met_by_nothing():
    caster = moving_thing([0, 0, 0], body=1, n=2)
    found = caster.moving(np.array([[-2.0, 0, 0]]), np.array([[2.0, 0, 0]]), np.tile(IDENTITY, (1, 2, 1)), np.zeros(1, dtype=int))
    assert found.count.tolist() == [1]


def test_no_segments_give_no_results():
    caster, none = moving_thing([0, 0, 0]), np.zeros((0, 3))
    assert caster.static(none, none).count.shape == (0,)
    assert caster.moving(none, none, np.zeros((0, 1, 7)), np.zeros(0)).loss.shape == (0,)
    assert len(caster.crossings(none, none, np.zeros((0, 1, 7)), np.zeros(0, dtype=int))) == 0


SEGMENT = (np.zeros((2, 3)), np.ones((2, 3)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.static(np.zeros((2, 3)), np.zeros((3, 3))), "segments want two arrays"),
        (lambda c: c.static(np.zeros(3), np.zeros(3)), "segments want two arrays"),
        (lambda c: c.static(np.array([[0.0, 0, 0], [np.nan, 0, 0]]), np.zeros((2, 3))), "segment 1 runs from"),
        (lambda c: c.static(np.zeros((1, 3)), np.full((1, 3), np.inf)), "segment 0 runs from"),
        (lambda c: c.moving(*SEGMENT, np.zeros((1, 2, 7)), np.zeros(2, dtype=int)), r"poses: wants shape \(instants, 1, 7\)"),
        (lambda c: c.moving(*SEGMENT, np.zeros((1, 1, 7)), np.zeros(2, dtype=int)), "quaternions of unit length"),
        (lambda c: c.moving(*SEGMENT, IDENTITY.reshape(1, 1, 7), np.array([0, 1])), "instant: wants 2 numbers from 0 to 0"),
        (lambda c: c.moving(*SEGMENT, IDENTITY.reshape(1, 1, 7), np.array([-1, 0])), "instant: wants 2 numbers from 0 to 0"),
        (lambda c: c.moving(*SEGMENT, IDENTITY.reshape(1, 1, 7), np.zeros(3, dtype=int)), "instant: wants 2 numbers"),
        (lambda c: c.moving(*SEGMENT, IDENTITY.reshape(1, 1, 7), np.zeros(2)), "instant: wants integers"),
    ],
)
def test_bad_segments_poses_and_instants_are_refused_in_a_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call(moving_thing([0, 0, 0]))


@pytest.mark.parametrize(
    ("scene", "entry", "message"),
    [
        (scene_of([0, 0, 0]), np.zeros(3), "entry_db: wants one finite number for each of 2 materials"),
        (scene_of([0, 0, 0]), np.array([0.0, np.nan]), "entry_db: wants one finite number"),
        (scene_of([0, 0, 0], half=(0.1, -0.1, 0.1)), ENTRY, "half lengths"),
        (scene_of([0, np.nan, 0]), ENTRY, "centre that isn't finite"),
        (scene_of([0, 0, 0], quaternion=[2.0, 0, 0, 0]), ENTRY, "unit length"),
    ],
)
def test_bad_scenes_and_losses_are_refused_in_a_sentence(scene, entry, message):
    with pytest.raises(ValueError, match=message):
        BoxCaster(scene, entry, PER_METRE)


def cloud(seed, boxes=80, segments=60):
    rng = np.random.default_rng(seed)
    turned = frames.normalise(rng.normal(size=(boxes, 4)))
    turned[::2] = frames.from_euler(rng.integers(-4, 5, len(turned[::2])) * np.pi / 2)
    scene = scene_of(rng.uniform(-3, 3, (boxes, 3)), rng.uniform(0.05, 0.6, (boxes, 3)), turned, material=rng.integers(0, 2, boxes))
    start, end = rng.uniform(-4, 4, (2, segments, 3))
    return scene, start, end


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_segment_read_backwards_meets_the_same_boxes(seed):
    scene, start, end = cloud(seed)
    caster = BoxCaster(scene, ENTRY, PER_METRE)
    there, back = caster.static(start, end), caster.static(end, start)
    np.testing.assert_array_equal(there.count, back.count)
    np.testing.assert_allclose(there.loss, back.loss, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_the_two_halves_of_a_segment_hold_what_the_whole_holds(seed, share):
    scene, start, end = cloud(seed)
    caster, middle = BoxCaster(scene, np.zeros(2), np.ones(2)), start + share * (end - start)  # losses are lengths
    whole, parts = caster.static(start, end).loss, caster.static(start, middle).loss + caster.static(middle, end).loss
    np.testing.assert_allclose(parts, whole, atol=1e-8)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_scene_and_its_segments_turned_together_look_the_same(seed):
    scene, start, end = cloud(seed)
    rng = np.random.default_rng(seed)
    pose = np.concatenate([rng.uniform(-20, 20, 3), frames.normalise(rng.normal(size=4))])
    there = Scene((Body("thing", "thing", pose),), scene.boxes, scene.materials, scene.bounds)
    moving = Scene((Body("thing", "thing", IDENTITY, moving=True),), scene.boxes, scene.materials, scene.bounds)
    still = BoxCaster(scene, ENTRY, PER_METRE).static(start, end)
    placed = frames.to_world(pose, start), frames.to_world(pose, end)
    turned = BoxCaster(there, ENTRY, PER_METRE).static(*placed)
    moved = BoxCaster(moving, ENTRY, PER_METRE).moving(*placed, pose.reshape(1, 1, 7), np.zeros(len(start), dtype=int))
    for found in (turned, moved):
        np.testing.assert_array_equal(found.count, still.count)
        np.testing.assert_allclose(found.loss, still.loss, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_answers_depend_neither_on_the_other_segments_nor_on_the_order_of_boxes(seed):
    scene, start, end = cloud(seed, segments=1500)  # more than a chunk
    caster = BoxCaster(scene, ENTRY, PER_METRE)
    together = caster.static(start, end)
    some = np.random.default_rng(seed).permutation(len(start))[:50]
    apart = caster.static(start[some], end[some])
    np.testing.assert_array_equal(apart.loss, together.loss[some])  # bit for bit
    mixed = np.random.default_rng(seed).permutation(len(scene.boxes))
    other = Scene(scene.bodies, scene.boxes.take(mixed), scene.materials, scene.bounds)
    np.testing.assert_array_equal(BoxCaster(other, ENTRY, PER_METRE).static(start, end).count, together.count)


def test_obstructions_are_the_sums_of_the_crossings():
    scene, start, end = cloud(7, segments=400)
    caster = BoxCaster(scene, ENTRY, PER_METRE)
    listed, summed = caster.crossings(start, end, NO_POSES, np.zeros(len(start), dtype=int)), caster.static(start, end)
    material = scene.boxes.material[listed.box]
    loss = np.bincount(listed.segment, ENTRY[material] + PER_METRE[material] * listed.length, minlength=len(start))
    np.testing.assert_array_equal(np.bincount(listed.segment, minlength=len(start)), summed.count)
    np.testing.assert_allclose(summed.loss, loss, atol=1e-9)


@pytest.mark.parametrize("boxes", [0, 1, WIDTH, WIDTH + 1, 40 * WIDTH])
def test_every_box_is_packed_exactly_once(boxes):
    rng = np.random.default_rng(boxes)
    scene = scene_of(rng.uniform(-9, 9, (boxes, 3)), rng.uniform(0.1, 0.4, (boxes, 3)))
    trees = forest([scene.boxes], [np.arange(boxes)])
    for member, size in ((trees.box_of, boxes), (trees.leaf_of, len(trees.box_of)), (trees.middle_of, len(trees.leaf_of))):
        np.testing.assert_array_equal(np.sort(member[member >= 0]), np.arange(size))
