"""Changes of phase as changes of distance: their arithmetic, the trajectory that they sharpen, and the bound for it."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.phase_changes import PhaseChanges, change, one_carrier
from testbed import plugins
from testbed.checks import samples
from testbed.estimate import run
from testbed.metrics.position_bound import PositionBound, PositionBoundConfig
from testbed.recording import Recording, Trial
from testbed.scene import Truth
from testbed.types import Antennas, Prior, Reads, Site, Snapshots, Tags, Targets
from testbed.units import SPEED_OF_LIGHT, wrap_positive

CARRIER = 900e6
RADIAN = SPEED_OF_LIGHT / (4 * np.pi * CARRIER)  # m
PLACES = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 3.0]])


def shot(t, phase, rows=1):
    """A snapshot of one tag of each row by two antennas."""
    cell = np.broadcast_to(np.asarray(phase, dtype=float), (rows, 1, 2))
    when = np.full(rows, t)
    return Snapshots(when, when, np.zeros((rows, 1)), np.full(cell.shape, -50.0), cell)


def taken(phases, *, counts=(True, True), longest=0.15):
    memory, rows = PhaseChanges(1, 2, RADIAN, longest), np.array([0])
    return [memory.take(rows, shot(t, phase), np.array([[counts]])) for t, phase in phases]


def test_a_change_is_the_way_there_and_back_less_whole_waves():
    distance = np.array([2.0, 2.03])
    (first, _), (came, span) = taken((0.1 * k, wrap_positive(-d / RADIAN + np.array([1.0, 5.0]))) for k, d in enumerate(distance))
    assert np.isnan(first).all()
    np.testing.assert_allclose(came, 0.03, atol=1e-12)
    np.testing.assert_allclose(span, 0.1)


def test_nothing_is_said_after_a_gap_for_a_link_that_is_left_out_or_was_not_heard():
    assert np.isnan(taken([(0.0, 1.0), (0.2, 1.1)])[1][0]).all()
    assert np.isnan(taken([(0.0, 1.0), (0.1, 1.1)], counts=(True, False))[1][0]).tolist() == [[[False, True]]]
    later = taken([(0.0, [1.0, 1.0]), (0.1, [np.nan, 1.1]), (0.14, 1.2)])
    assert np.isnan(later[1][0]).tolist() == [[[True, False]]]
    np.testing.assert_allclose(later[2][1][0, 0], [0.14, 0.04])


def test_rows_keep_their_phases_apart():
    memory = PhaseChanges(2, 2, RADIAN, 1.0)
    memory.take(np.array([1]), shot(0.0, 1.0), np.ones((1, 1, 2), dtype=bool))
    came, _ = memory.take(np.array([0, 1]), shot(0.1, 1.5, rows=2), np.ones((2, 1, 2), dtype=bool))
    assert np.isnan(came[0]).all()
    np.testing.assert_allclose(came[1], -0.5 * RADIAN)


def test_the_gradient_is_the_slope():
    rng = np.random.default_rng(1)
    states, antenna, span = rng.normal(size=(20, 6)), rng.normal(size=(20, 3)) + 3, rng.uniform(0, 0.2, 20)
    value, gradient = change(states, antenna, span)
    for i in range(6):
        step = 1e-6 * np.eye(6)[i]
        slope = (change(states + step, antenna, span)[0] - change(states - step, antenna, span)[0]) / 2e-6
        np.testing.assert_allclose(gradient[:, i], slope, atol=1e-7)
    np.testing.assert_allclose(value, np.linalg.norm(states[:, :3] - antenna, axis=1) - np.linalg.norm(
        states[:, :3] - span[:, None] * states[:, 3:] - antenna, axis=1))  # fmt: skip


def test_a_reader_that_hops_is_refused():
    with pytest.raises(ValueError, match="ukf: changes of phase need one carrier, and the site has 3"):
        one_carrier(replace(samples.site(), frequencies=np.array([8e8, 9e8, 9.1e8])), "ukf")


# ---------------------------------------------------------------- a whole recording


def walk(noise_db=2.0, noise_rad=0.05, seed=3):
    """Recording and truth (K, 3) of a tag that walks past four antennas, read by all ten times a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(31) / 10
    where = np.array([1.0, 0.5, 0.8]) + t[:, None] * np.array([0.5, 0.4, 0.0])
    r = np.linalg.norm(where[:, None] - PLACES, axis=2)
    rssi = -40 - 40 * np.log10(r) + noise_db * rng.normal(size=r.shape)
    phase = wrap_positive(-r / RADIAN + rng.uniform(0, 6, 4) + noise_rad * rng.normal(size=r.shape))
    k, m = (a.ravel() for a in np.meshgrid(t, np.arange(4), indexing="ij"))
    n = len(PLACES)
    antennas = Antennas(
        id=np.array([f"a{i}" for i in range(n)]), position=PLACES, quaternion=np.tile([1.0, 0, 0, 0], (n, 1)), gain=np.zeros(n),
        beamwidth=np.full(n, np.pi), front_to_back=np.full(n, 200.0), power=np.zeros(n),
    )  # fmt: skip
    site = Site(antennas, Tags(id=np.array(["tag"])), np.array([CARRIER]))
    reads = Reads(k, k, m, np.zeros(len(k)), rssi=rssi.ravel(), phase=phase.ravel())
    return Recording(0, 3.0, site, {"reads": reads}, Targets(np.array(["tag"]), np.array([""])), (np.array([0]),)), where


