"""The channel against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed import frames
from testbed.radio import materials
from testbed.radio.antenna import exponent, off_boresight
from testbed.radio.propagation import direct_path, phase_of, power_at_reader, power_at_tag
from testbed.radio.regions import REGIONS
from testbed.radio.tags import tag_model
from testbed.units import SPEED_OF_LIGHT, wrap

F = 866.3e6


@given(st.floats(0.1, 100), st.floats(-20, 20))
def test_friis(distance, gain):
    h = direct_path(distance, F, gain, 0.0)
    expected = 10 ** (gain / 10) * (SPEED_OF_LIGHT / F / (4 * np.pi * distance)) ** 2
    np.testing.assert_allclose(abs(h) ** 2, expected, rtol=1e-9)


@given(st.floats(0.1, 100), st.floats(0, 60))
def test_rssi_phase_and_forward_power_come_from_one_channel(distance, loss):
    h = direct_path(distance, F, 5.0, loss)
    forward = power_at_tag(h, 29.0) - 29.0
    np.testing.assert_allclose(power_at_reader(h, 29.0, 8.0), 29.0 + 2 * forward - 8.0, atol=1e-9)
    np.testing.assert_allclose(wrap(phase_of(h) + 4 * np.pi * F * distance / SPEED_OF_LIGHT), 0.0, atol=1e-8)


def test_phase_gives_back_a_change_of_range_to_a_tenth_of_a_millimetre():
    d = np.linspace(2.0, 3.0, 1001)  # 1 mm steps, far below λ/4
    unwrapped = np.unwrap(phase_of(direct_path(d, F, 0.0, 0.0)))
    moved = -(unwrapped - unwrapped[0]) * SPEED_OF_LIGHT / (4 * np.pi * F)
    np.testing.assert_allclose(moved, d - d[0], atol=1e-4)


def test_an_obstacle_costs_its_decibels_once_forward_and_twice_in_rssi():
    free, behind = direct_path(5.0, F, 0.0, 0.0), direct_path(5.0, F, 0.0, 7.0)
    np.testing.assert_allclose(power_at_tag(free, 0) - power_at_tag(behind, 0), 7.0)
    np.testing.assert_allclose(power_at_reader(free, 0, 8) - power_at_reader(behind, 0, 8), 14.0)


@given(st.floats(20, 150))
def test_half_the_beam_width_off_boresight_half_the_power_is_left(degrees):
    beam = np.deg2rad(degrees)
    np.testing.assert_allclose(np.cos(beam / 2) ** exponent(beam), 0.5, atol=1e-9)


def test_an_antenna_looks_along_its_own_x():
    q = frames.from_euler(np.pi / 2)  # towards +y
    cosine, distance = off_boresight(q, np.array([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    np.testing.assert_allclose(cosine, [1, 0, -1], atol=1e-12)
    np.testing.assert_allclose(distance, [2, 3, 1])


def test_losses_of_materials_are_in_the_ranges_that_they_are_sourced_from():
    def over(name, metres):
        entry, per_metre = materials.losses((name,))
        return float(entry[0] + per_metre[0] * metres)

    assert over("steel", 0.002) >= 35
    assert 20 <= over("rack_bay", 1.1) <= 30
    assert 3 <= over("carton", 0.3) <= over("carton", 0.6) <= 6
    assert 8 <= over("person", 0.2) <= over("person", 0.4) <= 15
    assert 20 <= over("liquid_pallet", 1.0) <= 30
    assert 5 < over("concrete", 0.2) < 10  # ITU-R P.2040: 7.4 dB for 20 cm at 870 MHz


def test_an_unknown_material_or_tag_is_answered_with_the_nearest_name():
    with pytest.raises(ValueError, match="did you mean steel"):
        materials.losses(("steal",))
    with pytest.raises(ValueError, match="did you mean monza_4"):
        tag_model("monza4")


def test_the_hop_tables_of_the_regions():
    assert np.allclose(REGIONS["etsi"].carriers, [865.7e6, 866.3e6, 866.9e6, 867.5e6])
    fcc = REGIONS["fcc"].carriers
    assert (len(fcc), fcc[0], fcc[-1]) == (50, 902.75e6, 927.25e6)
