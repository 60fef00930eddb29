"""A guided person in a world: what stands in the way is walked round and told, and the radio hears what the channel lets through."""

import copy
import pickle

import numpy as np
import pytest

from testbed import archive, worker
from testbed.geometry import Boxes
from testbed.guided.ground import Ground
from testbed.guided.section import GuidedWalk
from testbed.guided.walkers import Walkers
from testbed.scenario import ScenarioError, from_dict
from testbed.scene import Body, Scene
from testbed.worker import Block, run_block


@pytest.fixture(autouse=True)
def _closed():
    yield
    worker.close()


def ground(*boxes, room=0.3):
    """Boxes as (x, y, half x, half y, yaw, bottom, top)."""
    center = np.array([[x, y, (low + high) / 2] for x, y, _, _, _, low, high in boxes]).reshape(-1, 3)
    half = np.array([[a, b, (high - low) / 2] for _, _, a, b, _, low, high in boxes]).reshape(-1, 3)
    turned = np.array([[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)] for *_, yaw, _, _ in boxes]).reshape(-1, 4)
    body = Body("thing", "rack", np.array([0, 0, 0, 1, 0, 0, 0.0]))
    scene = Scene(
        (body,), Boxes(center, turned, half, body=np.zeros(len(boxes)), material=np.zeros(len(boxes))), ("steel",), np.zeros((2, 3))
    )
    return Ground(scene, room)


def person(x, y, heading=0.0):
    config = GuidedWalk(start_distance_m=1, turn_std_deg=0, step_std_m=0)
    return Walkers(config, 1, np.zeros(1, dtype=int), "user", np.array([[50.0, 0.0]]), np.array([[x, y, heading]]))


WALL = (2.0, 0.0, 0.1, 1.0, 0.0, 0.0, 2.0)


def test_what_is_near_is_in_the_way_and_what_is_overhead_or_a_kerb_is_not():
    here = ground(WALL, (5.0, 0.0, 1.0, 1.0, 0.0, 2.0, 2.5), (8.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.04))
    places = np.array([[1.7, 0.0], [1.5, 0.0], [2.0, 1.25], [2.25, 1.2], [5.0, 0.0], [8.0, 0.0]])
    np.testing.assert_array_equal(here.blocked(places), [True, False, True, True, False, False])


def test_a_turned_box_is_in_the_way_where_it_is():
    here = ground((0.0, 0.0, 2.0, 0.1, np.pi / 2, 0.0, 1.0), room=0.1)
    np.testing.assert_array_equal(here.blocked(np.array([[0.0, 1.9], [1.9, 0.0]])), [True, False])


def test_reach_ends_before_the_obstacle_and_who_stands_too_near_may_leave():
    here = ground(WALL)
    assert here.reach(np.zeros(2), 0.0, 5.0) == pytest.approx(1.6, abs=0.051)
    assert here.reach(np.zeros(2), np.pi, 5.0) == 5.0
    assert here.reach(np.array([1.75, 0.0]), np.pi, 1.0) == 1.0


def test_the_way_round_is_the_shorter_one_and_is_kept_to_its_end():
    here, side = ground(WALL), np.zeros(1, dtype=int)
    for y, wanted in ((0.6, 1), (-0.6, -1)):
        people = person(1.55, y)
        turn = here.round(people, np.array([0]), np.zeros(1), np.array([0.5]), side)
        assert np.sign(turn[0]) == wanted
        assert side[0] == wanted
        side[:] = 0


def test_somebody_led_straight_at_a_wall_gets_behind_it():
    here, side, people, row = ground(WALL), np.zeros(1, dtype=int), person(0.0, 0.1), np.array([0])
    for _ in range(25):
        wanted = np.arctan2(-people.place[0, 1], 6.0 - people.place[0, 0])
        turn = here.round(people, row, np.array([wanted - people.heading[0]]), np.array([0.5]), side)
        people.turn(row, turn)
        step = here.free(people, row, np.array([0.5]))
        before = people.place.copy()
        people.step(row, step)
        here.keep_out(people, row, before)
        assert not here.blocked(people.place, 0.2).any()
    assert people.place[0, 0] > 3.0


