"""A vehicle's log in the text of libRSF: its odometer as streams, its true path beside them, and its heading by integration.

One measurement a line, named by its first word (`odom3`: t, velocity x y z in m/s, turn rate x y z in rad/s; `point3`: t and an
Earth-centred place in m). Only these two are read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.columns import Array
from testbed.types import Heading, Odometry
from testbed.units import wrap

WORDS = {"odom3": 7, "point3": 4}  # numbers of a line that are used, its time included


@dataclass(frozen=True, eq=False)
class VehicleLog:
    """What a vehicle drove: the odometer at t (K,) s from its first sample, speed (K,) m/s, yaw_rate (K,) rad/s; and its true places.

    truth_t (N,) s, truth (N, 2) m in a plane that touches the Earth at the first of them: x to the east, y to the north.
    """

    t: Array
    speed: Array
    yaw_rate: Array
    truth_t: Array
    truth: Array

    def position(self, t: Array) -> Array:
        """(..., 2) m: the true place at times t (...,), on straight lines between those recorded."""
        return np.stack([np.interp(t, self.truth_t, column) for column in self.truth.T], axis=-1)

    def course(self, far: float) -> tuple[float, float]:
        """(heading rad, time s) over the first `far` m of the true path: the straight line from its start to there."""
        away = np.hypot(*(self.truth - self.truth[0]).T)
        k = int(np.argmax(away >= far))
        if not away[k] >= far:
            raise ValueError(f"the path never leads {far:g} m away from its start")
        dx, dy = self.truth[k] - self.truth[0]
        return float(np.arctan2(dy, dx)), float(self.truth_t[k])

    def heading(self, at: float, value: float) -> Array:
        """(K,) rad in (-π, π]: the yaw rate integrated (trapezoids), with its mean over the first `at` s at `value`.

        The course over a stretch is the mean heading of a vehicle on it, so that a bend in it does no harm.
        """
        turned = np.concatenate([[0.0], np.cumsum(np.diff(self.t) * (self.yaw_rate[1:] + self.yaw_rate[:-1]) / 2)])
        driven = np.where(self.t <= at, self.speed, 0.0)
        start = np.arctan2((driven * np.sin(turned)).sum(), (driven * np.cos(turned)).sum())
        return wrap(value - start + turned)

    def streams(self, heading: Array) -> dict[str, Odometry | Heading]:
        """Odometer and heading as streams of target 0, without latency."""
        carrier = np.zeros(len(self.t))
        return {
            "odometry": Odometry(self.t, self.t, carrier, self.speed, self.yaw_rate),
            "heading": Heading(self.t, self.t, carrier, heading),
        }


def read_vehicle_log(odometer: Path, truth: Path) -> VehicleLog:
    """A vehicle's log from its two files. ValueError, with file and line, for what can't be read or does not go forward in time."""
    samples, places = _lines(odometer, "odom3"), _lines(truth, "point3")
    begin = samples[0, 0]
    t = samples[:, 0] - begin
    return VehicleLog(t, samples[:, 1], samples[:, 6], places[:, 0] - begin, local_plane(places[:, 1:4]))


def _lines(path: Path, word: str) -> Array:
    """(N, ...) numbers of all lines that begin with `word`."""
    found: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        parts = line.split()
        if not parts or parts[0] != word:
            continue
        try:
            values = [float(part) for part in parts[1 : 1 + WORDS[word]]]
        except ValueError:
            raise ValueError(f"{path.name}:{number}: a number is wanted after {word}, the line is {line[:60]!r}") from None
        if len(values) < WORDS[word] or not np.isfinite(values).all():
            raise ValueError(f"{path.name}:{number}: {word} wants {WORDS[word]} finite numbers")
        if found and values[0] <= found[-1][0]:
            raise ValueError(f"{path.name}:{number}: the time {values[0]:g} s does not come after {found[-1][0]:g} s")
        found.append(values)
    if not found:
        raise ValueError(f"{path.name}: there is no line that begins with {word}")
    return np.array(found)


def local_plane(earth: Array) -> Array:
    """(N, 2) m east and north of the first of N Earth-centred, Earth-fixed places (N, 3) m.

    North and up by the sphere through the first place: against the ellipsoid the axes are tilted by 0.2°, less than a part in 10⁵ of a
    distance in the plane.
    """
    up = earth[0] / np.linalg.norm(earth[0])
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    return (earth - earth[0]) @ np.stack([east, north], axis=1)
