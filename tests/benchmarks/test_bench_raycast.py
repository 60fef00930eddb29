"""Speed of the box caster: against PyBullet's ray batch, and of what moves against everything. Both sides measured in one run.

`pytest -m benchmark --benchmark-enable -s tests/benchmarks/test_bench_raycast.py` also prints µs per ray.
"""

import time

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes
from testbed.scene import Body, Scene
from worlds.raycast import BoxCaster

pytestmark = pytest.mark.benchmark

RACKS, PER_RACK, CARTONS = 40, 50, 38
FLOOR = np.array([42.0, 22.0])
TIMES_FASTER = 25  # all obstacles by boxes against the first hit by PyBullet
SHARE = 1 / 8  # what moves, of a full cast


def best(*calls, rounds=9):
    """Shortest wall time of each call, s. The calls take turns, so that all of them get quiet moments and none gets them all."""
    seconds = np.empty((rounds, len(calls)))
    for r in range(rounds):
        for i, call in enumerate(calls):
            began = time.perf_counter()
            call()
            seconds[r, i] = time.perf_counter() - began
    return seconds.min(axis=0)


def rack(rng):
    """Centres and halves of a rack of 4 m: 8 posts, 4 shelves, 38 cartons on them."""
    boxes = [((x, y, 2.0), (0.04, 0.04, 2.0)) for x in np.linspace(0, 4, 4) for y in (0.0, 1.0)]
    boxes += [((2.0, 0.5, z), (2.0, 0.5, 0.02)) for z in (0.2, 1.4, 2.6, 3.8)]
    for k in range(CARTONS):
        half = rng.uniform([0.1, 0.15, 0.1], [0.18, 0.4, 0.45])
        boxes.append(((0.3 + 0.4 * (k // 4), 0.5, 0.22 + 1.2 * (k % 4) + half[2]), half))
    return boxes


def trolley():
    """Centres and halves of a loaded trolley: deck, posts, shelves, six crates."""
    posts = [((x, y, 0.9), (0.02, 0.02, 0.6)) for x in (-0.55, 0.55) for y in (-0.35, 0.35)]
    decks = [((0, 0, z), (0.6, 0.4, 0.02)) for z in (0.3, 0.8, 1.3)]
    return posts + decks + [((x, 0, z), (0.12, 0.3, 0.2)) for x in (-0.3, 0.0, 0.3) for z in (0.53, 1.03)]


def hall(movers=0):
    """A hall of 2,000 boxes in racks, with some trolleys that move."""
    rng = np.random.default_rng(1)
    places = [np.array([5.0 * (r % 8), 4.0 * (r // 8), 0.0, *frames.IDENTITY[3:]]) for r in range(RACKS)]
    bodies = [Body(f"rack{r}", "rack", place) for r, place in enumerate(places)]
    boxes = [(*box, r) for r in range(RACKS) for box in rack(rng)]
    for m in range(movers):
        bodies.append(Body(f"trolley{m}", "trolley", frames.IDENTITY, moving=True))
        boxes += [(*box, RACKS + m) for box in trolley()]
    center, half, body = (np.array(column) for column in zip(*boxes, strict=True))
    material = np.arange(len(center)) % 3
    boxes = Boxes(center=center, quaternion=np.tile(frames.IDENTITY[3:], (len(center), 1)), half=half, body=body, material=material)
    return Scene(tuple(bodies), boxes, ("steel", "carton", "wood"), np.array([[0, 0, 0], [*FLOOR, 5.0]]))


def caster(scene):
    return BoxCaster(scene, np.array([20.0, 1.0, 3.0]), np.array([0.0, 10.0, 20.0]))


def links(scene, antennas, tags, rng):
    """Segments from antennas under the ceiling to tags on the long sides of cartons."""
    above = rng.uniform([0, 0, 2], [*FLOOR, 4.5], (antennas, 3))
    boxes = scene.static_boxes()
    carton = rng.choice(np.flatnonzero(np.arange(len(boxes)) % PER_RACK >= PER_RACK - CARTONS), tags)
    side = rng.choice([-1.0, 1.0], tags) * (boxes.half[carton, 1] + 0.02)
    on = boxes.center[carton] + side[:, None] * np.array([0.0, 1.0, 0.0])
    return np.repeat(above, tags, axis=0), np.tile(on, (antennas, 1))


def test_all_obstacles_by_boxes_are_found_25_times_faster_than_pybullets_first_hit(benchmark):
    pytest.importorskip("pybullet")
    from worlds.bullet import RAYS_PER_CALL, Client

    scene = hall()
    start, end = links(scene, 64, RAYS_PER_CALL // 64, np.random.default_rng(2))
    boxes = caster(scene)
    with Client() as compounds, Client() as separate:
        compounds.load_static(scene)
        static = scene.static_boxes()
        for half, pose in zip(static.half, np.concatenate([static.center, static.quaternion], axis=1), strict=True):
            separate.load_box(half, pose, "box")

        def first_hits(client):  # as directly as it goes: without our own wrapping
            return lambda: client._p.rayTestBatch(start, end, numThreads=1, physicsClientId=client._id)

        assert (boxes.static(start, end).count > 0).mean() == pytest.approx((compounds.hits(start, end).body >= 0).mean(), abs=0.002)
        ours, *theirs = best(lambda: boxes.static(start, end), first_hits(compounds), first_hits(separate)) / len(start) * 1e6
    benchmark.pedantic(boxes.static, (start, end), rounds=5)
    benchmark.extra_info.update(
        us_per_ray=ours, pybullet_us_per_ray_in_compounds=theirs[0], pybullet_us_per_ray_separate=theirs[1], times_faster=min(theirs) / ours
    )
    assert len(scene.boxes) == 2000
    assert min(theirs) >= TIMES_FASTER * ours, benchmark.extra_info


def test_what_moves_is_cast_again_in_an_eighth_of_a_full_cast(benchmark):
    scene, rng = hall(movers=5), np.random.default_rng(3)
    boxes = caster(scene)
    start, end = links(scene, 64, 2000, rng)
    poses, instant = np.tile(frames.IDENTITY, (1, 5, 1)), np.zeros(len(start), dtype=np.int64)
    poses[0, :, :2] = rng.uniform([2, 2], FLOOR - 2, (5, 2))
    poses[0, :, 3:] = frames.from_euler(rng.uniform(-np.pi, np.pi, 5))
    assert boxes.moving(start, end, poses, instant).count.sum() > 1000
    still, moving = best(lambda: boxes.static(start, end), lambda: boxes.moving(start, end, poses, instant))
    benchmark.pedantic(boxes.moving, (start, end, poses, instant), rounds=5)
    benchmark.extra_info.update(still_ms=still * 1e3, moving_ms=moving * 1e3, share=moving / (still + moving))
    assert moving <= SHARE * (still + moving), benchmark.extra_info
