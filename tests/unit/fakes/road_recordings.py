"""Recordings of vehicles on roads: the study's point vehicle by the testbed's own world and sensors, and streams written by hand."""

import numpy as np

from testbed.estimate import row_seeds, run
from testbed.geometry import Roads
from testbed.plugins import load
from testbed.prior import draw_prior
from testbed.recording import Recording
from testbed.rng import RowRandom
from testbed.scenario import from_dict
from testbed.simulate import Simulator
from testbed.types import Antennas, Event, Heading, Odometry, Prior, Site, Tags, Targets
from worlds.road_hall import RoadHall

W3 = RoadHall(RoadHall.Config(racks=False)).roads()
PAPER = {
    "name": "roads",
    "seed": 7,
    "trials": 100,
    "duration_s": 200,
    "truth_hz": 100,
    "step_hz": 200,
    "world": {"kind": "road_hall", "racks": False},
    "actors": [{"id": "f", "kind": "forklift", "motion": "kinematic", "walk": {"speed_mps": 2}}],
    "sensors": [
        {"id": "odometer", "kind": "odometry", "on": "f", "scale_std": 0, "bias_range_mps": 0.5, "noise_std_mps": 0.6},
        {"id": "compass", "kind": "compass", "on": "f", "bias_std_deg": 0, "noise_kappa": 2},
    ],
    "targets": ["f"],
}


def trials(n, first=0, **changes):
    """n trials of the study's vehicle."""
    scenario = from_dict({**PAPER, **changes})
    with Simulator(scenario) as simulator:
        return [simulator.trial(i) for i in range(first, first + n)]


def tracked(made, kind, seed=7, id="", **config):
    """The track of an estimator on trials."""
    return by_method(made, load("estimators", kind), seed, id or kind, **config)


def by_method(made, method, seed=7, id="", **config):
    """The same for a class, which need not be a plug-in."""
    recordings = [t.recording for t in made]
    prior = draw_prior(from_dict(PAPER).prior, made, seed)
    return run(recordings, method, method.Config(**config), prior, row_seeds(seed, recordings, id or method.__name__))


def by_hand(nodes, segments, t, speed, heading, one_way=None):
    """A recording of one vehicle with an odometer and a compass that say what is given, on a network of its own."""
    t = np.asarray(t, dtype=np.float64)
    speed, heading = (np.broadcast_to(np.asarray(v, dtype=np.float64), t.shape) for v in (speed, heading))
    roads = Roads(np.array(nodes), np.array(segments), np.zeros(len(segments), dtype=bool) if one_way is None else np.array(one_way))
    site = Site(Antennas.empty(), Tags.empty(), np.empty(0), roads=roads)
    streams = {"odometry": Odometry(t, t, 0 * t, speed), "heading": Heading(t, t, 0 * t, heading)}
    return Recording(0, float(t[-1]), site, streams, Targets(np.array(["f"]), np.array(["f"])), (np.empty(0, dtype=np.int64),))


def nowhere(rows=1, x=0.0, y=0.0, std=1.0, vx=0.0, vy=0.0):
    """A prior at a place."""
    mean = np.tile([x, y, 0.0, vx, vy, 0.0], (rows, 1))
    return Prior(np.zeros(rows), mean, np.tile(std**2 * np.eye(6), (rows, 1, 1)))


def site(roads):
    return Site(Antennas.empty(), Tags.empty(), np.empty(0), roads=roads)


def made(method, rows=1, roads=None, prior=None, **config):
    """An estimator that has started on a network (the study's, where left out)."""
    one = method(method.Config(**config), site(W3 if roads is None else roads), RowRandom(np.arange(5, 5 + rows)))
    one.start(nowhere(rows) if prior is None else prior)
    return one


def heard(kind, t, value, row=0):
    """One sample as an event."""
    table = Odometry if kind == "odometry" else Heading
    return Event(kind, np.array([row]), table(np.array([t]), np.array([t]), np.array([0]), np.array([value])))


def step(one, t, speed, heading):
    """A compass and an odometer sample of one time, in the driver's order."""
    one.predict(np.full(len(one._time), t))
    one.update(heard("heading", t, heading))
    one.update(heard("odometry", t, speed))
