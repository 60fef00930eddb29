"""The report: one HTML file that holds everything it shows, opens without a network, and asks nobody for anything.

Made from an output folder alone, at the end of a run or years later; the same folder gives the same page, byte for byte.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from testbed.archive import StoreError
from testbed.report import cases, figures_guide, grids, player, words
from testbed.report.album import Picture, album
from testbed.report.amounts import capital, counted, listed
from testbed.report.cases import Case
from testbed.report.cloud_motion import cloud_motion
from testbed.report.covered import site
from testbed.report.figures import Drawing, Styles
from testbed.report.figures_gates import gates
from testbed.report.figures_plan import floor_plan
from testbed.report.figures_radio import phase_by_range, radio_strips
from testbed.report.figures_roads import clouds, curves, settling
from testbed.report.figures_run import error_distribution, sweep
from testbed.report.figures_time import consistency, error_over_time, signal_strength
from testbed.report.grids import Grid
from testbed.report.published import published
from testbed.report.study import GONE, Kept, Study, read
from testbed.scenario import from_text
from testbed.worker import Failure

NAME = "report.html"
MOST_RECORDINGS = 6  # drawn in one page
MOST_DISTRIBUTIONS = 12  # points of a sweep
MOST_FAILURES = 20  # kinds of them
MOST_TRACEBACK = 20_000  # letters


@dataclass(frozen=True)
class Shown:
    """A recording as the page shows it; only the first has `data`, for the player."""

    heading: str
    plan: Drawing
    errors: Drawing | None
    figures: tuple[Drawing, ...]
    album: tuple[Picture, ...]
    no_album: str
    is_wide: bool = False
    targets: tuple[str, ...] = ()
    estimators: tuple[tuple[str, str], ...] = ()
    data: str = ""
    player_notes: str = ""
    guide: str = ""


@dataclass(frozen=True)
class PointShown:
    """One point of the sweep: its tables and its distribution."""

    label: str
    results: Grid
    legend: str
    world: Grid | None
    pairs: Grid | None
    everything: Grid
    distribution: Drawing | None


@dataclass(frozen=True)
class FailureShown:
    """Failures of one cause."""

    what: str
    error: str
    where: str
    traceback: str


@dataclass(frozen=True)
class Recordings:
    """What came of the recordings: computed cases, and what is to be said of those that are not shown."""

    cases: tuple[Case, ...] = ()
    notes: tuple[str, ...] = field(default=())


def write(folder: Path) -> Path:
    """Make `folder`/report.html of the run in `folder`, and return its path. What was there before is replaced, whole or not at all.

    StoreError for a folder without a finished run, and where the disk refuses.
    """
    folder = Path(folder)
    content = page(read(folder)).encode()
    path = folder / NAME
    rough = path.with_name(f".{NAME}.{os.getpid()}.part")
    try:
        rough.write_bytes(content)
        rough.replace(path)
    except OSError as error:
        rough.unlink(missing_ok=True)
        raise StoreError(f"the report can't be written to {path}: {error.strerror or error}") from error
    return path


def page(study: Study) -> str:
    """The whole page of a run."""
    styles = Styles(study.estimators)
    found = _recordings(study)
    shown = [_shown(case, study, styles, i) for i, case in enumerate(found.cases)]
    points = [_point(study, point, found.cases, styles) for point in dict.fromkeys(s.point for s in study.summaries)]
    failures, failure_notes = _failures(study.failures)
    verdict = words.verdict(study)
    claims, papers = grids.claims(study), published(study)
    covered = site(study)
    text = str(study.manifest["scenario"]["text"])
    context = {
        "title": study.title,
        "name": study.name,
        "started": study.started,
        "summary": words.summary(study),
        "verdict": {"text": verdict[0], "mark": "good" if verdict[1] else "bad"} if verdict else None,
        "gap": study.gap,
        "contents": _contents(bool(claims), bool(papers), bool(failures), bool(covered)),
        "identity": grids.identity(study),
        "commands": words.commands(study),
        "text": text,
        "text_lines": len(text.splitlines()),
        "overrides": _overrides(study),
        "points": points,
        "why_none": "every trial failed, see below." if study.failures else "the scenario names no estimator, or no target.",
        "sweep": sweep(study, styles, "sweep"),
        "over_runs": [drawn for drawn in (curves(study, "curves"), settling(study, "settling"), *gates(study)) if drawn],
        "claims": claims,
        "papers": papers,
        "coverage": covered,
        "first": shown[0] if shown else None,
        "others": shown[1:],
        "no_recording": _no_recording(study),
        "recording_notes": found.notes,
        "failures": failures,
        "failure_notes": failure_notes,
        "method": words.method(study),
        "omissions": words.omissions(study.scenario),
    }
    return _rendered(context)


def _rendered(context: dict[str, Any]) -> str:
    template = resources.files("testbed.report") / "template"
    source, style, script = ((template / name).read_text(encoding="utf-8") for name in ("report.html", "report.css", "player.js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(source).render(page=context, style=style, script=script, script_hash=digest)


def _contents(claims: bool, papers: bool, failures: bool, coverage: bool) -> list[tuple[str, str]]:
    found = [("again", "What was run"), ("results", "Results")]
    found += [("published", "Beside the paper")] if papers else []
    found += [("claims", "Expectations")] if claims else []
    found += [("coverage", "Coverage")] if coverage else []
    found += [("recordings", "One trial, seen")]
    found += [("failures", "What failed")] if failures else []
    return [*found, ("notes", "What to keep in mind")]


def _overrides(study: Study) -> str:
    """The scenario as it ran, where the command's options or --set made another one of the text."""
    scenario = study.manifest["scenario"]
    try:
        same = from_text(scenario["text"]).document == scenario["document"]
    except GONE:  # its tables lay beside the file, or a plug-in is gone
        same = False
    return "" if same else json.dumps(scenario["document"], indent=1, ensure_ascii=False)


