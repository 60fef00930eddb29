"""What a run found: its tables, figures and claims, for Python, for people, for notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from testbed.evaluate import KEYS, ClaimResult, Interval, Rows, Summary, check_claims, mean_interval, metric_columns, plain, summarise
from testbed.published import compare
from testbed.published import document as published_document
from testbed.scenario import Scenario
from testbed.tables import frame
from testbed.until import Stopped
from testbed.worker import BlockResult, Failure


@dataclass(frozen=True, repr=False)
class RunResult:
    """What a run found.

    rows, world, timings : the tables of the output folder, by column (`testbed.evaluate.Rows`)
    table                : rows as an Arrow table
    until                : how many trials were enough, where that was asked for
    world_means          : by point and stimulus, the mean over trials
    folder               : where it is written, None where it is not
    """

    scenario: Scenario
    rows: Rows
    world: Rows
    timings: Rows
    failures: tuple[Failure, ...]
    summaries: tuple[Summary, ...]
    world_means: dict[int, dict[str, Interval]]
    claims: tuple[ClaimResult, ...]
    folder: Path | None = None
    until: Stopped | None = None

    @property
    def table(self) -> pa.Table:
        """The rows as an Arrow table, ready for pandas: `result.table.to_pandas()`. A row a point, trial, estimator and target."""
        return frame(self.rows)

    def __str__(self) -> str:
        """What `testbed run` prints."""
        from testbed.console import text  # rich, only where somebody looks

        return text(self)

    def __repr__(self) -> str:
        points = len(self.scenario.points())
        some = f"{points} points, " if points > 1 else ""
        found = {s.estimator: s.statistics.get("position_error_m.mean") for s in self.summaries if s.point == 0}
        errors = ", ".join(f"{id} {i.mean:.3g} ± {i.se:.1g} m" for id, i in found.items() if i is not None)
        held = f"{sum(claim.ok for claim in self.claims)} of {len(self.claims)} claims hold"
        return f"<RunResult {self.scenario.name}: {some}{self.scenario.trials} trials, {len(self.failures)} failures, {held}; {errors}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the means over trials, and claims that did not hold."""
        from testbed.notebook import html

        return html(self)

    @property
    def ok(self) -> bool:
        """Every claim holds, and no trial failed."""
        return not self.failures and all(claim.ok for claim in self.claims)

    def document(self) -> dict[str, Any]:
        """What `testbed run --json` prints. Failures are listed without their tracebacks, which failures.parquet holds."""
        points = [
            {
                "set": point.set,
                "estimators": {s.estimator: s.document() for s in self.summaries if s.point == point.index},
                "world": {name: plain(mean.mean) for name, mean in self.world_means[point.index].items()},
            }
            for point in self.scenario.points()
        ]
        return {
            "scenario": self.scenario.name,
            "hash": self.scenario.hash,
            "seed": self.scenario.seed,
            "trials": self.scenario.trials,
            "points": points,
            "expect": [claim.document() for claim in self.claims],
            **({"until": self.until.document()} if self.until else {}),
            "published": published_document(compare(self.scenario.published, self.rows, self.world), [point["set"] for point in points]),
            "failures": [
                {"point": f.point, "trial": f.trial, "estimator": f.estimator, "stage": f.stage, "error": f.error} for f in self.failures
            ],
            "ok": self.ok,
        }


def judged(scenario: Scenario, whole: BlockResult, folder: Path | None, until: Stopped | None) -> RunResult:
    """The figures and claims of all of a run's blocks put together."""
    points = [point.index for point in scenario.points()]
    nothing = {name: np.empty(0, dtype=np.int64 if name in ("point", "trial", "seed") else np.str_) for name in KEYS}
    rows, world = whole.rows or nothing, whole.world or nothing
    means = {
        point: {name: mean_interval(world[name][world["point"] == point].astype(np.float64)) for name in metric_columns(world)}
        for point in points
    }
    summaries = tuple(summarise(rows))
    claims = tuple(check_claims(scenario.expect, rows, world, points))
    return RunResult(scenario, rows, world, whole.timings, whole.failures, summaries, means, claims, folder, until)
