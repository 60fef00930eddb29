"""The checks of worlds, actors, sensors and metrics find what is wrong: a sound class, and the same broken in one way each."""

import itertools
import sys
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from testbed import frames
from testbed.check import ConformanceError, check_actor, check_metric, check_sensor, check_world
from testbed.checks.surroundings import ClearSight
from testbed.geometry import Boxes, Mounts
from testbed.protocols import Obstruction, Sensed
from testbed.quantity import Config
from testbed.rng import Counter, keys_of, stream
from testbed.scene import Body, Scene, Truth
from testbed.types import Antennas, Reads

CALLS = itertools.count(1)  # what is never the same twice
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def expect(check, cls, rule):
    with pytest.raises(ConformanceError, match=rule):
        check(cls)


# ---------------------------------------------------------------- worlds


class Hall:
    """A room with one pillar; actors go straight from their first way point at 1 m/s."""

    Config: ClassVar = Config
    pillar: ClassVar = Boxes(center=[[0, 0, 1.0]], quaternion=[UPRIGHT], half=[[0.2, 0.2, 1.0]], body=[0])
    mounts: ClassVar = Mounts(["pillar.a"], ["pillar"], ["antenna"], [0], [[0.21, 0, 1.0]], [UPRIGHT])

    def __init__(self, config):
        self.open = True

    def scene(self, actors):
        bodies = [Body("pillar", "pillar", np.array([4.0, 4.0, 0, *UPRIGHT]))]
        parts = [self.pillar]
        for i, plan in enumerate(actors, start=1):
            boxes = plan.actor.boxes()[0]
            parts.append(boxes.with_(body=np.full(len(boxes), i), material=np.zeros(len(boxes))))
            bodies.append(Body(plan.id, plan.kind, plan.pose, moving=True))
        bounds = np.array([[0.0, 0.0, 0.0], [8.0, 8.0, 4.0]])
        return Scene(tuple(bodies), Boxes.concatenate(parts), ("steel",), bounds, self.mounts)

    def move(self, scene, actors, duration, root, trial, step_hz=240, truth_hz=120):
        t = np.arange(int(duration * truth_hz) + 1) / truth_hz
        poses = np.tile(frames.IDENTITY, (len(t), len(actors), 1))
        for i, plan in enumerate(actors):
            poses[:, i, :3] = plan.pose[:3] + np.outer(t, [stream(root, trial, plan.id).uniform(0.9, 1.1), 0, 0])
        return Truth(t=t, poses=poses, bodies=scene.moving_names)

    def caster(self, scene, engine, entry_db, per_metre_db):
        return ClearSight()

    def close(self):
        self.open = False


def hall(**changes):
    return type("Broken", (Hall,), changes)


def changed_scene(**changes):
    return lambda self, actors: replace(Hall.scene(self, actors), **changes)


def changed_move(change):
    def move(self, scene, *arguments):
        return change(Hall.move(self, scene, *arguments), scene)

    return move


def remembering(self, *arguments):
    self.times = getattr(self, "times", 0) + 1
    truth = Hall.move(self, *arguments)
    return truth.with_(poses=truth.poses + np.array([1e-9 * self.times, 0, 0, 0, 0, 0, 0]))


def lazy_import(self, actors):
    import pybullet  # noqa: F401

    return Hall.scene(self, actors)


class Fog(ClearSight):
    def static(self, start, end):
        return Obstruction(np.zeros(len(start)), np.ones(len(start)))


