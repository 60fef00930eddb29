"""Odometer and compass against the motion that they ride on. Statistical tests state their false-alarm probability."""

import numpy as np
import pytest
from scipy.stats import kstest, uniform, vonmises

from testbed import frames
from testbed.geometry import Boxes
from testbed.protocols import Surroundings, Tagged
from testbed.scene import Body, Scene, Truth
from testbed.sensors.compass import Compass, von_mises
from testbed.sensors.odometry import Odometry
from testbed.sensors.steel import distance_to, standing_steel
from testbed.types import Tags
from testbed.units import wrap

SECONDS, SPEED, RADIUS = 20.0, 1.5, 2.0
SCENE = Scene((Body("f", "forklift", frames.IDENTITY, moving=True),), Boxes.empty(), (), np.zeros((2, 3)))


def circle():
    t = np.arange(int(SECONDS * 120) + 1) / 120
    angle = SPEED / RADIUS * t
    position = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0 * t], axis=1)
    return Truth(t=t, poses=np.concatenate([position, frames.from_euler(angle + np.pi / 2)], axis=1)[:, None], bodies=("f",))


def sensed(sensor, trial=0, target="f", **config):
    made = sensor(sensor.Config(on="f", **config), "s", SCENE)
    around = Surroundings(
        SCENE, circle(), Tagged(Tags.empty(), np.empty(0), np.empty((0, 7))), [target], np.empty(0), SECONDS, None, 1, trial
    )
    (stream,) = made.sense(around, 0).streams.values()
    return stream


QUIET = {"scale_std": 0, "noise_std_mps": 0, "yaw_bias_std_dps": 0, "yaw_noise_std_dps": 0}


def test_a_quiet_odometer_tells_speed_and_turn():
    odometry = sensed(Odometry, **QUIET)
    inside = slice(1, -1)  # at the very ends the truth stands still beyond
    np.testing.assert_allclose(odometry.speed[inside], SPEED, atol=1e-4)
    np.testing.assert_allclose(odometry.yaw_rate[inside], SPEED / RADIUS, atol=1e-4)
    assert len(odometry) == SECONDS * 10 + 1


def test_scale_and_bias_hold_for_a_trial_and_differ_between_trials():
    ratios = [sensed(Odometry, trial=i, **{**QUIET, "scale_std": 0.1, "bias_std_mps": 0.2}).speed[1:-1] - SPEED for i in range(200)]
    assert max(np.ptp(r) for r in ratios) < 1e-3
    spread = np.std([r[0] for r in ratios])
    expected = np.hypot(0.1 * SPEED, 0.2)
    assert abs(spread / expected - 1) < 5 / np.sqrt(2 * 200)  # five sigma of a standard deviation: false alarm 6e-7


def test_noise_of_the_odometer_has_its_size():
    noise = sensed(Odometry, rate_hz=100, **{**QUIET, "noise_std_mps": 0.3}).speed[1:-1] - SPEED
    assert abs(noise.std() / 0.3 - 1) < 5 / np.sqrt(2 * len(noise))  # five sigma: false alarm 6e-7


def test_a_quiet_compass_tells_the_yaw_wrapped():
    heading = sensed(Compass, bias_std_deg=0, noise_std_deg=0)
    truth = SPEED / RADIUS * heading.t + np.pi / 2
    np.testing.assert_allclose(wrap(heading.heading - truth), 0, atol=1e-4)
    assert np.all(np.abs(heading.heading) <= np.pi)


def test_the_wandering_error_has_its_size_and_its_correlation_time():
    # means over 400 trials; the bounds are five standard errors: false alarm about 1e-6 each
    trials = 400
    error = np.stack(
        [
            np.rad2deg(wrap(h.heading - (SPEED / RADIUS * h.t + np.pi / 2)))
            for h in (sensed(Compass, trial=i, bias_std_deg=0, noise_std_deg=0, wander_std_deg=10, wander_time_s=2) for i in range(trials))
        ]
    )
    for k in (0, 100):  # stationary: as large at the start as later
        assert abs(error[:, k].std() / 10 - 1) < 5 / np.sqrt(2 * trials)
    later = np.corrcoef(error[:, 50], error[:, 70])[0, 1]  # 2 s apart
    assert abs(later - np.exp(-1)) < 5 * (1 - np.exp(-2)) / np.sqrt(trials)


