"""A filter for what now stands and now moves: two motion models side by side, weighed by how well each explains what is heard.

H. A. P. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching coefficients",
IEEE Transactions on Automatic Control 33 (1988).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from estimators.belief import status_of
from estimators.still import Still, StillConfig
from estimators.ukf import Ukf, UkfConfig
from testbed.quantity import Seconds
from testbed.types import POSITION_VELOCITY, Array, Estimate, Event, Prior, RowRandom, Site, UpdateInfo


class ImmConfig(UkfConfig, StillConfig):
    """As for a `ukf`; a thing stands, and moves, for `stay_s` on average. `moving_at_start`: how likely it moves to begin with."""

    stay_s: Annotated[Seconds, Field(gt=0, le=1e6)] = 5.0
    moving_at_start: Annotated[float, Field(gt=0, lt=1)] = 0.5

    @model_validator(mode="after")
    def _forward_alone(self) -> ImmConfig:
        if self.smooth:
            raise ValueError("an imm goes forward alone: smooth is for ekf and ukf")
        return self


class Imm:
    """Two unscented filters, one for standing and one for constant velocity, mixed at every step by the probability of each.

    The extra `moving` of an estimate is the probability that the row moves. Breaks where signals change by themselves (a person steps
    in between): that looks like motion.
    """

    Config = ImmConfig
    consumes: frozenset[str] = frozenset({"reads"})

    def __init__(self, config: ImmConfig, site: Site, rng: RowRandom) -> None:
        self._config = config
        self._bank = [_Standing(config, site, rng), Ukf(config, site, rng)]
        self.consumes = self._bank[1].consumes

    def start(self, prior: Prior) -> None:
        for one in self._bank:
            one.start(prior)
        moving = self._config.moving_at_start
        self._time, self._probability = np.array(prior.t), np.tile([1 - moving, moving], (prior.rows, 1))
        self._heard = np.array(prior.t)

    def predict(self, t: Array) -> None:
        self._mix(np.maximum(t - self._time, 0.0))
        for one in self._bank:
            one.predict(t)
        self._time = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        infos = [one.update(event) for one in self._bank]
        said = np.stack([info.log_likelihood for info in infos], axis=1)
        judged = np.isfinite(said).all(axis=1)
        rows = event.row[judged]
        weight = np.log(self._probability[rows]) + said[judged]
        top = weight.max(axis=1, keepdims=True)
        likelihood = np.full(len(event), np.nan)
        likelihood[judged] = (top + np.log(np.exp(weight - top).sum(axis=1, keepdims=True)))[:, 0]
        weight = np.exp(weight - top)
        self._probability[rows] = np.maximum(weight / weight.sum(axis=1, keepdims=True), 1e-12)
        used = infos[0].used | infos[1].used
        self._heard[event.row[used]] = self._time[event.row[used]]
        nis = np.minimum(*(np.nan_to_num(info.nis, nan=np.inf) for info in infos))  # of the model that explains it best
        return UpdateInfo(used, likelihood, np.where(np.isfinite(nis), nis, np.nan), infos[0].dof)

    def estimate(self) -> Estimate:
        mean, covariance = mixed([one.estimate() for one in self._bank], self._probability)
        status = status_of(self._time - self._heard, self._config)
        return Estimate(POSITION_VELOCITY, mean, covariance, status, {"moving": self._probability[:, 1].copy()})

    def _mix(self, dt: Array) -> None:
        """Let each filter begin the step as a mixture of both, by how likely the thing changed over to it (Blom and Bar-Shalom, step 1)."""
        gone = np.flatnonzero(dt > 0)
        if not len(gone):
            return
        stays = 0.5 + 0.5 * np.exp(-2 * dt[gone] / self._config.stay_s)  # a two-state chain that leaves either at the rate 1 / stay_s
        share = np.stack([np.stack([stays, 1 - stays], axis=1), np.stack([1 - stays, stays], axis=1)], axis=1)  # (rows, from, to)
        joint = share * self._probability[gone][:, :, None]
        after = joint.sum(axis=1)
        before = [one.estimate() for one in self._bank]
        for to, one in enumerate(self._bank):
            mean, covariance = mixed(before, joint[:, :, to] / after[:, [to]], gone)
            one.put(gone, mean, covariance)
        self._probability[gone] = after


class _Standing(Ukf):
    """The same filter of a thing that stands."""

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        super().__init__(config, site, rng)
        self._motion = Still(config)

    @classmethod
    def _method(cls) -> str:
        return "imm"


def mixed(parts: list[Estimate], weight: Array, rows: Array | slice = slice(None)) -> tuple[Array, Array]:
    """Mean (B, n) and covariance (B, n, n) of mixtures of Gaussians with weights (B, parts)."""
    means = np.stack([part.mean[rows] for part in parts], axis=1)
    mean = np.einsum("bp,bpi->bi", weight, means)
    apart = means - mean[:, None]
    covariances = np.stack([part.covariance[rows] for part in parts], axis=1)
    covariance = np.einsum("bp,bpij->bij", weight, covariances + apart[..., :, None] * apart[..., None, :])
    return mean, (covariance + covariance.transpose(0, 2, 1)) / 2
