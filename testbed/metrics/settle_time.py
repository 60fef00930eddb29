"""How long a method seeks before it tracks, and whether it ever does."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from testbed.columns import Array
from testbed.metrics.track_error import distance
from testbed.quantity import Config as BaseConfig
from testbed.quantity import Metres, Seconds
from testbed.recording import Trial
from testbed.types import Status, Track


class SettleTime:
    """The settle time of a row: the start of its first `hold_s` with an error below `error_m`; a row without any is lost.

    Settle times of lost rows are infinite, which a mean can't hold: `settle_s` speaks of the others, so read it beside `lost_runs`.
    Quantiles are asked for as shares: `settled_in_time` >= 0.5 says that the median over runs, lost ones kept, is within `limit_s`.
    `tracking.share` and `tracking.right` judge what a method says of itself (status OK): how often, and how often within `error_m`.
    """

    on_request: ClassVar[bool] = True  # for methods that begin anywhere: scenarios name it

    class Config(BaseConfig):
        """dims: 2 on the floor, 3 in space. A track that ends before hold_s are over does not settle in them."""

        error_m: Annotated[Metres, Field(gt=0)] = 2.0
        hold_s: Annotated[Seconds, Field(gt=0)] = 10.0
        limit_s: Annotated[Seconds, Field(ge=0)] = 18.0
        skip_s: Annotated[Seconds, Field(ge=0)] = 0.0
        dims: Literal[2, 3] = 2

    columns: ClassVar[dict[str, str]] = {
        "settle_s": "start of the first stretch with a small error, s; runs without one are left out",
        "settled_in_time": "1 for a run that settled within the limit, else 0",
        "lost_runs": "1 for a run that never settled, else 0",
        "tracking.share": "share of report times at which the method said that it tracks",
        "tracking.right": "of those, the share with an error below the threshold",
    }

    def __init__(self, config: Config) -> None:
        self._config = config

    def compute(self, track: Track, truth: Array, trial: Trial) -> dict[str, Array]:
        """Columns (B,)."""
        c = self._config
        chosen = track.t >= c.skip_s
        good = (distance(track, truth, c.dims) <= c.error_m)[chosen]  # NaN compares as false
        t, tracks = track.t[chosen], (track.status == Status.OK)[chosen]
        settle = np.array([first_stretch(t, g, c.hold_s) for g in good.T]).reshape(len(track.trial))
        said = tracks.sum(axis=0)
        never = np.isinf(settle)
        return {
            "settle_s": np.where(never, np.nan, settle),
            "settled_in_time": (settle <= c.limit_s).astype(np.float64),
            "lost_runs": never.astype(np.float64),
            "tracking.share": tracks.mean(axis=0) if len(t) else np.full(len(settle), np.nan),
            "tracking.right": np.divide((tracks & good).sum(axis=0), said, out=np.full(len(settle), np.nan), where=said > 0),
        }


def first_stretch(t: Array, good: Array, hold: float) -> float:
    """Start (s) of the first unbroken stretch of `good` (K,) report times t (K,) that lasts `hold` s, inf where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2):
        if t[end - 1] - t[begin] >= hold - 1e-9:
            return float(t[begin])
    return np.inf
