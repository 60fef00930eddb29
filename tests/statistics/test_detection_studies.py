"""The paper's claims at the sizes that they need, and the wrong builds of its filter that they tell from the right one.

Common random numbers: all filters see the same trials. The seed is fixed; bands are those that independent builds of the same reading
of the paper reach, the mean over the trials being what is compared. The order of four grids (B5)
and what goes beyond the paper are in scenarios (test_detection_scenarios.py).
"""

from functools import cache

import numpy as np
import pytest

from estimators import detection_cloud
from estimators.detection_asynchronous import DetectionAsynchronous
from estimators.detection_centroid import DetectionCentroid
from estimators.detection_cloud import Cloud
from estimators.detection_model import looked_up
from estimators.detection_synchronous import DetectionSynchronous
from testbed.estimate import row_seeds, run
from testbed.prior import draw_prior
from testbed.scenario import PriorModel, from_dict
from testbed.simulate import Simulator

SEED = 8101
PRIOR = PriorModel(position_std_m=(1.0, 1.0, 0.001), velocity_std_mps=(0.5, 0.5, 0.001))
FAST = (("cells", 8), ("speed_mps", 3.0))


@cache
def made(trials, seconds=20, world=(), dead=(0.9, 17.1), **detection):
    """Trials of one walker, counted."""
    zone = {"alpha": dead[0], "beta": dead[1]}
    scenario = from_dict({
        "name": "study", "seed": SEED, "trials": trials, "duration_s": seconds, "truth_hz": 20, "step_hz": 20,
        "world": {"kind": "reader_grid", "walkers": 1, **dict(world)},
        "sensors": [{"id": "grid", "kind": "rfid", "antennas": {"on": "reader*"},
                     "detection": {"kind": "logistic_beta", "geometry": False, "dead_zone": zone, **detection}}],
        "tags": [{"id": "tag", "on": "walker1", "mount": "tag"}], "targets": ["tag"],
    })  # fmt: skip
    with Simulator(scenario) as simulator:
        return tuple(simulator.trial(k) for k in range(trials))


def errors(trials, method, **config):
    """(trials,) mean distance over slots 6 to T."""
    recordings = [t.recording for t in trials]
    config = method.Config.model_validate(config)
    track = run(recordings, method, config, draw_prior(PRIOR, trials, SEED), row_seeds(SEED, recordings, "x"), report_hz=1.0)
    truth = np.concatenate([t.target_states(track.t)[:, :, :2] for t in trials], axis=1)
    return np.linalg.norm(track.mean[..., :2] - truth, axis=-1)[track.t >= 6].mean(axis=0)


# ---------------------------------------------------------------- wrong builds


class PlainBinomial(DetectionAsynchronous):
    """Without the Beta spread."""


class Mirrored(DetectionAsynchronous):
    """τ taken from the slot's end."""

    def stamp(self, t):
        slot = np.floor(t)
        return slot + 1 - (t - slot)


class NotPredicted(DetectionAsynchronous):
    """Reports what was believed after the last block."""

    def estimate(self):
        now, self._now = self._now, np.array(self._cloud.at)
        try:
            return super().estimate()
        finally:
            self._now = now


def one_covariance_a_step(monkeypatch):
    """Eq. 1 as printed: the noise of a step does not depend on its length as white noise does. Variance of the acceleration q."""

    def move(self, rows, dt):
        z = np.empty((len(rows), 2, self.x.shape[2]))
        detection_cloud.normals(self._draw(rows), z)
        z *= np.sqrt(self.density)
        h = dt[:, None, None]
        self.x[rows, :2] += h * self.x[rows, 2:] + h**2 / 2 * z
        self.x[rows, 2:] += h * z
        self._stale[rows] = True

    monkeypatch.setattr(Cloud, "move", move)


def without_boresight(monkeypatch):
    """θ as the arctan of a ratio, folded."""

    def weigh(self, rows, antenna, n, lag, table, view):
        for b, a, k, h in zip(rows, antenna, n, lag, strict=True):
            dx, dy = self.x[b, :2] + h * self.x[b, 2:] - view.position[a, :2, None]
            angle = np.abs(np.rad2deg(np.arctan(dy / dx)))
            self.log_weight[b] += looked_up(table[k], np.hypot(dx, dy), angle)
        self._weighed[rows] = True
        self._stale[rows] = True

    monkeypatch.setattr(Cloud, "weigh", weigh)


RADIANS = {
    "logit": [-4.9433, 0.8370, 0.0552 * np.pi / 180],
    "variance": [-0.04453125, 0.034375, -0.003125, 0.0, -0.05 * (np.pi / 180 / 60) ** 2],
}


def test_wrong_builds_are_told_from_the_right_one_by_a_few_trials(monkeypatch):
    """Ten paired trials, readers 10 m apart. The wrong ones are off by metres; what is less needs the study below."""
    trials = made(10)
    right = errors(trials, DetectionAsynchronous)
    assert 0.8 < right.mean() < 1.7
    assert errors(trials, DetectionAsynchronous, **RADIANS).mean() > 3.5
    without_boresight(monkeypatch)
    assert errors(trials, DetectionAsynchronous).mean() > 3.5


def test_what_time_costs_shows_in_a_dozen_trials_of_a_fast_tag():
    trials = made(12, 12, FAST)
    right = errors(trials, DetectionAsynchronous)
    assert (errors(trials, DetectionSynchronous) - right).mean() > 0.15
    assert (errors(trials, DetectionCentroid) - right).mean() > 0.6


# ---------------------------------------------------------------- the study


@pytest.mark.study
def test_a_rows_a_fast_tag_under_a_dense_grid(monkeypatch):
    trials = made(100, 12, FAST)
    right = errors(trials, DetectionAsynchronous, particles=1000)
    assert 0.44 <= right.mean() <= 0.60
    assert (errors(trials, DetectionSynchronous, particles=1000) - right).mean() >= 0.33
    fewer = errors(trials, DetectionAsynchronous)
    assert (errors(trials, DetectionSynchronous) - fewer).mean() >= 0.25
    assert 1.0 <= (errors(trials, DetectionCentroid) - fewer).mean() <= 1.4
    wrong = {
        "no final prediction": errors(trials, NotPredicted, particles=1000),
        "plain binomial": errors(trials, PlainBinomial, particles=1000, variance=[0, 0, 0, 0, 0]),
        "mirrored": errors(trials, Mirrored, particles=1000),
    }
    one_covariance_a_step(monkeypatch)
    wrong["Eq. 1 a step"] = errors(trials, DetectionAsynchronous, particles=1000)
    for name, found in wrong.items():
        assert (found - right).mean() > 0.05, name
    assert wrong["Eq. 1 a step"].mean() > 0.75
    assert wrong["no final prediction"].mean() > 0.60


@pytest.mark.study
def test_b_rows_the_paper_s_own_setting(monkeypatch):
    trials = made(150)
    right = errors(trials, DetectionAsynchronous)
    assert 1.00 <= right[:50].mean() <= 1.40
    assert (errors(trials, DetectionCentroid) - right)[:50].mean() >= 1.1
    assert (errors(made(150, world=(("antennas", 3),)), DetectionAsynchronous) - right).mean() > 0.2
    half = made(50, dead=(12.0, 12.0))
    assert (errors(half, DetectionAsynchronous, dead_alpha=12.0, dead_beta=12.0) - right[:50]).mean() > 0.25
