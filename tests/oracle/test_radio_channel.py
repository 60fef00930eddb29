"""The channel as a whole against closed forms: Friis, two rays over a floor, three walls by hand, and a rack that is driven past."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes
from testbed.radio.channel import Channel, Fixed
from testbed.radio.diffraction import knife_edge, nu_of_edge
from testbed.radio.links import Ends
from testbed.radio.materials import losses
from testbed.radio.propagation import phase_of, power_at_reader, power_at_tag
from testbed.radio.setting import ChannelConfig, Radio
from testbed.scene import Body, Scene, Truth
from testbed.types import Antennas, Tags
from testbed.units import SPEED_OF_LIGHT, wrap
from worlds.raycast import BoxCaster

FREQUENCIES = np.array([865.7e6, 867.5e6])
MATERIALS = ("concrete", "steel", "wood")
QUIET = {"diffuse": False, "orders": 0}
POLARISATION_DB = 10 * np.log10(2)  # a circular wave on a linear tag
ONE_WAY_DB = 6.0 + 2.0 - POLARISATION_DB  # antenna, tag


def answer(places, config=None, boxes=(), antenna=(0.0, 0.0, 1.5), still=True, turned=None):
    """h and all that goes with it of one antenna and tags at `places` (N, 3), on the first carrier.

    boxes: (low, high, material) in a hall of 60 m to each side. Where not `still`, the tag moves along `places`, one a second.
    Tags are the same all round; with `turned`, a quaternion, they are dipoles that hang like that.
    """
    places = np.atleast_2d(np.asarray(places, dtype=float))
    n = len(places) if still else 1
    scene = hall(boxes, moving=not still)
    caster = BoxCaster(scene, *losses(scene.materials))
    looks = np.concatenate([antenna, frames.IDENTITY[3:]])
    antennas = Antennas(
        id=["a"], position=[antenna], quaternion=[looks[3:]], gain=[6.0], beamwidth=[np.pi / 2], front_to_back=[18.0], power=[29.0]
    )
    tags = Tags(id=[f"tag{i}" for i in range(n)], gain=np.full(n, 2.0), sensitivity=np.full(n, -19.5))
    tags = tags.with_(pattern=np.full(n, "isotropic" if turned is None else "dipole"))
    upright = np.tile(frames.IDENTITY[3:] if turned is None else turned, (n, 1))
    far = Ends(np.full(n, -1), np.hstack([places, upright])) if still else Ends(np.array([0]), frames.IDENTITY[None])
    radio = Radio(
        ChannelConfig(**(QUIET if config is None else config)),
        scene, caster, antennas, Ends(np.array([-1]), looks[None]), tags, far, FREQUENCIES, limit=False,
    )  # fmt: skip
    t = np.arange(len(places), dtype=float)
    truth = Truth(t=t[:1], poses=np.zeros((1, 0, 7)), bodies=())
    if not still:
        poses = np.concatenate([places, np.tile(frames.IDENTITY[3:], (len(places), 1))], axis=1)[:, None]
        truth = Truth(t=t, poses=poses, bodies=("carrier",))
    channel = Channel(radio, Fixed(radio), truth, 1, 0)
    tag = np.arange(n) if still else np.zeros(len(places), dtype=int)
    when = np.zeros(n) if still else t
    return channel.respond(np.zeros(len(tag), dtype=int), tag, when, np.zeros(len(tag), dtype=int))


def hall(boxes, moving):
    bodies = [Body("hall", "hall", frames.IDENTITY)] + [Body("carrier", "trolley", frames.IDENTITY, moving=True)] * moving
    if not boxes:
        made = Boxes.empty()
    else:
        low, high, material = (np.array(x, dtype=float) for x in zip(*boxes, strict=True))
        upright = np.tile(frames.IDENTITY[3:], (len(low), 1))
        made = Boxes((low + high) / 2, upright, (high - low) / 2, body=np.zeros(len(low)), material=material)
    return Scene(tuple(bodies), made, MATERIALS, np.array([[-60.0, -60, 0], [60, 60, 8]]))


def gain_towards(antenna, point, axis=(1.0, 0.0, 0.0)):
    """dBi, by hand: cos^n with half the power at 45°, 18 dB behind."""
    way = np.asarray(point, dtype=float) - antenna
    cosine = (way @ np.asarray(axis)) / np.linalg.norm(way, axis=-1)
    n = np.log(0.5) / np.log(np.cos(np.pi / 4))
    lobe = 10 * n * np.log10(np.maximum(cosine, 1e-9))
    return 6.0 + np.maximum(lobe, -18.0) + 2.0 - POLARISATION_DB


def ray(length, gain_db, coefficient=1.0):
    """One path by Friis: amplitude and phase."""
    wavelength = SPEED_OF_LIGHT / FREQUENCIES[0]
    return coefficient * wavelength / (4 * np.pi * length) * 10 ** (gain_db / 20) * np.exp(-2j * np.pi * length / wavelength)


def gamma(permittivity, cosine):
    """Fresnel's equations for a linear tag in a circular wave, written out again."""
    root = np.sqrt(permittivity - 1 + cosine**2)
    te, tm = (cosine - root) / (cosine + root), (permittivity * cosine - root) / (permittivity * cosine + root)
    return np.sqrt((abs(te) ** 2 + abs(tm) ** 2) / 2) * te / abs(te)


