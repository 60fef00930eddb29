"""Particle filters on the floor: RSSI from an unknown start, ranges with biases and an odometer, both against a known truth."""

import numpy as np

from estimators.floor_cloud import student
from estimators.range_particles import RangeParticles
from estimators.rssi_particles import RssiParticles
from testbed.estimate import run
from testbed.recording import Recording
from testbed.types import POSITION_VELOCITY, Antennas, Odometry, Prior, Ranges, Reads, Site, Tags, Targets

CORNERS = np.array([[0.0, 0, 1], [6, 0, 1], [6, 6, 1], [0, 6, 1]])
ROWS = 4  # rows of one filter with seeds of their own


def site():
    n = len(CORNERS)
    turn = np.tile([1.0, 0, 0, 0], (n, 1))
    patterns = {"gain": np.zeros(n), "beamwidth": np.full(n, 2 * np.pi), "front_to_back": np.full(n, 20.0)}
    antennas = Antennas(np.array(list("abcd")), CORNERS, turn, power=np.zeros(n), reference=np.full(n, -40.0), **patterns)
    return Site(antennas, Tags(np.array(["lid"])), np.empty(0))


def tracked(method, streams, config, std=2.0):
    recordings = [
        Recording(k, 20.0, site(), streams, Targets(np.array(["cart"]), np.array(["cart"])), (np.array([0]),)) for k in range(ROWS)
    ]
    mean, covariance = np.tile([3.0, 3, 1, 0, 0, 0], (ROWS, 1)), np.diag([std**2, std**2, 1e-6, 1, 1, 1e-6])
    prior = Prior(np.zeros(ROWS), mean, np.tile(covariance, (ROWS, 1, 1)), POSITION_VELOCITY)
    return run(recordings, method, method.Config(**config), prior, np.arange(ROWS, dtype=np.uint64) + 5, report_hz=5.0)


def circle(t):
    return np.stack([3 + 2 * np.cos(0.3 * t), 3 + 2 * np.sin(0.3 * t)], axis=-1)


def late_error(track):
    error = np.linalg.norm(track.mean[..., :2] - circle(track.t)[:, None], axis=2)
    return error[track.t > 8]


def test_rssi_finds_a_tag_from_nowhere():
    random, t = np.random.default_rng(1), np.arange(0.05, 20, 0.05)
    antenna = np.arange(len(t)) % 4
    apart = np.linalg.norm(np.column_stack([circle(t), np.ones(len(t))]) - CORNERS[antenna], axis=1)
    rssi = -40 - 20 * np.log10(apart) + random.normal(0, 3, len(t))
    rssi[::17] -= 25  # a tenth of a hall stands in between now and then
    reads = Reads(t, t, antenna, np.zeros(len(t)), rssi=rssi)
    config = {"path_loss_exponent": 2, "use_pattern": False, "sigma_db": 3, "freedom": 4, "correlation_s": 0}
    error = late_error(tracked(RssiParticles, {"reads": reads}, config))
    assert np.median(error) < 1.0  # one read tells a distance to 1.2 m


def test_ranges_that_are_too_long_are_seen_through():
    random, t = np.random.default_rng(2), np.arange(0.0, 20, 0.1)
    anchor = np.arange(len(t)) % 4
    apart = np.linalg.norm(np.column_stack([circle(t), np.ones(len(t))]) - CORNERS[anchor], axis=1)
    ranges = Ranges(t, t, anchor, np.zeros(len(t)), apart + np.array([0.3, 0.1, 0.2, 0.15])[anchor] + random.normal(0, 0.03, len(t)))
    odometry = Odometry(t, t, np.zeros(len(t)), np.full(len(t), 0.6), np.full(len(t), 0.3))
    error = [
        np.median(
            late_error(
                tracked(RangeParticles, {"ranges": ranges, "odometry": odometry}, {"bias_m": 0.0, "bias_std_m": std, "sigma_m": 0.05})
            )
        )
        for std in (0.2, 0.0)
    ]
    assert error[0] < 0.6 * error[1]


def test_without_a_read_the_cloud_only_spreads():
    track = tracked(RssiParticles, {"reads": Reads.empty()}, {"path_loss_exponent": 2, "margin_m": None})
    spread = np.einsum("kbii->kb", track.covariance[..., :2, :2])
    assert (np.diff(spread, axis=0)[::10] > 0).all()
    assert track.status[-1].tolist() == [2] * ROWS


def test_particles_stay_on_the_floor_they_are_given():
    random, t = np.random.default_rng(3), np.arange(0.1, 20, 0.1)
    reads = Reads(t, t, np.zeros(len(t)), np.zeros(len(t)), rssi=random.normal(-40, 1, len(t)))
    track = tracked(RssiParticles, {"reads": reads}, {"path_loss_exponent": 2, "box_m": [[2, 2], [4, 4]]}, std=5.0)
    assert ((track.mean[..., :2] > 2) & (track.mean[..., :2] < 4)).all()


def test_student_is_normal_for_many_degrees_of_freedom():
    z = np.linspace(-3, 3, 13)
    np.testing.assert_allclose(student(z, 1e9), -(z**2) / 2, atol=1e-6)
