"""Patterns from tables, the dipole of a tag, and what polarisation takes: against closed forms and scipy's rotations."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from testbed import frames
from testbed.radio.antenna import DEGREES, exponent, half_power_width, tabulated
from testbed.radio.coupling import NULL_DB, Coupling, dipole_axis, polarisation_loss
from testbed.types import Antennas, Tags

HALF = 10 * np.log10(0.5)
angles = st.floats(-np.pi, np.pi)


def pattern_db(cosine, n, floor):
    """cos^n in dB down to a floor, written out again."""
    return np.maximum(10 * n * np.log10(np.maximum(cosine, 1e-30)), -floor)


def antennas(n=1, **changes):
    fields = {
        "id": [f"a{i}" for i in range(n)], "position": np.zeros((n, 3)), "quaternion": np.tile(frames.IDENTITY[3:], (n, 1)),
        "gain": np.full(n, 6.0), "beamwidth": np.full(n, np.pi / 2), "front_to_back": np.full(n, 18.0), "power": np.full(n, 29.0),
    }  # fmt: skip
    return Antennas(**{**fields, **changes})


def gain(antenna, towards, tag="isotropic", axis=(0.0, 1.0, 0.0), looking=frames.IDENTITY[3:]):
    """dBi of one antenna with a tag of 2 dBi for each direction (N, 3)."""
    towards = np.atleast_2d(np.asarray(towards, dtype=float))
    zero, ones = np.zeros(len(towards), dtype=int), np.ones((len(towards), 1))
    coupling = Coupling(antenna, Tags(id=["t"], pattern=[tag]))
    return coupling.at(zero, zero, looking * ones, np.asarray(axis) * ones, towards)[0]


def around(degrees):
    """Directions in the xz plane, so many degrees off +x."""
    off = np.deg2rad(np.atleast_1d(degrees))
    return np.stack([np.cos(off), np.zeros_like(off), np.sin(off)], axis=1)


# ---------------------------------------------------------------- antennas


def test_without_a_table_the_pattern_is_cos_n():
    off = np.linspace(0, 180, 400)
    expected = 6.0 + 2.0 + HALF + pattern_db(np.cos(np.deg2rad(off)), exponent(np.pi / 2), 18.0)
    np.testing.assert_allclose(gain(antennas(), around(off)), expected, atol=1e-9)


def test_a_table_is_met_at_its_knots_and_straight_in_db_between():
    table = tabulated([0, 30, 60, 180], [0, -2, -10, -25])
    got = gain(antennas(pattern=[table]), around([0, 15, 30, 45, 60, 120, 180, 59.5])) - 8.0 - HALF
    np.testing.assert_allclose(got, [0, -1, -2, -6, -10, -17.5, -25, -10 + 4 / 30], atol=1e-9)


def test_a_table_is_the_same_all_round_and_turns_with_its_antenna():
    table = tabulated([0, 90, 180], [0, -12, -20])
    turned = frames.from_euler(0.7, -0.3, 1.1)
    for roll in (0.0, 1.0, 2.5):
        way = frames.rotate(turned, [np.cos(0.5), np.sin(0.5) * np.cos(roll), np.sin(0.5) * np.sin(roll)])
        assert gain(antennas(pattern=[table]), way, looking=turned) == pytest.approx(8 + HALF - 12 * np.rad2deg(0.5) / 90)


def test_one_antenna_may_have_a_table_beside_another_without():
    flat = antennas(2, pattern=[np.full(181, np.nan), tabulated([0, 180], [0, -1])])
    way, one = np.tile(around(180), (2, 1)), np.tile(frames.IDENTITY[3:], (2, 1))
    got, _ = Coupling(flat, Tags(id=["t"])).at(np.arange(2), np.zeros(2, int), one, np.zeros((2, 3)), way)
    np.testing.assert_allclose(got - 8 - HALF, [-18, -1])


def test_a_table_that_ends_early_says_how_it_goes_on():
    table = tabulated([0, 40, 90], [0, -3, -15], beyond=-22)
    assert table[[90, 91, 180]].tolist() == [-15, -22, -22]


def test_the_half_power_width_of_a_table_is_that_of_its_pattern():
    beam = np.deg2rad(68)
    table = pattern_db(np.cos(np.deg2rad(DEGREES)), exponent(beam), 18.0)
    assert half_power_width(table) == pytest.approx(beam, abs=1e-4)
    assert half_power_width(np.zeros(181)) == 2 * np.pi


@pytest.mark.parametrize(
    ("angle", "level", "beyond", "message"),
    [
        ([0, 90], [0], None, "2 angles and 1 gains"),
        ([0], [0], None, "two angles at least"),
        ([0, np.nan, 180], [0, 0, 0], None, "finite"),
        ([0, 90, 90, 180], [0, -3, -4, -20], None, "must ascend, and 90 follows 90"),
        ([5, 180], [0, -20], None, "goes from 5 to 180"),
        ([0, 360], [0, -20], None, "goes from 0 to 360"),
        ([0, 180], [6, -20], None, "0 at 0°, not 6 (what boresight has is gain_dbi)"),
        ([0, 30, 180], [0, 1, -20], None, "1 dB at 30° is more: turn the antenna"),
        ([0, 90], [0, -10], None, "ends at 90°: go on to 180, or say with beyond_db"),
        ([0, 180], [0, -10], -20, "beyond_db is for a table that ends before 180°"),
        ([0, 90], [0, -10], 3, "beyond_db must be 0 or less, is 3"),
    ],
)
def test_what_is_wrong_with_a_table_is_said(angle, level, beyond, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        tabulated(angle, level, beyond)


# ---------------------------------------------------------------- tags


def test_a_dipole_has_the_pattern_of_half_a_wavelength():
    off = np.deg2rad(np.linspace(25, 155, 60))  # from the dipole's axis, outside its null
    axis = np.stack([np.cos(off), np.sin(off), np.zeros(60)], axis=1)
    ones = np.tile(frames.IDENTITY[3:], (60, 1))
    zero = np.zeros(60, int)
    got, _ = Coupling(antennas(), Tags(id=["t"], pattern=["dipole"])).at(zero, zero, ones, axis, np.tile([3.0, 0, 0], (60, 1)))
    expected = 20 * np.log10(np.cos(np.pi / 2 * np.cos(off)) / np.sin(off))
    np.testing.assert_allclose(got - 8 - HALF, expected, atol=1e-9)
    # half the power at 39° off broadside: the textbook's 78° beam
    assert np.interp(np.deg2rad(90 - 39), off, expected) == pytest.approx(-3.0, abs=0.1)


def test_along_its_own_axis_a_tag_is_nearly_deaf_and_no_more():
    for axis in ([1.0, 0, 0], [-1.0, 0, 0], [np.cos(1e-7), np.sin(1e-7), 0]):
        assert gain(antennas(), [4.0, 0, 0], "dipole", axis)[0] - 8 - HALF == pytest.approx(-NULL_DB)


@given(angles, angles, angles)
def test_a_circular_wave_does_not_care_how_a_tag_is_rolled(roll, off, way):
    k = np.array([np.cos(way), np.sin(way), 0.0])
    rolled = Rotation.from_rotvec(roll * k).apply([np.cos(off), 0, np.sin(off)])
    unrolled = gain(antennas(), k, "dipole", [np.cos(off), 0, np.sin(off)])
    np.testing.assert_allclose(gain(antennas(), k, "dipole", rolled), unrolled, atol=1e-6)


@given(angles, angles, angles)
def test_no_tag_gets_more_than_the_bound(yaw, pitch, off):
    axis = dipole_axis(frames.from_euler(yaw, pitch)[None])
    for polarisation in ("circular", "linear"):
        antenna = antennas(polarisation=[polarisation])
        assert gain(antenna, around(np.rad2deg(off)), "dipole", axis)[0] <= 8.0 - polarisation_loss(antenna)[0] + 1e-9


def test_the_dipole_of_a_tag_is_its_y_axis():
    turned = frames.from_euler(0.4, -0.9, 2.2)
    np.testing.assert_allclose(dipole_axis(turned[None])[0], frames.rotate(turned, [0.0, 1.0, 0.0]), atol=1e-12)


def test_a_tag_without_a_direction_takes_one_half_of_everything():
    ways = np.random.default_rng(1).normal(size=(50, 3))
    for polarisation in ("circular", "linear"):
        one = gain(antennas(polarisation=[polarisation]), ways)
        np.testing.assert_allclose(one, gain(antennas(), ways, axis=(0.0, 0.0, 1.0)), atol=1e-12)


# ---------------------------------------------------------------- linear antennas


@given(st.floats(0, np.pi))
def test_on_boresight_a_linear_antenna_gives_the_squared_cosine(roll):
    got = gain(antennas(polarisation=["linear"]), [2.0, 0, 0], "dipole", [0, np.sin(roll), np.cos(roll)])[0] - 8.0
    crossed = HALF - NULL_DB
    assert got == pytest.approx(max(20 * np.log10(max(abs(np.cos(roll)), 1e-9)), crossed), abs=1e-6)


@given(angles, st.floats(0.01, 3.1), angles, angles)
def test_off_boresight_its_field_is_carried_along_without_turning(around_boresight, off, yaw, pitch):
    k = np.array([np.cos(off), np.sin(off) * np.cos(around_boresight), np.sin(off) * np.sin(around_boresight)])
    carried = Rotation.from_rotvec(off * np.cross([1.0, 0, 0], k) / np.sin(off)).apply([0.0, 0, 1])
    axis = dipole_axis(frames.from_euler(yaw, pitch)[None])[0]
    along = axis @ k
    across = 1 - along**2
    power = max(
        np.cos(np.pi / 2 * along) ** 2 / max(across, 1e-9) * (carried @ axis) ** 2 / max(across, 1e-9), 10 ** ((HALF - NULL_DB) / 10)
    )
    shape = pattern_db(np.cos(off), exponent(np.pi / 2), 18.0)
    got = gain(antennas(polarisation=["linear"]), k, "dipole", axis)[0]
    assert got == pytest.approx(8.0 + shape + 10 * np.log10(power), abs=1e-4)


def test_straight_behind_nothing_breaks():
    assert np.isfinite(gain(antennas(polarisation=["linear"]), [-1.0, 0, 0], "dipole", [0.0, 0.6, 0.8])).all()
    assert np.isfinite(gain(antennas(polarisation=["linear"]), [0.0, 0, 0], "dipole")).all()  # and where there is no distance


def test_a_name_that_nobody_knows_is_refused():
    with pytest.raises(ValueError, match="'eliptical': neither linear nor circular"):
        Coupling(antennas(polarisation=["eliptical"]), Tags(id=["t"]))
    with pytest.raises(ValueError, match="'loop': neither dipole nor isotropic"):
        Coupling(antennas(), Tags(id=["t"], pattern=["loop"]))
