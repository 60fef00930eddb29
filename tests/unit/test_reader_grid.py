"""The grid of readers: where antennas are, which one is left out, and how its walkers move."""

import numpy as np
import pytest
from pydantic import ValidationError

from testbed import frames
from worlds import reader_grid
from worlds.reader_grid import ReaderGrid, track


def world(**config):
    return ReaderGrid(ReaderGrid.Config(**config))


def antennas(scene):
    rows = np.flatnonzero(scene.mounts.use == "antenna")
    body = scene.mounts.body[rows]
    pose = np.array([frames.compose(scene.bodies[b].pose, np.concatenate([scene.mounts.position[i], scene.mounts.quaternion[i]]))
                     for i, b in zip(rows, body, strict=True)])  # fmt: skip
    return [str(n) for n in scene.mounts.name[rows]], pose


def test_antennas_stand_on_the_corners_of_their_cell_and_face_its_middle():
    names, pose = antennas(world().scene([]))
    assert len(names) == 64
    first = pose[[names.index(f"reader1.a{i}") for i in range(4)]]
    np.testing.assert_allclose(first[:, :2], [[0, 0], [10, 0], [10, 10], [0, 10]], atol=1e-12)
    ahead = frames.rotate(first[:, 3:], np.array([1.0, 0, 0]))
    np.testing.assert_allclose(first[:, :3] + np.sqrt(50) * ahead, np.tile([5, 5, 1.5], (4, 1)), atol=1e-12)


def test_with_three_antennas_the_corner_ix_plus_2_iy_is_left_out():
    names, _ = antennas(world(antennas=3).scene([]))
    assert len(names) == 48
    for iy in range(4):
        for ix in range(4):
            missing = {f"reader{4 * iy + ix + 1}.a{c}" for c in range(4)} - set(names)
            assert missing == {f"reader{4 * iy + ix + 1}.a{(ix + 2 * iy) % 4}"}


def test_thirteen_metres_is_a_third_of_forty():
    _, pose = antennas(world(cells=3).scene([]))
    assert np.unique(np.round(pose[:, 0], 9)) == pytest.approx([0, 40 / 3, 80 / 3, 40])


def moved(trial=0, root=3, **config):
    grid = world(**{"walkers": 1, **config})
    return grid.move(grid.scene([]), [], 20.0, root, trial, 20, 20)


def test_tracks_start_in_the_middle_stay_inside_and_are_their_trials_own():
    for trial in range(20):
        place = moved(trial).poses[:, 0, :2]
        assert ((place[0] >= 8) & (place[0] <= 32)).all()
        assert ((place >= 1) & (place <= 39)).all()
    assert (moved(2).poses == moved(2).poses).all()
    assert (moved(2).poses[0] != moved(3).poses[0]).any()
    two = moved(2, walkers=2)
    assert two.bodies == ("walker1", "walker2")
    assert (two.poses[:, 0] == moved(2).poses[:, 0]).all()  # another walker moves nobody


def test_tracks_are_white_acceleration():
    """Displacements of 4,000 walkers after 2 s, about their first velocity: variances within 4 σ, which fails once in 4,000 seeds."""
    config = ReaderGrid.Config(speed_mps=0.0, acceleration_density_m2ps3=0.1)
    t, random = np.arange(41) / 20, np.random.default_rng(1)
    ends = np.array([(p := track(config, t, random))[-1] - p[0] for _ in range(4000)]).ravel()
    assert ends.var() == pytest.approx(0.1 * 8 / 3, rel=4 * np.sqrt(2 / len(ends)))


def test_walkers_keep_clear_of_racks():
    config = ReaderGrid.Config(rack_bays=2, rack_rows=2)
    t, random = np.arange(201) / 20, np.random.default_rng(1)
    for _ in range(5):
        x, y = track(config, t, random).T % 10.0
        beside = np.minimum(np.abs(y - 2.5), np.abs(y - 7.5))
        assert not ((np.abs(x - 5) < 2 * 2.8 / 2 + 0.4) & (beside < 0.55 + 0.4)).any()


def test_who_stops_stands_and_sets_off_at_full_speed():
    config = ReaderGrid.Config(stop_s=3.0, go_s=3.0, acceleration_density_m2ps3=0.0, speed_mps=2.0)
    t, random = np.arange(1201) / 20, np.random.default_rng(1)
    speed = np.concatenate([np.linalg.norm(np.diff(track(config, t, random), axis=0), axis=1) * 20 for _ in range(20)])
    assert np.unique(np.round(speed, 6)).tolist() == [0.0, 2.0]
    assert 0.3 < (speed == 0).mean() < 0.7


def test_what_can_not_be_is_refused(monkeypatch):
    monkeypatch.setattr(reader_grid, "ATTEMPTS", 100)
    for wrong in ({"rack_bays": 4}, {"rack_bays": 1, "rack_rows": 6}, {"margin_m": 9}, {"antenna_height_m": 5.9}, {"start_margin_m": 20}):
        with pytest.raises(ValidationError):
            ReaderGrid.Config(**wrong)
    with pytest.raises(ValueError, match="stays clear"):
        track(ReaderGrid.Config(speed_mps=20.0), np.arange(401) / 20, np.random.default_rng(1))