# ---------------------------------------------------------------- results


def _point(study: Study, point: int, found: Sequence[Case], styles: Styles) -> PointShown:
    results = grids.results(study, point)
    drawn = error_distribution(study, point, found, styles, f"distribution-{point}") if point < MOST_DISTRIBUTIONS else None
    honest = any(h.text == "NEES" for h in results.heads)
    legend = "Errors are distances to the truth; “available” is the share of report times with an estimate that the method stands by."
    if honest:
        legend += " NEES and NIS are given with their 95 % χ² limits: above them a filter is too sure of itself, below too modest."
    return PointShown(
        label=study.label(point) or "All trials",
        results=results,
        legend=legend,
        world=grids.world(study, point),
        pairs=grids.pairs(study, point),
        everything=grids.everything(study, point),
        distribution=drawn,
    )


# ---------------------------------------------------------------- recordings


def _recordings(study: Study) -> Recordings:
    """The recordings that are drawn: the first of each point, then more while there is room. One that can't be read is named."""
    first = {kept.point: kept for kept in reversed(study.recordings)}
    order = [*sorted(first.values(), key=lambda k: k.point), *(k for k in study.recordings if first[k.point] != k)]
    found: list[Case] = []
    notes: list[str] = []
    for kept in order:
        if len(found) == MOST_RECORDINGS:
            break
        try:
            found.append(cases.load(study, kept))
        except StoreError as error:
            notes.append(f"{capital(str(error))}.")
    left = len(order) - len(found) - len(notes)
    if left > 0:
        notes.append(f"{counted(left, 'more recording')} kept and not drawn here: a page shows {MOST_RECORDINGS} at most.")
    return Recordings(tuple(found), tuple(notes))


def _no_recording(study: Study) -> str:
    """Why there is nothing to see, and how there will be."""
    kept = str(study.manifest.get("keep", ""))
    how = "run it again with --keep first:1 (or failed, worst:N, all)"
    if study.recordings:
        return f"The recordings that were kept can't be read; {how}."
    if kept == "none":
        return f"No recording was kept (--keep none), so plan, error over time and player can't be made; {how}."
    return f"No recording was kept (the run kept {kept or 'none'}), so plan, error over time and player can't be made; {how}."


def _heading(study: Study, kept: Kept) -> str:
    label = study.label(kept.point)
    failed = any((f.point, f.trial) == (kept.point, kept.trial) for f in study.failures)
    return f"Trial {kept.trial}{f' at {label}' if label else ''}{', which failed in part' if failed else ''}"


def _shown(case: Case, study: Study, styles: Styles, index: int) -> Shown:
    where = _heading(study, case.kept)
    plan = floor_plan(case, styles, f"plan-{index}", where)
    errors = error_over_time(case, styles, f"errors-{index}", where)
    figures = [*figures_guide.figures(case, styles, f"guide-{index}", where), clouds(case, styles, f"clouds-{index}", where)]
    figures += [signal_strength(case, f"rssi-{index}", where), consistency(case, styles, f"nees-{index}", where)]
    if not index:  # they are large: one recording's are enough to look at
        figures[-1:-1] = [*radio_strips(case, f"radio-{index}", where), phase_by_range(case, f"phase-{index}", where)]
    pictures = album(case, styles, moving=index == 0)
    moving = None if index else cloud_motion(case, styles)
    seen = (*pictures.pictures, *([moving] if moving else []))
    shown = Shown(where, plan, errors, tuple(f for f in figures if f), seen, pictures.note)
    if index:
        return shown
    content = player.data(case, styles, plan, errors)
    return replace(
        shown,
        is_wide=case.is_wide,
        targets=tuple(aim.name for aim in case.aims),
        estimators=tuple((one["id"], one["colour"]) for one in content["estimators"]),
        data=player.text(content),
        guide=figures_guide.guide_of(case) if case.trial.walk is not None else "",
        player_notes=_player_notes(content),
    )


def _player_notes(content: dict[str, Any]) -> str:
    said = [content["reads"]["thinned"]] if content["reads"]["thinned"] else []
    if content["every"] > 1:
        said.append(f"One in {content['every']} reports is shown.")
    return " ".join(said)


# ---------------------------------------------------------------- failures


def _failures(found: Sequence[Failure]) -> tuple[list[FailureShown], list[str]]:
    """Failures, those of one cause together, each with the traceback of its first trial."""
    alike: dict[tuple[str, str, str], list[Failure]] = {}
    for failure in found:
        alike.setdefault((failure.stage, failure.estimator, failure.error), []).append(failure)
    shown = []
    for (stage, estimator, error), group in list(alike.items())[:MOST_FAILURES]:
        trials = listed([f"{f.point}/{f.trial}" for f in group], 12)
        trace = group[0].traceback
        if len(trace) > MOST_TRACEBACK:
            trace = f"{trace[: MOST_TRACEBACK // 2]}\n… {len(trace) - MOST_TRACEBACK:,} letters left out …\n{trace[-MOST_TRACEBACK // 2 :]}"
        shown.append(FailureShown(f"{estimator} in {stage}" if estimator else stage, error, f"point/trial {trials}", trace))
    more = len(alike) - len(shown)
    notes = [f"{counted(more, 'more kind', 'more kinds')} of failures are in failures.parquet."] if more > 0 else []
    return shown, notes