TWO_MOUNTS = Mounts(["a", "a"], ["g", "g"], ["tag", "tag"], [-1, -1], [[1, 1, 1.0], [2, 2, 1.0]], [UPRIGHT, UPRIGHT])
HALLS = [
    (hall(scene=lazy_import), "wants a physics engine"),
    (
        hall(scene=lambda self, actors: changed_scene(bodies=(*Hall.scene(self, actors).bodies,) * 2)(self, actors)),
        "two bodies have one name: pillar",
    ),
    (hall(mounts=TWO_MOUNTS), "two mounts have one name: a"),
    (hall(mounts=Hall.mounts.with_(position=[[0.1, 0.1, 1.0]])), "the mount pillar.a lies inside a box"),
    (hall(mounts=Hall.mounts.with_(body=[-1], position=[[4.1, 4.1, 1.0]])), "the mount pillar.a lies inside a box"),
    (hall(mounts=Hall.mounts.with_(use=["hat"])), "neither for a tag nor for an antenna"),
    (hall(mounts=Hall.mounts.with_(quaternion=[[2.0, 0, 0, 0]])), "not of length 1"),
    (hall(mounts=Hall.mounts.with_(body=[9])), "a mount belongs to a body that is not there"),
    (hall(pillar=Hall.pillar.with_(body=[9])), "a box belongs to a body that is not there"),
    (hall(pillar=Hall.pillar.with_(material=[3])), "a material that is not listed"),
    (hall(pillar=Hall.pillar.with_(half=[[0.2, 0.0, 1.0]])), "a box has no extent"),
    (hall(scene=changed_scene(bounds=np.zeros((2, 3)))), "the bounds are not a room"),
    (
        hall(scene=lambda self, actors: changed_scene(boxes=Hall.pillar.with_(center=[[0, 0, 1 + 1e-9 * next(CALLS)]]))(self, actors)),
        "different scenes",
    ),
    (hall(move=changed_move(lambda truth, scene: truth.with_(bodies=("ghost",)))), "the truth is of"),
    (hall(move=changed_move(lambda truth, scene: truth.with_(t=truth.t / 2))), "the truth runs from 0 to 0.75 s"),
    (hall(move=changed_move(lambda truth, scene: truth.with_(t=1.5 * (truth.t / 1.5) ** 1.1))), "not evenly spaced"),
    (hall(move=changed_move(lambda truth, scene: truth.with_(poses=truth.poses * np.nan))), "a true pose is not finite"),
    (hall(move=remembering), "not a function of its arguments"),
    (hall(move=changed_move(lambda truth, scene: np.random.rand() and truth)), "global random state"),  # noqa: NPY002
    (hall(caster=lambda self, *a: Fog()), "loses power without an obstacle"),
]


def test_a_sound_world_passes_and_is_closed():
    made = []
    check_world(hall(__init__=lambda self, config: made.append(self)))
    assert [w.open for w in made if hasattr(w, "open")] == [False, False]


@pytest.mark.parametrize(("cls", "rule"), HALLS, ids=[f"{i}_{rule}".replace(" ", "_") for i, (_, rule) in enumerate(HALLS)])
def test_a_broken_world_is_found_out(cls, rule):
    expect(check_world, cls, rule)


def test_checking_a_world_leaves_the_physics_engine_importable():
    before = sys.modules.get("pybullet")
    check_world(Hall)
    expect(check_world, hall(scene=lazy_import), "wants a physics engine")
    assert sys.modules.get("pybullet") is before


class Crate:
    """A box of one material with a tag on top."""

    Config: ClassVar = Config
    box: ClassVar = Boxes(center=[[0, 0, 0.5]], quaternion=[UPRIGHT], half=[[0.4, 0.4, 0.5]])
    tag: ClassVar = Mounts(["top"], [""], ["tag"], [-1], [[0, 0, 1.01]], [UPRIGHT])

    def __init__(self, config):
        pass

    def boxes(self):
        return self.box, ("carton",)

    def mounts(self):
        return self.tag


ACTORS = [
    ({"box": Boxes.empty()}, "has no boxes"),
    ({"box": Crate.box.with_(center=[[0, 0, 0.7]])}, "its lowest point is at 0.2 m"),
    ({"box": Crate.box.with_(material=[1])}, "a box is of material 1, there are 1"),
    ({"tag": Crate.tag.with_(position=[[0, 0, 0.9]])}, "the mount top lies inside a box"),
    (
        {"boxes": lambda self: (Crate.box.with_(half=[[0.4, 0.4 + 1e-9 * next(CALLS), 0.5]]), ("carton",))},
        "two objects of one config differ",
    ),
]


def test_a_sound_actor_passes():
    check_actor(Crate)


@pytest.mark.parametrize(("changes", "rule"), ACTORS, ids=[rule.replace(" ", "_") for _, rule in ACTORS])
def test_a_broken_actor_is_found_out(changes, rule):
    expect(check_actor, type("Broken", (Crate,), {"__init__": lambda self, config: None, **changes}), rule)


# ---------------------------------------------------------------- sensors


class Ear:
    """Hears every tag in reach ten times a second."""

    Config: ClassVar = Config
    produces: ClassVar = frozenset({"reads"})
    ids: ClassVar = ("ear",)

    def __init__(self, config, id, scene):
        self.id = id

    def antennas(self):
        n = len(self.ids)
        return Antennas(list(self.ids), np.zeros((n, 3)), [UPRIGHT] * n, *([np.ones(n)] * 4))

    def frequencies(self):
        return np.array([866e6])

    def noise(self, around, time, tag):
        return Counter(around.root, around.trial, f"sensors.{self.id}").normal(time, keys_of(around.tagged.tags.id)[tag])

    def times(self, around):
        return np.arange(10) / 10

    def arrival(self, t):
        return t

    def sense(self, around, first_antenna):
        near = np.flatnonzero(np.linalg.norm(around.tagged.pose[:, :3], axis=1) < 1e3)
        time, tag = (a.ravel() for a in np.meshgrid(np.arange(10), near, indexing="ij"))
        t = self.times(around)[time]
        rssi = -50 + self.noise(around, time, tag)
        reads = Reads(t=t, t_arrival=self.arrival(t), antenna=self.heard_by(first_antenna, len(t)), tag=self.told(tag), rssi=rssi)
        return Sensed({"reads": reads}, {"line_of_sight": (1.0, 1.0)})

    def heard_by(self, first, n):
        return np.full(n, first)

    def told(self, tag):
        return tag


