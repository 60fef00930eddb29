"""Tracks as things to draw: one line for the truth of each target, one for each estimate of it, all over the same times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.recording import Trial
from testbed.report import palette
from testbed.types import Status, Track

TRUTH = "truth"
TRUTH_HZ = 10.0


@dataclass(frozen=True, eq=False)
class Trace:
    """What one method says of one target, or the truth of it.

    t          : (K,) s, ascending
    points     : (K, 3) m, world frame; NaN where the method has nothing to say
    covariance : (K, 2, 2) m², of x and y, or None (the truth)
    """

    name: str
    target: str
    colour: str
    t: Array
    points: Array
    covariance: Array | None = None


def traces(trial: Trial, tracks: Mapping[str, Track], colours: Mapping[str, str] | None = None, targets: Sequence[str] = ()) -> list[Trace]:
    """The truth and all tracks of a trial, for the `targets` named or for all. Colours by estimator, else by their order."""
    colours = colours or palette.assign(tracks)
    names = [str(n) for n in trial.recording.targets.name]
    wanted = [n for n in names if not targets or n in targets]
    found = []
    t = np.linspace(0.0, trial.recording.duration, max(2, round(trial.recording.duration * TRUTH_HZ) + 1))
    states = trial.target_states(t)
    for name in wanted:
        truth = Trace(TRUTH, name, palette.TRUTH, t, states[:, names.index(name), :3])
        found.append(truth)
        for id, track in tracks.items():
            rows = np.flatnonzero((track.target == name) & (track.trial == trial.recording.trial))
            if len(rows):
                found.append(_estimate(id, colours[id], track, int(rows[0]), truth))
    return found


def _estimate(id: str, colour: str, track: Track, row: int, truth: Trace) -> Trace:
    x, y = (track.components.index(c) for c in ("x", "y"))
    points = np.empty((len(track.t), 3))
    points[:, :2] = track.mean[:, row][:, [x, y]]
    if "z" in track.components:
        points[:, 2] = track.mean[:, row, track.components.index("z")]
    else:  # a method for the plane: drawn at the height of the truth
        points[:, 2] = np.interp(track.t, truth.t, truth.points[:, 2])
    points[track.status[:, row] == Status.LOST] = np.nan
    return Trace(id, truth.target, colour, track.t, points, track.covariance[:, row][:, [[x, x], [y, y]], [[x, y], [x, y]]])
