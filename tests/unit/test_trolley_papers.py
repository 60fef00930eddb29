"""The published study of trolleys at a gate: figures without noise, to a thousandth of a centimetre, as the scenario expects them."""

import pytest

import testbed
from testbed.scenario import load

GOLDEN = {  # cm, by number of antennas; the EKF and UKF also by filterpy, in tests/oracle/test_filterpy.py
    "ekf": (96.9301, 75.8144, 26.9633),
    "ukf": (76.5767, 48.5446, 23.3295),
    "rp": (74.1766, 43.3289, 23.9984),
    "rt": (56.1996, 46.9371, 21.2361),
    "wa": (65.3862, 38.0397, 21.3836),
    "ukf_beams": (98.2507, 61.5638, 37.6601),
}


@pytest.fixture(scope="module")
def result():
    return testbed.run("papers/trolley-noise-free")


def test_every_figure_without_noise_is_met_through_the_scenario(result):
    assert result.ok
    cells = result.document()["published"][0]["tables"][0]["cells"]
    assert len(cells) == 18
    for cell in cells:
        assert cell["ours"] == pytest.approx(GOLDEN[cell["estimator"]][cell["set"]["sensors.gate.count"] - 2], abs=1e-3)
        assert cell["inside"]


def test_the_study_has_all_fifteen_published_figures_with_a_band_each():
    tables = load("papers/trolley").published[0].tables
    figures = [f for table in tables[:3] for f in table.figures]
    assert sorted(f.paper for f in figures) == sorted([
        86.18, 66.75, 43.45, 69.06, 49.30, 27.18, 65.84, 39.81, 25.60, 68.41, 45.90, 26.82, 65.96, 38.79, 26.61,
    ])  # fmt: skip
    assert all(f.accept for f in figures)


def test_methods_are_compared_on_the_same_noise(result):
    made = testbed.run("papers/trolley", trials=2, estimators=["ukf", "ukf_beams"], set={"sweep": {"sensors.gate.count": [2]}})
    assert made.world["point"].tolist() == [0, 0]
    assert not made.failures


@pytest.mark.study
@pytest.mark.parametrize("name", ["trolley", "trolley-order", "trolley-beyond", "trolley-random-worlds", "trolley-occlusion"])
def test_noisy_figures_and_the_order_of_the_methods_hold(name):
    verdicts = testbed.check_scenario(f"papers/{name}", jobs="auto")
    assert [str(v) for v in verdicts if not v.ok] == []