def in_a_row(self, around, time, tag):
    return stream(around.root, around.trial, "ear").normal(size=len(time))


def by_index(self, around, time, tag):
    return Counter(around.root, around.trial, "ear").normal(time, tag)


def counting_calls(self, around, time, tag):
    self.calls = getattr(self, "calls", 0) + 1
    return Ear.noise(self, around, time, tag) + 1e-6 * self.calls


def by_object(self, around, time, tag):
    return Ear.noise(self, around, time, tag) + np.random.default_rng().normal()


def by_place(self, first, n):
    self.first = first
    return np.full(n, first)


EARS = [
    ({"produces": frozenset({"smells"})}, "produces must be a frozenset"),
    ({"produces": frozenset({"reads", "rounds"})}, "says that it produces"),
    ({"ids": ("ear", "ear")}, "two antennas have one id"),
    ({"frequencies": lambda self: np.array([0.0])}, "a carrier is no frequency"),
    ({"arrival": lambda self, t: t[::-1] + 1}, "not in the order of arrival"),
    ({"times": lambda self, around: np.arange(10) / 5}, "outside of the trial"),
    ({"arrival": lambda self, t: t - 0.1}, "arrive before they happen"),
    ({"heard_by": lambda self, first, n: np.full(n, first + 1)}, "reads.antenna points to what is not there"),
    ({"heard_by": lambda self, first, n: np.zeros(n)}, "reads.antenna points to what is not there"),
    ({"told": lambda self, tag: tag + 2}, "reads.tag points to what is not there"),
    ({"noise": in_a_row}, "a tag in reach changes what reads of the others say"),
    ({"noise": by_index}, "a tag out of reach changes the reads"),
    ({"noise": counting_calls}, "a second time, after another trial, gives other reads"),
    ({"noise": by_object}, "gives other reads"),
    ({"noise": lambda self, around, time, tag: np.random.rand(len(time))}, "global random state"),  # noqa: NPY002
    ({"heard_by": by_place, "arrival": lambda self, t: t}, None),
    ({"sense": lambda self, around, first: Sensed({"reads": Reads.empty()})}, "sensed nothing at all"),
    ({"sense": lambda self, around, first: Sensed(Ear.sense(self, around, first).streams, {"sight": (np.nan, 1.0)})}, "a stimulus"),
]


@pytest.mark.parametrize(("changes", "rule"), EARS, ids=[f"{i}_{rule}".replace(" ", "_") for i, (_, rule) in enumerate(EARS)])
def test_a_broken_sensor_is_found_out_and_a_sound_one_is_not(changes, rule):
    cls = type("Broken", (Ear,), changes)
    if rule is None:
        check_sensor(cls)
    else:
        expect(check_sensor, cls, rule)


def test_a_sensor_whose_draws_depend_on_its_place_in_the_site_is_found_out():
    class Placed(Ear):
        def sense(self, around, first_antenna):
            sensed = super().sense(around, first_antenna)
            reads = sensed.streams["reads"]
            return Sensed({"reads": reads.with_(rssi=reads.rssi + 0.1 * first_antenna)})

    expect(check_sensor, Placed, "depend on how many antennas stand before")


# ---------------------------------------------------------------- metrics


class Share:
    """The share of reports that are not lost."""

    Config: ClassVar = Config

    def __init__(self, config):
        pass

    def compute(self, track, truth, trial):
        return {"share": (track.status != 2).mean(axis=0)}


METRICS = [
    (lambda self, track, truth, trial: {}, "computes no column"),
    (lambda self, track, truth, trial: {"share": 1.0}, "not one number a row"),
    (lambda self, track, truth, trial: {"share": np.random.default_rng().random(len(track.trial))}, "computed twice it differs"),
    (lambda self, track, truth, trial: {"share": np.full(len(track.trial), track.mean.mean())}, "depends on the other rows"),
    (lambda self, track, truth, trial: {f"share{np.isfinite(track.mean).all()}": track.used}, "other columns when nothing"),
]


def test_a_sound_metric_passes():
    check_metric(Share)


@pytest.mark.parametrize(("compute", "rule"), METRICS, ids=[rule.replace(" ", "_") for _, rule in METRICS])
def test_a_broken_metric_is_found_out(compute, rule):
    expect(check_metric, type("Broken", (Share,), {"compute": compute}), rule)
