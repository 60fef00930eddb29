"""Tracks over a picture: seen or hidden by the depth image, the legend beside the picture, the animation's frames."""

import io
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow

from testbed.geometry import Boxes
from testbed.recording import Recording, Trial
from testbed.report import animation, palette, shots
from testbed.report.cameras import CameraSpec
from testbed.report.overlay import NINETY_FIVE, draw, ellipse, visible
from testbed.report.traces import TRUTH, Trace, traces
from testbed.scene import Scene, Truth
from testbed.types import Antennas, Site, Status, Tags, Targets, Track
from testbed.view import Camera, Image

CAMERA = Camera("c", np.array([0.0, 0.0, 1.0]), np.array([10.0, 0.0, 1.0]), np.pi / 2, 320, 240)
GREY = (90, 120, 150)


def screen(depth=5.0):
    """A picture of a wall `depth` m ahead that fills the left half, and nothing on the right."""
    image = np.full((240, 320), np.inf)
    image[:, :160] = depth
    return Image(CAMERA, np.full((240, 320, 3), GREY, dtype=np.uint8), image, np.where(np.isinf(image), -1, 0).astype(np.int32))


def across(x, name="ukf", colour=palette.VERMILLION, n=60):
    """A track from left to right, x m ahead."""
    y = np.linspace(0.8 * x, -0.8 * x, n)
    return Trace(name, "t1", colour, np.linspace(0, 6, n), np.column_stack([np.full(n, x), y, np.ones(n)]))


def share_of(rgb, colour, columns):
    """How many of some columns have the very colour in the middle rows."""
    return (np.abs(rgb[115:125].astype(int) - palette.rgb(colour)).max(axis=2) < 12).any(axis=0)[columns].mean()


def test_a_point_behind_the_wall_is_hidden_and_beside_or_before_it_is_not():
    points = np.array([[8.0, 2.0, 1.0], [8.0, -2.0, 1.0], [4.0, 2.0, 1.0], [5.02, 2.0, 1.0], [-3.0, 0.0, 1.0], [8.0, -50.0, 1.0]])
    np.testing.assert_array_equal(visible(screen(), points), [False, True, True, True, False, False])


@given(st.floats(1, 30), st.floats(-0.9, 0.9), st.floats(-0.7, 0.7))
def test_what_can_be_seen_is_what_lies_before_the_depth_image(x, right, up):
    point = np.array([x, -right * x, 1 + up * x])
    (u, v), depth = CAMERA.project(point)
    behind = depth > screen().depth[round(v), round(u)]
    near_rim = 158 <= u <= 161 or abs(depth - 5) < 0.1
    assert near_rim or visible(screen(), point[None])[0] == (not behind)


def test_a_track_is_solid_where_it_is_seen_and_faint_dashes_where_it_is_hidden():
    rgb = draw(screen(), [across(8.0)], legend=False)
    assert share_of(rgb, palette.VERMILLION, np.s_[170:250]) == 1.0
    assert share_of(rgb, palette.VERMILLION, np.s_[70:150]) == 0.0
    changed = (np.abs(rgb.astype(int) - GREY).max(axis=2) > 20).any(axis=0)[70:150]
    assert 0.3 < changed.mean() < 0.8
    assert sum(a != b for a, b in pairwise(changed)) >= 8  # dashes, and gaps between them
    before = draw(screen(), [across(4.0)], legend=False)
    assert share_of(before, palette.VERMILLION, np.s_[70:250]) == 1.0


def test_a_track_is_drawn_up_to_a_time_and_not_where_it_is_lost():
    track = across(4.0)
    until = draw(screen(), [track], until=3.0, legend=False)  # half the way: the middle of the picture
    assert share_of(until, palette.VERMILLION, np.s_[70:155]) == 1.0
    assert (until[:, 165:] == GREY).all()
    points = track.points.copy()
    points[20:40] = np.nan
    lost = draw(screen(), [Trace("ukf", "t1", track.colour, track.t, points)], legend=False)
    third = (np.array([160 - 96 * (1 - 2 * k / 59) for k in (21, 38)])).astype(int)
    assert (lost[:, third[0] : third[1]] == GREY).all()


def test_nothing_to_draw_leaves_the_picture_alone():
    empty = Trace("ukf", "t1", palette.BLUE, np.empty(0), np.empty((0, 3)))
    one = Trace("ukf", "t1", palette.BLUE, np.zeros(1), np.array([[np.nan] * 3]))
    np.testing.assert_array_equal(draw(screen(), [empty, one], now=0.0, legend=False)[:, :], screen().rgb)
    passing = Trace("ukf", "t1", palette.BLUE, np.arange(2.0), np.array([[-5.0, 0, 1], [-1.0, 0, 1]]))
    np.testing.assert_array_equal(draw(screen(), [passing], legend=False), screen().rgb)


