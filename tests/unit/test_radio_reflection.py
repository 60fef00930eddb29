"""Fresnel coefficients against textbook facts, and which faces of a hall reflect."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed import frames
from testbed.geometry import Boxes
from testbed.radio.materials import MATERIALS
from testbed.radio.reflection import DIELECTRICS, bounces, fresnel, mixed, permittivities, reflectors
from testbed.scene import Body, Scene

COSINE = np.linspace(0.001, 1, 200)


def hall(boxes, materials=("concrete", "steel")):
    """A hall of 20 m × 10 m × 5 m with boxes (low corner, high corner, material)."""
    low, high, material = zip(*boxes, strict=True)
    low, high = np.array(low, float), np.array(high, float)
    upright = np.tile(frames.IDENTITY[3:], (len(low), 1))
    made = Boxes((low + high) / 2, upright, (high - low) / 2, body=np.zeros(len(low)), material=material)
    return Scene((Body("hall", "hall", frames.IDENTITY),), made, materials, np.array([[0.0, 0, 0], [20, 10, 5]]))


def test_every_material_that_stops_waves_also_reflects_them():
    assert set(DIELECTRICS) == set(MATERIALS)
    assert np.isinf(permittivities(("steel",))[0])
    assert (permittivities(tuple(n for n in DIELECTRICS if n != "steel")).imag <= 0).all()


def test_an_unknown_material_is_answered_with_the_nearest_name():
    with pytest.raises(ValueError, match="did you mean concrete"):
        permittivities(("concret",))


@given(st.floats(1.1, 80), st.floats(0, 5))
def test_at_a_right_angle_both_parts_are_the_jump_of_the_index(real, imaginary):
    index = np.sqrt(real - 1j * imaginary)
    te, tm = fresnel(real - 1j * imaginary, 1.0)
    assert te == pytest.approx((1 - index) / (1 + index))
    assert tm == pytest.approx(-te)


@given(st.floats(1.1, 80))
def test_at_brewsters_angle_the_tm_part_is_gone(permittivity):
    cosine = 1 / np.sqrt(1 + permittivity)  # tan i = √ε
    assert abs(fresnel(permittivity, cosine)[1]) < 1e-7


@pytest.mark.parametrize("name", sorted(DIELECTRICS))
def test_nothing_reflects_more_than_it_gets_and_all_of_it_when_grazed(name):
    te, tm = fresnel(permittivities((name,)), COSINE)
    assert np.abs(te).max() <= 1 + 1e-12
    assert np.abs(tm).max() <= 1 + 1e-12
    grazed = mixed(*fresnel(permittivities((name,)), 1e-6))
    assert grazed == pytest.approx(-1.0, abs=1e-3)


def test_metal_turns_the_field_over_at_every_angle():
    np.testing.assert_allclose(mixed(*fresnel(np.inf, COSINE)), -1.0)


def test_the_mixture_has_the_mean_power_and_the_te_phase():
    te, tm = fresnel(permittivities(("concrete",)), COSINE)
    both = mixed(te, tm)
    np.testing.assert_allclose(np.abs(both) ** 2, (np.abs(te) ** 2 + np.abs(tm) ** 2) / 2)
    np.testing.assert_allclose(np.angle(both / te), 0.0, atol=1e-12)


def test_large_faces_that_look_into_the_hall_reflect_and_others_do_not():
    wall = ((0.0, 9.9, 0.0), (20.0, 10.1, 5.0), 0)
    cabinet = ((5.0, 4.0, 0.0), (7.0, 5.0, 2.0), 1)
    hidden = ((7.0, 4.0, 0.0), (9.0, 5.0, 2.0), 1)  # side by side: the faces between them can't be seen
    box = ((12.0, 2.0, 0.0), (12.6, 2.4, 0.4), 1)
    found = reflectors(hall([wall, cabinet, hidden, box]), min_area=1.5)
    by_box = {b: found.normal[found.box == b].round(9).tolist() for b in (-1, 0, 1, 2, 3)}
    assert by_box[-1] == [[0, 0, 1]]
    assert by_box[0] == [[0, -1, 0]]  # its back looks out of the hall, its ends and top are narrow
    assert sorted(by_box[1]) == [[-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 1, 0]]
    assert sorted(by_box[2]) == [[0, -1, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]]
    assert by_box[3] == []
    assert len(reflectors(hall([box]), floor=None)) == 0


def test_a_turned_box_reflects_off_its_turned_faces():
    quaternion = frames.from_euler(0.3)
    made = Boxes([[10.0, 5, 1]], [quaternion], [[0.1, 2, 1]], body=[0], material=[0])
    scene = Scene((Body("hall", "hall", frames.IDENTITY),), made, ("steel",), np.array([[0.0, 0, 0], [20, 10, 5]]))
    found = reflectors(scene, floor=None)
    assert len(found) == 2
    np.testing.assert_allclose(np.abs(found.normal @ frames.rotate(quaternion, np.array([1.0, 0, 0]))), 1.0)


def test_a_face_reflects_only_in_front_of_it_and_only_on_it():
    faces = reflectors(hall([((5.0, 4.0, 0.0), (7.0, 5.0, 2.0), 1)]), floor=None)
    start = np.array([[6.0, 1, 1], [6, 1, 1], [6, 1, 1], [3.0, 4.5, 1]])
    end = np.array([[6.5, 2, 1], [6.5, 4.5, 1], [9.5, 1, 1], [4.0, 4.5, 1.0]])
    found = bounces(start, end, faces)
    assert found.link.tolist() == [0, 3]  # the second is in front of nothing, the third would turn beside the face
    np.testing.assert_allclose(found.point[0], [6.3, 4, 1])  # 3 m and 2 m away from it: 3/5 of the way
    np.testing.assert_allclose(found.length, [np.hypot(0.5, 5.0), 3.0])
    np.testing.assert_allclose(found.coefficient, -1.0)


def test_many_paths_are_found_as_well_as_few():
    faces = reflectors(hall([((5.0, 4.0, 0.0), (7.0, 5.0, 2.0), 1)]))
    rng = np.random.default_rng(0)
    start, end = (rng.uniform([0, 0, 0.1], [20, 10, 5], (400, 3)) for _ in range(2))
    together = bounces(start, end, faces)
    alone = [bounces(start[i : i + 1], end[i : i + 1], faces) for i in range(400)]
    assert together.link.tolist() == [i for i, found in enumerate(alone) for _ in range(len(found))]
    assert np.array_equal(together.length, np.concatenate([found.length for found in alone]))
