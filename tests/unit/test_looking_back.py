"""Smoothing, most probable trajectories, standing or moving, and the bound: against dense linear algebra on small problems."""

import numpy as np
import pytest
from scipy import stats

from estimators import kalman
from estimators.belief import Belief, StatusConfig, smoother_gain
from estimators.imm import mixed
from estimators.motion import ConstantVelocity, MotionConfig
from estimators.still import Still, StillConfig
from estimators.trajectories import Course, step
from testbed import plugins
from testbed.checks import samples
from testbed.estimate import row_seeds, run
from testbed.metrics.position_bound import PositionBound, PositionBoundConfig
from testbed.recording import Recording, Trial
from testbed.scene import Truth
from testbed.types import POSITION_VELOCITY, Estimate, Heights, Prior, Reads, Targets

START, DOUBT = np.array([1.0, 2.0, 0.5, 0.3, -0.2, 0.0]), np.diag([1.0, 0.5, 0.8, 0.2, 0.3, 0.1])
TIMES = np.array([0.2, 0.5, 0.5, 1.1, 1.4])
NOISE = 0.09


def joint(motion, times=TIMES, start=0.0):
    """Mean (K 6,) and covariance of the states at `times` under the motion model alone."""
    k = len(times)
    mean, covariance = np.zeros((k, 6)), np.zeros((k, 6, k, 6))
    x, p = START, DOUBT
    for i, dt in enumerate(np.diff(times, prepend=start)):
        f, q = motion.matrices(dt)
        x, p = f @ x, f @ p @ f.T + q
        mean[i], covariance[i, :, i] = x, p
        for j in range(i):
            covariance[i, :, j] = f @ covariance[i - 1, :, j]
            covariance[j, :, i] = covariance[i, :, j].T
    return mean.ravel(), covariance.reshape(6 * k, 6 * k)


def conditioned(mean, covariance, h, z, r):
    s = h @ covariance @ h.T + r * np.eye(len(z))
    gain = covariance @ h.T @ np.linalg.inv(s)
    return mean + gain @ (z - h @ mean), covariance - gain @ h @ covariance


