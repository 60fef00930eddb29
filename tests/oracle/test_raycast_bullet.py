"""The box caster against PyBullet's own rays in the demo world. Every difference must have an explanation."""

import numpy as np
import pytest

pytest.importorskip("pybullet")

from testbed import frames
from testbed.geometry import Boxes
from testbed.protocols import ActorPlan
from testbed.scene import Body, Scene
from worlds.actors.forklift import Forklift
from worlds.actors.trolley import Trolley
from worlds.bullet_rays import BulletCaster
from worlds.dock_gate import DockGate
from worlds.parts import floor_pose
from worlds.raycast import BoxCaster

SEGMENTS, INSTANTS = 10_000, 12
GRAZE = 1e-4  # m: PyBullet may miss a corner or an edge if less than this of a segment is inside
WITHIN_FACE = 1e-6  # m: a segment that stays as near as this to a face; whose side it is on is a matter of rounding
LENGTH = 1e-4  # m by which lengths inside may differ


@pytest.fixture(scope="module")
def scene():
    trolley, forklift = Trolley(Trolley.Config()), Forklift(Forklift.Config())
    plans = [
        ActorPlan("t1", "trolley", "kinematic", trolley, None, floor_pose(1.5, 3.0)),
        ActorPlan("forklift", "forklift", "kinematic", forklift, None, floor_pose(7.0, 9.3)),
    ]
    return DockGate(DockGate.Config()).scene(plans)