def test_a_step_gone_wrong_stops_before_the_wall():
    here, people, row = ground(WALL), person(1.4, 0.0), np.array([0])
    before = people.place.copy()
    people.step(row, np.array([1.0]))
    here.keep_out(people, row, before)
    assert people.place[0, 0] == pytest.approx(1.6, abs=0.06)
    assert people.distance[0] == pytest.approx(people.place[0, 0] - 1.4)


def test_an_empty_floor_is_in_nobodys_way():
    here = ground()
    assert here.is_empty
    assert not here.blocked(np.zeros((3, 2))).any()


# ---------------------------------------------------------------- with a radio

OFFICE = {
    "name": "office",
    "seed": 4,
    "trials": 1,
    "duration_s": 120,
    "truth_hz": 60,
    "world": {"kind": "office", "desk": False},
    "actors": [
        {
            "id": "user",
            "kind": "person",
            "motion": "guided",
            "position_m": [1.2, 2.2],
            "yaw_deg": 10,
            "guided": {
                "step_std_m": 0.02,
                "turn_std_deg": 2,
                "found_m": 0.4,
                "room_m": 0.1,
                "speed_mps": 0.5,
                "most_steps": 25,
                "walks_on": 5,
            },
        }
    ],
    "tags": [{"id": "box", "on": "chair1", "mount": "box"}, {"id": "other", "position_m": [5.0, 4.0, 1.0]}],
    "targets": ["box"],
    "sensors": [{"id": "reader", "kind": "rfid", "reader": "sargas", "antennas": {"on": "user", "mount": "hand"}}],
    "estimators": [
        {"kind": "handheld_rb", "stream": {"wraps_at": "pi"}, "beam_deg": 150, "edge_deg": 60, "farthest_m": 6, "step_std_m": 0.05}
    ],
    "metrics": [{"kind": "guidance"}],
}


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    folder = tmp_path_factory.mktemp("office")
    return folder, run_block(Block(pickle.dumps(from_dict(OFFICE)), 0, (0,), folder, (0,)))


def test_in_an_office_the_reader_in_the_hand_leads_to_the_box(office):
    folder, result = office
    assert not result.failures, result.failures[0].traceback
    assert result.rows["found"][0] == 1
    trial = archive.load_trial(archive.place(folder, 0, 0))
    reads, walk = trial.recording.streams["reads"], trial.walk
    assert set(np.asarray(reads.tag).tolist()) == {0}, "Select lets the sought tag through alone"
    assert (np.asarray(reads.phase) < np.pi + 1e-9).all()
    rate = len(reads) / (walk.t[-1] - walk.began[0])
    assert 50 < rate <= 320
    body = trial.truth.pose(trial.truth.index("user"), walk.t)
    hand = body[:, :2] + 0.45 * np.stack([np.cos(walk.heading), np.sin(walk.heading)], axis=1)
    np.testing.assert_allclose(hand[:-1], np.stack([walk.x, walk.y], axis=1)[:-1], atol=0.01)


def test_the_same_office_gives_the_same_walk(office):
    one, two = office[1], run_block(Block(pickle.dumps(from_dict(OFFICE)), 0, (0,)))
    for name, column in one.rows.items():
        np.testing.assert_array_equal(column, two.rows[name])


def test_a_reader_that_nobody_carries_guides_nobody():
    document = copy.deepcopy(OFFICE)
    document["sensors"][0]["antennas"] = {"position_m": [1, 1, 1], "aim_m": [3, 3, 1]}
    with pytest.raises(ScenarioError, match="carries no reader"):
        run_block(Block(pickle.dumps(from_dict(document)), 0, (0,)))