def test_the_bias_of_a_range_is_uniform_and_moves_no_other_draw():
    ranged = {**QUIET, "bias_range_mps": 0.5, "noise_std_mps": 0.1}
    bias = np.array([np.mean(sensed(Odometry, trial=i, **ranged).speed[1:-1] - SPEED) for i in range(200)])
    assert kstest(bias, uniform(-0.5, 1.0).cdf).pvalue > 1e-6  # false alarm 1e-6
    bare = sensed(Odometry, **{**ranged, "bias_range_mps": 0.0}).speed
    assert np.ptp(sensed(Odometry, **ranged).speed - bare) < 1e-12


@pytest.mark.parametrize("kappa", [0.0, 0.5, 2.0, 50.0])
def test_von_mises_noise_follows_its_distribution(kappa):
    heading = sensed(Compass, rate_hz=400, bias_std_deg=0, noise_kappa=kappa)
    error = wrap(heading.heading - (SPEED / RADIUS * heading.t + np.pi / 2))
    assert kstest(error, vonmises(kappa).cdf if kappa else uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-6  # false alarm 1e-6


def test_von_mises_draws_are_quantiles():
    share = np.linspace(0.001, 0.999, 41)
    np.testing.assert_allclose(von_mises(share, 2.0), vonmises.ppf(share, 2.0), atol=2e-4)


# ---------------------------------------------------------------- steel


STEEL_SCENE = Scene(
    (Body("f", "forklift", frames.IDENTITY, moving=True), Body("rack", "rack", frames.IDENTITY)),
    Boxes(
        np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 5.0]]),
        np.tile([1.0, 0, 0, 0], (2, 1)),
        np.array([[0.5, 0.5, 1], [9, 9, 0.1]]),
        [1, 1],
        [0, 1],
    ),
    ("steel", "wood"),
    np.zeros((2, 3)),
)


def test_steel_is_what_stands_and_is_of_steel():
    steel = standing_steel(STEEL_SCENE)
    np.testing.assert_allclose(steel, [[0, 0, 0.5, 0.5]])
    np.testing.assert_allclose(distance_to(steel, np.array([[0.2, 0.1], [1.5, 0.0], [3.5, 4.5]])), [0, 1, 5])
    assert np.isinf(distance_to(steel[:0], np.zeros((1, 2)))).all()


def test_the_error_by_steel_belongs_to_the_place_and_falls_off():
    errors = []
    for trial in range(300):
        made = Compass(
            Compass.Config(on="f", bias_std_deg=0, noise_std_deg=0, steel_std_deg=20, steel_reach_m=2.0, steel_length_m=3.0),
            "s",
            STEEL_SCENE,
        )
        around = Surroundings(
            STEEL_SCENE, circle(), Tagged(Tags.empty(), np.empty(0), np.empty((0, 7))), ["f"], np.empty(0), SECONDS, None, 1, trial
        )
        (stream,) = made.sense(around, 0).streams.values()
        errors.append(np.rad2deg(wrap(stream.heading - (SPEED / RADIUS * stream.t + np.pi / 2))))
    errors = np.array(errors)
    t = np.arange(errors.shape[1]) / 10
    angle = SPEED / RADIUS * t
    place = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    expected = 20 * np.exp(-0.5 * (distance_to(standing_steel(STEEL_SCENE), place) / 2.0) ** 2)
    ratio = errors[:, 1:-1].std(axis=0) / expected[1:-1]
    assert abs(ratio.mean() - 1) < 0.15
    assert np.abs(ratio - 1).max() < 5 / np.sqrt(2 * 300) + 0.05  # five sigma, and what 48 waves lack of a normal field
    again = np.hypot(*(place[1:-1, None] - place[None, 1:-1]).transpose(2, 0, 1)) < 0.08
    i, k = np.nonzero(np.triu(again, 20))
    assert len(i)  # the circle is driven more than twice
    assert np.abs(errors[:, 1 + i] - errors[:, 1 + k]).max() < 4.0


def test_samples_speak_of_the_target_on_the_body_or_of_nobody():
    assert set(sensed(Odometry).carrier) == {0}
    assert set(sensed(Compass, target="other").carrier) == {-1}


def test_latency_moves_the_arrival_alone():
    odometry = sensed(Odometry, latency_s=0.3)
    np.testing.assert_allclose(odometry.t_arrival - odometry.t, 0.3)


@pytest.mark.parametrize("sensor", [Odometry, Compass])
def test_a_body_that_is_not_there_is_named(sensor):
    with pytest.raises(ValueError, match=r"no moving body is named 'g'; there are f"):
        sensor(sensor.Config(on="g"), "s", SCENE)