CONCRETE = 5.24 - 1j * 0.0462 * 0.87**0.7822 / (2 * np.pi * 0.87e9 * 8.8541878188e-12)
WOOD = 1.99 - 1j * 0.0047 * 0.87**1.0718 / (2 * np.pi * 0.87e9 * 8.8541878188e-12)


def test_friis():
    d = np.geomspace(0.2, 100, 50)
    places = np.stack([d, np.zeros_like(d), np.full_like(d, 1.5)], axis=1)
    expected = 10 ** (ONE_WAY_DB / 10) * (SPEED_OF_LIGHT / FREQUENCIES[0] / (4 * np.pi * d)) ** 2
    np.testing.assert_allclose(np.abs(answer(places).h) ** 2, expected, rtol=1e-9)


@pytest.mark.parametrize("height", [0.3, 1.0, 2.2])
def test_two_rays_over_a_floor(height):
    x = np.linspace(0.5, 40, 400)
    places = np.stack([x, np.zeros_like(x), np.full_like(x, height)], axis=1)
    antenna = np.array([0.0, 0.0, 1.5])
    h = answer(places, {"diffuse": False, "orders": 1}).h
    image = places * [1, 1, -1]
    length = np.linalg.norm(image - antenna, axis=1)
    expected = ray(np.linalg.norm(places - antenna, axis=1), gain_towards(antenna, places))
    expected += ray(length, gain_towards(antenna, image), gamma(CONCRETE, (1.5 + height) / length))
    assert np.abs(h / expected - 1).max() < 1e-6
    # closed in magnitude and in phase each, as engineers write it
    np.testing.assert_allclose(np.abs(h), np.abs(expected), rtol=1e-6)
    np.testing.assert_allclose(wrap(np.angle(h) - np.angle(expected)), 0.0, atol=1e-6)


def test_the_floor_makes_rssi_rise_somewhere_while_the_tag_goes_away():
    feet = np.array([1.0, 3.0, 5.0, 7.0]) * 0.3048
    falls = []
    for height in np.arange(0.3, 2.0, 0.1):
        places = np.stack([feet, np.zeros(4), np.full(4, height)], axis=1)
        received = power_at_reader(answer(places, {"diffuse": False}, antenna=(0.0, 0.0, 1.0)).h, 29.0, 8.0)
        falls.append(np.diff(received).max())
    assert max(falls) >= 1.0


def test_three_walls_by_hand():
    # concrete at y = 3, steel at x = 8, wood at y = -4; no floor; the tag's images by mirrored coordinates
    walls = [((-5, 3, -3), (8, 3.2, 7), 0), ((8, -4, -3), (8.2, 3, 7), 1), ((-5, -4.2, -3), (8, -4, 7), 2)]
    places = np.array([[4.0, 1.0, 1.2], [6.5, -2.0, 2.0], [2.0, 0.0, 0.4]])
    antenna = np.array([0.0, 0.0, 1.5])
    config = {"diffuse": False, "orders": 1, "floor": None, "edges": False}
    h = answer(places, config, walls).h
    for place, got in zip(places, h, strict=True):
        x, y, z = place
        expected = ray(np.linalg.norm(place - antenna), gain_towards(antenna, place))
        for image, permittivity, across in (((x, 6 - y, z), CONCRETE, 1), ((16 - x, y, z), None, 0), ((x, -8 - y, z), WOOD, 1)):
            way = np.array(image) - antenna
            length = np.linalg.norm(way)
            coefficient = -1.0 if permittivity is None else gamma(permittivity, abs(way[across]) / length)
            expected += ray(length, gain_towards(antenna, image), coefficient)
        assert abs(got / expected - 1) < 1e-6


def test_each_path_meets_a_dipole_from_its_own_direction():
    # the last leg of each path, walked by hand from the wall to the tag, against the dipole's own axis
    walls = [((-5, 3, -3), (8, 3.2, 7), 1), ((8, -4, -3), (8.2, 3, 7), 1)]
    antenna, place, turned = np.array([0.0, 0.0, 1.5]), np.array([4.0, 1.0, 1.2]), frames.from_euler(0.5, 0.3, 0.9)
    h = answer(place, {"diffuse": False, "orders": 1, "floor": None, "edges": False}, walls, turned=turned).h[0]
    x, y, z = place
    expected, across, dipole = 0j, [], frames.rotate(turned, [0.0, 1.0, 0.0])
    for image, plane, coefficient in ((place, None, 1.0), ((x, 6 - y, z), (1, 3.0), -1.0), ((16 - x, y, z), (0, 8.0), -1.0)):
        way = np.array(image) - antenna
        turn = antenna if plane is None else antenna + way * (plane[1] - antenna[plane[0]]) / way[plane[0]]
        leg = (place - turn) / np.linalg.norm(place - turn)
        across.append(np.sqrt(1 - (leg @ dipole) ** 2))
        pattern = np.cos(np.pi / 2 * (leg @ dipole)) / across[-1]
        expected += ray(np.linalg.norm(way), gain_towards(antenna, image) + 20 * np.log10(pattern), coefficient)
    assert abs(h / expected - 1) < 1e-6
    assert np.ptp(across) > 0.1


