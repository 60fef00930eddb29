"""How the EKF, the UKF and the centroid behave: on data they should follow, in silence, and on data that are bad."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from estimators.centroid import centroid
from estimators.rssi_model import RssiConfig, RssiModel
from estimators.windows import Newest
from testbed import plugins
from testbed.checks import samples
from testbed.estimate import row_seeds, run
from testbed.recording import Recording
from testbed.types import Event, Prior, Reads, Status, Targets

SITE = samples.site()
KALMAN = ["ekf", "ukf", "ekf_filterpy", "ukf_filterpy"]


def reads_of(path, t, antenna, sigma=0.0, seed=0, **options):
    """Reads of tag 0 along path(t) (N, 3), by the estimators' own model plus white noise."""
    expected = RssiModel(RssiConfig(**options), SITE, "test").expected(path(t), antenna, np.zeros(len(t), dtype=int))
    return Reads(
        t=t, t_arrival=t, antenna=antenna, tag=np.zeros(len(t)), rssi=expected + np.random.default_rng(seed).normal(0, sigma, len(t))
    )


def recording(reads, duration, trial=0):
    name = np.array(["tag0"])
    return Recording(trial, duration, SITE, {"reads": reads}, Targets(name, name), (np.array([0]),))


def prior(mean, std=(0.5, 0.5, 0.5, 0.25, 0.25, 0.25), rows=1):
    return Prior(np.zeros(rows), np.tile(mean, (rows, 1)), np.tile(np.diag(np.square(std)), (rows, 1, 1)))


def track(kind, recordings, start, **options):
    method = plugins.load("estimators", kind)
    return run(recordings, method, method.Config(**options), start, row_seeds(0, recordings, kind))


def still(place):
    return lambda t: np.tile(place, (len(t), 1))


@pytest.mark.parametrize("kind", KALMAN)
@pytest.mark.parametrize("place", [(3.0, 2.5, 1.0), (1.2, 3.8, 0.8)])
def test_a_tag_that_stands_still_is_found(kind, place):
    t = np.arange(200) / 20
    made = recording(reads_of(still(place), t, np.arange(200) % 4, sigma=1.0), 10.0)
    end = track(kind, [made], prior([2.5, 2.8, 1.0, 0, 0, 0]), sigma_db=1.0, acceleration_density_m2ps3=1e-4).mean[-1, 0]
    assert np.linalg.norm(end[:2] - place[:2]) < 0.35  # the antennas all hang at one height, and tell little of the tag's
    assert abs(end[2] - place[2]) < 0.6


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_tag_that_moves_is_followed_better_than_it_is_predicted(kind):
    t = np.arange(300) / 50

    def path(t):
        return np.stack([1.5 + 0.5 * t, 2.0 + 0.1 * t, np.full(len(t), 1.0)], axis=1)

    made = recording(reads_of(path, t, np.arange(300) % 4, sigma=2.0), 6.0)
    wrong = prior([1.8, 1.7, 1.0, 0.1, 0.4, 0])
    found = track(kind, [made], wrong, sigma_db=2.0)
    error = np.linalg.norm(found.mean[:, 0, :3] - path(found.t), axis=1)
    alone = wrong.mean[0, :3] + found.t[:, None] * wrong.mean[0, 3:]
    assert error[20:].mean() < 0.5 * np.linalg.norm(alone - path(found.t), axis=1)[20:].mean()


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_doubt_is_honest_where_the_model_holds(kind):
    """400 rows: the mean of NEES over 6 is χ² with 2400 degrees of freedom over 2400. Two-sided at 1e-4, fixed seed."""
    rng, rows, t = np.random.default_rng(17), 400, np.arange(40) / 10
    std = np.array([0.15, 0.15, 0.15, 0.1, 0.1, 0.1])
    truth0 = np.concatenate([np.tile([3.0, 2.5, 0.2], (rows, 1)), rng.normal(0, 0.1, (rows, 3))], axis=1)
    start = Prior(np.zeros(rows), truth0 + std * rng.normal(size=(rows, 6)), np.tile(np.diag(std**2), (rows, 1, 1)))
    made = []
    for row in range(rows):
        where = lambda t, row=row: truth0[row, :3] + t[:, None] * truth0[row, 3:]  # noqa: E731
        made.append(recording(reads_of(where, t, rng.integers(0, 4, 40), 4.0, row), 4.0, trial=row))
    found = track(kind, made, start, gate="none", correlation_s=0.0, acceleration_density_m2ps3=0.0)
    truth = truth0.copy()
    truth[:, :3] += 4.0 * truth0[:, 3:]
    apart = found.mean[-1] - truth
    nees = np.einsum("bi,bij,bj->b", apart, np.linalg.inv(found.covariance[-1]), apart)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 6 * rows)
    assert low < nees.sum() < high
    low, high = chi2.ppf([5e-5, 1 - 5e-5], len(found.innovations.nis))
    assert low < found.innovations.nis.sum() < high


