"""Does a metric keep the contract of `testbed.protocols.Metric`?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from testbed import frames
from testbed.checks import samples
from testbed.checks.common import alike, configured, require, same, untouched_globals
from testbed.geometry import WORLD
from testbed.protocols import Metric
from testbed.recording import Trial
from testbed.scene import Truth
from testbed.types import Innovations, Status, Track


def check_metric(cls: type, config: Any = None) -> None:
    """Compute a metric on a made-up track; ConformanceError for the first rule that is broken."""
    config, who = configured(cls, config), cls.__name__
    make: Callable[[Any], Metric] = cls
    trial, track = _trial(), _track()
    truth = trial.target_states(track.t)
    with untouched_globals(who):
        columns = make(config).compute(track, truth, trial)
        require(columns, who, "computes no column")
        for name, values in columns.items():
            require(np.shape(values) == (samples.TARGETS,), who, f"{name} is of shape {np.shape(values)}, not one number a row")
        again = make(config).compute(track, truth, trial)
        require(all(same(columns[n], again[n]) for n in columns), who, "computed twice it differs")
        for row in range(samples.TARGETS):
            alone = make(config).compute(track.take(np.array([row])), truth[:, [row]], _of_one(trial, row))
            differ = [n for n in columns if not alike(alone[n], columns[n][[row]])]
            require(not differ, who, f"{', '.join(differ)} of a row depends on the other rows")
        lost = make(config).compute(_lost(track), truth, trial)
        require(set(lost) == set(columns), who, "has other columns when nothing was ever estimated")


def _trial() -> Trial:
    recording = samples.recording(duration=1.0)
    pose = np.tile(frames.IDENTITY, (samples.TARGETS, 1))
    pose[:, :3] = np.random.default_rng(3).uniform(samples.HALL[0], samples.HALL[1], (samples.TARGETS, 3))
    nobody = Truth(t=np.array([0.0, 1.0]), poses=np.empty((2, 0, 7)))
    return Trial(recording, nobody, np.full(samples.TARGETS, WORLD), pose, {"line_of_sight": 1.0})


def _of_one(trial: Trial, row: int) -> Trial:
    body, pose = trial.target_body[[row]], trial.target_pose[[row]]
    return replace(trial, recording=samples.only(trial.recording, row), target_body=body, target_pose=pose)


def _track() -> Track:
    """A track with good, coasting and lost reports, one row of them lost throughout."""
    draws, rows, k = np.random.default_rng(4), samples.TARGETS, 11
    status = draws.choice([Status.OK, Status.OK, Status.COASTING, Status.LOST], (k, rows))
    status[:, -1] = Status.LOST
    innovations = Innovations(
        row=np.repeat(np.arange(rows), 6), t=np.tile(np.linspace(0, 1, 6), rows), nis=draws.chisquare(1, 6 * rows),
        dof=np.ones(6 * rows), log_likelihood=draws.normal(-3, 1, 6 * rows),
    )  # fmt: skip
    return Track(
        t=np.linspace(0, 1, k),
        mean=draws.normal(2, 1, (k, rows, 6)),
        covariance=np.tile(np.eye(6), (k, rows, 1, 1)),
        status=status,
        trial=np.zeros(rows),
        target=samples.recording(duration=0.1).targets.name,
        used=np.full(rows, 5),
        refused=np.ones(rows),
        late=np.zeros(rows),
        update_seconds=np.full(rows, 1e-4),
        innovations=innovations,
    )


def _lost(track: Track) -> Track:
    return track.with_(
        mean=np.full_like(track.mean, np.nan), status=np.full_like(track.status, Status.LOST), innovations=Innovations.empty()
    )
