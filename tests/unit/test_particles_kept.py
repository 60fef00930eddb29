"""Particles on their way from a method to a kept recording: thinned, stored, and only where somebody wants them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed import tables
from testbed.estimate import run, thinned
from testbed.quantity import Config
from testbed.recording import Recording
from testbed.types import POSITION_VELOCITY, Antennas, Estimate, Prior, Site, Status, Tags, Targets


class Cloud:
    """Three particles a row, at x = 0, 1 and 2, the last one twice as heavy as the others together."""

    Config = Config
    consumes = frozenset({"reads"})

    def __init__(self, config, site, rng):
        pass

    def start(self, prior):
        self.prior = prior

    def predict(self, t):
        pass

    def update(self, event):
        raise AssertionError("there are no events")

    def estimate(self):
        status = np.full(self.prior.rows, Status.OK)
        return Estimate(POSITION_VELOCITY, self.prior.mean, self.prior.covariance, status)

    def particles(self):
        position = np.zeros((self.prior.rows, 3, 3))
        position[..., 0] = np.arange(3)
        return position, np.tile([1 / 6, 1 / 6, 4 / 6], (self.prior.rows, 1))


class Without(Cloud):
    particles = None


def track(method, count):
    site = Site(antennas=Antennas.empty(), tags=Tags.empty(), frequencies=np.empty(0))
    recording = Recording(0, 1.0, site, {}, Targets(name=["a", "b"], body=["", ""]), (np.empty(0, int), np.empty(0, int)))
    prior = Prior(np.zeros(2), np.zeros((2, 6)), np.tile(np.eye(6), (2, 1, 1)))
    return run([recording], method, Config(), prior, np.arange(2, dtype=np.uint64), report_hz=2, particles=count)


def test_as_many_as_were_asked_for_are_kept_in_proportion_to_their_weight():
    kept = track(Cloud, 60).particles
    assert kept.shape == (3, 2, 60, 3)
    assert [(kept[1, 0, :, 0] == x).sum() for x in range(3)] == [10, 10, 40]


def test_nobody_asked_nothing_is_kept():
    assert track(Cloud, 0).particles.shape == (3, 2, 0, 3)


def test_rows_of_a_track_keep_their_own_particles_and_come_back_from_disk(tmp_path):
    whole = track(Cloud, 7)
    one = whole.take(np.array([1]))
    np.testing.assert_array_equal(one.particles, whole.particles[:, [1]])
    tables.write(one, tmp_path / "t.parquet")
    np.testing.assert_array_equal(tables.read(tmp_path / "t.parquet").particles, one.particles)


@given(st.lists(st.floats(0.01, 1), min_size=1, max_size=30), st.integers(1, 200))
def test_each_particle_comes_as_often_as_its_weight_says_to_within_one(weights, n):
    weight = np.array([weights]) / np.sum(weights)
    position = np.zeros((1, len(weights), 3))
    position[0, :, 0] = np.arange(len(weights))
    times = np.bincount(thinned(position, weight, n)[0, :, 0].astype(int), minlength=len(weights))
    assert times.sum() == n
    assert np.all(np.abs(times - n * weight[0]) <= 1 + 1e-9)


def test_weights_need_not_sum_to_one_to_the_last_bit():
    assert thinned(np.zeros((1, 4, 3)), np.full((1, 4), 0.25 - 1e-12), 5).shape == (1, 5, 3)


def test_a_method_without_particles_keeps_none():
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(Without, "particles")
        patch.delattr(Cloud, "particles")
        assert track(Without, 60).particles.shape[2] == 0
