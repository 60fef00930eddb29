"""What the command prints for people: tables of results, claims, findings. Computes nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from io import StringIO
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from testbed.doctor import Finding
from testbed.evaluate import ClaimResult, Interval, Summary

if TYPE_CHECKING:
    from testbed.result import RunResult
    from testbed.worker import Failure

# column of the results -> heading; those that no row has a value of are left out
HEADINGS = {
    "position_error_m.mean": "mean error m",
    "position_error_m.p50": "p50 m",
    "position_error_m.p95": "p95 m",
    "position_error_m.final": "final m",
    "availability": "available",
    "nees.mean": "NEES",
    "nees.inside_95": "in 95 %",
    "nis.mean": "NIS/dof",
    "time_lost_s.total": "lost s",
    "segment.identified": "right road",
    "settle_s": "settle s",
    "lost_runs": "lost runs",
    "steps": "steps",
    "turns": "turns",
    "distance_m": "way m",
    "found": "found",
    "cosine.mean": "cosine",
    "slips": "slips",
}


def amount(interval: Interval | None) -> str:
    """A mean with its standard error, as "0.31 ± 0.01"; "–" where there is none."""
    if interval is None or math.isnan(interval.mean):
        return "–"
    digits = 3 if 0 < abs(interval.mean) < 0.1 else 2 if abs(interval.mean) < 100 else 1
    spread = "" if math.isnan(interval.se) else f" ± {interval.se:.{digits}f}"
    return f"{interval.mean:.{digits}f}{spread}"


def results(console: Console, title: str, summaries: Sequence[Summary], sets: Mapping[int, Mapping[str, object]]) -> None:
    """One table a point of the sweep: an estimator a row, means over trials with their standard errors."""
    for point in dict.fromkeys(s.point for s in summaries):
        here = [s for s in summaries if s.point == point]
        shown = [c for c in HEADINGS if any(c in s.statistics and not math.isnan(s.statistics[c].mean) for s in here)]
        swept = ", ".join(f"{path} = {value}" for path, value in sets.get(point, {}).items())
        table = Table(title=f"{title}{': ' + swept if swept else ''}", title_justify="left", caption_justify="left")
        table.add_column("estimator")
        for column in shown:
            table.add_column(HEADINGS[column], justify="right", no_wrap=True)
        table.add_column("trials", justify="right")
        for s in here:
            n = max((i.n for i in s.statistics.values()), default=0)
            table.add_row(s.estimator, *[amount(s.statistics.get(column)) for column in shown], str(n))
        table.caption = "mean over trials ± standard error"
        limits = next((s.limits["nees.mean"] for s in here if "nees.mean" in s.limits), None)
        if limits and not math.isnan(limits[0]):
            table.caption += f"; NEES of an honest filter: {limits[0]:.1f} to {limits[1]:.1f} (95 %)"
        console.print(table)


def run(console: Console, result: RunResult) -> None:
    """All that a run found: tables, what the world offered, failures, claims, and where it is written."""
    scenario = result.scenario
    results(console, scenario.name, result.summaries, {point.index: point.set for point in scenario.points()})
    for point in scenario.points():
        world(console, result.world_means[point.index], point.set)
    failures(console, result.failures)
    claims(console, result.claims, str(scenario.path or scenario.name))
    if result.until is not None:
        console.print(str(result.until), soft_wrap=True)
    if result.folder is not None:
        console.print(f"written to {result.folder}", soft_wrap=True)


def failures(console: Console, found: Sequence[Failure]) -> None:
    """Trials that crashed, those of one cause together."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for failure in found:
        alike.setdefault((failure.stage, failure.estimator, failure.error), []).append(f"{failure.point}/{failure.trial}")
    for (stage, estimator, error), trials in alike.items():
        shown = ", ".join(trials[:6]) + (f" and {len(trials) - 6} more" if len(trials) > 6 else "")
        what = f"{estimator} in {stage}" if estimator else stage
        console.print(f"[red]failed[/red] {what}, point/trial {shown}: {escape(error)}", soft_wrap=True)


def text(result: RunResult) -> str:
    """What `run` prints, as plain text."""
    console = Console(width=160, highlight=False, color_system=None, file=StringIO())
    run(console, result)
    return console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]  it is the StringIO


def figures(console: Console, title: str, columns: Mapping[str, Sequence[object]]) -> None:
    """A table's columns as rows: for few rows of many figures."""
    table = Table(title=title, title_justify="left", show_header=False)
    for name, values in columns.items():
        table.add_row(name, *[f"{v:.6g}" if isinstance(v, float) else "–" if v is None else str(v) for v in values])
    console.print(table)


def world(console: Console, stimulus: Mapping[str, Interval], swept: Mapping[str, object]) -> None:
    """What the world offered, over all sensors, in one line; figures that had nothing to speak of are left out."""
    said = [f"{name} {amount(interval)}" for name, interval in stimulus.items() if "." not in name and interval.n]
    where = f" at {', '.join(f'{path} = {value}' for path, value in swept.items())}" if swept else ""
    if said:
        console.print(f"world{where}: {'; '.join(said)}", soft_wrap=True)


def claims(console: Console, judged: Sequence[ClaimResult], path: str) -> None:
    """Expectations that held, and those that did not with their place in the file."""
    for claim in judged:
        low, high = claim.interval
        between = "" if math.isnan(low) else f" (95 % interval {low:.4g} to {high:.4g})"
        got = "no value" if math.isnan(claim.value) else f"{claim.value:.4g}"
        mark = "[green]holds[/green]" if claim.ok else "[red]FAILED[/red]"
        note = f"; {claim.note}" if claim.note else ""
        place = path if claim.line is None else f"{path}:{claim.line}"  # a claim set from outside stands in no line
        console.print(f"{mark} {place}: {claim.text}: got {got}{between}{note}", highlight=False, soft_wrap=True)


def findings(console: Console, found: Sequence[Finding]) -> None:
    """The doctor's list."""
    marks = {"ok": "[green]ok    [/green]", "note": "[yellow]note  [/yellow]", "broken": "[red]BROKEN[/red]"}
    for finding in found:
        console.print(f"{marks[finding.level]} {finding.what}", highlight=False, soft_wrap=True)
        if finding.mend:
            console.print(f"       {finding.mend}", highlight=False, markup=False, soft_wrap=True)
