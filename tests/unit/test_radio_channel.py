"""What the channel promises of moving bodies, of time that stands still, and of who is asked and how."""

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Boxes
from testbed.radio.channel import Channel, Fixed
from testbed.radio.links import Ends
from testbed.radio.materials import losses
from testbed.radio.propagation import power_at_tag
from testbed.radio.setting import ChannelConfig, Radio
from testbed.scene import WORLD, Body, Scene, Truth
from testbed.types import Antennas, Tags
from worlds.raycast import BoxCaster

FREQUENCIES = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])
BOUNDS = np.array([[-15.0, -10, 0], [15, 10, 6]])


class Hall:
    """Racks and a wall; a cart with two tags and an antenna that drives along y = 0, and a forklift that crosses later."""

    def __init__(self, config=None, limit=True, tags=40, seed=1, racks=True):
        rng = np.random.default_rng(seed)
        boxes = [((x, y, 0.0), (x + 2.5, y + 1.0, 2.5), 0, 0) for x in (-9, -5, 3, 7) for y in (-4.0, 3.0)] * racks
        boxes += [((-15.0, 9.8, 0.0), (15.0, 10.0, 6.0), 1, 0)]
        boxes += [((-0.4, -0.35, 0.2), (0.4, 0.35, 1.5), 0, 1), ((-1.0, -0.5, 0.3), (1.0, 0.5, 2.0), 0, 2)]
        low, high, material, body = (np.array(x) for x in zip(*boxes, strict=True))
        made = Boxes((low + high) / 2, np.tile(frames.IDENTITY[3:], (len(low), 1)), (high - low) / 2, body=body, material=material)
        bodies = tuple(Body(name, name, frames.IDENTITY, moving) for name, moving in (("hall", False), ("cart", True), ("fork", True)))
        self.scene = Scene(bodies, made, ("steel", "concrete"), BOUNDS)
        n = tags + 2
        place = rng.uniform([-12, -9, 0.3], [12, 9, 2.5], (tags, 3))
        far = np.vstack([np.hstack([place, np.tile(frames.IDENTITY[3:], (tags, 1))]), _at(0.42, 0, 1), _at(0, 0.37, 1)])
        self.far = Ends(np.array([WORLD] * tags + [0, 0]), far)
        near = np.array([_at(-11, 0, 2.5), _at(0, -8, 3.0, np.pi / 2), _at(0.5, 0, 1.2), _at(11, 2, 2.0, np.pi)])
        self.near = Ends(np.array([WORLD, WORLD, 0, WORLD]), near)
        antennas = Antennas(
            id=list("abcd"), position=near[:, :3], quaternion=near[:, 3:], gain=np.full(4, 6.0), beamwidth=np.full(4, 1.2),
            front_to_back=np.full(4, 18.0), power=np.full(4, 29.0),
        )  # fmt: skip
        made_of = Tags(id=[f"t{i}" for i in range(n)], gain=np.full(n, 2.0), sensitivity=np.full(n, -19.5))
        caster = BoxCaster(self.scene, *losses(self.scene.materials))
        self.radio = Radio(ChannelConfig(**(config or {})), self.scene, caster, antennas, self.near, made_of, self.far, FREQUENCIES, limit)
        self.fixed = Fixed(self.radio)

    def channel(self, cart=None, fork=None, trial=0, seconds=10.0):
        """The channel while cart and forklift stand at or drive between given places, ((x, y), (x, y))."""
        t = np.arange(0, seconds + 1e-9, 1 / 60)
        poses = np.zeros((len(t), 2, 7))
        for body, way in enumerate((cart or ((0, -20), (0, -20)), fork or ((0, -40), (0, -40)))):
            poses[:, body, :2] = np.asarray(way[0]) + (t / seconds)[:, None] * (np.asarray(way[1]) - way[0])
        poses[..., 3] = 1.0
        return Channel(self.radio, self.fixed, Truth(t=t, poses=poses, bodies=("cart", "fork")), 5, trial)


def _at(x, y, z, yaw=0.0):
    return np.concatenate([[x, y, z], frames.from_euler(yaw)])


@pytest.fixture(scope="module")
def hall():
    return Hall()


