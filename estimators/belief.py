"""The Gaussian beliefs of B rows over time, which every Kalman filter here keeps: present time, mean, covariance, and status.

Kept from beginning to end, they can be gone back over: H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear
dynamic systems", AIAA Journal 3 (1965). The motion is linear, so the smoother needs no linearisation of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from estimators.motion import ConstantVelocity
from testbed.quantity import Config, Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Prior, Status


class StatusConfig(Config):
    """After how long without a used read a row says that it is coasting, and that it is lost. It takes reads all the same."""

    coast_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 1.0
    lost_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 10.0


def status_of(silent: Array, config: StatusConfig) -> Array:
    """(B,) int8 from the seconds since the last used read."""
    coasting = np.where(silent > config.coast_s, Status.COASTING, Status.OK)
    return np.where(silent > config.lost_s, Status.LOST, coasting).astype(np.int8)


class Motion(Protocol):
    """How a state of n components goes on."""

    n: int

    def advance(self, mean: Array, covariance: Array, dt: Array) -> None: ...


class _Step(NamedTuple):
    """A prediction: over how long (B,) s and to when, from what (after all updates before), to what."""

    dt: Array
    t: Array
    mean: Array
    covariance: Array
    to_mean: Array
    to_covariance: Array


class Belief:
    """B Gaussians over the state of a motion model. Updates change `mean` and `covariance` in place, for some rows.

    A model of several points starts each of them as the first, `apart` (points - 1, 3) m from it. With `keep` every prediction is
    remembered, for `smoothed`. ValueError where the prior does not speak of position and velocity.
    """

    def __init__(self, prior: Prior, motion: Motion, config: StatusConfig, apart: Array | None = None, keep: bool = False) -> None:
        if prior.components != POSITION_VELOCITY:
            raise ValueError(f"a prior over position and velocity is wanted, this one is over {', '.join(prior.components)}")
        points = motion.n // 6
        self.mean, self.covariance = np.tile(prior.mean, points), np.zeros((prior.rows, motion.n, motion.n))
        for point in range(points):
            here = slice(6 * point, 6 * point + 6)
            self.covariance[:, here, here] = prior.covariance
            if point and apart is not None:
                self.mean[:, here][:, :3] += apart[point - 1]
        self._motion, self._config = motion, config
        self._time, self._heard = np.array(prior.t), np.array(prior.t)
        self._steps: list[_Step] | None = [] if keep else None
        self._silences: list[Array] = []

    def predict(self, t: Array) -> None:
        """Bring every row to t (B,) s; rows that are there already stay as they are, bit for bit."""
        dt = np.maximum(t - self._time, 0.0)
        before = (self.mean.copy(), self.covariance.copy()) if self._steps is not None else None
        self._motion.advance(self.mean, self.covariance, dt)
        self._time = np.array(t)
        if self._steps is not None and before is not None:
            self._steps.append(_Step(dt, self._time, *before, self.mean.copy(), self.covariance.copy()))

    def heard(self, rows: Array, used: Array) -> None:
        """The rows for which `used` holds took something at their present time."""
        rows = rows[used]
        self._heard[rows] = self._time[rows]
        if self._steps is not None and len(rows):
            self._silences.append(np.where(np.isin(np.arange(len(self._heard)), rows), self._time, -np.inf))

    def estimate(self) -> Estimate:
        """Copies of what is believed now of the first point, with the status that the silence gives."""
        mean, covariance = self.mean[:, :6].copy(), self.covariance[:, :6, :6].copy()
        return Estimate(POSITION_VELOCITY, mean, covariance, status_of(self._time - self._heard, self._config))

    def smoothed(self, t: Array) -> Sequence[Estimate]:
        """What is believed in the end of the times t (K,) s, each of which some prediction led to; before the start, of the start."""
        if not self._steps:
            raise RuntimeError("this belief was not kept, so it can't be gone back over")
        times, means, covariances = self._backward(self._steps)
        found = []
        for when in t:
            place = np.maximum((times <= when + 1e-9).sum(axis=0) - 1, 0)  # (B,) the last state that was there by then
            row = np.arange(times.shape[1])
            mean, covariance = means[place, row, :6], covariances[place, row][:, :6, :6]
            found.append(Estimate(POSITION_VELOCITY, mean, covariance, self._status_at(when)))
        return found

    def _status_at(self, when: float) -> Array:
        """As it was said then: status speaks of silence before, not after."""
        start = self._steps[0].t - self._steps[0].dt if self._steps else self._time
        heard = np.array([np.where(s <= when + 1e-9, s, -np.inf) for s in [start, *self._silences]])
        return status_of(np.maximum(when, start) - np.maximum(heard.max(axis=0), start), self._config)

    def _backward(self, steps: Sequence[_Step]) -> tuple[Array, Array, Array]:
        """States from the first to the last: times (S, B), means (S, B, n), covariances (S, B, n, n)."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        found = [(steps[-1].t, mean, covariance)]
        for i in range(len(steps) - 1, 0, -1):
            step = steps[i]
            if not isinstance(self._motion, ConstantVelocity):
                raise TypeError("only constant velocity can be gone back over")
            gain = smoother_gain(self._motion, step.dt, step.covariance, step.to_covariance)
            mean = step.mean + np.einsum("bij,bj->bi", gain, mean - step.to_mean)
            covariance = step.covariance + gain @ (covariance - step.to_covariance) @ gain.transpose(0, 2, 1)
            covariance = (covariance + covariance.transpose(0, 2, 1)) / 2
            found.append((steps[i - 1].t, mean, covariance))
        times, means, covariances = (np.array(a) for a in zip(*reversed(found), strict=True))
        return times, means, covariances


def smoother_gain(motion: ConstantVelocity, dt: Array, covariance: Array, predicted: Array) -> Array:
    """(B, n, n): P Fᵀ P⁻¹, from the covariances before and after predicting over dt (B,) s; exactly I where no time passed."""
    transition = np.broadcast_to(np.eye(motion.n), covariance.shape).copy()
    transition[:, motion.position, motion.velocity] = dt[:, None]
    scale = np.sqrt(np.einsum("bii->bi", predicted))  # of the predicted state: metres and metres per second are solved for alike
    scale = np.where(scale > 0, scale, 1.0)
    across = (transition @ covariance) / scale[:, :, None]
    gain = np.linalg.solve(predicted / (scale[:, :, None] * scale[:, None, :]), across).transpose(0, 2, 1) / scale[:, None, :]
    return np.where((dt == 0)[:, None, None], np.eye(motion.n), gain)
