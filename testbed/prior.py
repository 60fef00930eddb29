"""What an estimator is told before it starts: a normal distribution about a scenario's place, or about a draw round the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from testbed.recording import Trial
from testbed.rng import Counter, keys_of
from testbed.types import POSITION_VELOCITY, Prior

if TYPE_CHECKING:
    from testbed.scenario import PriorModel


def draw_prior(model: PriorModel, trials: Sequence[Trial], root: int) -> Prior:
    """The prior of every target of every trial, in that order: B rows over position and velocity, `age_s` before t = 0.

    The covariance is what the model says. The mean is the model's own place and velocity where it gives them, else the truth
    at t = 0 plus a draw from that covariance, keyed by the target's name: all estimators of a trial start from the same one.
    """
    std = np.array([*model.position_std_m, *model.velocity_std_mps])
    means = []
    for trial in trials:
        truth = trial.target_states(np.zeros(1))[0]
        draws = Counter(root, trial.recording.trial, "prior")
        mean = truth + std * draws.normal(keys_of(trial.recording.targets.name)[:, None], np.arange(6))
        if model.position_m is not None:
            mean[:, :3] = model.position_m
        if model.velocity_mps is not None:
            mean[:, 3:] = model.velocity_mps
        means.append(mean)
    mean = np.concatenate([*means, np.empty((0, 6))])
    return Prior(np.full(len(mean), -model.age_s), mean, np.tile(np.diag(std**2), (len(mean), 1, 1)), POSITION_VELOCITY)