def everyone(hall, t):
    """All links at time t: antenna, tag, t, carrier."""
    a, k = (x.ravel() for x in np.meshgrid(np.arange(4), np.arange(len(hall.far.body)), indexing="ij"))
    return a, k, np.full(len(a), t), np.zeros(len(a), dtype=int)


def test_nobody_who_can_be_heard_is_left_out_of_the_candidates(hall):
    whole = Hall(limit=False)
    for t in (0.0, 3.3, 7.7):
        way = {"cart": ((-9, 0), (9, 0)), "fork": ((-1, -8), (2, 9))}
        a, k, when, carrier = everyone(hall, t)
        power = power_at_tag(whole.channel(**way).respond(a, k, when, carrier).h, 29.0)
        place, tag = hall.channel(**way).candidates(np.arange(4), np.full(4, t))
        listed = set(zip(place.tolist(), tag.tolist(), strict=True))
        heard = {(int(i), int(j)) for i, j in zip(a[power >= -19.5], k[power >= -19.5], strict=True)}
        assert len(heard) > 15
        assert heard <= listed
        assert len(listed) < len(a)


def test_limits_of_the_search_change_nothing_for_those_who_can_be_heard(hall):
    way = {"cart": ((-9, 0), (9, 0)), "fork": ((-1, -8), (2, 9))}
    a, k, when, carrier = everyone(hall, 4.2)
    limited = hall.channel(**way).respond(a, k, when, carrier)
    whole = Hall(limit=False).channel(**way).respond(a, k, when, carrier)
    power, short = power_at_tag(whole.h, 29.0), power_at_tag(limited.h, 29.0)
    heard = power >= -19.5
    assert heard.sum() > 15
    np.testing.assert_allclose(short[heard], power[heard], atol=1.5)  # faint reflections are left out
    assert (short[power < -21.0] < -19.5).all()


def test_an_answer_depends_on_its_own_link_and_instant_alone(hall):
    channel = hall.channel(cart=((-9, 0), (9, 0)), fork=((-1, -8), (2, 9)))
    rng = np.random.default_rng(0)
    a, k, t = rng.integers(0, 4, 300), rng.integers(0, 42, 300), rng.uniform(0, 10, 300)
    carrier = rng.integers(0, 4, 300)
    whole = channel.respond(a, k, t, carrier)
    some = rng.permutation(300)[:77]
    again = hall.channel(cart=((-9, 0), (9, 0)), fork=((-1, -8), (2, 9))).respond(a[some], k[some], t[some], carrier[some])
    assert again.equals(whole.take(some))
    assert len(channel.respond(a[:0], k[:0], t[:0], carrier[:0])) == 0


def test_a_link_between_things_that_stand_is_constant_to_the_last_bit_while_nothing_moves_near_it(hall):
    channel = hall.channel(cart=((-9, -20), (9, -20)), fork=((0, -40), (0, -60)))
    a, k, _, carrier = everyone(hall, 0.0)
    rows = np.flatnonzero(hall.near.body[a] + hall.far.body[k] == 2 * WORLD)
    h = [channel.respond(a[rows], k[rows], np.full(len(rows), t), carrier[rows]).h for t in (0.0, 2.5, 9.9)]
    assert np.array_equal(h[0], h[1])
    assert np.array_equal(h[0], h[2])


def test_a_moving_body_changes_the_links_near_it_and_leaves_the_others_alone(hall):
    still, moved = (hall.channel(fork=((x, 0.0), (x, 0.0))) for x in (-50, -8))
    a, k, t, carrier = everyone(hall, 1.0)
    rows = np.flatnonzero((hall.near.body[a] == WORLD) & (hall.far.body[k] == WORLD))
    before, after = (c.respond(a[rows], k[rows], t[rows], carrier[rows]) for c in (still, moved))
    start, end = hall.near.pose[a[rows], :3], hall.far.pose[k[rows], :3]
    at = np.array([-8.0, 0, 1.15])
    excess = np.linalg.norm(at - start, axis=1) + np.linalg.norm(end - at, axis=1) - np.linalg.norm(end - start, axis=1)
    changed = before.h != after.h
    kept = hall.fixed.index[a[rows], k[rows]] >= 0
    assert changed[(excess < 2.0) & kept].all()
    assert changed.sum() >= 5
    reflections_off_the_wall_reach_farther = 7.0
    assert not changed[excess > reflections_off_the_wall_reach_farther].any()
    assert (before.count != after.count).sum() >= 2


