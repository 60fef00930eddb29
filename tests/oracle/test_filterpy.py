"""The batched filters against filterpy, event by event over whole runs."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from estimators import kalman
from estimators.motion import ConstantVelocity, MotionConfig
from testbed import plugins
from testbed.checks import samples
from testbed.estimate import row_seeds, run

PLAIN = {"gate": "none", "correlation_s": 0.0}
CASES = [
    ("ekf", PLAIN | {"curvature_noise": False}),
    ("ekf", PLAIN | {"curvature_noise": False, "process_noise": "piecewise_acceleration", "path_loss_exponent": 3.1}),
    ("ekf", {}),
    ("ekf", {"gate": 0.6, "sigma_db": 1.0, "use_pattern": False}),
    ("ukf", PLAIN),
    ("ukf", PLAIN | {"alpha": 1.0, "beta": 0.0, "process_noise": "piecewise_acceleration"}),
    ("ukf", PLAIN | {"kappa": -3.0, "alpha": 1.0, "reference_dbm": -35.0}),
    ("ukf", {"gate": 0.6, "sigma_db": 1.0}),
]


@pytest.mark.parametrize(("kind", "options"), CASES)
def test_a_whole_run_equals_filterpys(kind, options):
    recordings = [samples.recording(trial, duration=3.0, reads_hz=12.0, latency=0.1) for trial in range(2)]
    prior, seeds = samples.prior(recordings), row_seeds(1, recordings, kind)
    ours, theirs = plugins.load("estimators", kind), plugins.load("estimators", f"{kind}_filterpy")
    config = ours.Config(**options)
    a, b = (run(recordings, method, config, prior, seeds, hold_s=0.05) for method in (ours, theirs))
    np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(a.status, b.status)
    for name in ("used", "refused", "late"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("nis", "log_likelihood"):
        np.testing.assert_allclose(getattr(a.innovations, name), getattr(b.innovations, name), rtol=1e-9, atol=1e-9)
    assert a.used.min() > 5
    assert a.late.sum() > 0
    if options.get("gate") == 0.6:
        assert a.refused.min() > 3


METRES = {"measure": "distance", "reference_dbm": -35.0, "process_noise": "piecewise_acceleration"}
TOGETHER = [
    ("ekf", PLAIN | {"curvature_noise": False}),
    ("ekf", {}),
    ("ekf", METRES | {"curvature_noise": True, "gate": "none"}),
    ("ekf", METRES | {"curvature_noise": False, "antennas": "s*", "distance_std_m": 0.8}),
    ("ukf", {}),
    ("ukf", PLAIN | {"antennas": "*east", "tags": "tag[0-3]"}),
    ("ukf", METRES | {"alpha": 1.0, "beta": 0.0, "gate": "none"}),
    ("ukf", METRES | {"gate": 0.6}),
]


def simultaneous(trial):
    """The checks' recording with reads at tenths of a second: several of a target at most instants."""
    made = samples.recording(trial, duration=3.0, reads_hz=12.0)
    reads = made.streams["reads"]
    t = np.round(reads.t, 1)
    made.streams["reads"] = reads.with_(t=t, t_arrival=t)
    return made


@pytest.mark.parametrize(("kind", "options"), TOGETHER)
def test_reads_taken_together_equal_filterpys_vector_update(kind, options):
    recordings = [simultaneous(trial) for trial in range(2)]
    prior, seeds = samples.prior(recordings), row_seeds(1, recordings, kind)
    ours, theirs = plugins.load("estimators", kind), plugins.load("estimators", f"{kind}_filterpy")
    config = ours.Config(together=True, **options)
    a, b = (run(recordings, method, config, prior, seeds) for method in (ours, theirs))
    np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=0, atol=1e-8)
    for name in ("status", "used", "refused"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(a.innovations.dof, b.innovations.dof)
    np.testing.assert_allclose(a.innovations.nis, b.innovations.nis, rtol=1e-7, atol=1e-8)
    assert a.used.min() > 5
    assert a.innovations.dof.max() > 1


# ---------------------------------------------------------------- vectors of distances, the trolley scenario of Nick and Götze

WAY = np.array([[3, 1.5, 0.75], [3, 2.5, 1.75], [2, 3.5, 0.75]])
ANTENNAS = np.array([[0.5, 3, 0.5], [4.5, 2.5, 3], [3.5, 1.5, 0.5], [0.5, 3, 3.5]])
DT, SPEED, STEPS, R = 0.1, 0.5, 63, 0.35**2
START, DOUBT = np.array([4.5, 3, 1, 0, 0, 0]), np.diag([0.25] * 3 + [0.0625] * 3)
MOTION = MotionConfig(process_noise="piecewise_acceleration", acceleration_std_mps2=0.4)
RISE = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])  # of the second tag over the first