@pytest.mark.parametrize("kind", KALMAN)
def test_a_row_says_that_it_coasts_and_then_that_it_is_lost(kind):
    made = recording(reads_of(still((3.0, 2.5, 1.0)), np.array([1.05, 1.15]), np.array([0, 1])), 6.0)
    found = track(kind, [made], prior([3, 2.5, 1, 0, 0, 0]), coast_s=0.5, lost_s=3.0)
    status = dict(zip(np.round(found.t, 1), found.status[:, 0], strict=True))
    assert [status[t] for t in (0.0, 0.4, 0.8, 1.1, 1.6, 1.8, 4.1, 4.2)] == [
        Status.OK, Status.OK, Status.COASTING, Status.OK, Status.OK, Status.COASTING, Status.COASTING, Status.LOST,
    ]  # fmt: skip
    assert np.isfinite(found.mean).all()
    trace = np.trace(found.covariance[:, 0, :3, :3], axis1=1, axis2=2)
    assert (np.diff(trace[15:]) > 0).all()


@pytest.mark.parametrize("kind", KALMAN)
def test_reads_without_rssi_are_refused_and_leave_no_mark(kind):
    t = np.arange(20) / 20 + 0.01
    good = reads_of(still((3.0, 2.0, 1.0)), t, np.arange(20) % 4)
    spoilt = Reads.concatenate([good, good.with_(t=t + 0.001, t_arrival=t + 0.001, rssi=np.full(20, np.nan))])
    start = prior([3, 2.5, 1, 0, 0, 0])
    a, b = track(kind, [recording(good, 1.0)], start), track(kind, [recording(spoilt, 1.0)], start)
    assert (b.used[0], b.refused[0]) == (a.used[0], 20)
    np.testing.assert_allclose(a.mean[-1], b.mean[-1], atol=1e-9)


@pytest.mark.parametrize("kind", KALMAN)
@pytest.mark.parametrize("factor", [1e3, 1e300, -1e300])
def test_no_number_however_absurd_makes_an_estimate_that_is_not_finite(kind, factor):
    t = np.arange(60) / 30
    reads = reads_of(still((3.0, 2.0, 1.0)), t, np.arange(60) % 4)
    absurd = reads.with_(rssi=np.where(np.arange(60) % 3 == 0, reads.rssi * factor, reads.rssi))
    found = track(kind, [recording(absurd, 2.0)], prior([3, 2.5, 1, 0, 0, 0]), gate="none", correlation_s=0.0)
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.covariance).all()
    assert (np.linalg.eigvalsh(found.covariance) > -1e-9 * np.abs(found.covariance).max(axis=(2, 3))[..., None]).all()


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_gate_keeps_a_deep_fade_out_and_without_it_the_fade_pulls(kind):
    t = np.arange(80) / 40
    reads = reads_of(still((3.0, 2.5, 1.0)), t, np.arange(80) % 4)
    faded = reads.with_(rssi=reads.rssi - 30.0 * (np.arange(80) % 20 == 7))
    start, made = prior([3, 2.5, 1, 0, 0, 0], std=[0.2] * 6), [recording(faded, 2.0)]
    kept, pulled = (track(kind, made, start, gate=g, correlation_s=0.0) for g in (0.999, "none"))
    assert kept.refused[0] == 4
    assert pulled.refused[0] == 0
    off = [np.linalg.norm(x.mean[5:, 0, :3] - [3, 2.5, 1], axis=1).max() for x in (kept, pulled)]
    assert off[0] < 0.5 * off[1]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_same_reads_given_many_times_over_make_nobody_surer(kind):
    t = np.arange(10) / 10 + 0.05
    once = reads_of(still((3.0, 2.5, 1.0)), t, np.arange(10) % 4)
    often = once.take(np.repeat(np.arange(10), 50))
    start = prior([3, 2.5, 1, 0, 0, 0])
    a, b = (track(kind, [recording(r, 1.0)], start) for r in (once, often))
    sure = [np.linalg.det(x.covariance[-1, 0, :3, :3]) for x in (a, b)]
    assert sure[1] > 0.9 * sure[0]