def test_a_line_that_passes_the_camera_is_drawn_as_far_as_it_can_be_seen():
    passing = Trace("ukf", "t1", palette.BLUE, np.arange(2.0), np.array([[-5.0, -1.0, 1.0], [4.0, -1.0, 1.0]]))
    rgb = draw(screen(), [passing], legend=False)
    assert share_of(rgb, palette.BLUE, np.s_[200:320]) == 1.0  # from 4 m ahead, 30 px right of the middle, to the rim


@pytest.mark.parametrize("now", [None, 2.0])
def test_the_legend_covers_nothing(now):
    names = [across(4.0 + 0.1 * i, name, palette.ESTIMATORS[i]) for i, name in enumerate(("ekf", "ukf", "a_name_of_some_length", "pf"))]
    bare, whole = draw(screen(), names, now=now, legend=False), draw(screen(), names, now=now)
    np.testing.assert_array_equal(whole[:240], bare)
    strip = whole[240:]
    assert strip.shape[0] >= 2 * 18  # too much for one line
    assert (strip[:, [0, -1]] == 255).all()  # no text is cut at the rims
    for i in range(4):
        assert (strip == palette.rgb(palette.ESTIMATORS[i])).all(axis=2).any()


def test_the_marker_is_where_the_track_is_at_that_time():
    track = across(4.0, TRUTH, palette.TRUTH)
    rgb = draw(screen(), [track], now=4.5, until=0.0, legend=False)
    pixel, _ = CAMERA.project(track.points[int(4.5 / 6 * 59)])
    dark = np.argwhere((rgb[:130] < 40).all(axis=2))
    np.testing.assert_allclose(dark.mean(axis=0)[::-1], pixel, atol=1.5)


def test_an_ellipse_holds_95_percent():
    covariance = np.array([[2.0, 0.8], [0.8, 0.5]])
    ring = ellipse(np.array([1.0, 2.0, 9.0]), covariance)
    apart = ring[:, :2] - [1, 2]
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", apart, np.linalg.inv(covariance), apart), NINETY_FIVE)
    np.testing.assert_allclose(NINETY_FIVE, -2 * np.log(0.05))  # the closed form of χ² with two degrees of freedom
    assert (ring[:, 2] < 0.05).all()  # on the floor


# ---------------------------------------------------------------- from a trial


def make_trial():
    t = np.linspace(0, 4, 41)
    poses = np.zeros((41, 1, 7))
    poses[:, 0] = np.column_stack([4 + 0 * t, 2 - t, 0 * t, np.ones(41), np.zeros((41, 3))])
    site = Site(antennas=Antennas.empty(), tags=Tags(np.array(["a"])), frequencies=np.empty(0))
    recording = Recording(7, 4.0, site, {}, Targets(np.array(["a", "fixed"]), np.array(["t1", ""])), (np.array([0]), np.array([0])))
    place = np.array([[0, 0, 1, 1, 0, 0, 0], [5, 0, 1, 1, 0, 0, 0.0]])
    return Trial(recording, Truth(t, poses, ("t1",)), np.array([0, -1]), place, {})


def make_track(components=("x", "y", "z")):
    """Rows: trial 6, trial 7 target a, trial 7 target fixed. Row i's x is 10 i + k."""
    n = len(components)
    mean = np.zeros((5, 3, n))
    mean[..., components.index("x")] = np.arange(5)[:, None] + 10 * np.arange(3)
    covariance = np.tile(np.arange(1.0, n + 1)[:, None] * np.eye(n), (5, 3, 1, 1))
    status = np.zeros((5, 3), dtype=np.int8)
    status[2, 1] = Status.LOST
    counts = np.zeros(3, dtype=np.int64)
    names = np.array(["a", "a", "fixed"])
    return Track(
        np.arange(5.0), mean, covariance, status, np.array([6, 7, 7]), names, counts, counts, counts, np.zeros(3), components=components
    )


