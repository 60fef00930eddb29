"""A real car's odometer on street networks about its way: from its start, and from nowhere. 1.55 km in 283 s.

The data (smartLoc, TU Chemnitz, CC BY-SA 4.0) are not part of the project: these tests skip where they are absent.
"""

from pathlib import Path

import numpy as np
import pytest

from estimators.mapmatch_grid import MapmatchGrid
from testbed.estimate import run
from testbed.metrics.settle_time import first_stretch
from testbed.recording import Recording
from testbed.types import Antennas, Prior, Site, Status, Tags, Targets
from testbed.vehicle_log import read_vehicle_log
from worlds.street_network import street_network

FOLDER = Path(__file__).parents[2] / ".." / "shared" / "data" / "vehicle_odometry_smartloc"
NETWORKS = range(4)
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the car's log is not here: ../shared/data/vehicle_odometry_smartloc")

# the heading is a gyro's, integrated: it is smooth, and off by what it has drifted and by how the streets were drawn, 8° for seconds
CAR = {"kappa": 50.0, "correlation_s": 3.0, "cell_m": 1.0, "bias_range_mps": 0.2, "noise_mps": 0.6, "near_m": 8.0}


@pytest.fixture(scope="module")
def log():
    return read_vehicle_log(FOLDER / "Berlin_Potsdamer_Platz_odom3_extract.txt", FOLDER / "Berlin_Potsdamer_Platz_GT.txt")


def located(log, seed, start):
    """The track of the car on network `seed`, and how many of its streets are wrong."""
    course, at = log.course(15.0)
    roads, wrong = street_network(log.truth, seed)
    site = Site(Antennas.empty(), Tags.empty(), np.empty(0), roads=roads)
    streams = log.streams(log.heading(at, course))
    nobody = (np.empty(0, dtype=np.int64),)
    recording = Recording(seed, float(log.t[-1]), site, streams, Targets(np.array(["car"]), np.array(["car"])), nobody)
    velocity = log.speed[0] * np.array([np.cos(course), np.sin(course)])
    mean = np.array([[*log.truth[0], 0.0, *velocity, 0.0]])
    prior = Prior(np.zeros(1), mean, np.diag([9.0, 9.0, 0.01, 1.0, 1.0, 0.01])[None])
    config = MapmatchGrid.Config(start=start, **CAR)
    return run([recording], MapmatchGrid, config, prior, np.array([1], dtype=np.uint64), report_hz=5.0), wrong


def error(log, track):
    return np.hypot(*(track.mean[:, 0] - log.position(track.t)).T)


def dead_reckoned(log):
    """(K,) m: the error of speed and heading alone, from the true start."""
    course, at = log.course(15.0)
    heading, dt = log.heading(at, course), np.diff(log.t)
    step = (log.speed[1:] + log.speed[:-1]) / 2 * dt
    way = np.cumsum(np.stack([step * np.cos(heading[:-1]), step * np.sin(heading[:-1])], axis=1), axis=0)
    return np.hypot(*(log.truth[0] + way - log.position(log.t[1:])).T)


@pytest.mark.parametrize("seed", NETWORKS)
def test_from_its_start_the_car_is_never_lost(log, seed):
    track, wrong = located(log, seed, "prior")
    found, alone = error(log, track), dead_reckoned(log)
    assert wrong >= 30
    assert np.median(found) <= 5
    assert np.quantile(found, 0.9) <= 10
    assert found.max() <= 30
    assert np.median(found) < np.median(alone) / 3
    assert np.quantile(found, 0.9) < np.quantile(alone, 0.9) / 3


@pytest.mark.parametrize("seed", NETWORKS)
def test_from_nowhere_the_car_is_found_and_says_so(log, seed):
    track, wrong = located(log, seed, "network")
    found, tracks = error(log, track), track.status[:, 0] == Status.OK
    settled = first_stretch(track.t, found < 10.0, 10.0)
    assert wrong >= 30
    assert settled < 60
    assert np.median(found) <= 5
    assert tracks.mean() > 0.7
    assert (found[tracks] < 30).mean() > 0.95
