"""Truth against what it stands for: the exact path of a kinematic body, its own every step of a dynamic one."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from testbed import frames, plugins, rng
from testbed.protocols import ActorPlan
from testbed.route import Route
from worlds.motion import nearest_segment
from worlds.parts import floor_pose
from worlds.paths import plan

BEND = Route(waypoints_m=[(1.5, 1.5), (6, 1.5), (6, 4.5), (2, 4.5)], speed_mps=1.4, corner_radius_m=0.6, lateral_acceleration_mps2=2.0)
ON_THE_BODY = np.array([0.7, 0.4, 1.5, 1.0, 0.0, 0.0, 0.0])  # a tag on a corner: turning moves it as well


def world(name="open_floor", **config):
    cls = plugins.load("worlds", name)
    return cls(cls.Config(**config))


def actor(kind, motion, route, name="a1", **config):
    cls = plugins.load("actors", kind)
    (x0, y0), (x1, y1) = route.waypoints_m[:2]
    return ActorPlan(name, kind, motion, cls(cls.Config(**config)), route, floor_pose(x0, y0, np.arctan2(y1 - y0, x1 - x0)))


def tag_positions(truth, t):
    return frames.compose(truth.pose(0, t), ON_THE_BODY)[:, :3]


def test_interpolated_truth_in_a_bend_is_within_a_fifth_of_a_millimetre_of_960_hz():
    hall, actors = world(), [actor("trolley", "kinematic", BEND)]
    scene = hall.scene(actors)
    usual = hall.move(scene, actors, 12.0, 1, 0)
    fine = hall.move(scene, actors, 12.0, 1, 0, step_hz=960, truth_hz=960)
    assert fine.t[1] == 1 / 960
    apart = np.linalg.norm(tag_positions(usual, fine.t) - frames.compose(fine.poses[:, 0], ON_THE_BODY)[:, :3], axis=1)
    assert apart.max() < 0.2e-3
    turned = frames.multiply(frames.conjugate(usual.pose(0, fine.t)[:, 3:]), fine.poses[:, 0, 3:])
    assert 2 * np.arcsin(np.linalg.norm(turned[:, 1:], axis=1).max()) < 1e-4
    assert np.ptp(frames.yaw_of(fine.poses[:, 0, 3:])) > 3.0  # it was a bend indeed


def test_kinematic_truth_is_the_trip_itself_at_its_instants():
    hall, actors = world(), [actor("person", "kinematic", BEND)]
    truth = hall.move(hall.scene(actors), actors, 5.0, 3, 4)
    trip = plan(BEND, rng.stream(3, 4, "actors.a1.route"))
    assert np.array_equal(truth.poses[:, 0], trip.pose(truth.t))


@pytest.mark.parametrize("kind", ["trolley", "forklift"])
def test_a_dynamic_truth_interpolates_its_own_steps(kind):
    pytest.importorskip("pybullet")
    gentler = BEND.model_copy(update={"lateral_acceleration_mps2": 1.0})  # at 2 m/s² the forklift's steered wheel skids
    hall, actors = world(), [actor(kind, "dynamic", gentler)]
    scene = hall.scene(actors)
    usual, every = hall.move(scene, actors, 10.0, 1, 0), hall.move(scene, actors, 10.0, 1, 0, truth_hz=240)
    hall.close()
    assert np.array_equal(usual.poses, every.poses[::2])
    apart = np.linalg.norm(tag_positions(usual, every.t) - frames.compose(every.poses[:, 0], ON_THE_BODY)[:, :3], axis=1)
    assert apart.max() < 0.2e-3


def test_truth_covers_a_duration_that_is_no_whole_number_of_instants():
    hall, actors = world(), [actor("person", "kinematic", BEND)]
    scene = hall.scene(actors)
    assert hall.move(scene, actors, 1.0, 1, 0).t[-1] == 1.0
    odd = hall.move(scene, actors, 1.003, 1, 0)
    assert 1.003 <= odd.t[-1] < 1.003 + 1 / 120
    np.testing.assert_allclose(np.diff(odd.t), 1 / 120)


def test_truth_must_fall_on_steps():
    hall, actors = world(), [actor("person", "kinematic", BEND)]
    with pytest.raises(ValueError, match="truth_hz 100 does not divide step_hz 240"):
        hall.move(hall.scene(actors), actors, 1.0, 1, 0, truth_hz=100)


def test_zones_and_road_segments_are_filled():
    hall = world("aisles", aisles=2, bays=2)
    roads = hall.roads()
    first, last = roads.nodes[0], roads.nodes[3]
    route = Route(waypoints_m=[tuple(first), tuple(roads.nodes[1]), tuple(last), tuple(roads.nodes[2])], speed_mps=2.0)
    actors = [actor("person", "kinematic", route)]
    scene = hall.scene(actors)
    truth = hall.move(scene, actors, 25.0, 1, 0)
    assert set(truth.segment[:, 0]) == {0, 1, 3}  # both aisles, and the east cross aisle between them
    assert scene.zones.name[truth.zone[0, 0]] == "cross_west"
    assert {"aisle1", "aisle2", "cross_east"} <= {str(scene.zones.name[z]) for z in truth.zone[:, 0]}


def test_the_nearest_segment_is_that_of_a_search_along_finely_divided_roads():
    roads = world("aisles", aisles=3).roads()
    points = np.random.default_rng(5).uniform(0, 20, (200, 2))
    share = np.linspace(0, 1, 2001)[:, None]
    ends = roads.nodes[roads.segments]
    distance = np.array([np.hypot(*(points[:, None] - (a + share * (b - a))).transpose(2, 0, 1)).min(axis=1) for a, b in ends])
    found = nearest_segment(roads, points)
    np.testing.assert_allclose(distance[found, np.arange(200)], distance.min(axis=0), atol=1e-3)


def test_parked_actors_do_not_move_and_have_no_truth():
    hall = world()
    parked = ActorPlan("t1", "trolley", "parked", actor("trolley", "parked", BEND).actor, None, floor_pose(3, 3, 1.0))
    actors = [parked, actor("person", "kinematic", BEND, name="p1")]
    scene = hall.scene(actors)
    assert scene.moving_names == ("p1",)
    assert hall.move(scene, actors, 1.0, 1, 0).bodies == ("p1",)
    alone = hall.move(hall.scene([parked]), [parked], 1.0, 1, 0)
    assert alone.poses.shape == (121, 0, 7)


def test_an_actor_more_moves_no_other_actor():
    jittery = BEND.model_copy(update={"lateral_jitter_m": 0.2, "speed_jitter": 0.1, "start_jitter_s": 1.0})
    hall, p1, p2 = world(), actor("person", "kinematic", jittery, "p1"), actor("person", "kinematic", jittery, "p2")
    alone, both = hall.move(hall.scene([p1]), [p1], 5.0, 1, 2), hall.move(hall.scene([p2, p1]), [p2, p1], 5.0, 1, 2)
    assert np.array_equal(alone.poses[:, 0], both.poses[:, both.index("p1")])
    assert not np.array_equal(both.poses[:, 0], both.poses[:, 1])


def test_scenes_and_kinematic_motion_do_without_pybullet():
    program = """
        import sys
        sys.modules["pybullet"] = None  # an import of it raises ImportError
        import numpy as np
        from testbed import plugins
        from testbed.protocols import ActorPlan
        from testbed.route import Route
        from worlds.parts import floor_pose
        route = Route(waypoints_m=[(1, 1), (4, 1)])
        for name in plugins.names("worlds"):
            cls = plugins.load("worlds", name)
            if any(field.is_required() for field in cls.Config.model_fields.values()):
                continue  # made of a file
            actors = [ActorPlan(k, k, "kinematic", plugins.load("actors", k)(plugins.load("actors", k).Config()), route, floor_pose(1, 1))
                      for k in plugins.names("actors")]
            hall = cls(cls.Config())
            hall.move(hall.scene(actors), actors, 1.0, 1, 0)
            hall.close()
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True)
