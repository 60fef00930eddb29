"""The box caster against an independent slab test: every pair of segment and box, one box at a time, in plain numpy."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import WORLD, Boxes
from testbed.scene import Body, Scene
from worlds.raycast import BoxCaster

MATERIALS = ("steel", "carton", "wood")
ENTRY, PER_METRE = np.array([20.0, 1.5, 4.0]), np.array([0.0, 12.0, 30.0])
HALL = np.array([[0.0, 0.0, 0.0], [24.0, 12.0, 4.0]])
SEGMENTS, INSTANTS = 10_000, 11
TOUCH = 1e-9  # m


def slab(boxes, start, end):
    """Where each of N segments enters each of B boxes, and how much of it lies inside (N, B), m; 0 long where it misses."""
    axes = frames.matrix(boxes.quaternion)  # columns
    length = np.linalg.norm(end - start, axis=1)
    enter, inside = np.zeros((len(start), len(boxes))), np.zeros((len(start), len(boxes)))
    for b in range(len(boxes)):
        a, way = (start - boxes.center[b]) @ axes[b], (end - start) @ axes[b]
        flat = np.abs(way) < TOUCH
        way = np.where(flat, 1.0, way)
        first = np.minimum((-boxes.half[b] - a) / way, (boxes.half[b] - a) / way)
        last = np.maximum((-boxes.half[b] - a) / way, (boxes.half[b] - a) / way)
        first, last = np.where(flat, 0.0, first).max(axis=1).clip(min=0.0), np.where(flat, 1.0, last).min(axis=1).clip(max=1.0)
        within = (~flat | (np.abs(a) < boxes.half[b] - TOUCH)).all(axis=1)
        piece = np.where(within, last - first, 0.0) * length
        enter[:, b], inside[:, b] = first * length, np.where(piece > TOUCH, piece, 0.0)
    return enter, inside


def crossings_by_slab(scene, start, end, poses, instant, moving):
    """(C, 4) rows of segment, box, enter, length, by the boxes that move or by those that don't."""
    owner, rows = scene.boxes.body, []
    rest = np.concatenate([scene.rest_poses(), [frames.IDENTITY]])
    for q in range(len(poses)) if moving else [None]:
        some = np.arange(len(start)) if q is None else np.flatnonzero(instant == q)
        index = np.flatnonzero(np.isin(owner, scene.moving) == moving)
        boxes = scene.boxes.take(index)
        pose = rest[boxes.body] if q is None else poses[q][[list(scene.moving).index(b) for b in boxes.body]]
        placed = boxes.with_(
            center=frames.to_world(pose, boxes.center), quaternion=frames.normalise(frames.multiply(pose[:, 3:], boxes.quaternion))
        )
        enter, inside = slab(placed, start[some], end[some])
        i, j = np.nonzero(inside)
        rows.append(np.stack([some[i], index[j], enter[i, j], inside[i, j]], axis=1))
    return np.concatenate(rows)