@pytest.fixture(scope="module")
def cast(scene):
    """Half the segments between mounts of antennas and mounts of tags, half between any points of the hall."""
    rng = np.random.default_rng(20262)
    start, end = rng.uniform(scene.bounds[0], scene.bounds[1], (2, SEGMENTS, 3))
    mounts = frames.to_world(scene.rest_poses()[scene.mounts.body], scene.mounts.position)
    for points, use in ((start, "antenna"), (end, "tag")):
        points[: SEGMENTS // 2] = rng.choice(mounts[scene.mounts.use == use], SEGMENTS // 2)
    poses = np.tile(frames.IDENTITY, (INSTANTS, len(scene.moving), 1))
    poses[..., :2] = rng.uniform([1, 1], scene.bounds[1, :2] - 1, (*poses.shape[:2], 2))
    poses[..., 3:] = frames.from_euler(rng.uniform(-np.pi, np.pi, poses.shape[:2]))
    return start, end, poses, rng.integers(0, INSTANTS, SEGMENTS)


@pytest.fixture(scope="module")
def losses(scene):
    rng = np.random.default_rng(1)
    return rng.uniform(1, 20, len(scene.materials)), rng.uniform(0, 40, len(scene.materials))


@pytest.fixture(scope="module")
def reference(scene, cast, losses):
    return BulletCaster(scene, *losses).crossings(*cast)


def explanation(scene, cast, segment, box, length):
    """Why the two engines may differ over a crossing, or None."""
    if length < GRAZE:
        return "grazes an edge"
    start, end, poses, instant = cast
    body = scene.boxes.body[box]
    pose = poses[instant[segment], list(scene.moving).index(body)] if body in scene.moving else scene.bodies[body].pose
    boxes = scene.boxes.take(slice(box, box + 1))
    pose = frames.compose(pose, np.concatenate([boxes.center[0], boxes.quaternion[0]]))
    ends = frames.to_local(pose, np.stack([start[segment], end[segment]]))
    apart = np.abs(np.abs(ends) - boxes.half[0])
    return "runs within a face" if ((apart < WITHIN_FACE).all(axis=0) & (ends[0] * ends[1] > 0)).any() else None


def differences(found, reference):
    """{(segment, box): length} of crossings that only one engine knows or whose lengths differ."""
    one, other = (dict(zip(zip(c.segment.tolist(), c.box.tolist(), strict=True), c.length, strict=True)) for c in (found, reference))
    return {
        key: max(one.get(key, 0.0), other.get(key, 0.0))
        for key in sorted(one.keys() | other.keys())
        if key not in one or key not in other or abs(one[key] - other[key]) > LENGTH
    }


def agreement(differing):
    return 1 - len({segment for segment, _ in differing}) / SEGMENTS


def unexplained(scene, cast, differing):
    return [(key, length) for key, length in differing.items() if explanation(scene, cast, *key, length) is None]


def test_both_engines_agree_in_the_demo_world_and_every_difference_is_explained(scene, cast, losses, reference):
    assert len(np.unique(reference.segment)) > SEGMENTS / 3
    moving = np.isin(scene.boxes.body[reference.box], scene.moving)
    assert 100 < moving.sum() < len(reference) / 2
    differing = differences(BoxCaster(scene, *losses).crossings(*cast), reference)
    assert agreement(differing) >= 0.9995
    assert unexplained(scene, cast, differing) == []


def test_obstructions_of_both_engines_have_the_same_counts_and_losses(scene, cast, losses):
    some = slice(SEGMENTS // 2 - 750, SEGMENTS // 2 + 750)
    start, end, poses, instant = cast[0][some], cast[1][some], cast[2], cast[3][some]
    boxes, bullet = BoxCaster(scene, *losses), BulletCaster(scene, *losses)
    for one, other in (
        (boxes.static(start, end), bullet.static(start, end)),
        (boxes.moving(start, end, poses, instant), bullet.moving(start, end, poses, instant)),
    ):
        assert (one.count != other.count).mean() <= 0.0005
        same = one.count == other.count
        np.testing.assert_array_less(np.abs(one.loss - other.loss)[same], 1e-9 + LENGTH * losses[1].max() * one.count[same] + 1e-9)


@pytest.mark.parametrize("mutation", ["quaternions as x, y, z, w", "rotations the other way", "the next instant", "boxes 1 mm larger"])
def test_the_comparison_notices(scene, cast, losses, reference, mutation):
    start, end, poses, instant = cast
    if mutation == "boxes 1 mm larger":
        scene = Scene(scene.bodies, scene.boxes.with_(half=scene.boxes.half + 0.0005), scene.materials, scene.bounds)
    elif mutation == "the next instant":
        poses = np.roll(poses, -1, axis=0)
    else:
        turned = frames.conjugate(poses[..., 3:]) if mutation == "rotations the other way" else np.roll(poses[..., 3:], -1, axis=-1)
        poses = np.concatenate([poses[..., :3], turned], axis=-1)
    differing = differences(BoxCaster(scene, *losses).crossings(start, end, poses, instant), reference)
    assert agreement(differing) < 0.9995
    assert unexplained(scene, cast, dict(list(differing.items())[:100]))


def things(center, half, quaternion=None):
    """A scene of some boxes of one material."""
    center = np.asarray(center, dtype=float)
    quaternion = np.tile([1.0, 0, 0, 0], (len(center), 1)) if quaternion is None else quaternion
    boxes = Boxes(center=center, quaternion=quaternion, half=np.broadcast_to(half, center.shape), body=np.zeros(len(center)))
    return Scene((Body("things", "thing", frames.IDENTITY),), boxes, ("stuff",), np.array([[-9.0] * 3, [9.0] * 3]))


def both(scene):
    """The two engines, 1 dB and 10 dB/m."""
    return [engine(scene, np.array([1.0]), np.array([10.0])) for engine in (BoxCaster, BulletCaster)]


NO_POSES = np.zeros((1, 0, 7))


def listed(caster, start, end):
    return caster.crossings(start, end, NO_POSES, np.zeros(len(start), dtype=int))


def assert_same(engines, start, end):
    one, other = (listed(e, start, end) for e in engines)
    np.testing.assert_array_equal(one.segment, other.segment)
    np.testing.assert_array_equal(one.box, other.box)
    np.testing.assert_allclose(one.enter, other.enter, atol=1e-9)
    np.testing.assert_allclose(one.length, other.length, atol=1e-9)
    return one


def test_segments_that_start_end_or_lie_inside_a_box():
    start = np.array([[0.0, 0.1, 0.2], [-3.0, 0.1, 0.2], [-0.4, 0.1, 0.2], [0.0, 0.1, 0.2]])
    end = np.array([[3.0, 0.1, 0.2], [0.0, 0.1, 0.2], [0.3, 0.2, 0.1], [0.0, 0.1, 0.2]])
    found = assert_same(both(things([[0.0, 0.0, 0.0]], [0.5, 0.5, 0.5])), start, end)
    assert found.segment.tolist() == [0, 1, 2]  # the last has no length
    np.testing.assert_allclose(found.length, [0.5, 0.5, np.linalg.norm(end[2] - start[2])])


def test_boxes_whose_faces_coincide_are_all_found():
    # Cartons side by side and on top of each other, one twice in the same place, one that ends flush inside another
    center = [[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [1.0, 0, 0], [1.0, 0, 1.0]]
    rng = np.random.default_rng(3)
    start, end = np.array([-4.0, 0, 0]) + rng.uniform(-0.4, 0.4, (200, 3)), np.array([6.0, 0, 0]) + rng.uniform(-0.4, 0.4, (200, 3))
    found = assert_same(both(things(center, [0.5, 0.5, 0.5])), start, end)
    assert np.bincount(found.segment).min() >= 4


def test_only_grazes_and_segments_within_a_face_are_explained():
    scene = things([[0.0, 0.0, 0.0]], [0.5, 0.5, 0.5])
    ends = [[[-2, 0.5, 0], [2, 0.5, 0]], [[-2, 0.5 - 1e-5, 0], [2, 0.5 - 1e-5, 0]], [[-2, 0.5, 0], [2, -0.5, 0]]]
    start, end = np.array(ends, dtype=float).swapaxes(0, 1)
    cast = start, end, NO_POSES, np.zeros(3, dtype=int)
    assert [explanation(scene, cast, i, 0, 1.0) for i in range(3)] == ["runs within a face", None, None]
    assert explanation(scene, cast, 2, 0, 0.5 * GRAZE) == "grazes an edge"


def test_turned_boxes_and_long_segments():
    rng = np.random.default_rng(4)
    center, quaternion = rng.uniform(-3, 3, (60, 3)), frames.normalise(rng.normal(size=(60, 4)))
    start, end = rng.uniform(-60, 60, (2, 3000, 3))
    end = rng.uniform(-2, 2, end.shape) + (rng.uniform(-2, 2, end.shape) - start)  # past the middle, as far again
    one, other = (listed(e, start, end) for e in both(things(center, [0.4, 0.2, 0.3], quaternion)))
    known = set(zip(other.segment, other.box, strict=True))
    missed = np.array([(s, b) not in known for s, b in zip(one.segment, one.box, strict=True)])
    assert len(one) > 3000
    assert (one.length[missed] < GRAZE).all()
    assert known <= set(zip(one.segment, one.box, strict=True))


def test_nothing_stands_in_an_empty_hall():
    empty = Scene((), Boxes.empty(), ("air",), np.array([[0.0] * 3, [9.0] * 3]))
    caster = BulletCaster(empty, np.zeros(1), np.zeros(1))
    start, end = np.zeros((3, 3)), np.ones((3, 3))
    assert caster.static(start, end).count.tolist() == [0, 0, 0]
    assert caster.moving(start, end, NO_POSES, np.zeros(3, dtype=int)).loss.tolist() == [0.0, 0.0, 0.0]
    assert len(listed(caster, start, end)) == 0
    assert caster.static(start[:0], end[:0]).count.shape == (0,)
