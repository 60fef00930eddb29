"""Soft line of sight past real boxes, against the knife edge of ITU-R P.526 and against plain geometry."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes
from testbed.radio.diffraction import clearance, detour_of_nu, knife_edge, knife_edge_exact, nu_of_edge
from testbed.radio.sight import CHUNK, Obstacles, across, sight
from testbed.scene import Body, Scene
from worlds.raycast import BoxCaster

WAVELENGTH = 299_792_458 / 866.3e6
OPAQUE, CARTON = 0, 1


def caster(boxes, moving=False):
    """A caster over boxes (centre, half, quaternion, material): opaque takes 60 dB, carton 1 dB and 8 dB/m."""
    center, half, quaternion, material = zip(*boxes, strict=True)
    body = Body("thing", "thing", frames.IDENTITY, moving=moving)
    made = Boxes(center, np.array(quaternion), half, body=np.zeros(len(boxes)), material=material)
    scene = Scene((body,), made, ("opaque", "carton"), np.array([[-9, -9, -9], [9, 9, 9]]))
    return BoxCaster(scene, np.array([60.0, 1.0]), np.array([0.0, 8.0]))


def box(low, high, material=OPAQUE):
    low, high = np.asarray(low, float), np.asarray(high, float)
    return (low + high) / 2, (high - low) / 2, frames.IDENTITY[3:], material


def half_plane(roll):
    """The plane x = 0 below an edge that passes through the origin, turned by `roll` about x."""
    turn = frames.from_euler(0.0, 0.0, roll)
    return (frames.rotate(turn, np.array([0.0, 0.0, -300.0])), (0.0005, 300.0, 300.0), turn, OPAQUE), turn


def past_the_edge(turn, height, before, behind):
    """Lines from x = -before to x = +behind, the edge `height` above each of them."""
    start = np.stack([np.full_like(height, -before), np.zeros_like(height), -height], axis=1)
    end = np.stack([np.full_like(height, behind), np.zeros_like(height), -height], axis=1)
    return frames.rotate(turn, start), frames.rotate(turn, end)


@pytest.mark.parametrize("degrees", [0, 90, 180, -90, 45, 22.5, 10])
@pytest.mark.parametrize("distance", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("share", [0.1, 0.35, 0.5, 0.9])
def test_a_single_edge_is_within_two_decibels_of_the_recommendation(degrees, distance, share):
    edge, turn = half_plane(np.deg2rad(degrees))
    before, behind = share * distance, (1 - share) * distance
    nu = np.linspace(-1.0, 3.0, 81)
    height = np.sign(nu) * clearance(nu, before, distance, WAVELENGTH)
    np.testing.assert_allclose(nu_of_edge(height, before, behind, WAVELENGTH), nu, atol=1e-9)
    seen = sight(*past_the_edge(turn, height, before, behind), WAVELENGTH, Obstacles(caster([edge])))
    np.testing.assert_allclose(seen.loss, knife_edge_exact(nu), atol=2.0)
    off_by = 0.15 if degrees % 45 == 0 else 0.75  # an edge between two directions is found a little farther out
    beyond_the_zone = nu < -0.7
    np.testing.assert_allclose(seen.loss[~beyond_the_zone], knife_edge(nu[~beyond_the_zone]), atol=off_by)


def test_an_edge_close_to_an_end_is_found_as_well():
    edge, turn = half_plane(0.0)
    nu = np.linspace(-1.0, 3.0, 81)
    before, behind = 0.16, 7.84
    height = np.sign(nu) * clearance(nu, before, 8.0, WAVELENGTH)
    seen = sight(*past_the_edge(turn, height, before, behind), WAVELENGTH, Obstacles(caster([edge])))
    np.testing.assert_allclose(seen.loss, knife_edge_exact(nu), atol=2.0)


def test_with_small_angles_the_textbook_formula_for_nu_does_as_well():
    edge, turn = half_plane(np.pi / 2)
    nu = np.linspace(-1.0, 3.0, 81)
    seen = sight(*past_the_edge(turn, nu / np.sqrt(2 / WAVELENGTH * (1 / 5 + 1 / 7)), 5.0, 7.0), WAVELENGTH, Obstacles(caster([edge])))
    np.testing.assert_allclose(seen.loss, knife_edge_exact(nu), atol=2.0)


def test_beyond_the_search_the_obstacle_itself_is_what_is_left():
    edge, turn = half_plane(0.0)
    seen = sight(*past_the_edge(turn, np.array([4.0]), 2.0, 2.0), WAVELENGTH, Obstacles(caster([edge])))
    assert seen.loss[0] == 60.0
    assert seen.detour[0] == 0.0
    assert seen.clear[0] == pytest.approx(1e-6)


def test_half_of_the_zone_is_clear_where_the_edge_is_in_the_line():
    edge, turn = half_plane(0.0)
    height = np.array([-1.0, -1e-6, 1e-6, 1.0])
    seen = sight(*past_the_edge(turn, height, 3.0, 3.0), WAVELENGTH, Obstacles(caster([edge])))
    assert seen.clear[0] == 1.0
    assert seen.clear[1] == pytest.approx(0.5, abs=0.15)
    assert seen.clear[2] == pytest.approx(0.5, abs=0.15)
    assert seen.clear[3] < 1e-5
    assert seen.count.tolist() == [0, 0, 1, 1]


def test_the_clear_share_is_that_of_a_disc_cut_by_an_edge():
    edge, turn = half_plane(0.0)
    rim = clearance(np.sqrt(2) * 0.6, 3.0, 6.0, WAVELENGTH)
    cut = np.linspace(-1.2, 1.2, 49)  # of the disc's radius; positive: the edge stands beyond the line
    seen = sight(*past_the_edge(turn, rim * cut, 3.0, 3.0), WAVELENGTH, Obstacles(caster([edge])))
    x = np.clip(cut, -1, 1)
    np.testing.assert_allclose(seen.clear, (np.arccos(x) - x * np.sqrt(1 - x * x)) / np.pi, atol=0.16)
    assert (np.diff(seen.clear) < 0.02).all()  # more edge is less sky, but for the grain of the search


def test_a_thing_that_takes_little_never_costs_more_than_it_takes():
    wall = box((-0.15, -4, -4), (0.15, 0.0, 4), CARTON)  # 1 + 8 · 0.3 = 3.4 dB
    y = np.linspace(-2, 2, 81)
    start, end = (np.stack([np.full_like(y, x), y, np.zeros_like(y)], axis=1) for x in (-3.0, 3.0))
    seen = sight(start, end, WAVELENGTH, Obstacles(caster([wall])))
    np.testing.assert_allclose(seen.loss[y < -0.05], 3.4)
    assert seen.loss.max() < 3.6  # a ray at the rim goes through a little aslant
    assert (np.diff(seen.loss) <= 0.2).all()
    assert seen.loss[y > 0].max() > 2.0  # its edge is felt from outside
    assert (seen.loss[y > 1.0] == 0).all()
    assert seen.detour.max() == 0.0


def test_a_thick_thing_is_gone_round_at_a_point_that_clears_both_of_its_corners():
    slab = box((-1.0, -9, -9), (1.0, 0.0, 9))
    depth = 0.3
    seen = sight(np.array([[-3.0, -depth, 0]]), np.array([[3.0, -depth, 0]]), WAVELENGTH, Obstacles(caster([slab])))
    over_both = nu_of_edge(depth * 3.0 / 2.0, 3.0, 3.0, WAVELENGTH)  # tangents over the corners meet above the middle
    assert seen.loss[0] == pytest.approx(knife_edge(over_both), abs=0.3)
    assert seen.detour[0] == pytest.approx(detour_of_nu(over_both, WAVELENGTH), rel=0.05)


def test_a_way_round_may_lead_through_something_that_takes_little():
    steel = box((-0.01, -9, -9), (0.01, 0.2, 9))
    carton = box((1.0, -9, -9), (1.2, 9, 9), CARTON)  # 2.6 dB, everywhere
    start, end = np.array([[-3.0, 0, 0]]), np.array([[3.0, 0, 0]])
    both = sight(start, end, WAVELENGTH, Obstacles(caster([steel, carton]))).loss[0]
    alone = sight(start, end, WAVELENGTH, Obstacles(caster([steel]))).loss[0]
    # the bend clears the steel from the middle of both things, so it is a little farther out than alone
    assert alone + 2.4 < both < alone + 2.6 + 1.5


def test_of_two_edges_the_nearer_way_round_is_taken():
    post = box((-0.01, -0.5, -9), (0.01, 0.2, 9))
    seen = sight(np.array([[-3.0, 0, 0]]), np.array([[3.0, 0, 0]]), WAVELENGTH, Obstacles(caster([post])))
    assert seen.loss[0] == pytest.approx(knife_edge(nu_of_edge(0.2, 3.0, 3.0, WAVELENGTH)), abs=0.2)


def test_moving_bodies_are_met_at_their_instants_and_only_where_they_come_near():
    cast = caster([box((-0.01, -0.5, -0.5), (0.01, 0.5, 0.5))], moving=True)
    away = np.array([0.0, 50.0, 0.0, 1, 0, 0, 0])
    poses = np.stack([frames.IDENTITY, away])[:, None]
    start, end = np.tile([[-3.0, 0, 0]], (3, 1)), np.tile([[3.0, 0, 0]], (3, 1))
    seen = sight(start, end, WAVELENGTH, Obstacles(cast, poses, np.array([0, 1, 0]), np.array([True, True, False])))
    assert seen.loss[0] == pytest.approx(knife_edge(nu_of_edge(0.5, 3.0, 3.0, WAVELENGTH)), abs=0.2)
    assert seen.loss[1:].tolist() == [0.0, 0.0]
    assert seen.count.tolist() == [1, 0, 0]


def test_what_is_worth_nothing_is_not_searched_and_what_is_stays_the_same(monkeypatch):
    edge, turn = half_plane(0.0)
    nu = np.linspace(-1.0, 3.0, 41)
    lines = past_the_edge(turn, np.sign(nu) * clearance(nu, 3.0, 6.0, WAVELENGTH), 3.0, 3.0)
    obstacles = Obstacles(caster([edge]))
    whole = sight(*lines, WAVELENGTH, obstacles)
    limited = sight(*lines, WAVELENGTH, obstacles, np.full(len(nu), 12.0))
    near = whole.loss <= 12.0
    assert np.array_equal(limited.loss[near], whole.loss[near])
    assert np.array_equal(limited.clear[near], whole.clear[near])
    assert (limited.loss[~near] > 12.0).all()
    monkeypatch.setattr("testbed.radio.sight.CHUNK", 7)
    assert sight(*lines, WAVELENGTH, obstacles).equals(whole)
    assert len(nu) < CHUNK


def test_directions_are_unit_vectors_across_the_axis_the_first_level_the_third_upright():
    axis = frames.normalise(np.array([[1.0, 2, 0.5], [0, 0, 1], [-3, 0, 0.0]]))
    out = across(axis)
    np.testing.assert_allclose(np.linalg.norm(out, axis=2), 1.0)
    np.testing.assert_allclose(np.einsum("ndi,ni->nd", out, axis), 0.0, atol=1e-12)
    np.testing.assert_allclose(out[:, 0, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(out[2, 2], [0, 0, 1], atol=1e-12)


def test_nothing_is_not_looked_at():
    empty = sight(np.zeros((0, 3)), np.zeros((0, 3)), WAVELENGTH, Obstacles(caster([box((0, 0, 0), (1, 1, 1))])))
    assert len(empty) == 0