def hall(rng, racks=24, cartons=14, movers=8):
    """Racks of posts, shelves and cartons at right angles, askew and tilted; crates alone; a wall of the world; vehicles."""
    bodies, boxes = [], []
    for r in range(racks):
        yaw = [0.0, np.pi / 2, np.pi, 0.3, rng.uniform(-np.pi, np.pi)][r % 5]
        tilt = 0.2 if r % 7 == 0 else 0.0
        where = [*rng.uniform(HALL[0], HALL[1] - [0, 0, 3]), *frames.from_euler(yaw, tilt, -tilt)]
        bodies.append(Body(f"rack{r}", "rack", np.array(where)))
        posts = [((x, y, 1.5), (0.04, 0.04, 1.5), 0) for x in (-1.0, 1.0) for y in (-0.5, 0.5)]
        shelves = [((0.0, 0.0, z), (1.0, 0.5, 0.015), 0) for z in (0.5, 1.5, 2.5)]
        goods = [(rng.uniform([-0.9, -0.4, 0], [0.9, 0.4, 3]), rng.uniform(0.05, 0.3, 3), 1 + k % 2) for k in range(cartons)]
        boxes += [
            (*box, r, frames.IDENTITY[3:] if i % 6 else frames.normalise(rng.normal(size=4)))
            for i, box in enumerate(posts + shelves + goods)
        ]
    boxes.append(((12.0, 6.0, 2.0), (0.1, 3.0, 2.0), 2, WORLD, frames.IDENTITY[3:]))
    for m in range(movers):
        bodies.append(Body(f"vehicle{m}", "trolley", frames.IDENTITY, moving=True))
        sides = [((x, y, 0.8), (0.03, 0.03, 0.8), 0) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
        load = [(rng.uniform([-0.4, -0.2, 0.2], [0.4, 0.2, 1.4]), rng.uniform(0.05, 0.3, 3), 1) for _ in range(5 * m)]
        boxes += [(*box, len(bodies) - 1, frames.from_euler(0.5 * (i % 3))) for i, box in enumerate(sides + load)]
    center, half, material, body, quaternion = (np.array(column) for column in zip(*boxes, strict=True))
    return Scene(tuple(bodies), Boxes(center=center, quaternion=quaternion, half=half, body=body, material=material), MATERIALS, HALL)


@pytest.fixture(scope="module")
def setting():
    rng = np.random.default_rng(20260)
    scene = hall(rng)
    start, end = rng.uniform(HALL[0], HALL[1], (2, SEGMENTS, 3))
    end[:500] = start[:500] + rng.normal(scale=0.3, size=(500, 3))  # short ones, many that start, end or lie inside
    end[500:1000] = start[500:1000] + np.eye(3)[rng.integers(0, 3, 500)] * rng.uniform(-9, 9, (500, 1))  # along the axes
    end[1000:1050] = start[1000:1050]
    movers = len(scene.moving)
    poses = np.concatenate(
        [rng.uniform(HALL[0], HALL[1], (INSTANTS, movers, 3)), frames.normalise(rng.normal(size=(INSTANTS, movers, 4)))], axis=2
    )
    instant = rng.integers(0, INSTANTS, SEGMENTS)
    by_slab = {moving: crossings_by_slab(scene, start, end, poses, instant, moving) for moving in (False, True)}
    return scene, (start, end, poses, instant), by_slab


def agrees(scene, found, rows):
    """Counts exactly and losses to 1e-9 dB."""
    segment, box = rows[:, 0].astype(int), rows[:, 1].astype(int)
    material = scene.boxes.material[box]
    loss = np.bincount(segment, ENTRY[material] + PER_METRE[material] * rows[:, 3], minlength=SEGMENTS)
    count = np.bincount(segment, minlength=SEGMENTS)
    return np.array_equal(found.count, count) and np.abs(found.loss - loss).max() < 1e-9


def test_standing_boxes_are_counted_exactly_and_their_losses_agree_to_a_billionth(setting):
    scene, (start, end, _, _), by_slab = setting
    assert len(by_slab[False]) > SEGMENTS  # the segments do meet obstacles
    assert agrees(scene, BoxCaster(scene, ENTRY, PER_METRE).static(start, end), by_slab[False])


def test_moving_boxes_are_counted_exactly_and_their_losses_agree_to_a_billionth(setting):
    scene, cast, by_slab = setting
    assert len(by_slab[True]) > SEGMENTS / 20
    assert agrees(scene, BoxCaster(scene, ENTRY, PER_METRE).moving(*cast), by_slab[True])


def test_every_crossing_is_listed_with_its_box_entrance_and_length(setting):
    scene, cast, by_slab = setting
    rows = np.concatenate([by_slab[False], by_slab[True]])
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    found = BoxCaster(scene, ENTRY, PER_METRE).crossings(*cast)
    order = np.lexsort((found.box, found.segment))
    np.testing.assert_array_equal(found.segment[order], rows[:, 0])
    np.testing.assert_array_equal(found.box[order], rows[:, 1])
    np.testing.assert_allclose(found.enter[order], rows[:, 2], atol=1e-9, rtol=0)
    np.testing.assert_allclose(found.length[order], rows[:, 3], atol=1e-9, rtol=0)
    assert (np.diff(found.segment) >= 0).all()
    assert (np.diff(found.enter)[np.diff(found.segment) == 0] >= 0).all()


def test_the_box_that_holds_a_point_is_found(setting):
    scene, _, _ = setting
    point = np.random.default_rng(5).uniform(HALL[0], HALL[1], (2000, 3))
    boxes, index = scene.static_boxes(), np.flatnonzero(~np.isin(scene.boxes.body, scene.moving))
    depth = boxes.half - np.abs(np.einsum("bij,nbi->nbj", frames.matrix(boxes.quaternion), point[:, None] - boxes.center))
    holds = (depth > TOUCH).all(axis=2)
    expected = np.where(holds.any(axis=1), index[holds.argmax(axis=1)], -1)
    assert (expected >= 0).sum() > 20
    np.testing.assert_array_equal(BoxCaster(scene, ENTRY, PER_METRE).inside(point), expected)


WRONG_BOXES = {
    "quaternions as x, y, z, w": lambda boxes: boxes.with_(quaternion=np.roll(boxes.quaternion, -1, axis=1)),
    "rotations the other way": lambda boxes: boxes.with_(quaternion=frames.conjugate(boxes.quaternion)),
    "no rotations": lambda boxes: boxes.with_(quaternion=np.tile([1.0, 0, 0, 0], (len(boxes), 1))),
    "whole for half edges": lambda boxes: boxes.with_(half=2 * boxes.half),
    "edges exchanged": lambda boxes: boxes.with_(half=boxes.half[:, [1, 0, 2]]),
    "a box left out": lambda boxes: boxes.with_(half=boxes.half * (np.arange(len(boxes)) != 5)[:, None]),
    "another material": lambda boxes: boxes.with_(material=(boxes.material + 1) % 3),
}


@pytest.mark.parametrize("mutation", WRONG_BOXES)
def test_the_comparison_notices_wrong_boxes(setting, mutation):
    scene, cast, by_slab = setting
    wrong = Scene(scene.bodies, WRONG_BOXES[mutation](scene.boxes), MATERIALS, HALL)
    caster = BoxCaster(wrong, ENTRY, PER_METRE)
    assert not agrees(scene, caster.static(*cast[:2]), by_slab[False])


@pytest.mark.parametrize("mutation", ["quaternions as x, y, z, w", "the next instant", "two bodies exchanged", "rotations the other way"])
def test_the_comparison_notices_wrong_poses(setting, mutation):
    scene, (start, end, poses, instant), by_slab = setting
    wrong = poses.copy()
    if mutation == "quaternions as x, y, z, w":
        wrong[..., 3:] = np.roll(poses[..., 3:], -1, axis=-1)
    elif mutation == "rotations the other way":
        wrong[..., 3:] = frames.conjugate(poses[..., 3:])
    elif mutation == "the next instant":
        wrong = np.roll(poses, -1, axis=0)
    else:
        wrong[:, [0, 1]] = poses[:, [1, 0]]
    assert not agrees(scene, BoxCaster(scene, ENTRY, PER_METRE).moving(start, end, wrong, instant), by_slab[True])


@pytest.mark.parametrize(("entry", "per_metre"), [(PER_METRE, ENTRY), (ENTRY, 0 * PER_METRE), (ENTRY, PER_METRE * (1 + 1e-9))])
def test_the_comparison_notices_wrong_losses(setting, entry, per_metre):
    scene, (start, end, _, _), by_slab = setting
    assert not agrees(scene, BoxCaster(scene, entry, per_metre).static(start, end), by_slab[False])