def path():
    """(63, 3) m: positions at arc length k v dt along the way points."""
    legs = np.linalg.norm(np.diff(WAY, axis=0), axis=1)
    along = np.clip(np.arange(STEPS) * SPEED * DT, 0, legs.sum())
    return np.stack([np.interp(along, np.concatenate([[0], np.cumsum(legs)]), WAY[:, i]) for i in range(3)], axis=1)


def distances(points, antennas):
    return np.linalg.norm(points[..., None, :3] - antennas, axis=-1)


def slopes(x, antennas):
    h = np.zeros((len(antennas), len(x)))
    h[:, :3] = (x[:3] - antennas) / distances(x, antennas)[:, None]
    return h


def ours(kind, antennas, noise=None):
    """(63, 6) estimates by the batched core; `noise` (63, M) is added to the distances."""
    m, motion, rows = len(antennas), ConstantVelocity(MOTION), np.array([0])
    mean, covariance = START[None].copy(), DOUBT[None].copy()
    weights, limits, track = kalman.Weights.merwe(6, 1.0, 0.0, 0.0), kalman.gate_limits("none", m), []
    for k, z in enumerate(distances(path(), antennas)):
        z = z if noise is None else z + noise[k]
        motion.advance(mean, covariance, np.array([DT]))
        if kind == "ukf":
            points = kalman.sigma_points(mean, covariance, rows, weights)
            innovation = z - distances(points, antennas)
            kalman.unscented_update(mean, covariance, rows, points, innovation, R * np.eye(m)[None], weights, limits)
        else:
            innovation = (z - distances(mean[0], antennas))[None]
            kalman.extended_update(mean, covariance, rows, innovation, slopes(mean[0], antennas)[None], R * np.eye(m)[None], limits)
        track.append(mean[0].copy())
    return np.array(track)


def theirs(kind, antennas, noise):
    m = len(antennas)
    transition, q = ConstantVelocity(MOTION).matrices(DT)
    if kind == "ukf":
        points = MerweScaledSigmaPoints(6, 1.0, 0.0, 0.0)
        one = UnscentedKalmanFilter(6, m, DT, hx=lambda x: distances(x, antennas), fx=lambda x, dt: transition @ x, points=points)
    else:
        one = ExtendedKalmanFilter(6, m)
        one.F = transition
    one.x, one.P, one.Q, one.R = START.copy(), DOUBT.copy(), q, R * np.eye(m)
    track = []
    for k, z in enumerate(distances(path(), antennas)):
        one.predict()
        jacobian = () if kind == "ukf" else (lambda x: slopes(x, antennas), lambda x: distances(x, antennas))
        one.update(z + noise[k], *jacobian)
        track.append(one.x.copy())
    return np.array(track)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("m", [2, 3, 4])
def test_vectors_of_distances_give_filterpys_track(kind, m):
    noise = np.random.default_rng(m).normal(0, 0.3, (STEPS, m))
    np.testing.assert_allclose(ours(kind, ANTENNAS[:m], noise), theirs(kind, ANTENNAS[:m], noise), atol=1e-9)


def rmse_cm(track):
    return 100 * np.sqrt(((track[10:, :3] - path()[10:]) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize(
    ("kind", "m", "expected"),
    [("ekf", 2, 96.9301), ("ekf", 3, 75.8144), ("ekf", 4, 26.9633), ("ukf", 2, 76.5767), ("ukf", 3, 48.5446), ("ukf", 4, 23.3295)],
)
def test_errors_on_noise_free_distances_are_those_of_the_fitted_study(kind, m, expected):
    assert rmse_cm(ours(kind, ANTENNAS[:m])) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(("m", "expected"), [(2, 74.1766), (3, 43.3289), (4, 23.9984)])
def test_two_tags_on_one_trolley_are_twelve_states_and_a_pseudo_measurement(m, expected):
    antennas, rows = ANTENNAS[:m], np.array([0])
    motion, weights = ConstantVelocity(MOTION, targets=2), kalman.Weights.merwe(12, 1.0, 0.0, 0.0)
    mean, covariance = np.concatenate([START, START + RISE])[None], np.kron(np.eye(2), DOUBT)[None].copy()
    noise = np.diag([R] * 2 * m + [1e-4] * 6)[None]
    track = []
    for first, second in zip(distances(path(), antennas), distances(path() + RISE[:3], antennas), strict=True):
        motion.advance(mean, covariance, np.array([DT]))
        points = kalman.sigma_points(mean, covariance, rows, weights)
        seen = np.concatenate(
            [distances(points, antennas), distances(points[..., 6:], antennas), points[..., 6:] - points[..., :6]], axis=-1
        )
        innovation = np.concatenate([first, second, RISE]) - seen
        kalman.unscented_update(mean, covariance, rows, points, innovation, noise, weights, kalman.gate_limits("none", 2 * m + 6))
        track.append(mean[0].copy())
    assert rmse_cm(np.array(track)) == pytest.approx(expected, abs=1e-3)