def test_a_tag_that_points_at_the_antenna_is_fifteen_decibels_down():
    ahead, away = (answer([[5.0, 0, 1.5]], turned=frames.from_euler(yaw)).h[0] for yaw in (0.0, np.pi / 2))
    assert 20 * np.log10(abs(away / ahead)) == pytest.approx(-15.0)
    assert np.angle(away) == pytest.approx(np.angle(ahead))


def test_a_thing_on_a_leg_takes_from_that_reflection_alone():
    wall, beside = ((-5, 3, -3), (9, 3.2, 7), 0), ((1.9, 1.4, 0), (2.1, 1.6, 3), 1)
    leg = ((0.9, 1.4, 0), (1.1, 1.6, 3), 1)  # the path turns at (2, 3): half-way there it is at (1, 1.5)
    place = np.array([[4.0, 0.0, 1.5]])
    config = {"diffuse": False, "orders": 1, "floor": None, "edges": False}
    direct = answer(place).h[0]
    free, missed, hit = (answer(place, config, boxes).h[0] for boxes in ([wall], [wall, beside], [wall, leg]))
    np.testing.assert_allclose(missed, free, rtol=1e-12)
    np.testing.assert_allclose(hit - direct, (free - direct) * 10 ** (-40 / 20), rtol=1e-6)


def test_phase_gives_back_a_change_of_range_to_a_tenth_of_a_millimetre():
    x = np.linspace(2.0, 3.0, 1001)
    places = np.stack([x, 0.4 * np.ones_like(x), np.full_like(x, 1.1)], axis=1)
    h = answer(places, still=False).h
    distance = np.linalg.norm(places - [0.0, 0.0, 1.5], axis=1)
    moved = -np.unwrap(phase_of(h)) * SPEED_OF_LIGHT / (4 * np.pi * FREQUENCIES[0])
    np.testing.assert_allclose(moved - moved[0], distance - distance[0], atol=1e-7)


def test_margin_rssi_and_phase_are_those_of_one_h():
    places = np.random.default_rng(4).uniform([1, -3, 0.2], [8, 3, 3], (50, 3))
    got = answer(places, {})
    forward = power_at_tag(got.h, 29.0) - 29.0
    np.testing.assert_allclose(power_at_reader(got.h, 29.0, 8.0), 29.0 + 2 * forward - 8.0)
    np.testing.assert_allclose(np.exp(1j * phase_of(got.h)), (got.h / np.abs(got.h)) ** 2)


def test_a_tag_driven_past_a_metal_rack_is_lost_and_found_when_geometry_says():
    # a steel cabinet, 2 m long, 3 m from the antenna; the tag passes 2 m behind it: its shadow there is 10/3 m long
    cabinet = ((3.0, -1.0, 0.0), (3.001, 1.0, 4.0), 1)
    y = np.arange(-4.0, 4.0001, 0.02)
    places = np.stack([np.full_like(y, 5.0), y, np.full_like(y, 1.5)], axis=1)
    got = answer(places, QUIET, [cabinet], still=False)
    free = answer(places, QUIET, still=False)
    edge = 5.0 / 3.0
    assert np.array_equal(got.count > 0, np.abs(y) < edge)
    lost = 20 * np.log10(np.abs(free.h) / np.abs(got.h))
    np.testing.assert_allclose(lost, got.loss, atol=1e-9)
    nu = np.array([nu_of_edge(*_past(place), SPEED_OF_LIGHT / FREQUENCIES.mean()) for place in places])
    near = np.abs(nu) < 2.5
    np.testing.assert_allclose(got.loss[near & (np.abs(y) > 0.4)], knife_edge(nu[near & (np.abs(y) > 0.4)]), atol=1.0)
    clear = nu < -0.9
    assert np.array_equal(got.h[clear], free.h[clear])  # phase and level are untouched in the open
    assert (got.clear[clear] == 1).all()
    assert (got.clear[np.abs(y) < 0.5] < 0.01).all()
    phase = wrap(phase_of(got.h) - phase_of(free.h))
    assert np.abs(phase[clear]).max() == 0.0
    shadow = (nu > 0.2) & (nu < 1.5)  # round the edge the way is ν² λ/4 longer, and twice that there and back
    np.testing.assert_allclose(wrap(phase[shadow] + np.pi * nu[shadow] ** 2), 0.0, atol=0.5)


def _past(place):
    """Height of the cabinet's nearer edge (3, ±1) across the line from (0, 0) to the tag, and the distances along it."""
    way = place[:2] / np.linalg.norm(place[:2])
    edge = np.array([3.0, np.sign(place[1])])
    before = edge @ way
    across = np.sign(place[1]) * (way[0] * edge[1] - way[1] * edge[0])
    return across, before, np.linalg.norm(place[:2]) - before
