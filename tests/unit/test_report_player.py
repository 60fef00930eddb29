"""What the player is given: small, exact to a pixel, and the same as the recording."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
import report_fakes as fakes
from hypothesis import given
from hypothesis import strategies as st

from testbed import archive, frames
from testbed.report import cases, player, study
from testbed.report.figures import Styles
from testbed.report.figures_plan import floor_plan
from testbed.report.figures_time import error_over_time
from testbed.types import Reads


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return study.read(fakes.quick(tmp_path_factory.mktemp("run") / "out", trials=1))


@pytest.fixture(scope="module")
def case(run):
    return cases.load(run, run.recordings[0])


def made(case, ids=("ekf", "ukf", "centroid")):
    styles = Styles(ids)
    return player.data(case, styles, floor_plan(case, styles, "plan-0", ""), error_over_time(case, styles, "errors-0", ""))


@pytest.fixture(scope="module")
def content(case):
    return made(case)


# ---------------------------------------------------------------- packing


@given(st.lists(st.one_of(st.floats(-20, 120), st.just(float("nan"))), min_size=1, max_size=50))
def test_packing_keeps_numbers_to_half_a_step_nothing_as_nothing_and_says_what_is_beyond(values):
    values = np.array(values)
    column = player.packed(values, 0.0, 100.0)
    back = player.unpacked(column)
    step = 100.0 / 65533
    inside = (values >= 0) & (values <= 100)
    assert np.abs(back[inside] - values[inside]).max(initial=0.0) <= step / 2 * 1.000001
    assert np.isnan(back[np.isnan(values)]).all()
    far = (values < -step) | (values > 100 + step)
    assert np.isinf(back[far]).all()


def test_the_ends_of_a_range_and_a_range_of_no_length_are_kept():
    assert player.unpacked(player.packed(np.array([2.0, 7.0]), 2.0, 7.0)) == pytest.approx([2.0, 7.0])
    assert player.unpacked(player.packed(np.zeros(3), 0.0, 0.0)).tolist() == [0.0, 0.0, 0.0]


def test_numbers_are_little_endian():
    assert base64.b64decode(player.packed(np.array([1.0]), 0.0, 65533.0)["d"]) == b"\x01\x00"


def test_uneven_times_are_given_one_by_one():
    assert player._times(np.array([0.0, 0.1, 0.2])) == {"first": 0.0, "step": pytest.approx(0.1), "n": 3}
    uneven = player._times(np.array([0.0, 0.1, 0.5]))
    assert player.unpacked(uneven["list"]) == pytest.approx([0.0, 0.1, 0.5])


def test_names_cannot_end_the_script_that_holds_them():
    text = player.text({"name": "</script><script>alert(1)//\u2028"})
    assert "<" not in text
    assert json.loads(text) == {"name": "</script><script>alert(1)//\u2028"}


# ---------------------------------------------------------------- content


def test_tracks_are_the_recordings_to_a_twentieth_of_a_pixel(content, case):
    tracks = archive.load_tracks(case.kept.folder)
    pixel = 1.0 / content["plan"]["u"][1]  # m a point of the plan
    for one in content["estimators"]:
        line, track = one["targets"][0], tracks[one["id"]]
        stands = track.status[:, 0] != 2
        for axis, name in enumerate("xy"):
            assert player.unpacked(line[name])[stands] == pytest.approx(track.mean[stands, 0, axis], abs=pixel / 20)
        assert line["t"] == {"first": 0.0, "step": pytest.approx(0.1), "n": len(track.t)}
        assert line["status"] == "".join(map(str, track.status[:, 0]))


def test_ellipses_have_the_tracks_covariance(content, case):
    line, track = content["estimators"][0]["targets"][0], archive.load_tracks(case.kept.folder)["ekf"]
    a, b, angle = (player.unpacked(line[name]) for name in ("a", "b", "angle"))
    turn = np.stack([np.stack([np.cos(angle), -np.sin(angle)], 1), np.stack([np.sin(angle), np.cos(angle)], 1)], 1)
    made_again = turn @ (np.stack([a**2, b**2], 1)[:, :, None] * np.swapaxes(turn, 1, 2)) / 5.991464547
    assert made_again == pytest.approx(track.covariance[:, 0, :2, :2], abs=2e-3)


def test_bodies_and_reads_are_the_recordings(content, case):
    body, truth = content["bodies"][0], case.trial.truth
    t = body["t"]["first"] + body["t"]["step"] * np.arange(body["t"]["n"])
    pose = truth.pose(0, t)
    assert player.unpacked(body["x"]) == pytest.approx(pose[:, 0], abs=1e-3)
    assert player.unpacked(body["yaw"]) == pytest.approx(frames.yaw_of(pose[:, 3:]), abs=1e-3)
    reads = content["reads"]
    assert player.unpacked(reads["t"]) == pytest.approx(np.sort(case.reads.t), abs=1e-4)
    assert sorted(player.unpacked(reads["tag"])) == sorted(case.reads.tag)
    assert [name for name, *_ in content["antennas"]] == case.antennas.id.tolist()
    assert content["wanted"] == [case.tagged.tags.id.tolist().index("lid")]


def test_a_carried_tag_is_given_in_the_frame_of_what_carries_it(content, case):
    by_name = {name: (body, x, y) for name, body, x, y in content["tags"]}
    assert by_name["still"] == (-1, 4.0, 3.0)
    body, x, y = by_name["lid"]
    place = frames.to_world(case.trial.truth.pose(body, 2.0), np.array([x, y, 0.0]))
    assert place[:2] == pytest.approx(case.trial.target_states(np.array([2.0]))[0, 0, :2], abs=2e-3)


# ---------------------------------------------------------------- size


def busy(case, seconds, rate):
    """A case of many seconds with reads at `rate` a second."""
    t = np.arange(int(seconds * rate)) / rate
    reads = Reads(t=t, t_arrival=t, antenna=np.arange(len(t)) % 8, tag=np.arange(len(t)) % 2, rssi=np.full(len(t), -60.0))
    recording = replace(case.trial.recording, duration=float(seconds), streams={"reads": reads})
    k = int(seconds * 10) + 1

    def longer(line):
        index = np.arange(k) % len(line.t)
        parts = {name: getattr(line, name)[index] for name in ("position", "covariance", "error", "nees", "status")}
        return replace(line, t=np.arange(k) / 10, **parts)

    t = cases.instants(seconds)
    still = np.tile(case.aims[0].truth[0], (len(t), 1))
    aims = tuple(replace(aim, t=t, truth=still, lines=tuple(map(longer, aim.lines))) for aim in case.aims)
    return replace(case, trial=replace(case.trial, recording=recording), aims=aims)


def test_a_minute_with_three_estimators_takes_less_than_a_megabyte(case):
    long = busy(case, 60, 400)
    content = made(long)
    assert len(content["estimators"]) == 3
    assert content["reads"]["thinned"] == ""
    assert len(player.unpacked(content["reads"]["t"])) == 24_000
    assert len(player.text(content).encode()) <= 1_000_000


def test_particles_of_three_methods_over_a_minute_still_fit(case):
    long = busy(case, 60, 400)
    cloud = np.random.default_rng(1).normal(size=(601, 2000, 2)) + 3.0
    lines = tuple(replace(line, cloud=cloud) for line in long.aims[0].lines)
    content = made(replace(long, aims=(replace(long.aims[0], lines=lines),)))
    assert len(player.text(content).encode()) <= 1_000_000
    shown = content["estimators"][0]["targets"][0]["cloud"]
    assert shown["n"] == player.CLOUD
    assert player.unpacked(shown["x"])[: shown["n"]] == pytest.approx(cloud[0, np.linspace(0, 1999, 100).astype(int), 0], abs=2e-3)


def test_of_too_many_reads_those_of_the_targets_are_shown_and_said_so(case):
    content = made(busy(case, 60, 1000))
    assert content["reads"]["thinned"] == "Only reads of the targets' tags are shown."
    assert set(player.unpacked(content["reads"]["tag"])) == set(content["wanted"])
    more = made(busy(case, 60, 2000))
    assert more["reads"]["thinned"] == "Of the reads of the targets' tags one in 2 is shown."
    assert len(player.unpacked(more["reads"]["t"])) == 30_000


def test_of_too_many_reports_every_nth_is_shown(case):
    content = made(busy(case, 400, 1))
    assert content["every"] == 2
    assert content["estimators"][0]["targets"][0]["t"] == {"first": 0.0, "step": pytest.approx(0.2), "n": 2001}


# ---------------------------------------------------------------- rare tracks


def test_a_track_with_particles_is_shown_as_a_cloud(tmp_path):
    folder = fakes.quick(tmp_path / "cloud", trials=1)
    cloud = np.random.default_rng(2).normal(size=(41, 1, 40, 3)) + 3.0

    def with_particles(track):
        return track.with_(particles=cloud)

    fakes.rewrite(folder, "ekf", with_particles)
    read = study.read(folder)
    shown = made(cases.load(read, read.recordings[0]))["estimators"]
    assert shown[0]["targets"][0]["cloud"]["n"] == 40
    assert player.unpacked(shown[0]["targets"][0]["cloud"]["y"])[:40] == pytest.approx(cloud[0, 0, :, 1], abs=2e-3)
    assert shown[1]["targets"][0]["cloud"] is None


def test_an_estimator_without_a_track_of_a_target_is_left_out_of_it(case):
    fewer = replace(case, aims=(replace(case.aims[0], lines=case.aims[0].lines[:1]),))
    assert [one["id"] for one in made(fewer)["estimators"]] == ["ekf"]


def test_a_place_far_off_is_beyond_and_a_huge_ellipse_as_well(case):
    line = case.aims[0].lines[0]
    position, covariance = line.position.copy(), line.covariance.copy()
    position[3], covariance[4] = 1e9, np.eye(2) * 1e12
    bent = replace(case, aims=(replace(case.aims[0], lines=(replace(line, position=position, covariance=covariance),)),))
    shown = made(bent)["estimators"][0]["targets"][0]
    assert np.isinf(player.unpacked(shown["x"])[3])
    assert np.isinf(player.unpacked(shown["a"])[4])
    assert np.isfinite(player.unpacked(shown["x"])[5])
