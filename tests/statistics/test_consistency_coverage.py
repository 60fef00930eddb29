"""Do the intervals cover, and is an honest filter called honest? Fixed seeds; each test states how often chance alone fails it."""

import numpy as np
import pytest
from scipy import stats

from testbed.evaluate import chi2_limits, mean_interval, summarise
from testbed.metrics.consistency import Consistency
from testbed.types import POSITION_VELOCITY, Innovations, Track

STEP, SPECTRAL_DENSITY, MEASUREMENT_STD = 0.1, 0.5, 0.3
TRIALS, TIMES, TARGETS = 40, 60, 2


def transition():
    move, noise = np.eye(6), np.zeros((6, 6))
    for axis in range(3):
        p, v = axis, axis + 3
        move[p, v] = STEP
        block = SPECTRAL_DENSITY * np.array([[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]])
        noise[np.ix_([p, v], [p, v])] = block
    return move, noise


def filtered(rng, rows, believed_std=MEASUREMENT_STD):
    """A linear Kalman filter on data of its own model (nearly constant velocity, positions measured): track and truth."""
    move, noise = transition()
    see = np.eye(3, 6)
    start = np.diag([1.0, 1.0, 1.0, 0.25, 0.25, 0.25])
    truth = rng.multivariate_normal(np.zeros(6), start, rows)
    mean, covariance = np.zeros((rows, 6)), start.copy()
    means, covariances, truths, said = [], [], [], []
    for k in range(TIMES):
        truth = truth @ move.T + rng.multivariate_normal(np.zeros(6), noise, rows)
        measured = truth @ see.T + MEASUREMENT_STD * rng.normal(size=(rows, 3))
        mean, covariance = mean @ move.T, move @ covariance @ move.T + noise
        spread = see @ covariance @ see.T + believed_std**2 * np.eye(3)
        gain = np.linalg.solve(spread, see @ covariance).T
        innovation = measured - mean @ see.T
        nis = np.einsum("bi,ij,bj->b", innovation, np.linalg.inv(spread), innovation)
        said.append(Innovations(np.arange(rows), np.full(rows, k * STEP), nis, np.full(rows, 3), np.zeros(rows)))
        mean, covariance = mean + innovation @ gain.T, covariance - gain @ spread @ gain.T
        covariance = (covariance + covariance.T) / 2
        means.append(mean), covariances.append(np.broadcast_to(covariance, (rows, 6, 6))), truths.append(truth)
    none = np.zeros(rows)
    track = Track(
        t=np.arange(TIMES) * STEP,
        mean=means,
        covariance=covariances,
        status=np.zeros((TIMES, rows)),
        trial=np.zeros(rows),
        target=np.arange(rows),
        used=none,
        refused=none,
        late=none,
        update_seconds=none,
        components=POSITION_VELOCITY,
        innovations=Innovations.concatenate(said),
    )
    return track, np.array(truths)


def scored(seed, believed_std=MEASUREMENT_STD):
    rng = np.random.default_rng(seed)
    metric = Consistency(Consistency.Config())
    parts = [metric.compute(*filtered(rng, TARGETS, believed_std), None) for _ in range(TRIALS)]
    rows = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    keys = {"point": np.zeros(TRIALS * TARGETS, int), "trial": np.repeat(np.arange(TRIALS), TARGETS)}
    return {**keys, "estimator": np.full(TRIALS * TARGETS, "kf"), **rows}


def test_a_kalman_filter_on_its_own_model_is_within_its_limits():
    # false alarm: 0.05 for NIS (exact), below 0.05 for NEES (its average over times and targets varies less); 0.1 in all
    summary = summarise(scored(20261))[0]
    for column in ("nees.mean", "nis.mean"):
        low, high = summary.limits[column]
        assert low <= summary.statistics[column].mean <= high, column


def test_the_share_inside_of_a_kalman_filter_on_its_own_model_is_95_percent():
    # NIS: 14,400 independent updates, a binomial share of standard deviation 0.0018; four of them are passed by chance 1 time in 16,000
    inside = scored(20262)["nis.inside_95"].mean()
    assert abs(inside - 0.95) < 4 * np.sqrt(0.95 * 0.05 / (TRIALS * TARGETS * TIMES))


@pytest.mark.parametrize(("factor", "side"), [(0.7, 1), (1.4, -1)])
def test_a_filter_that_believes_in_the_wrong_noise_is_found_out(factor, side):
    # the alarm is missed with a chance far below 1e-6: the limits are ±2 % wide, the effect is tens of percent
    summary = summarise(scored(20263, believed_std=factor * MEASUREMENT_STD))[0]
    low, high = summary.limits["nis.mean"]
    assert (summary.statistics["nis.mean"].mean > high) if side > 0 else (summary.statistics["nis.mean"].mean < low)


@pytest.mark.parametrize(
    ("draw", "coverage"),
    [(lambda r, s: r.normal(size=s), 0.95), (lambda r, s: r.uniform(-1, 1, s), 0.9436)],
    ids=["normal", "uniform"],
)
def test_the_t_interval_of_eight_trials_covers_the_mean(draw, coverage):
    # Exact for the normal law; 0.9436 for the uniform one (10^6 draws of another seed, by numpy alone). The share of 4,000
    # intervals has a standard deviation of 0.0035: four of them are passed by chance 1 time in 16,000.
    rng = np.random.default_rng(20264)
    found = [mean_interval(values) for values in draw(rng, (4000, 8))]
    covered = np.mean([f.low <= 0.0 <= f.high for f in found])
    assert abs(covered - coverage) < 4 * 0.0035


def test_chi2_limits_hold_the_average_of_independent_nees_in_95_percent():
    # 20,000 averages of 10 statistics of 6 degrees of freedom: standard deviation 0.0015; a chance of 1 in 16,000 beyond four
    low, high = chi2_limits(6, 10)
    averages = stats.chi2.rvs(6, size=(20_000, 10), random_state=np.random.default_rng(20265)).mean(axis=1)
    assert abs(np.mean((averages >= low) & (averages <= high)) - 0.95) < 4 * 0.0015