def test_curvature_noise_keeps_a_read_at_the_antenna_from_being_overrated():
    """A first read by an antenna 0.3 m away, with half a metre of doubt: the straight line claims centimetres."""
    place = SITE.antennas.position[0] + [0.2, 0.2, -0.1]
    made = [recording(reads_of(still(place), np.array([0.05]), np.array([0])), 0.1)]
    start = prior([*place, 0, 0, 0])
    plain, careful = (track("ekf", made, start, curvature_noise=c).covariance[-1, 0, :3, :3] for c in (False, True))
    assert np.sqrt(np.linalg.eigvalsh(plain)[0]) < 0.15
    assert np.sqrt(np.linalg.eigvalsh(careful)[0]) > 0.35


@pytest.mark.parametrize("kind", [*KALMAN, "centroid"])
def test_an_antenna_that_is_carried_about_is_refused_in_a_sentence(kind):
    carried = replace(SITE, antennas=SITE.antennas.with_(carrier=np.array(["forklift", "", "", ""])))
    made = replace(recording(Reads.empty(), 1.0), site=carried)
    with pytest.raises(ValueError, match=f"^{kind}: the place of southwest is not known, it is carried"):
        track(kind, [made], prior([3, 2.5, 1, 0, 0, 0]))


@pytest.mark.parametrize("kind", KALMAN)
def test_a_prior_over_something_else_is_refused(kind):
    start = Prior(np.zeros(1), np.zeros((1, 2)), np.eye(2)[None], ("x", "y"))
    with pytest.raises(ValueError, match="position and velocity"):
        track(kind, [recording(Reads.empty(), 1.0)], start)


# ---------------------------------------------------------------- centroid and windows


def test_one_antenna_heard_is_where_the_tag_is_said_to_be():
    made = recording(Reads([0.5], [0.5], [2], [0], rssi=[-60.0]), 3.0)
    found = track("centroid", [made], prior([1, 1, 1, 0, 0, 0]), memory_s=1.0, coast_s=1.0, lost_s=2.0, spread_m=0.7)
    status = dict(zip(np.round(found.t, 1), found.status[:, 0], strict=True))
    assert [status[t] for t in (0.0, 0.4, 0.5, 1.5, 1.6, 2.5, 2.6)] == [2, 2, 0, 0, 1, 1, 2]
    np.testing.assert_allclose(found.mean[5:, 0], np.tile(SITE.antennas.position[2], (26, 1)))  # held in silence
    np.testing.assert_allclose(found.covariance[5, 0], 0.49 * np.eye(3))
    np.testing.assert_allclose(found.mean[0, 0], [1, 1, 1])