def measured(times=TIMES, seed=2):
    """One linear measurement of position at each time: rows (K, 3) and values (K,)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(len(times), 3)), rng.normal(1.0, 1.0, len(times))


@pytest.mark.parametrize("kind", ["white_acceleration", "piecewise_acceleration"])
def test_going_back_over_a_belief_gives_the_exact_conditional_of_all_states(kind):
    motion = ConstantVelocity(MotionConfig(process_noise=kind))
    rows, values = measured()
    belief = Belief(Prior(np.zeros(1), START[None], DOUBT[None]), motion, StatusConfig(), keep=True)
    belief.predict(np.zeros(1))
    for t, h, z in zip(TIMES, rows, values, strict=True):
        belief.predict(np.array([t]))
        jacobian = np.zeros((1, 1, 6))
        jacobian[0, 0, :3] = h
        innovation = np.array([[z - h @ belief.mean[0, :3]]])
        kalman.extended_update(
            belief.mean, belief.covariance, np.array([0]), innovation, jacobian, np.array([[[NOISE]]]), kalman.gate_limits("none", 1)
        )
    mean, covariance = joint(motion)
    select = np.zeros((len(TIMES), 6 * len(TIMES)))
    for i, h in enumerate(rows):
        select[i, 6 * i : 6 * i + 3] = h
    mean, covariance = conditioned(mean, covariance, select, values, NOISE)
    for i, estimate in enumerate(belief.smoothed(TIMES)):
        if i in (1, 2):  # two states of one time are one state
            i = 2
        here = slice(6 * i, 6 * i + 6)
        np.testing.assert_allclose(estimate.mean[0], mean[here], atol=1e-9)
        np.testing.assert_allclose(estimate.covariance[0], covariance[here, here], atol=1e-9)


def test_rows_with_times_of_their_own_are_gone_back_over_each_by_itself():
    recordings = [samples.recording(trial, duration=2.0) for trial in range(2)]
    prior, seeds = samples.prior(recordings), row_seeds(1, recordings, "ukf")
    method = plugins.load("estimators", "ukf")
    together = run(recordings, method, method.Config(smooth=True), prior, seeds)
    rows = len(recordings[0].targets)
    for i, one in enumerate(recordings):
        alone = run([one], method, method.Config(smooth=True), prior.take(np.arange(rows) + rows * i), seeds[rows * i : rows * (i + 1)])
        np.testing.assert_allclose(together.mean[:, rows * i : rows * (i + 1)], alone.mean, atol=1e-9)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_last_estimate_is_the_same_and_earlier_ones_are_surer(kind):
    recordings = [samples.recording(0, duration=3.0)]
    prior, seeds = samples.prior(recordings), row_seeds(1, recordings, kind)
    method = plugins.load("estimators", kind)
    forward, back = (run(recordings, method, method.Config(smooth=smooth), prior, seeds) for smooth in (False, True))
    np.testing.assert_allclose(back.mean[-1], forward.mean[-1], atol=1e-9)
    np.testing.assert_array_equal(back.status, forward.status)
    size = [np.trace(track.covariance[:-1, :, :3, :3], axis1=2, axis2=3) for track in (forward, back)]
    assert (size[1] <= size[0] + 1e-9).all()
    assert (size[1].mean() < 0.8 * size[0].mean()).all()
    np.testing.assert_array_equal(back.used, forward.used)


def test_no_time_between_two_states_makes_them_one():
    gain = smoother_gain(ConstantVelocity(MotionConfig()), np.array([0.0, 0.1]), np.tile(DOUBT, (2, 1, 1)), np.tile(2 * DOUBT, (2, 1, 1)))
    np.testing.assert_array_equal(gain[0], np.eye(6))
    assert (gain[1] != np.eye(6)).any()


# ---------------------------------------------------------------- trajectories


def course(kind, rows, values, times):
    motion = MotionConfig(process_noise=kind)
    white = kind == "white_acceleration"
    intensity = motion.acceleration_density_m2ps3 if white else motion.acceleration_std_mps2**2
    dt = np.diff(times, prepend=times[0])[None]
    z = values[None, :, None]
    x, p = START[None].copy(), DOUBT[None].copy()
    ConstantVelocity(motion).advance(x, p, times[:1].copy())
    return Course(np.array([len(times)]), dt, z, np.full(z.shape, NOISE), x, p, intensity, white), rows[None, :, None, :], motion


@pytest.mark.parametrize("kind", ["white_acceleration", "piecewise_acceleration"])
def test_one_undamped_step_solves_a_linear_problem_exactly_wherever_it_begins(kind):
    times = np.array([0.2, 0.5, 0.9, 1.1])
    rows, values = measured(times)
    problem, gradient, motion = course(kind, rows, values, times)
    states = np.random.default_rng(0).normal(size=(1, 4, 6))
    expected = np.einsum("ekmi,eki->ekm", gradient, states[..., :3])
    found, covariance = step(problem, states, expected, gradient, np.zeros(1))
    select = np.zeros((4, 24))
    for i, h in enumerate(rows):
        select[i, 6 * i : 6 * i + 3] = h
    mean, exact = conditioned(*joint(ConstantVelocity(motion), times), select, values, NOISE)
    np.testing.assert_allclose(found[0].ravel(), mean, atol=1e-8)
    for i in range(4):
        np.testing.assert_allclose(covariance[0, i], exact[6 * i : 6 * i + 6, 6 * i : 6 * i + 6], atol=1e-8)


def test_the_cost_is_least_at_the_solution_and_is_the_density_of_the_model():
    times = np.array([0.2, 0.5, 0.9])
    rows, values = measured(times)
    problem, gradient, motion = course("white_acceleration", rows, values, times)

    def cost(states):
        return float(problem.cost(states, np.einsum("ekmi,eki->ekm", gradient, states[..., :3]))[0])

    nowhere = np.zeros((1, 3, 6))
    best, _ = step(problem, nowhere, np.zeros((1, 3, 1)), gradient, np.zeros(1))
    mean, covariance = joint(ConstantVelocity(motion), times)
    rng = np.random.default_rng(1)
    for _ in range(20):
        other = best + rng.normal(0, 0.3, best.shape)
        assert cost(other) > cost(best)
        density = stats.multivariate_normal(mean, covariance).logpdf(other.ravel()) - stats.multivariate_normal(mean, covariance).logpdf(
            mean
        )
        residual = values - np.einsum("ki,ki->k", rows, other[0, :, :3])
        assert cost(other) == pytest.approx(-density + (residual**2).sum() / NOISE / 2)


def test_damping_keeps_a_step_short():
    times = np.array([0.2, 0.5, 0.9])
    rows, values = measured(times)
    problem, gradient, _ = course("white_acceleration", rows, values, times)
    lengths = [
        np.linalg.norm(step(problem, np.zeros((1, 3, 6)), np.zeros((1, 3, 1)), gradient, np.array([d]))[0]) for d in (0.0, 1.0, 100.0, 1e6)
    ]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[-1] < 1e-3


# ---------------------------------------------------------------- many starts


def mirrored():
    """Two antennas on the wall x = 0 hear a tag that stands in front of it; the prior has most of its weight behind the wall."""
    site = samples.site()
    antennas = site.antennas.with_(position=np.array([[0, 0, 1], [0, 5, 1], [0, 2.5, 2], [0, 1, 2.5]]), beamwidth=np.full(4, np.pi))
    where, t = np.array([1.5, 2.0, 1.0]), np.arange(31) / 10
    k, m = (a.ravel() for a in np.meshgrid(t, np.arange(4), indexing="ij"))
    rssi = -40 - 40 * np.log10(np.linalg.norm(where - antennas.position[m], axis=1))
    reads = Reads(k, k, m, np.zeros(len(k)), rssi=rssi)
    made = Recording(
        0,
        3.0,
        type(site)(antennas, site.tags, site.frequencies),
        {"reads": reads},
        Targets(np.array(["t"]), np.array([""])),
        (np.array([0]),),
    )
    prior = Prior(np.zeros(1), np.array([[-1.0, 2.0, 1.0, 0, 0, 0]]), np.diag([4.0, 1.0, 0.25, 0.01, 0.01, 0.01])[None])
    return made, prior, where


def test_many_starts_find_the_side_of_the_wall_that_the_prior_makes_likelier():
    made, prior, where = mirrored()
    options = {"together": True, "reference_dbm": -40.0, "sigma_db": 1.0, "correlation_s": 0.0, "use_pattern": False, "gate": "none"}
    method = plugins.load("estimators", "batch_map")
    for side, middle in ((-1.0, -1.0), (1.0, 1.0)):
        told = prior.with_(mean=np.array([[middle, 2.0, 1.0, 0, 0, 0]]))
        track = run([made], method, method.Config(**options), told, np.zeros(1, dtype=np.uint64))
        np.testing.assert_allclose(track.mean[:, 0, :3], np.tile(where * [side, 1, 1], (31, 1)), atol=0.05)


def test_heights_are_part_of_the_most_probable_trajectory():
    made, prior, where = mirrored()
    height = Heights(np.arange(31) / 10, np.arange(31) / 10, np.zeros(31), np.full(31, where[2]))
    made.streams["heights"] = height
    method = plugins.load("estimators", "batch_map")
    options = {"together": True, "reference_dbm": -40.0, "sigma_db": 1.0, "correlation_s": 0.0, "use_pattern": False, "height_std_m": 0.05}
    track = run([made], method, method.Config(**options), prior, np.zeros(1, dtype=np.uint64))
    np.testing.assert_allclose(track.mean[-1, 0, :3], where * [-1, 1, 1], atol=0.05)
    assert track.covariance[-1, 0, 2, 2] < 0.05**2 / 2


# ---------------------------------------------------------------- standing or moving


def test_a_mixture_has_the_mean_and_covariance_of_its_samples():
    rng = np.random.default_rng(4)
    parts = []
    for _ in range(2):
        a = rng.normal(size=(6, 6))
        parts.append(Estimate(POSITION_VELOCITY, rng.normal(size=(1, 6)), (a @ a.T)[None]))
    mean, covariance = mixed(parts, np.array([[0.3, 0.7]]))
    second = sum(w * (p.covariance[0] + np.outer(p.mean[0], p.mean[0])) for w, p in zip((0.3, 0.7), parts, strict=True))
    np.testing.assert_allclose(mean[0], 0.3 * parts[0].mean[0] + 0.7 * parts[1].mean[0])
    np.testing.assert_allclose(covariance[0], second - np.outer(mean[0], mean[0]), atol=1e-12)


def test_what_stands_forgets_its_velocity_and_stays_where_it_is():
    still = Still(StillConfig(still_speed_std_mps=0.02, still_wander_m2ps=0.01))
    mean, covariance = np.tile(START, (2, 1)), np.tile(DOUBT + 0.05, (2, 1, 1))
    still.advance(mean, covariance, np.array([0.0, 2.0]))
    np.testing.assert_array_equal(mean[0], START)
    np.testing.assert_array_equal(covariance[0], DOUBT + 0.05)
    np.testing.assert_array_equal(mean[1], [*START[:3], 0, 0, 0])
    np.testing.assert_allclose(covariance[1, 3:, 3:], 0.0004 * np.eye(3))
    np.testing.assert_allclose(np.diag(covariance[1])[:3], np.diag(DOUBT)[:3] + 0.05 + 0.02)
    assert not covariance[1, :3, 3:].any()


def walked(speed):
    """A tag that stands for 3 s, then moves along y at `speed`; exact levels by four antennas, ten times a second."""
    site = samples.site()
    t = np.arange(61) / 10
    k, m = (a.ravel() for a in np.meshgrid(t, np.arange(4), indexing="ij"))
    where = np.stack([np.full(len(k), 2.0), 1.5 + speed * np.maximum(k - 3.0, 0.0), np.full(len(k), 1.0)], axis=1)
    rssi = (
        -35 - 40 * np.log10(np.linalg.norm(where - site.antennas.position[m], axis=1)) + 0.3 * np.random.default_rng(5).normal(size=len(k))
    )
    reads = Reads(k, k, m, np.zeros(len(k)), rssi=rssi)
    return Recording(0, 6.0, site, {"reads": reads}, Targets(np.array(["t"]), np.array([""])), (np.array([0]),))


def moving(speed, until):
    method = plugins.load("estimators", "imm")
    config = method.Config(together=True, reference_dbm=-35.0, sigma_db=0.5, correlation_s=0.0, use_pattern=False)
    made = walked(speed)
    seen = []
    prior = Prior(np.zeros(1), np.array([[2.0, 1.5, 1.0, 0, 0, 0]]), np.diag([0.25] * 3 + [0.25] * 3)[None])

    class Watched(method):
        def estimate(self):
            found = super().estimate()
            seen.append(float(found.extras["moving"][0]))
            return found

    run([made], Watched, config, prior, np.zeros(1, dtype=np.uint64))
    return np.array(seen)[[29, until]]


def test_an_imm_says_standing_while_it_stands_and_moving_when_it_moves():
    standing, gone = moving(1.0, 45)
    assert standing < 0.3
    assert gone > 0.9
    assert moving(0.0, 60)[1] < 0.3


def test_an_imm_that_never_changes_and_begins_as_moving_is_a_ukf():
    recordings = [samples.recording(0, duration=2.0)]
    prior, seeds = samples.prior(recordings), row_seeds(1, recordings, "ukf")
    imm, ukf = (plugins.load("estimators", kind) for kind in ("imm", "ukf"))
    a = run(recordings, ukf, ukf.Config(), prior, seeds)
    b = run(recordings, imm, imm.Config(moving_at_start=1 - 1e-12, stay_s=1e6, still_speed_std_mps=1e-3), prior, seeds)
    np.testing.assert_allclose(a.mean[:5], b.mean[:5], atol=1e-3)


# ---------------------------------------------------------------- the bound


def bounded(config, reads_at=(0.0, 0.1, 0.2, 0.3)):
    """The bound for a tag that stands at the origin of a room with four antennas, and their places."""
    site = samples.site()
    t = np.array(reads_at)
    k, m = (a.ravel() for a in np.meshgrid(t, np.arange(4), indexing="ij"))
    reads = Reads(k, k, m, np.zeros(len(k)), rssi=np.full(len(k), -50.0))
    recording = Recording(0, 1.0, site, {"reads": reads}, Targets(np.array(["t"]), np.array([""])), (np.array([0]),))
    pose = np.array([[2.0, 1.5, 1.0, 1, 0, 0, 0]])
    trial = Trial(recording, Truth(np.array([0.0, 1.0]), np.zeros((2, 0, 7))), np.array([-1]), pose, {})
    method = plugins.load("estimators", "centroid")
    track = run([recording], method, method.Config(), Prior(np.zeros(1), np.zeros((1, 6)), np.eye(6)[None]), np.zeros(1, dtype=np.uint64))
    found = PositionBound(PositionBoundConfig(**config)).compute(track, np.zeros((11, 1, 6)), trial)
    return float(found["position_bound_m.filtered"][0]), float(found["position_bound_m.smoothed"][0]), site.antennas.position


def test_the_bound_of_one_instant_is_the_inverse_of_fisher_and_prior_information():
    filtered, smoothed, antennas = bounded({"sigma_db": 2.0, "position_std_m": 0.7}, reads_at=(0.0,))
    apart = np.array([2.0, 1.5, 1.0]) - antennas
    h = -40 / np.log(10) * apart / (apart**2).sum(axis=1, keepdims=True)
    expected = np.sqrt(np.trace(np.linalg.inv(h.T @ h / 4 + np.eye(3) / 0.49)))
    assert filtered == pytest.approx(expected)
    assert smoothed == pytest.approx(expected)


def test_the_bound_is_below_for_those_who_look_back_know_more_or_hear_better():
    base = {"sigma_db": 2.0, "position_std_m": 1.0}
    filtered, smoothed, _ = bounded(base)
    assert smoothed < filtered
    assert bounded(base | {"height_std_m": 0.05})[0] < filtered
    assert bounded(base | {"sigma_db": 1.0})[0] < filtered
    assert bounded(base | {"position_std_m": 0.5})[0] < filtered
    assert bounded(base | {"antennas": "south*"})[0] > filtered
    assert bounded(base | {"acceleration_std_mps2": 5.0})[0] > filtered


def test_without_reads_there_is_no_bound():
    assert np.isnan(bounded({"tags": "other"})[0])
    assert np.isnan(bounded({"skip_s": 5.0})[0])