def test_when_a_body_has_passed_everything_is_as_it_was(hall):
    channel = hall.channel(fork=((-8, -30), (-8, 30)))
    a, k, _, carrier = everyone(hall, 0.0)
    rows = np.flatnonzero(hall.fixed.index[a, k] >= 0)
    h = [channel.respond(a[rows], k[rows], np.full(len(rows), s), carrier[rows]).h for s in (0.0, 5.0, 10.0)]
    assert np.array_equal(h[0], h[2])
    assert (h[0] != h[1]).any()


def test_a_tag_that_stands_fades_in_time_only_by_what_moves(hall):
    channel = hall.channel(fork=((-8.5, -1.0), (-7.5, 1.0)))
    pair = int(np.flatnonzero((hall.fixed.antenna == 0) & (hall.fixed.sight.clear > 0.99))[0])
    tag, t = int(hall.fixed.tag[pair]), np.linspace(0, 10, 400)
    h = channel.respond(np.zeros(400, int), np.full(400, tag), t, np.zeros(400, int)).h
    steps = np.abs(np.diff(h)) / np.abs(h).mean()
    assert 0 < steps.max() < 0.5  # it changes, and smoothly
    assert np.ptp(20 * np.log10(np.abs(h))) > 0.5


def test_what_an_antenna_and_a_tag_ride_on_does_not_stir_their_own_link():
    hall = Hall({"orders": 0}, racks=False)
    parked, driven = (hall.channel(cart=way) for way in (((0, 0), (0, 0)), ((0, 0), (0, 5))))
    for channel in (parked, driven):
        h = channel.respond(np.full(5, 2), np.full(5, 40), np.linspace(0, 5, 5), np.zeros(5, int)).h
        np.testing.assert_allclose(np.abs(h[1:] / h[0]), 1.0, rtol=0.7)  # both ride: only the hall's own field changes
    two = np.full(2, 2), np.full(2, 40), np.array([0.0, 5.0]), np.zeros(2, int)
    assert np.ptp(parked.respond(*two).h.real) == 0.0


def test_trials_fade_apart_and_the_geometry_stays(hall):
    a, k, t, carrier = everyone(hall, 1.0)
    first, again, other = (hall.channel(trial=i).respond(a, k, t, carrier) for i in (0, 0, 1))
    assert first.equals(again)
    assert np.array_equal(first.loss, other.loss)
    assert (first.h != other.h).any()


def test_carriers_fade_apart(hall):
    channel = hall.channel()
    pair = int(np.flatnonzero(hall.fixed.sight.clear > 0.99)[0])
    a, k = np.full(4, hall.fixed.antenna[pair]), np.full(4, hall.fixed.tag[pair])
    level = 20 * np.log10(np.abs(channel.respond(a, k, np.zeros(4), np.arange(4)).h))
    assert np.ptp(level) > 0.01


def test_adding_a_tag_or_an_antenna_moves_nothing():
    small, large = Hall(tags=10), Hall(tags=40)
    same = np.arange(10)
    larger = large.far.pose[same]
    assert np.array_equal(small.far.pose[same], larger)
    a, k = np.repeat(np.arange(4), 10), np.tile(same, 4)
    answers = [h.channel(fork=((-8, -3), (-8, 3))).respond(a, k, np.full(40, 4.0), np.zeros(40, int)) for h in (small, large)]
    assert answers[0].equals(answers[1])


def test_with_everything_off_it_is_free_space_with_obstacles():
    hall = Hall({"orders": 0, "diffuse": False, "edges": False})
    a, k, t, carrier = everyone(hall, 1.0)
    got = hall.channel().respond(a, k, t, carrier)
    one = (got.count == 1) & (k < 40)
    assert one.sum() > 10
    assert set(got.loss[one].round(6)) <= {40.0, *got.loss[one & (got.loss < 39)].round(6)}
    assert (got.loss[got.count == 0] == 0).all()