def test_weights_are_powers_to_the_exponent():
    places = np.array([[0.0, 0, 0], [1.0, 0, 0], [9.0, 9, 9]])
    mean, _ = centroid(np.array([[-50.0, -60.0, np.nan]]), places, 1.0, 0.5)
    np.testing.assert_allclose(mean, [[1 / 11, 0, 0]])
    mean, covariance = centroid(np.array([[-50.0, -60.0, np.nan]]), places, 0.25, 0.5)
    share = 10**-0.25 / (1 + 10**-0.25)
    np.testing.assert_allclose(mean, [[share, 0, 0]])
    np.testing.assert_allclose(covariance[0], np.diag([share * (1 - share), 0, 0]) + 0.25 * np.eye(3))


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3))
def test_the_centroid_stays_among_the_antennas_that_hear(seed, exponent):
    rng = np.random.default_rng(seed)
    rssi, places = rng.uniform(-200, 50, (4, 5)), rng.uniform(-9, 9, (5, 3))
    rssi[rng.random(rssi.shape) < 0.3] = np.nan
    mean, covariance = centroid(rssi, places, exponent, 0.1)
    for row in range(4):
        heard = np.isfinite(rssi[row])
        if not heard.any():
            assert np.isnan(mean[row]).all()
            continue
        assert (mean[row] >= places[heard].min(axis=0) - 1e-9).all()
        assert (mean[row] <= places[heard].max(axis=0) + 1e-9).all()
        assert np.linalg.eigvalsh(covariance[row])[0] > 0.009


def event(rows, t, antenna, rssi, tag=None):
    n = len(rows)
    return Event("reads", np.array(rows), Reads(t, t, antenna, np.zeros(n) if tag is None else tag, rssi=rssi))


def test_newest_keeps_the_last_value_of_each_antenna_as_long_as_asked():
    kept = Newest(2, 3)
    assert kept.add(event([0, 1], [1.0, 1.0], [2, 0], [-50.0, np.nan])).tolist() == [True, False]
    kept.add(event([0], [2.0], [2], [-55.0]))
    kept.add(event([0], [1.5], [2], [-99.0]))  # late: older than what is there
    nan = np.nan
    np.testing.assert_array_equal(kept.rssi(np.array([2.5, 2.5]), 1.0), [[nan, nan, -55.0], [nan, nan, nan]])
    np.testing.assert_array_equal(kept.rssi(np.array([3.1, 3.1]), 1.0), np.full((2, 3), nan))


def test_newest_tells_reference_tags_apart():
    kept = Newest(1, 2, tags=np.array([7, 3]))
    kept.add(event([0], [1.0], [1], [-50.0], tag=[3]))
    kept.add(event([0], [1.0], [0], [-60.0], tag=[7]))
    np.testing.assert_array_equal(kept.rssi(np.array([1.0]), 1.0), [[[-60.0, np.nan], [np.nan, -50.0]]])


def test_rows_of_a_batch_are_bit_for_bit_what_each_is_alone():
    made = [samples.recording(trial, duration=1.0) for trial in range(2)]
    start = samples.prior(made)
    for kind in ("ekf", "ukf"):
        method = plugins.load("estimators", kind)
        together = run(made, method, method.Config(), start, row_seeds(0, made, kind))
        alone = run([samples.only(made[1], 2)], method, method.Config(), start.take(np.array([6])), np.zeros(1, dtype=np.uint64))
        np.testing.assert_array_equal(together.mean[:, 6], alone.mean[:, 0])
        np.testing.assert_array_equal(together.covariance[:, 6], alone.covariance[:, 0])


COMPILED = """
import sys
from estimators import kalman, motion, rssi_model
from testbed import plugins
from testbed.checks import samples
from testbed.estimate import row_seeds, run
from testbed.rng import RowRandom

kernels = [k for m in (kalman, motion, rssi_model) for k in vars(m).values() if hasattr(k, "signatures")]
made = [samples.recording(duration=1.0)]
method, prior, seeds = plugins.load("estimators", sys.argv[1]), samples.prior(made), row_seeds(0, made, "x")
one = method(method.Config(), made[0].site, RowRandom(seeds))
one.start(prior)
before = [len(k.signatures) for k in kernels]
run(made, method, method.Config(), prior, seeds)
print(sum(before), sum(len(k.signatures) for k in kernels))
"""


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_kernels_are_compiled_at_the_start_so_that_wall_times_are_of_updates(kind):
    done = subprocess.run([sys.executable, "-c", COMPILED, kind], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    before, after = map(int, done.stdout.split())
    assert before == after >= 3
