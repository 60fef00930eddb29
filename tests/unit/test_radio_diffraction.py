"""Knife edges: the approximation against the Fresnel integrals, and the geometry of ν against the ellipse's definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from testbed.radio.diffraction import (
    CLEAR_OF_ZONE,
    clearance,
    detour_of_nu,
    knife_edge,
    knife_edge_exact,
    loss_to_nu,
    nu_of_detour,
    nu_of_edge,
)

WAVELENGTH = 0.3461


def test_the_exact_form_is_the_diffraction_integral_by_quadrature():
    for nu in (-1.0, 0.0, 0.7, 2.5):
        # ∫_ν^∞ exp(-jπt²/2) dt = (1 - j)/2 - ∫_0^ν, over the whole line's value |1 - j|
        real = quad(lambda t: np.cos(np.pi * t * t / 2), 0, nu)[0]
        imaginary = quad(lambda t: -np.sin(np.pi * t * t / 2), 0, nu)[0]
        field = abs((0.5 - 0.5j) - (real + 1j * imaginary)) / np.sqrt(2)
        assert knife_edge_exact(nu) == pytest.approx(-20 * np.log10(field), abs=1e-9)


def test_the_approximation_is_close_to_it_where_it_is_meant_to_hold():
    nu = np.linspace(-0.7, 6.0, 1000)
    np.testing.assert_allclose(knife_edge(nu), knife_edge_exact(nu), atol=0.13)


def test_figures_that_every_engineer_knows():
    assert knife_edge(0.0) == pytest.approx(6.03, abs=0.01)
    assert knife_edge_exact(0.0) == pytest.approx(20 * np.log10(2), abs=1e-12)
    assert knife_edge(0.5) == pytest.approx(10.3, abs=0.05)
    assert knife_edge(1.0) == pytest.approx(13.9, abs=0.05)
    assert (knife_edge(np.array([-5.0, -0.79, -0.78])) == 0).all()


@given(st.floats(-0.7, 8))
def test_a_loss_tells_its_nu(nu):
    assert loss_to_nu(knife_edge(nu)) == pytest.approx(nu, abs=1e-9)


@given(st.floats(0, 10), st.floats(0.05, 1))
def test_a_detour_tells_its_nu(nu, wavelength):
    assert nu_of_detour(detour_of_nu(nu, wavelength), wavelength) == pytest.approx(nu, abs=1e-12)


@given(st.floats(1, 30), st.floats(0.1, 0.9), st.floats(0.01, 0.3))
def test_a_low_edge_has_the_nu_of_the_recommendation(distance, share, height):
    before, behind = share * distance, (1 - share) * distance
    height = height * min(before, behind) / 3  # a tenth of the nearer end's distance at the most
    textbook = height * np.sqrt(2 / WAVELENGTH * (1 / before + 1 / behind))
    assert nu_of_edge(height, before, behind, WAVELENGTH) == pytest.approx(textbook, rel=5e-3)
    assert nu_of_edge(-height, before, behind, WAVELENGTH) == pytest.approx(-textbook, rel=5e-3)


@given(st.floats(0.1, 4), st.floats(0.3, 30), st.floats(0, 1))
def test_the_rim_is_where_the_way_there_is_longer_by_the_detour(nu, distance, share):
    along = share * distance
    off = clearance(nu, along, distance, WAVELENGTH)
    detour = np.hypot(along, off) + np.hypot(distance - along, off) - distance
    assert detour == pytest.approx(nu**2 * WAVELENGTH / 4, rel=1e-9, abs=1e-12)


def test_the_zone_that_must_be_clear_is_six_tenths_of_the_first_zones_radius():
    first = np.sqrt(WAVELENGTH * 5 * 5 / 10)  # √(λ d1 d2 / d)
    assert clearance(CLEAR_OF_ZONE, 5.0, 10.0, WAVELENGTH) == pytest.approx(0.6 * first, rel=0.01)