def rms(recording, where, **options):
    method = plugins.load("estimators", "batch_map")
    config = method.Config(together=True, reference_dbm=-40.0, correlation_s=0.0, sigma_db=2.0, use_pattern=False, **options)
    prior = Prior(np.zeros(1), np.array([[1.5, 1.0, 0.8, 0, 0, 0]]), np.diag([0.5**2] * 3 + [0.25] * 3)[None])
    track = run([recording], method, config, prior, np.zeros(1, dtype=np.uint64))
    assert np.isfinite(track.mean).all()
    return np.sqrt(((track.mean[:, 0, :3] - where) ** 2).sum(axis=1).mean())


def test_phases_make_the_trajectory_sharper():
    walks = [walk(seed=seed) for seed in range(4)]
    sharp, plain = (np.mean([rms(*one, **options) for one in walks]) for options in ({"phase_noise_rad": 0.05}, {}))
    assert sharp < 0.8 * plain


def test_phases_of_the_wrong_sign_do_harm():
    made, where = walk()
    reads = made.streams["reads"]
    wrong = replace(made, streams={"reads": reads.with_(phase=wrap_positive(-reads.phase))})
    assert rms(wrong, where, phase_noise_rad=0.05) > 1.5 * rms(made, where)


def test_reads_without_phase_leave_what_levels_say():
    made, where = walk()
    silent = replace(made, streams={"reads": made.streams["reads"].with_(phase=np.full(len(made.streams["reads"]), np.nan))})
    assert rms(silent, where, phase_noise_rad=0.05) == pytest.approx(rms(made, where), abs=1e-9)


def scored(metric, place=(2.0, 1.5, 1.0)):
    """The bound of a smoother for a tag that stands at `place`."""
    made, _ = walk()
    still = np.array([[*place, 1, 0, 0, 0]])
    trial = Trial(made, Truth(np.array([0.0, 3.0]), np.zeros((2, 0, 7))), np.array([-1]), still, {})
    method = plugins.load("estimators", "centroid")
    prior = Prior(np.zeros(1), np.zeros((1, 6)), np.eye(6)[None])
    track = run([made], method, method.Config(), prior, np.zeros(1, dtype=np.uint64))
    return float(metric.compute(track, np.zeros((31, 1, 6)), trial)["position_bound_m.smoothed"][0])


def bound(**options):
    return scored(PositionBound(PositionBoundConfig(sigma_db=2.0, **options)))


def test_the_bound_falls_with_phases_and_the_less_noisy_they_are():
    assert bound(phase_noise_rad=0.02) < bound(phase_noise_rad=0.5) < bound()
    assert bound(phase_noise_rad=3.0, longest_s=0.01) == pytest.approx(bound())


def test_every_trial_has_a_bound_of_its_own():
    metric = PositionBound(PositionBoundConfig(sigma_db=2.0))
    near, far = scored(metric, (0.5, 0.5, 0.5)), scored(metric, (9.0, 9.0, 2.0))
    assert far > 2 * near
    assert scored(metric, (0.5, 0.5, 0.5)) == near
