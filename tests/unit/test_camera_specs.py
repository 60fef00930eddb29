"""Cameras of a scenario: what may be said, when pictures are taken, where cameras stand, which walls make room."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from testbed import frames
from testbed.geometry import Boxes, Zones
from testbed.recording import Recording, Trial
from testbed.report import shots
from testbed.report.cameras import OVERVIEW, CameraSpec, mistakes, moments
from testbed.report.placing import place
from testbed.report.sight import crossed
from testbed.scene import Body, Scene, Truth
from testbed.types import Antennas, Reads, Site, Tags, Targets
from testbed.view import Image

UPRIGHT = frames.IDENTITY[3:]


def body(name, kind, x, y, yaw=0.0, moving=False):
    return Body(name, kind, np.concatenate([[x, y, 0.0], frames.from_euler(yaw)]), moving)


def make_scene():
    """A hall of 12 x 8 m with walls in the south and in the middle, a rack, a trolley and a person that move."""
    bodies = (
        body("south", "wall", 6, 0), body("middle", "wall", 6, 4), body("rack", "rack", 9, 6),
        body("t1", "trolley", 2, 2, moving=True), body("p1", "person", 3, 5, moving=True),
    )  # fmt: skip
    half = np.array([[6.0, 0.1, 2.5], [0.1, 4.0, 2.5], [1.5, 0.5, 1.5], [0.4, 0.3, 0.9], [0.2, 0.25, 0.85]])
    center = np.column_stack([np.zeros((5, 2)), half[:, 2]])
    boxes = Boxes(center, np.tile(UPRIGHT, (5, 1)), half, body=np.arange(5))
    zones = Zones(np.array(["dock", "store"]), np.array([[0, 0, 6, 8], [6, 0, 12, 8]]))
    return Scene(bodies, boxes, ("steel",), np.array([[0.0, 0.0, 0.0], [12.0, 8.0, 5.0]]), zones=zones)


def make_trial(scene, seconds=10.0):
    """The trolley drives east at 1 m/s, so it enters the store at 4 s; the person stands and looks north."""
    t = np.linspace(0, seconds, 101)
    poses = np.zeros((101, 2, 7))
    poses[:, 0] = np.column_stack([2 + t, np.full(101, 2.0), 0 * t, np.tile(UPRIGHT, (101, 1))])
    poses[:, 1] = np.concatenate([[3.0, 5.0, 0.0], frames.from_euler(np.pi / 2)])
    truth = Truth(t, poses, ("t1", "p1"), zone=scene.zones.locate(poses[..., :3]))
    reads = Reads(t=[1.5, 2.0, 8.0, 9.5], t_arrival=[1.5, 2.0, 8.0, 9.5], antenna=[0] * 4, tag=[1, 0, 0, 1], rssi=[-50.0] * 4)
    site = Site(antennas=Antennas.empty(), tags=Tags(np.array(["a", "b"])), frequencies=np.empty(0))
    recording = Recording(0, seconds, site, {"reads": reads}, Targets(np.array(["a"]), np.array(["t1"])), (np.array([0]),))
    return Trial(recording, truth, np.array([0]), np.array([frames.IDENTITY]), {})


SCENE = make_scene()
TRIAL = make_trial(SCENE)


def spec(**fields):
    return CameraSpec(id="c", **fields)


# ---------------------------------------------------------------- what may be said


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"shoulder": "p1", "follow": "t1"}, "shoulder already says where the camera stands"),
        ({"look_at_m": [1, 1, 1]}, "look_at_m goes with position_m"),
        ({"follow": "t1", "offset_m": [-3, 0, 2], "distance_m": 4}, "two ways to say the same"),
        ({"offset_m": [-3, 0, 2]}, "name it with follow"),
        ({"distance_m": 5}, "distance_m goes with follow"),
        ({"position_m": [0, 0, 3], "azimuth_deg": 20}, "azimuth_deg goes with follow or an overview"),
        ({"at": "midle"}, "no moment is called 'midle', did you mean middle"),
        ({"at": "lunch"}, "there are start, middle, end"),
        ({"at_s": [-1]}, "greater than or equal to 0"),
        ({"zoom": 2}, "Extra inputs"),
        ({"width_px": 100_000}, "less than or equal to 1920"),
    ],
)
def test_contradictions_are_told_in_a_sentence(fields, message):
    with pytest.raises(ValidationError, match=message):
        spec(**fields)


def test_single_moments_and_units_in_text_are_understood():
    one = spec(at="end", at_s="1500 ms", position_m=["100 cm", 2, 3])
    assert (one.at, one.at_s, one.position_m) == (["end"], [1.5], (1.0, 2.0, 3.0))


def test_what_only_the_hall_can_tell_is_found():
    assert mistakes(spec(follow="t1", at=["enter:store"], at_s=[9.9]), SCENE, 10.0) == []
    wrong = [spec(follow="t11"), spec(shoulder="lp1"), spec(at="enter:stores"), spec(at_s=[10.5])]
    assert [mistakes(w, SCENE, 10.0) for w in wrong] == [
        [("follow", "no body is called 't11', did you mean t1?")],
        [("shoulder", "no body is called 'lp1', did you mean p1?")],
        [("at", "no zone is called 'stores', did you mean store?")],
        [("at_s", "10.5 s is after the end of the recording at 10 s")],
    ]


# ---------------------------------------------------------------- when


def test_pictures_are_taken_at_times_and_events():
    wanted = spec(at_s=[2.5, 7], at=["start", "middle", "end", "first_read", "last_read", "enter:store", "leave:dock"])
    found = moments(wanted, SCENE, TRIAL)
    assert [name for name, _ in found][:2] == ["2.5s", "7s"]
    times = dict(found)
    assert (times["start"], times["middle"], times["end"]) == (0.0, 5.0, 10.0)
    assert (times["first_read"], times["last_read"]) == (2.0, 8.0)  # the target's own tag, not the other one
    assert times["enter-store"] == pytest.approx(4.1, abs=0.11)
    assert times["leave-dock"] == times["enter-store"]


def test_an_event_that_never_happens_has_no_picture():
    assert moments(spec(at="enter:store", follow="p1"), SCENE, TRIAL) == []
    assert moments(spec(at="enter:store", follow="t1"), SCENE, TRIAL) != []
    assert moments(spec(at="enter:dock"), SCENE, TRIAL) == []  # both begin in there


def test_without_a_word_about_it_the_picture_is_of_the_middle():
    assert moments(OVERVIEW, SCENE, TRIAL) == [("middle", 5.0)]


# ---------------------------------------------------------------- where


def test_an_offset_turns_with_the_body():
    camera, _ = place(spec(follow="p1", offset_m=[-2, 1, 3]), SCENE, TRIAL.truth, 1.0)
    np.testing.assert_allclose(camera.position, [3 - 1, 5 - 2, 3], atol=1e-9)  # it looks north: behind is south, left is west
    np.testing.assert_allclose(camera.target, [3, 5, 0.85])


def test_a_distance_and_a_direction_do_not_turn():
    camera, _ = place(spec(follow="t1", distance_m=4, azimuth_deg=90, elevation_deg=30), SCENE, TRIAL.truth, 3.0)
    np.testing.assert_allclose(camera.position, [5, 2 + 4 * np.cos(np.pi / 6), 0.9 + 2.0], atol=1e-6)


def test_one_that_follows_unasked_stands_where_the_body_is_seen_all_the_way():
    fields = {"follow": "t1", "distance_m": 5.0, "elevation_deg": 10}
    seen = [place(spec(**fields), SCENE, TRIAL.truth, t)[0] for t in (0.0, 5.0, 10.0)]
    away = [c.position - c.target for c in seen]
    np.testing.assert_allclose(away, [away[0]] * 3, atol=1e-9)
    still = SCENE.static_boxes()
    rack = still.take(still.body == 2)
    for camera in seen:
        assert not crossed(camera.position[None], camera.target[None], rack).any()


def test_a_camera_on_the_wall_turns_to_the_body_it_follows():
    camera, _ = place(spec(follow="t1", position_m=[11, 1, 4]), SCENE, TRIAL.truth, 3.0)
    np.testing.assert_array_equal(camera.position, [11, 1, 4])
    np.testing.assert_allclose(camera.target, [5, 2, 0.9], atol=1e-9)


def test_over_the_shoulder_is_behind_and_above_and_looks_ahead():
    camera, cut = place(spec(shoulder="p1"), SCENE, TRIAL.truth, 1.0)
    local = frames.to_local(TRIAL.truth.pose(1, 1.0), np.stack([camera.position, camera.target]))
    assert local[0, 0] < 0
    assert local[0, 1] < 0  # the right shoulder
    assert local[0, 2] > 1.7
    assert local[1, 0] > 2
    assert cut == frozenset()


@pytest.mark.parametrize("azimuth", [None, 0, 37, 90, 180, -135])
@pytest.mark.parametrize("size", [(640, 480), (300, 480)])
def test_an_overview_has_everything_in_the_picture_and_wastes_little(azimuth, size):
    camera, _ = place(spec(azimuth_deg=azimuth, width_px=size[0], height_px=size[1]), SCENE, TRIAL.truth, 0.0)
    top = 3.0  # of the rack: the upper walls may be cut off
    low, high = SCENE.bounds
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, top)])
    pixels, _ = camera.project(corners)
    used = (pixels.max(axis=0) - pixels.min(axis=0)) / size
    assert (pixels > 0).all()
    assert (pixels < np.array(size) - 1).all()
    assert used.max() > 0.9


def test_from_outside_the_walls_in_the_way_are_cut_off_and_no_others():
    names = [b.name for b in SCENE.bodies]
    for azimuth, wanted in ((-60, {"south", "middle"}), (60, {"middle"}), (-90, {"south"})):
        _, cut = place(spec(azimuth_deg=azimuth), SCENE, TRIAL.truth, 0.0)
        assert {names[i] for i in cut} - ({"middle"} if azimuth == -90 else set()) == wanted - ({"middle"} if azimuth == -90 else set())
    _, cut = place(spec(azimuth_deg=-60, cut=["ra*"]), SCENE, TRIAL.truth, 0.0)
    assert {names[i] for i in cut} == {"rack"}
    _, cut = place(spec(position_m=[1, 1, 3], look_at_m=[11, 1, 1]), SCENE, TRIAL.truth, 0.0)
    assert cut == frozenset()  # a camera in the hall sees what there is


def test_a_body_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="camera c: no body is called 'x'"):
        place(spec(follow="x"), SCENE, TRIAL.truth, 0.0)


# ---------------------------------------------------------------- sight lines


@given(st.integers(0, 2**32 - 1))
def test_a_box_is_crossed_if_some_point_on_the_way_lies_inside(seed):
    rng = np.random.default_rng(seed)
    n = 6
    boxes = Boxes(rng.uniform(-1, 1, (n, 3)), frames.normalise(rng.normal(size=(n, 4))), rng.uniform(0.1, 0.8, (n, 3)))
    start, end = rng.uniform(-2, 2, (2, 5, 3))
    share = np.linspace(0, 1, 2001)[:, None]
    found = crossed(start, end, boxes)
    for i in range(5):
        local = frames.rotate(frames.conjugate(boxes.quaternion)[:, None], start[i] + share * (end[i] - start[i]) - boxes.center[:, None])
        deepest = (boxes.half[:, None] - np.abs(local)).min(axis=2).max(axis=1)
        clear = np.abs(deepest) > 2e-3  # of 4 m in 2000 steps: grazing ones may fall between two points
        np.testing.assert_array_equal(found[i][clear], (deepest > 0)[clear])


def test_an_axis_parallel_ray_in_a_face_counts_and_one_beside_it_does_not():
    box = Boxes(np.zeros((1, 3)), UPRIGHT[None], np.ones((1, 3)))
    start = np.array([[-3.0, 1.0, 0.0], [-3.0, 1.001, 0.0], [-3.0, 0.0, 0.0]])
    end = np.array([[3.0, 1.0, 0.0], [3.0, 1.001, 0.0], [-2.0, 0.0, 0.0]])
    np.testing.assert_array_equal(crossed(start, end, box)[:, 0], [True, False, False])


# ---------------------------------------------------------------- pictures


class Painter:
    """A renderer that paints the number of its picture, and keeps what it was asked for."""

    def __init__(self):
        self.asked = []

    def render(self, camera, poses, cut=(), smooth=2):
        self.asked.append((camera, poses, cut))
        shape = (camera.height, camera.width)
        return Image(camera, np.full((*shape, 3), len(self.asked), np.uint8), np.full(shape, np.inf), np.full(shape, -1, np.int32))

    def close(self):
        pass


def test_all_pictures_are_taken_and_kept_beside_the_recording(tmp_path):
    painter = Painter()
    specs = [CameraSpec(id="all", at=["start", "end"], width_px=64, height_px=64), CameraSpec(id="by", follow="t1", at_s=[2, 4])]
    found = shots.capture(TRIAL, SCENE, specs, painter, tmp_path)
    assert list(found) == ["all-start", "all-end", "by-2s", "by-4s"]
    for i, (name, shot) in enumerate(found.items(), start=1):
        read = cv2.imread(str(tmp_path / "cameras" / f"{name}.png"))
        assert read.shape == shot.image.rgb.shape
        assert (read == i).all()
    np.testing.assert_allclose(painter.asked[3][1], TRIAL.truth.pose([0, 1], 4.0))
    np.testing.assert_allclose(painter.asked[3][0].target - painter.asked[2][0].target, [2, 0, 0], atol=1e-9)


def test_a_zone_with_an_odd_name_makes_a_fit_file_name():
    assert shots.Shot("c", "enter-../a b", 0.0, None).name == "c-enter-.._a_b"  # pyright: ignore