def test_traces_are_the_rows_of_the_trial_and_its_targets():
    found = traces(make_trial(), {"ekf": make_track()})
    assert [(f.name, f.target) for f in found] == [(TRUTH, "a"), ("ekf", "a"), (TRUTH, "fixed"), ("ekf", "fixed")]
    np.testing.assert_allclose(found[0].points[[0, -1]], [[4, 2, 1], [4, -2, 1]], atol=1e-9)
    np.testing.assert_array_equal(found[1].points[[0, 1, 3, 4], 0], [10, 11, 13, 14])
    assert np.isnan(found[1].points[2]).all()
    np.testing.assert_array_equal(found[3].points[:, 0], 20 + np.arange(5))
    np.testing.assert_array_equal(found[1].covariance[0], np.diag([1, 2]))
    assert {f.target for f in traces(make_trial(), {}, targets=["a"])} == {"a"}


def test_components_are_found_by_name_and_a_method_for_the_plane_is_at_the_height_of_the_truth():
    found = traces(make_trial(), {"ekf": make_track(("vx", "y", "x"))}, targets=["a"])[1]
    np.testing.assert_array_equal(found.points[[0, 1], 0], [10, 11])
    np.testing.assert_array_equal(found.covariance[0], np.diag([3, 2]))
    np.testing.assert_allclose(found.points[[0, 1], 2], 1.0)


def test_colours_differ_and_stay_with_their_place():
    given_ = palette.assign(["ekf", "ukf", "pf"])
    assert len({palette.TRUTH, *given_.values()}) == 4
    assert palette.assign(["ekf"])["ekf"] == given_["ekf"]
    assert palette.rgb("#0072B2") == (0, 114, 178)


class Wall:
    """A renderer of the picture above, in any size."""

    def __init__(self):
        self.poses = []

    def render(self, camera, poses, cut=(), smooth=2):
        self.poses.append(poses)
        shape = (camera.height, camera.width)
        return Image(camera, np.full((*shape, 3), GREY, dtype=np.uint8), np.full(shape, np.inf), np.full(shape, -1, np.int32))

    def close(self):
        pass


def test_an_animation_shows_the_whole_trial_in_the_frames_asked_for():
    trial, wall = make_trial(), Wall()
    scene = Scene((), Boxes.empty(), (), np.array([[-5.0, -5.0, 0.0], [10.0, 5.0, 3.0]]))
    spec = CameraSpec(id="c", position_m=(0, 0, 1), look_at_m=(10, 0, 1), field_of_view_deg=90)
    data = animation.animate(trial, scene, spec, wall, traces(trial, {"ekf": make_track()}, targets=["a"]), frames=9, size=(160, 120))
    moving = Pillow.open(io.BytesIO(data))
    assert moving.n_frames == 9
    assert moving.info["loop"] == 0
    first, last = (np.array(_frame(moving, k)) for k in (0, 8))
    assert first.shape[1] == 160
    inked = [(np.abs(f[:120].astype(int) - GREY).max(axis=2) > 60).sum() for f in (first, last)]
    assert inked[1] > inked[0] + 100  # the track has grown
    assert [p[0, 1] for p in wall.poses] == pytest.approx(2 - np.linspace(0, 4, 9))
    assert _durations(moving) == [100] * 8 + [1000]


def test_an_animation_too_large_gets_worse_and_then_shorter_but_runs_as_long():
    rng = np.random.default_rng(1)
    noise = list(rng.integers(0, 255, (16, 60, 80, 3), dtype=np.uint8))
    found = {limit: animation.bounded(noise, limit) for limit in (10**6, 40_000, 24_000)}
    assert all(len(data) <= limit for limit, data in found.items())
    opened = [Pillow.open(io.BytesIO(data)) for data in found.values()]
    assert [p.n_frames for p in opened] == [16, 16, 8]
    assert [_durations(p)[0] for p in opened] == [100, 100, 200]
    assert len(animation.bounded(noise, 10)) > 0  # as small as it gets


def _durations(moving):
    found = []
    for k in range(moving.n_frames):
        moving.seek(k)
        moving.load()
        found.append(moving.info["duration"])
    return found


def _frame(moving, k):
    moving.seek(k)
    return moving.convert("RGB")


@pytest.mark.parametrize("frames", [1, 301])
def test_an_animation_is_bounded(frames):
    with pytest.raises(ValueError, match="2 to 300 frames"):
        animation.animate(make_trial(), None, None, Wall(), [], frames=frames)  # pyright: ignore


def test_pictures_come_back_from_png_bit_for_bit_and_from_webp_nearly():
    rgb = draw(screen(), [across(8.0)])
    np.testing.assert_array_equal(np.array(Pillow.open(io.BytesIO(shots.png(rgb)))), rgb)
    again = np.array(Pillow.open(io.BytesIO(shots.webp(rgb))).convert("RGB"))
    assert np.abs(again.astype(int) - rgb).mean() < 2
    assert len(shots.webp(rgb)) < 20_000
