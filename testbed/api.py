"""What the command does, for Python: `testbed.run`, `testbed.replay`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from testbed import batch
from testbed.keep import DEFAULT
from testbed.progress import Progress, choose
from testbed.replay import Replay as Replay
from testbed.replay import replay as replay
from testbed.result import RunResult
from testbed.scenario import Scenario, from_dict, load, only, override
from testbed.until import MOST, Until

__all__ = ["Replay", "replay", "run", "scenario_of"]


def scenario_of(
    scenario: Scenario | Mapping[str, Any] | str | Path,
    *,
    trials: int | None = None,
    seed: int | None = None,
    estimators: Sequence[str] = (),
    sets: Mapping[str, Any] | Sequence[str] = (),
) -> Scenario:
    """A scenario from an object, a mapping, a file or a shipped name, with values set as by the command's options."""
    if isinstance(scenario, Mapping):
        scenario = from_dict(scenario, sets)
    elif isinstance(scenario, str | Path):
        scenario = load(scenario, sets)
    elif sets:
        scenario = override(scenario, sets)
    counts = {name: value for name, value in (("trials", trials), ("seed", seed)) if value is not None}
    if counts:
        scenario = override(scenario, counts)
    return only(scenario, estimators) if estimators else scenario


def run(
    scenario: Scenario | Mapping[str, Any] | str | Path,
    *,
    trials: int | None = None,
    seed: int | None = None,
    estimators: Sequence[str] = (),
    set: Mapping[str, Any] | Sequence[str] = (),
    jobs: int | Literal["auto"] = 1,
    out: str | Path | None = None,
    keep: str = DEFAULT,
    resume: bool = False,
    force: bool = False,
    until: str = "",
    most_trials: int = MOST,
    cluster: str = "",
    shared: str = "",
    progress: bool | Progress = False,
) -> RunResult:
    """Run a scenario's trials, and judge what it expects: `testbed run` as a function.

    scenario   : a file, the name of one that ships, a mapping as the YAML would give it, or a Scenario
    estimators : ids of those to run; all where left out. set : values by path, as `--set`
    jobs       : processes, "auto" for one a core. A script that uses more than one needs the usual `if __name__ == "__main__":`; one
                 is this process, which a crash in native code then ends
    out        : the output folder; nothing is written where left out. resume : go on in it; what would come out the same stays
    until      : "ukf.position_error_m.mean ± 2%": run more trials until the interval is that narrow, or there are most_trials
    cluster    : a dask scheduler's address or "slurm:PROFILE.yaml", shared : a place for its recordings (see `testbed.cluster`)
    progress   : show it on stderr

    print() shows the result as the command does, a notebook as a table; `.table` is an Arrow table (`.table.to_pandas()`),
    `.rows` the same by columns, `.document()` the command's JSON.
    Raises ScenarioError for mistakes in the scenario, StoreError for a folder that can't be used, Interrupted on Ctrl-C,
    ValueError for an `until` that can't be.
    """
    shown = choose(sys.stderr) if progress is True else progress or None
    return batch.run(
        scenario_of(scenario, trials=trials, seed=seed, estimators=estimators, sets=set),
        out=None if out is None else Path(out),
        jobs=jobs,
        keep=keep,
        resume=resume,
        force=force,
        command=("testbed.run",),
        cluster=cluster,
        shared=shared,
        until=Until.parse(until, most_trials) if until else None,
        progress=shown,
    )
