"""Reads at gates that are drawn from a model of their own: tags that go along a way, heard by turned antennas; no world, no channel.

Level: 40 log10 of distance, a cos^4 lobe there and back over a floor, white noise. Phase: twice the distance. Each antenna comes by every
`EVERY` s and reads what is above its threshold.
"""

import numpy as np

from testbed.estimate import run
from testbed.recording import Recording
from testbed.types import Antennas, Prior, Reads, Site, Tags, Targets
from testbed.units import SPEED_OF_LIGHT

FREQUENCY = 866e6
EVERY = 0.13  # s
THRESHOLD = -72.0  # dBm
NOISE = 3.0  # dB
HALL = 9.0  # m from gate to gate, along y


def antennas(gates=1, toe_deg=40.0, inward=0.0):
    """(4 a gate) a low pair that looks outwards and a high pair that looks inwards, 2.6 m apart; inward: rad, of all gates."""
    ids, position, yaw = [], [], []
    for g in range(gates):
        for side, y in (("left", 1.28), ("right", -1.28)):
            for height, z, way in (("low", 0.7, -1.0), ("high", 1.5, 1.0)):
                ids.append(f"gate{g + 1}.{side}_{height}")
                position.append([0.0, y, z])
                across = -np.sign(y) * np.pi / 2  # into the passage
                yaw.append(across - way * np.sign(across) * np.radians(toe_deg) + inward)
    position, n = np.array(position), len(ids)
    c, s = np.cos(inward), np.sin(inward)
    position[:, :2] = position[:, :2] @ np.array([[c, s], [-s, c]])
    position[:, 1] += HALL * np.repeat(np.arange(gates), 4)
    half = np.array(yaw) / 2
    quaternion = np.column_stack([np.cos(half), np.zeros(n), np.zeros(n), np.sin(half)])
    return Antennas(ids, position, quaternion, np.full(n, 6.0), np.full(n, np.radians(68.0)), np.full(n, 18.0), np.full(n, 29.0))


def site(tags, **gate):
    return Site(antennas(**gate), Tags([f"tag{i}" for i in range(tags)], pattern=np.full(tags, "isotropic")), np.array([FREQUENCY]))


def walk(*points, speed=1.0, start=0.0):
    """t (K,) -> (K, 3) m: straight legs between points (x, y) at one speed, 1 m above the floor; stands before and after."""
    points = np.array(points, dtype=float)
    reached = start + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) / speed

    def at(t):
        return np.column_stack([np.interp(t, reached, points[:, 0]), np.interp(t, reached, points[:, 1]), np.full(len(t), 1.0)])

    return at


def recording(ways, duration, seed=1, trial=0, threshold=THRESHOLD, **gate):
    """One tag a way."""
    here, rng = site(len(ways), **gate), np.random.default_rng([seed, trial])
    a = here.antennas
    rows = []
    for tag, way in enumerate(ways):
        for antenna in range(len(a)):
            t = np.arange(rng.uniform(0, EVERY), duration, EVERY) + rng.uniform(0, 0.01)
            t = t[t < duration]
            away = way(t) - a.position[antenna]
            distance = np.linalg.norm(away, axis=1)
            if distance.min() > HALL - 2:  # another gate's: nothing comes through
                continue
            w, _, _, z = a.quaternion[antenna]
            look = np.array([1 - 2 * z * z, 2 * w * z, 0.0])
            lobe = 10 ** (-a.front_to_back[antenna] / 10) + np.maximum(away @ look / distance, 0.0) ** 4
            level = -48.0 - 40 * np.log10(np.maximum(distance, 0.3)) + 20 * np.log10(lobe) + rng.normal(0, NOISE, len(t))
            phase = (4 * np.pi * FREQUENCY / SPEED_OF_LIGHT * distance + antenna + tag + rng.normal(0, 0.1, len(t))) % (2 * np.pi)
            heard = level > threshold
            rows += [(ti, antenna, tag, le, ph) for ti, le, ph in zip(t[heard], level[heard], phase[heard], strict=True)]
    rows.sort()
    columns = [np.array(column) for column in zip(*rows, strict=True)] if rows else [np.empty(0)] * 5
    t, antenna, tag, level, phase = columns
    reads = Reads(t, t, antenna, tag, np.zeros(len(t)), level, phase)
    names = [f"tag{i}" for i in range(len(ways))]
    return Recording(trial, duration, here, {"reads": reads}, Targets(names, names), tuple(np.array([i]) for i in range(len(ways))))


def tracked(recordings, method, report_hz=2.0, **config):
    rows = sum(len(r.targets) for r in recordings)
    prior = Prior(np.zeros(rows), np.zeros((rows, 6)), np.tile(np.eye(6), (rows, 1, 1)))
    return run(recordings, method, method.Config(**config), prior, np.zeros(rows, dtype=np.uint64), report_hz=report_hz)


def said(track, row=0):
    return track.decisions.what[track.decisions.row == row].tolist()
