"""`testbed calibrate --model logistic_beta`: what is measured, what is fitted, what is refused, what is written."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import betabinom

from testbed.calibrate import CalibrationError, Request, model
from testbed.calibrate.beta_fit import LARGEST, LEAST, Fit, fit
from testbed.calibrate.counts import Blocks, check, measure
from testbed.calibrate.logistic_beta import calibrate, campaign
from testbed.cli import main
from testbed.progress import Silent
from testbed.scenario import from_dict
from testbed.types import Counts, Rounds

TRUE = Fit((-4.9433, 0.8370, 0.0552), (-0.04453125, 0.034375, -0.003125, 0.0, -0.05 / 3600), 0.05, 10.0, 0.0)


def drawn(fit_, n=20_000, seed=3, queries=10):
    """Blocks that the model itself draws, at places all over; each a run of its own."""
    rng = np.random.default_rng(seed)
    d, angle = rng.choice(np.arange(1, 10.1), n), rng.choice(np.arange(0, 91, 15.0), n)
    m, v = fit_.mean(d, angle), fit_.spread(d, angle)
    strength = m * (1 - m) / v - 1
    p = rng.beta(m * strength, (1 - m) * strength)
    alive = rng.binomial(queries, p) * (rng.random(n) > fit_.dead)
    return Blocks(d, angle, alive, np.full(n, queries), np.arange(n), np.arange(n) % 4)


def blocks(n, queries=10, distance=None, degrees=None):
    n = np.asarray(n)
    d = np.linspace(1, 8, len(n)) if distance is None else np.full(len(n), distance)
    w = np.linspace(0, 60, len(n)) if degrees is None else np.full(len(n), degrees)
    return Blocks(d, w, n, np.full(len(n), queries), np.arange(len(n)), np.arange(len(n)) % 2)


# ---------------------------------------------------------------- the fit


def test_the_fit_finds_what_the_counts_were_drawn_from():
    """20,000 blocks. Bounds are four times the spread of the estimates over seeds: fails once in 10,000 seeds."""
    found = fit(drawn(TRUE))
    assert np.abs(np.array(found.logit) - TRUE.logit).max() < 0.4
    assert found.logit[1] == pytest.approx(0.837, abs=0.05)
    assert found.logit[2] == pytest.approx(0.0552, abs=0.004)
    assert found.dead == pytest.approx(0.05, abs=0.02)
    d, w = np.array([3.0, 5.5, 7.0, 5.5]), np.array([0.0, 0.0, 0.0, 30.0])
    np.testing.assert_allclose(found.spread(d, w), TRUE.spread(d, w), atol=0.015)


def test_no_parameters_are_more_likely_than_those_found():
    counts = drawn(TRUE, 5000)
    found = fit(counts)
    assert found.log_likelihood == pytest.approx(found.log_mass(counts).sum(), rel=1e-9)
    assert found.log_likelihood > TRUE.log_mass(counts).sum() - 0.02
    for a3 in (0.8, 1.2):
        other = Fit((*found.logit[:2], found.logit[2] * a3), found.variance, found.dead, 10.0, 0.0)
        assert other.log_mass(counts).sum() < found.log_likelihood


def test_masses_are_those_of_scipy():
    n = np.arange(11)
    at = Blocks(np.full(11, 5.0), np.full(11, 15.0), n, np.full(11, 10), n, n)
    m, v = (float(f(np.array([5.0]), np.array([15.0]))[0]) for f in (TRUE.mean, TRUE.spread))
    s = m * (1 - m) / v - 1
    wanted = 0.95 * betabinom.pmf(n, 10, m * s, (1 - m) * s) + 0.05 * (n == 0)
    np.testing.assert_allclose(np.exp(TRUE.log_mass(at)), wanted, rtol=1e-9)


def test_the_variance_stays_within_its_limits():
    wild = Fit((-5.0, 0.8, 0.05), (9.0, -2.0, 0.0, 0.0, 0.0), 0.0, 10.0, 0.0)
    d, w = np.linspace(0, 10, 50), np.zeros(50)
    m = wild.mean(d, w)
    share = wild.spread(d, w) / (m * (1 - m))
    assert share.min() == pytest.approx(LEAST)
    assert share.max() == pytest.approx(LARGEST)


def test_held_out_counts_are_more_likely_with_the_angle_than_by_distance_alone():
    found = campaign("drawn", drawn(TRUE, 4000))
    assert found.without_angle.logit[2] == 0
    assert found.without_angle.variance[3:] == (0, 0)
    assert found.gain.low > 0.3
    assert found.gain.mean == pytest.approx(found.held_out[0] - found.held_out[1], abs=1e-9)
    flat = Fit((-4.0, 0.7, 0.0), (0.03, 0.0, 0.0, 0.0, 0.0), 0.05, 10.0, 0.0)
    assert campaign("flat", drawn(flat, 4000)).gain.high < 0.02  # where angles say nothing, nothing is gained


# ---------------------------------------------------------------- what is measured

BENCH = {
    "name": "bench", "seed": 4, "trials": 2, "duration_s": 30, "world": {"kind": "open_floor", "posts": 0, "length_m": 20, "width_m": 12},
    "sensors": [{
        "id": "bench", "kind": "rfid", "detection": {"kind": "logistic_beta", "geometry": False},
        "antennas": [{"id": f"off{a}", "position_m": [2, 6, 1.5], "yaw_deg": a} for a in range(0, 91, 15)],
    }],
    "tags": [{"id": f"at{i}", "position_m": [2 + d, 6, 1.5], "yaw_deg": 180} for i, d in enumerate((1, 2, 3, 4, 5, 6, 7, 8, 9.4))],
}  # fmt: skip


@pytest.fixture(scope="module")
def counted():
    return measure(from_dict(BENCH), 1.0, Silent())


def test_blocks_are_all_queries_of_a_second_at_their_true_distance_and_angle(counted):
    assert len(counted) == 2 * 30 * 7 * 9
    assert (counted.queries == 10).all()
    assert np.unique(counted.distance.round(6)).tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9.4]
    np.testing.assert_allclose(np.unique(counted.degrees.round(4)), np.arange(0, 91, 15), atol=1e-3)
    assert len(np.unique(counted.run)) == 2 * 7 * 9
    near = (counted.distance < 2.5) & (counted.degrees < 10)
    assert counted.n[near].mean() == pytest.approx(9.3, abs=0.4)
    longer = measure(from_dict({**BENCH, "trials": 1}), 10.0, Silent())
    assert (longer.queries == 100).all()
    assert longer.n.sum() == counted.n[counted.trial == 0].sum()


def test_the_generator_s_parameters_come_back_from_its_counts(counted):
    """The whole way: another piece of code made the counts (`testbed.radio.logistic_beta`)."""
    found = fit(counted)
    assert found.logit[0] == pytest.approx(-4.9433, abs=0.5)
    assert found.logit[1] == pytest.approx(0.8370, abs=0.08)
    assert found.logit[2] == pytest.approx(0.0552, abs=0.006)
    assert found.dead == pytest.approx(0.05, abs=0.02)
    assert float(found.spread(np.array([5.5]), np.array([0.0]))[0]) == pytest.approx(0.05, abs=0.02)


# ---------------------------------------------------------------- what is refused


def rounds(queries=(10, 10)):
    return Rounds(round=[0, 1], t_start=[0.0, 1.0], t_end=[0.5, 1.5], t_arrival=[0.5, 1.5], antenna=[0, 0], reader=[0, 0], queries=queries)


@pytest.mark.parametrize(
    ("made", "counts", "says"),
    [
        (rounds((10, 0)), Counts.empty(), r"row 1 of rounds \(round 1, antenna 0\) has no queries"),
        (rounds(), Counts([0, 3], [0, 0], [0, 0], [1, 1]), "row 1 of counts is of round 3"),
        (rounds(), Counts([0, 1], [0, 0], [0, 0], [1, 11]), r"row 1 of counts \(round 1\) has 11 reads of 10 queries"),
        (rounds(), Counts([1], [0], [0], [-2]), "row 0 of counts"),
    ],
)
def test_counts_that_can_not_be_are_refused_with_the_row_named(made, counts, says):
    with pytest.raises(CalibrationError, match=f"bench: {says}"):
        check(made, counts, "bench")


@pytest.mark.parametrize(
    ("measured", "says"),
    [
        (blocks([3] * 5), "too few"),
        (blocks([3, 7] * 20, distance=4.0), "all counts are of 4.00 m"),
        (blocks([3, 7] * 20, degrees=30.0), "30° off boresight"),
        (blocks([0] * 40), "nothing was ever read"),
        (blocks([10] * 40), "every query was answered"),
    ],
)
def test_measurements_that_can_not_tell_are_refused_with_what_is_missing(measured, says):
    with pytest.raises(CalibrationError, match=says):
        fit(measured)


def test_what_makes_no_counts_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match="nobody was asked"):
        measure(from_dict({**BENCH, "sensors": [], "tags": []}), 1.0, Silent())
    with pytest.raises(CalibrationError, match="nothing to hold out"):
        calibrate(Request("detection-campaign", trials=1))
    with pytest.raises(CalibrationError, match="did you mean logistic_beta"):
        model("logistic_betta")


# ---------------------------------------------------------------- the command


def run(*arguments):
    with pytest.raises(SystemExit) as leaving:
        main(["calibrate", *arguments])
    return leaving.value.code


PLACES = "sweep={tags.probe.position_m: [[4, 5, 1.5], [6, 5, 1.5], [8, 5, 1.5]]}"
SHORT = ("detection-campaign", "--trials", "2", "--set", "duration_s=3", "--set", PLACES)


def test_the_command_writes_a_fit_what_was_measured_and_a_figure(tmp_path, capsys):
    assert run(*SHORT, "--json", "--out", str(tmp_path / "fit")) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "fit" / "calibration.json").read_text())
    assert document["held_out"]["runs"] == 3 * 7
    assert set(document["estimator"]) >= {"logit", "variance", "dead_alpha"}
    table = pq.read_table(tmp_path / "fit" / "measured.parquet")
    assert table.num_rows == document["blocks"] == 2 * 3 * 7 * 3
    assert (tmp_path / "fit" / "calibration.svg").read_text().startswith("<svg ")
    assert run(*SHORT, "--out", str(tmp_path / "fit")) == 2
    assert "--force" in capsys.readouterr().err


def test_what_it_prints_fits_an_estimator(capsys):
    from estimators.detection_asynchronous import DetectionAsynchronous

    assert run(*SHORT) == 0
    said = capsys.readouterr().out
    assert "published" in said
    assert "held out" in said
    DetectionAsynchronous.Config.model_validate(calibrate(Request(SHORT[0], trials=2, sets=["duration_s=3", PLACES])).section())


def test_mistakes_of_use_are_told_in_a_sentence(capsys):
    assert run("detection-campaign", "--model", "nonsense") == 2
    assert "no model is named 'nonsense'" in capsys.readouterr().err
    assert run("detection-campaign", "--block", "0") == 2
    assert "--block takes seconds" in capsys.readouterr().err


@pytest.mark.study
def test_the_campaign_in_the_physics_world_finds_a_model_like_the_published_one():
    """No published model is in the world: what comes out has its shape, and foretells better than distance alone."""
    found = calibrate(Request("detection-campaign"))
    a1, a2, a3 = found.fitted.logit
    assert -9 < a1 < -4
    assert 0.6 < a2 < 1.1
    assert 0.04 < a3 < 0.12
    assert found.gain.low > 0.1
