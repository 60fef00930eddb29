"""What every world and every actor must keep to, over all that are registered."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from testbed import frames, plugins
from testbed.protocols import ActorPlan
from testbed.route import Route
from worlds.parts import MATERIALS, floor_pose
from worlds.vehicles import Drivable

CONFIGS = {
    "aisles": [{}, {"aisles": 1, "bays": 1, "levels": 1, "fill": 0.0}, {"aisles": 3, "bays": 4, "levels": 5, "fill": 1.0, "liquid": 0.5}],
    "dock_gate": [
        {},
        {"gates": 1, "parked_trolleys": 16, "racks": 4, "pallets": 4, "length_m": 20.0, "width_m": 16.0},
        {"gates": 3, "parked_trolleys": 0, "racks": 0, "pallets": 0},
        {"gate_width_m": 1.2, "gate_height_m": 2.9, "antenna_high_m": 2.6, "gate_toe_deg": 60.0, "fill": 0.0},
    ],
    "open_floor": [{}, {"posts": 8, "length_m": 30.0}, {"posts": 0, "length_m": 2.0, "width_m": 2.0}],
    "building_map": [{}, {"sizes_m": {"*Desk": (1.6, 0.8, 0.75)}, "doors": "closed"}],
}
FILES = Path(__file__).parents[1] / "files" / "worlds"
NEEDED = {  # what a world can't do without
    "sdf": {"path": f"{FILES}/hall.sdf"},
    "building_map": {"path": f"{FILES}/house.building.yaml"},
    "occupancy": {"path": f"{FILES}/map.yaml"},
    "grid": {"path": f"{FILES}/arena.map", "cell_m": 0.5},
}
HALLS = [name for name in plugins.names("worlds") if not hasattr(plugins.load("worlds", name), "played")]  # not those that play logs
WORLDS = [pytest.param(name, config, id=f"{name}{i}") for name in HALLS for i, config in enumerate(CONFIGS.get(name, [{}]))]
ROUTE = Route(waypoints_m=[(1.2, 1.0), (1.9, 1.7)], speed_jitter=0.1, lateral_jitter_m=0.01)


def world(name, config):
    cls = plugins.load("worlds", name)
    return cls(cls.Config(**NEEDED.get(name, {}), **config))


def make(kind, motion="kinematic", name=None):
    cls = plugins.load("actors", kind)
    return ActorPlan(name or f"the_{kind}", kind, motion, cls(cls.Config()), ROUTE, floor_pose(*ROUTE.waypoints_m[0]))


def world_boxes(scene):
    pose = scene.rest_poses()[scene.boxes.body]
    return frames.to_world(pose, scene.boxes.center), frames.multiply(pose[:, 3:], scene.boxes.quaternion), scene.boxes.half


def gap_to_boxes(points, center, quaternion, half):
    """(N,) m: distance of each point (N, 3) to the nearest box, negative inside."""
    best = np.full(len(points), np.inf)
    for c, q, h in zip(center, quaternion, half, strict=True):
        outside = np.abs(frames.rotate(frames.conjugate(q), points - c)) - h
        distance = np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)
        best = np.minimum(best, distance)
    return best


@pytest.mark.parametrize(("name", "config"), WORLDS)
def test_a_scene_is_sound(name, config):
    scene = world(name, config).scene([])
    assert max(Counter(b.name for b in scene.bodies).values(), default=1) == 1
    assert max(Counter(scene.mounts.name).values(), default=1) == 1
    assert not any(b.moving for b in scene.bodies)
    assert scene.materials == MATERIALS
    assert ((scene.boxes.material >= 0) & (scene.boxes.material < len(MATERIALS))).all()
    assert set(scene.piece_body) == set(range(len(scene.bodies)))  # every body has a box or a mesh
    assert (scene.boxes.half > 0).all()
    for quaternion in (scene.boxes.quaternion, scene.mounts.quaternion, scene.rest_poses()[:, 3:]):
        np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-12)
    assert set(scene.mounts.use) <= {"tag", "antenna"}


@pytest.mark.parametrize(("name", "config"), WORLDS)
def test_all_boxes_and_mounts_lie_within_the_bounds(name, config):
    scene = world(name, config).scene([])
    center, quaternion, half = world_boxes(scene)
    reach = (np.abs(frames.matrix(quaternion)) * half[:, None, :]).sum(axis=2)
    low, high = scene.bounds
    assert (center - reach >= low - 0.11).all()  # a post on the edge stands half outside
    assert (center + reach <= high + 0.11).all()
    place = frames.to_world(scene.rest_poses()[scene.mounts.body], scene.mounts.position)
    assert ((place >= low - 0.11) & (place <= high + 0.11)).all()


@pytest.mark.parametrize(("name", "config"), WORLDS)
def test_mounts_stand_at_least_a_centimetre_outside_everything(name, config):
    scene = world(name, config).scene([])
    if not len(scene.mounts):
        return
    place = frames.to_world(scene.rest_poses()[scene.mounts.body], scene.mounts.position)
    gap = gap_to_boxes(place, *world_boxes(scene))
    assert gap.min() >= 0.01, scene.mounts.name[gap.argmin()]


@pytest.mark.parametrize(("name", "config"), WORLDS)
def test_no_two_things_stand_in_each_other(name, config):
    scene = world(name, config).scene([])
    center, quaternion, half = world_boxes(scene)
    cosine, sine = np.abs(frames.matrix(quaternion)[:, 0, :2].T)
    turned = np.minimum(cosine, sine) > 1e-9
    half = np.where((sine > 0.5)[:, None], half[:, [1, 0, 2]], half)
    for i in np.flatnonzero(~turned):
        over = (half[i] + half - np.abs(center[i] - center)).min(axis=1)
        other = (over > 1e-3) & ~turned & (scene.boxes.body != scene.boxes.body[i])
        pair = [scene.bodies[b].name for b in scene.boxes.body[[i, *np.flatnonzero(other)[:1]]]]
        assert not other.any() or all(p.startswith("wall") for p in pair), pair  # walls meet in the corners


@pytest.mark.parametrize(("name", "config"), WORLDS)
def test_scenes_are_repeatable_and_zones_and_roads_lie_inside(name, config):
    hall = world(name, config)
    first, second = hall.scene([]), world(name, config).scene([])
    assert first.boxes.equals(second.boxes)
    assert first.mounts.equals(second.mounts)
    low, high = first.bounds[:, :2]
    assert (first.zones.bounds[:, :2] >= low).all()
    assert (first.zones.bounds[:, 2:] <= high).all()
    if first.roads is not None:
        assert ((first.roads.nodes >= low) & (first.roads.nodes <= high)).all()
        assert first.roads.segments.max() < len(first.roads.nodes)


@pytest.mark.parametrize("name", HALLS)
def test_every_standing_body_is_hit_by_a_ray_in_the_physics_engine(name):
    pytest.importorskip("pybullet")
    from worlds.bullet import Client

    scene = world(name, {}).scene([])
    with Client() as client:
        parts = client.load_static(scene)
        client.refresh()
        body_of = {part.handle.uid: part.body for part in parts}
        boxes = scene.static_boxes()
        above = boxes.center + np.array([0.0, 0.0, 1.0]) * (boxes.half[:, 2:] + 0.002)
        hits = client.hits(above, boxes.center)
    # nothing but the box itself, or one that rests on it, lies between its top and its middle
    hit = np.array([body_of.get(int(b), -1) for b in hits.body])
    assert set(hit[hit == boxes.body]) == set(boxes.body)
    assert set(body_of.values()) == set(range(len(scene.bodies)))  # a mesh is tested by a ray of its own when it is loaded


@pytest.mark.parametrize("name", HALLS)
def test_motion_is_a_function_of_its_arguments(name):
    hall, actors = world(name, {}), [make("person", name="p1"), make("trolley", name="t1")]
    scene = hall.scene(actors)
    assert scene.moving_names == ("p1", "t1")
    first, other, again = (hall.move(scene, actors, 2.0, 5, trial) for trial in (0, 1, 0))
    hall.close()
    assert first.bodies == ("p1", "t1")
    assert np.array_equal(first.poses, again.poses)
    assert not np.array_equal(first.poses, other.poses)


def test_two_things_of_one_name_are_refused():
    hall = world("dock_gate", {})
    with pytest.raises(ValueError, match="2 things in the hall are called 'gate1': give the actor another id"):
        hall.scene([make("person", name="gate1")])


def test_an_engine_nobody_knows_is_refused():
    hall = world("open_floor", {})
    with pytest.raises(ValueError, match="no ray engine 'lidar'"):
        hall.caster(hall.scene([]), "lidar", np.zeros(10), np.zeros(10))


@pytest.mark.parametrize("kind", plugins.names("actors"))
def test_an_actor_is_made_of_known_materials_stands_on_the_floor_and_has_mounts_outside(kind):
    actor = make(kind).actor
    boxes, names = actor.boxes()
    assert set(names) <= set(MATERIALS)
    assert boxes.material.max() < len(names)
    assert (boxes.half > 0).all()
    assert (boxes.center - boxes.half)[:, 2].min() == pytest.approx(0.0)
    mounts = actor.mounts()
    assert len(set(mounts.name)) == len(mounts)
    assert "tag" in mounts.use
    assert gap_to_boxes(mounts.position, boxes.center, boxes.quaternion, boxes.half).min() >= 0.01
    if isinstance(actor, Drivable):
        chassis = actor.chassis()
        low, high = chassis.extent()
        wheels = np.array([(w.x, w.y) for w in chassis.wheels] + [c[:2] for c in chassis.castors])
        assert wheels[:, 0].min() < chassis.com[0] < wheels[:, 0].max()  # it stands on its wheels, not on its nose
        assert low[2] < chassis.com[2] < high[2]
        assert (low >= (boxes.center - boxes.half).min(axis=0) - 0.06).all()
        assert (high <= (boxes.center + boxes.half).max(axis=0) + 0.06).all()


@pytest.mark.parametrize("kind", plugins.names("actors"))
def test_scene_mounts_of_an_actor_carry_its_name(kind):
    scene = world("open_floor", {"posts": 0}).scene([make(kind, name="x1")])
    assert all(n.startswith("x1.") for n in scene.mounts.name)
    assert all(g == "x1" or g.startswith("x1.") for g in scene.mounts.group)
    assert set(scene.mounts.body) == {0}
