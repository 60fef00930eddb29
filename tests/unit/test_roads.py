"""Road networks: what is none, the ways on, the nearest place; walks along them, and the hall built round them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from testbed import frames, rng
from testbed.geometry import Roads
from testbed.protocols import ActorPlan
from testbed.roads import RoadGraph, check_roads, nearest_segment, project
from testbed.route import Route
from testbed.walk import RoadWalk
from worlds.actors.forklift import Forklift
from worlds.open_floor import OpenFloor
from worlds.road_hall import RoadHall
from worlds.roads import PointTrip, walk, wander

HALL = RoadHall(RoadHall.Config(racks=False))
W3 = RoadGraph(HALL.roads())
SQUARE = [[0, 0], [4, 0], [4, 3], [0, 3]]


def test_the_hall_s_own_network_is_that_of_the_study():
    assert len(HALL.roads().segments) == 26
    assert W3.edges == 52
    assert W3.length[:26].sum() == pytest.approx(216.0)
    np.testing.assert_array_equal(W3.segment, np.arange(52) % 26)
    assert (W3.direction > -np.pi).all()
    assert (W3.direction <= np.pi).all()
    np.testing.assert_allclose(np.cos(W3.direction[:26] - W3.direction[26:]), -1.0)


@pytest.mark.parametrize(
    ("nodes", "segments", "message"),
    [
        ([[0, 0], [1, 0]], [[0, 2]], r"segment 0 joins nodes \[0, 2\], there are nodes 0 to 1"),
        ([[0, 0], [1, 0], [1, 0]], [[0, 1], [1, 2]], r"segment 1 from node 1 to node 2 at \(1, 0\) has no length"),
        ([[0, 0], [1, 0]], [[0, 0]], "segment 0 from node 0 to node 0"),
        ([[0, 0], [1, 0]], [[0, 1], [1, 0]], r"segment 1 between \(1, 0\) and \(0, 0\) is there already, as segment 0"),
        ([[0, 0], [1, 0], [5, 5], [6, 5]], [[0, 1], [2, 3]], r"no way leads from node 0 at \(0, 0\) to node 2 at \(5, 5\)"),
        ([[0, 0], [1, 0], [2, 2]], [[0, 1]], r"to node 2 at \(2, 2\)"),
        ([[0, 0], [np.nan, 0]], [[0, 1]], "node 1 is at"),
    ],
)
def test_what_is_no_network_is_refused_with_its_place(nodes, segments, message):
    with pytest.raises(ValueError, match=message):
        check_roads(Roads(np.array(nodes), np.array(segments)))


def test_one_way_roads_may_run_against_each_other_and_must_lead_out():
    check_roads(Roads(np.array(SQUARE), np.array([[0, 1], [1, 2], [2, 3], [3, 0], [1, 0]]), np.array([True] * 5)))
    one_way = RoadGraph(Roads(np.array(SQUARE), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]), np.ones(4, dtype=bool)))
    assert one_way.edges == 4
    np.testing.assert_array_equal(one_way.onward, [1, 2, 3, 0])
    with pytest.raises(ValueError, match=r"node 1 at \(4, 0\) can be entered by segment 0 and not left again"):
        RoadGraph(Roads(np.array(SQUARE[:2]), np.array([[0, 1]]), np.array([True])))
    with pytest.raises(ValueError, match="at least one segment"):
        RoadGraph(Roads(np.zeros((0, 2)), np.zeros((0, 2))))


def test_ways_on_leave_the_head_and_never_go_back_but_from_a_dead_end():
    for graph in (W3, RoadGraph(Roads(np.array(SQUARE), np.array([[0, 1], [1, 2], [2, 3]])))):
        for edge in range(graph.edges):
            ways = graph.onward[graph.first[edge] : graph.first[edge + 1]]
            assert (graph.tail[ways] == graph.head[edge]).all()
            leaving = np.flatnonzero(graph.tail == graph.head[edge])
            assert set(ways) == (set(leaving) - {graph.back[edge]} or {graph.back[edge]})


@settings(max_examples=60, deadline=None)
@given(st.floats(-10, 45), st.floats(-10, 35))
def test_the_nearest_place_is_that_of_a_fine_search(x, y):
    roads = HALL.roads()
    share = np.linspace(0, 1, 2001)[:, None, None]
    ends = roads.nodes[roads.segments]
    fine = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
    apart = np.hypot(*np.moveaxis(fine - [x, y], -1, 0)).min(axis=0)
    segment, place, distance = project(roads, np.array([x, y]))
    assert distance == pytest.approx(apart.min(), abs=0.01)
    assert apart[segment] == pytest.approx(apart.min(), abs=0.01)
    assert np.hypot(*(place - [x, y])) == pytest.approx(distance)


def test_a_place_that_is_none_is_on_no_segment():
    segment, place, distance = project(HALL.roads(), np.array([np.nan, 0.0]))
    assert segment == -1
    assert np.isnan(place).all()
    assert np.isnan(distance)
    assert (nearest_segment(None, np.zeros((3, 2))) == -1).all()


# ---------------------------------------------------------------- walks


def test_a_point_keeps_its_speed_along_the_roads_and_carries_its_overshoot():
    trip = walk(RoadWalk(), HALL.roads(), 200.0, np.random.default_rng(1))
    assert isinstance(trip, PointTrip)
    t = np.arange(2001) / 10
    pose = trip.pose(t)
    assert project(HALL.roads(), pose[:, :2])[2].max() < 1e-9
    legs = W3.length[trip.edges]
    assert trip.offset + 2.0 * 200.0 < legs.sum()
    # the first node is met when the rest of the first edge is driven, the second one leg later: no time is lost there
    met = (legs[0] - trip.offset) / 2.0
    np.testing.assert_allclose(trip.pose(met)[:2], W3.roads.nodes[W3.head[trip.edges[0]]], atol=1e-9)
    np.testing.assert_allclose(trip.pose(met + legs[1] / 2)[:2], W3.roads.nodes[W3.head[trip.edges[1]]], atol=1e-9)
    assert frames.yaw_of(trip.pose(met + 1e-9)[3:]) == pytest.approx(W3.direction[trip.edges[1]])


def test_starts_are_uniform_over_the_directed_length_and_turns_over_the_ways_on():
    # χ² tests over 4,000 walks, each with a false alarm of 1e-6
    walks = [wander(W3, 60.0, rng.stream(3, i, "w")) for i in range(4000)]
    starts = np.bincount([edges[0] for edges, _ in walks], minlength=52)
    expected = 4000 * W3.length / W3.length.sum()
    assert ((starts - expected) ** 2 / expected).sum() < chi2.ppf(1 - 1e-6, 51)
    share = np.array([offset / W3.length[edges[0]] for edges, offset in walks])
    tenths = np.bincount((10 * share).astype(int), minlength=10)
    assert ((tenths - 400) ** 2 / 400).sum() < chi2.ppf(1 - 1e-6, 9)
    statistic, freedom = 0.0, 0
    turns = np.concatenate([np.stack([edges[:-1], edges[1:]], axis=1) for edges, _ in walks])
    for edge in range(52):
        ways = W3.onward[W3.first[edge] : W3.first[edge + 1]]
        count = np.array([((turns[:, 0] == edge) & (turns[:, 1] == w)).sum() for w in ways])
        assert count.sum() == (turns[:, 0] == edge).sum()  # nobody goes anywhere else
        statistic += ((count - count.mean()) ** 2 / count.mean()).sum()
        freedom += len(ways) - 1
    assert statistic < chi2.ppf(1 - 1e-6, freedom)


def test_a_vehicle_s_walk_stays_near_the_roads_with_rounded_corners():
    trip = walk(RoadWalk(corner_radius_m=1.5), HALL.roads(), 100.0, np.random.default_rng(2))
    pose = trip.pose(np.arange(1001) / 10)
    off = project(HALL.roads(), pose[:, :2])[2]
    assert 0.2 < off.max() < 0.5 * 1.5
    assert np.median(off) < 1e-6
    yaw = np.unwrap(frames.yaw_of(pose[:, 3:]))
    assert np.abs(np.diff(yaw)).max() < 0.2


def test_walks_are_refused_where_they_can_t_be():
    forklift = Forklift(Forklift.Config())
    plan = ActorPlan("f", "forklift", "kinematic", forklift, RoadWalk(), frames.IDENTITY)
    with pytest.raises(ValueError, match="actor f: a walk wants roads, and this world has none"):
        OpenFloor(OpenFloor.Config()).scene([plan])
    dynamic = ActorPlan("f", "forklift", "dynamic", forklift, RoadWalk(), frames.IDENTITY)
    with pytest.raises(ValueError, match="actor f: nothing with wheels turns at once"):
        HALL.scene([dynamic])


# ---------------------------------------------------------------- the hall


def test_racks_leave_the_roads_free_and_do_not_overlap():
    hall = RoadHall(RoadHall.Config(gates=[2, 9]))
    scene = hall.scene([])
    names = [b.name for b in scene.bodies]
    assert sum(n.startswith("rack") for n in names) > 20
    boxes = scene.static_boxes()
    racks = np.isin(boxes.body, [i for i, n in enumerate(names) if n.startswith("rack")])
    corners = np.array([[x, y, 0.0] for x in (-1, 0, 1) for y in (-1, 1)])
    places = boxes.center[racks, None] + frames.rotate(boxes.quaternion[racks, None], boxes.half[racks, None] * corners)
    assert project(scene.roads, places[..., :2])[2].min() >= 3.4 / 2 - 1e-6
    middle = {n: np.mean(scene.roads.nodes[scene.roads.segments[s]], axis=0) for n, s in (("gate1", 2), ("gate2", 9))}
    for name, place in middle.items():
        np.testing.assert_allclose(scene.bodies[names.index(name)].pose[:2], place)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"segments": [(0, 1), (0, 1)]}, "is there already"),
        ({"gates": [26]}, "there is no segment 26"),
        ({"one_way": [0, 0]}, "listed twice"),
        ({"gates": [1], "road_width_m": 1.5}, "gates want roads 2 m wide"),
        ({"rack_levels": 5}, "5 levels of 1.5 m don't fit"),
    ],
)
def test_halls_that_can_t_be_are_refused(config, message):
    with pytest.raises(ValueError, match=message):
        RoadHall.Config(**config)


def test_a_vehicle_off_the_network_is_named_with_its_way_point():
    route = Route(waypoints_m=[(0.0, 0.0), (3.0, 4.5)])
    plan = ActorPlan("f", "forklift", "kinematic", Forklift(Forklift.Config()), route, frames.IDENTITY)
    with pytest.raises(ValueError, match=r"actor f: way point 1 at \(3, 4.5\) is off the roads, 3.0 m from the nearest"):
        HALL.scene([plan])
