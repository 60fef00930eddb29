"""The posterior Cramér-Rao bound on position, beside which an error can be judged.

P. Tichavský, C. H. Muravchik, A. Nehorai, "Posterior Cramér-Rao bounds for discrete-time nonlinear filtering", IEEE Transactions on
Signal Processing 46 (1998): for linear motion the bound is the covariance of a Kalman filter whose measurements are linearised at the
true states; gone back over (Rauch, Tung, Striebel) it bounds what looks at the whole recording.

It binds methods that are unbiased on average over tracks drawn from this very model. On one given track a biased method may well be
better: by its prior, by knowing the height, by luck. The bound is about levels in dB, whatever the method makes of them.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Decibels, Metres, MetresPerSecond, Seconds
from testbed.recording import Trial
from testbed.types import Reads, Track
from testbed.units import SPEED_OF_LIGHT

SLOPE = 10 / np.log(10)  # dB per unit of the natural logarithm


class PositionBoundConfig(BaseConfig):
    """The model that the bound is of: what was drawn in the scenario, and what methods are told of motion and start.

    sigma_db, path_loss_exponent : of the law by which levels are made, without a pattern
    antennas, tags               : patterns over ids: the reads that count
    acceleration_std_mps2        : constant from one instant of reads to the next
    position_std_m, velocity_std_mps, age_s : of the prior
    height_std_m                 : of a height that is known at every instant of reads; None for none
    phase_noise_rad, longest_s   : of a read's phase on the one carrier, whose changes within `longest_s` are known; None for none
    skip_s                       : times before it are left out
    """

    sigma_db: Annotated[Decibels, Field(gt=0, le=40)] = 4.0
    path_loss_exponent: Annotated[float, Field(gt=0, le=12)] = 4.0
    antennas: str = "*"
    tags: str = "*"
    acceleration_std_mps2: Annotated[float, Field(gt=0, le=1e3)] = 0.4
    position_std_m: Annotated[Metres, Field(gt=0, le=1e3)] = 0.5
    velocity_std_mps: Annotated[MetresPerSecond, Field(gt=0, le=1e3)] = 0.25
    age_s: Annotated[Seconds, Field(ge=0, le=3600)] = 0.0
    height_std_m: Annotated[Metres, Field(gt=0, le=100)] | None = None
    phase_noise_rad: Annotated[float, Field(gt=0, le=3)] | None = None
    longest_s: Annotated[Seconds, Field(gt=0, le=10)] = 0.15
    skip_s: Annotated[Seconds, Field(ge=0)] = 0.0


class PositionBound:
    """Root of the mean, over the instants of reads, of the bound on the squared distance. NaN for a target that was never read."""

    Config = PositionBoundConfig
    on_request: ClassVar[bool] = True  # of one model, which the scenario has to name
    columns: ClassVar[dict[str, str]] = {
        "position_bound_m.filtered": "posterior Cramér-Rao bound on the distance to the truth for methods that go forward, m",
        "position_bound_m.smoothed": "the same for methods that look back at the end, m",
    }

    def __init__(self, config: PositionBoundConfig) -> None:
        self._config = config
        self._trial: Trial | None = None  # the last one, and its bounds: all estimators of a trial are scored one after another
        self._known: dict[int, tuple[float, float]] = {}

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,), m."""
        order = {str(name): i for i, name in enumerate(trial.recording.targets.name)}
        rows = [self._once(trial, order[str(name)]) for name in track.target]
        return dict(zip(self.columns, np.array(rows, dtype=np.float64).reshape(-1, 2).T, strict=True))

    def _once(self, trial: Trial, target: int) -> tuple[float, float]:
        """The bounds do not depend on the estimator: worked out for the first one of a trial, and told again to the others."""
        if self._trial is not trial:
            self._trial, self._known = trial, {}
        if target not in self._known:
            self._known[target] = self._bounds(trial, target)
        return self._known[target]

    def _bounds(self, trial: Trial, target: int) -> tuple[float, float]:
        reads = self._reads(trial, target)
        t = np.unique(reads.t)
        if not len(t):
            return np.nan, np.nan
        gradient = self._gradients(trial, target, reads)
        information = np.zeros((len(t), 6, 6))
        gained = gradient[:, :, None] * gradient[:, None, :] / self._config.sigma_db**2
        np.add.at(information[:, :3, :3], np.searchsorted(t, reads.t), gained)
        if self._config.phase_noise_rad is not None:
            now, gained = self._changes(trial, target, reads, self._config.phase_noise_rad)
            np.add.at(information, np.searchsorted(t, now), gained)
        if self._config.height_std_m is not None:
            information[:, 2, 2] += self._config.height_std_m**-2
        counts = t >= self._config.skip_s
        filtered, smoothed = self._covariances(np.diff(t, prepend=-self._config.age_s), information)
        if not counts.any():
            return np.nan, np.nan
        return _rms(filtered[counts]), _rms(smoothed[counts])

    def _reads(self, trial: Trial, target: int) -> Reads:
        recording, config = trial.recording, self._config
        reads = recording.streams.get("reads", Reads.empty())
        if not isinstance(reads, Reads):
            raise TypeError(f"the stream reads is made of {type(reads).__name__}")
        tags = [tag for tag in recording.target_tags[target] if fnmatchcase(str(recording.site.tags.id[tag]), config.tags)]
        antennas = [i for i, id in enumerate(recording.site.antennas.id) if fnmatchcase(str(id), config.antennas)]
        return reads.take(np.isin(reads.tag, tags) & np.isin(reads.antenna, antennas) & np.isfinite(reads.rssi))

    def _gradients(self, trial: Trial, target: int, reads: Reads) -> Array:
        """(N, 3) dB/m: of the level by the target's position, at the truth."""
        times, place = np.unique(reads.t, return_inverse=True)
        apart = trial.target_states(times)[place, target, :3] - trial.recording.site.antennas.position[reads.antenna]
        squared = np.maximum(np.einsum("ni,ni->n", apart, apart), 1e-12)
        return -self._config.path_loss_exponent * SLOPE * apart / squared[:, None]

    def _changes(self, trial: Trial, target: int, reads: Reads, noise: float) -> tuple[Array, Array]:
        """When distances to antennas are known to have changed (N,) s, and what each change tells of the state then (N, 6, 6).

        As in `estimators.phase_changes`: one constant velocity since the read before, errors of changes taken as independent.
        """
        site = trial.recording.site
        if len(site.frequencies) != 1:
            raise ValueError(f"position_bound: changes of phase need one carrier, and the site has {len(site.frequencies)}")
        metres = SPEED_OF_LIGHT / (4 * np.pi * float(site.frequencies[0]))
        order = np.lexsort((reads.t, reads.tag, reads.antenna))
        antenna, tag, t = reads.antenna[order], reads.tag[order], reads.t[order]
        again = (np.diff(antenna) == 0) & (np.diff(tag) == 0) & (np.diff(t) <= self._config.longest_s)
        now, span, place = t[1:][again], np.diff(t)[again], site.antennas.position[antenna[1:][again]]
        toward, came = (self._directions(trial, target, when, place) for when in (now, now - span))
        h = np.concatenate([toward - came, span[:, None] * came], axis=1)
        variance = 2 * (noise * metres) ** 2 + (self._config.acceleration_std_mps2 * span**2 / 2) ** 2
        return now, h[:, :, None] * h[:, None, :] / variance[:, None, None]

    def _directions(self, trial: Trial, target: int, t: Array, place: Array) -> Array:
        """(N, 3) unit vectors from places (N, 3) m to the target at the times (N,) s."""
        times, which = np.unique(t, return_inverse=True)
        apart = trial.target_states(times)[which, target, :3] - place
        return apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)

    def _covariances(self, dt: Array, information: Array) -> tuple[Array, Array]:
        """(K, 6, 6) each: of a filter after each instant, and of a smoother; dt[0] is from the prior to the first one.

        information (K, 6, 6): what the instant itself tells of the state.
        """
        config = self._config
        p = np.diag([config.position_std_m**2] * 3 + [config.velocity_std_mps**2] * 3)
        filtered, predicted, transitions = [], [], []
        for h, gained in zip(dt, information, strict=True):
            f = np.eye(6) + h * np.eye(6, k=3)
            push = np.concatenate([np.full(3, h * h / 2), np.full(3, h)])[:, None] * np.tile(np.eye(3), (2, 1))
            p = f @ p @ f.T + config.acceleration_std_mps2**2 * push @ push.T
            predicted.append(p)
            transitions.append(f)
            p = np.linalg.solve(np.eye(6) + p @ gained, p)
            p = (p + p.T) / 2
            filtered.append(p)
        smoothed = [filtered[-1]]
        for k in range(len(dt) - 2, -1, -1):
            gain = np.linalg.solve(predicted[k + 1], transitions[k + 1] @ filtered[k]).T
            smoothed.append(filtered[k] + gain @ (smoothed[-1] - predicted[k + 1]) @ gain.T)
        return np.array(filtered), np.array(smoothed[::-1])


def _rms(covariance: Array) -> float:
    """Root of the mean over (K, 6, 6) of the trace of position, m."""
    return float(np.sqrt(np.trace(covariance[:, :3, :3], axis1=1, axis2=2).mean()))
