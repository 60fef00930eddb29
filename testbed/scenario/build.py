"""A plain document to a Scenario: every part judged, every mistake placed, all of them told at once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from testbed import plugins
from testbed.report.cameras import CameraSpec
from testbed.scenario import overrides, sections, tags
from testbed.scenario.claims import Claim, claims
from testbed.scenario.model import MAX_INSTANTS, MAX_REPORTS, MAX_RUNS, Document
from testbed.scenario.problems import Loc, Problem
from testbed.scenario.published import Publication, publications
from testbed.scenario.scenario import Point, Scenario
from testbed.scenario.source import Review, Source
from testbed.scenario.wording import shown

_PLAIN = (
    "name", "title", "seed", "trials", "block", "duration_s", "prior", "report_hz", "hold_s", "step_hz", "truth_hz", "rays", "survey",
    "sweep", "report",
)  # fmt: skip


def build(document: Any, source: Source, text: str, path: Path | None) -> Scenario:
    """The scenario of a document and, with it, of every point of its sweep. ScenarioError with all mistakes of them all."""
    review = Review(source, source.faults)
    if not isinstance(document, dict):
        review.note((), f"a scenario is a mapping that begins with a name, as in name: dock, not {shown(document)}")
        review.finish()
    document = {name: value for name, value in document.items() if value is not None}  # a key with nothing after it is not given
    source.tables.update({n: t for n, t in files.items() if isinstance(t, str)} if isinstance(files := document.get("files"), dict) else {})
    whole = _whole(document, review, text, path)
    choices = overrides.choices(document, review)
    if whole is not None:
        _limit_runs(whole, choices, review)
    singly = whole is None or bool(review.problems)
    points = _points(document, source, choices, singly, review.problems, text, path)
    review.finish()
    if whole is None:
        raise AssertionError("a document without mistakes makes a scenario")
    published, kept = _published(document, whole, points, review)
    review.finish()
    document = _with_files(document, points, source)
    return replace(whole, swept=tuple(points), published=published, expect=(*whole.expect, *kept), document=document)


def _published(
    document: dict[str, Any], whole: Scenario, points: list[Point], review: Review
) -> tuple[tuple[Publication, ...], tuple[Claim, ...]]:
    columns = sections.columns(list(whole.metrics), review)
    return publications(document.get("published"), points or [Point(0, {}, whole)], _ids(document.get("estimators")), columns, review)


def _points(
    document: dict[str, Any],
    source: Source,
    choices: list[overrides.Choice],
    singly: bool,
    problems: list[Problem],
    text: str,
    path: Path | None,
) -> list[Point]:
    found: list[Point] = []
    for index, indices in enumerate(overrides.combinations(choices, singly) if choices else ()):
        varied, place = overrides.varied(document, source, choices, indices)
        review = Review(place, source.faults)
        scenario = _whole(varied, review, text, path)
        problems += review.problems
        if scenario is None:
            if len(problems) > 100:  # enough to work on; a sweep of thousands of wrong points is not spelt out
                break
            continue
        values = {name: choices[i][3][n] for i, (name, n) in enumerate(zip((c[0] for c in choices), indices, strict=True))}
        found.append(Point(index, values, replace(scenario, document=_with_files(varied, [], source))))
    return found


def _whole(raw: dict[str, Any], review: Review, text: str, path: Path | None) -> Scenario | None:
    """A document as one scenario, its sweep aside; None with mistakes put down."""
    document = review.check(Document, raw, ())
    if document is not None:
        _limits(document, review)
    world = sections.one("worlds", raw["world"], ("world",), review, id="world") if isinstance(raw.get("world"), dict) else None
    groups = {
        group: sections.every(raw.get(group), (group,), review, partial(_section, group, review))
        for group in ("actors", "sensors", "estimators")
    }
    metrics = _metrics(raw, review)
    cameras = sections.every(raw.get("cameras"), ("cameras",), review, lambda item, loc: review.check(CameraSpec, item, loc))
    for group in (*groups, "metrics", "cameras"):
        sections.distinct(raw.get(group), group, review)
    rules = tags.rules(raw.get("tags"), ("tags",), None, review)
    tags.distinct([*rules, *(tag for actor in groups["actors"] for tag in actor.tags)], {actor.id for actor in groups["actors"]}, review)
    columns = sections.columns(metrics, review)
    expect = claims(raw.get("expect"), _ids(raw.get("estimators")), columns, review)
    if document is None or world is None or review.problems:
        return None
    plain: dict[str, Any] = {name: getattr(document, name) for name in _PLAIN}
    listed: dict[str, Any] = {group: tuple(found) for group, found in groups.items()}
    return Scenario(
        **plain, **listed, world=world, metrics=tuple(metrics), cameras=tuple(cameras), tags=rules, targets=tuple(document.targets),
        references=tuple(document.references),
        expect=expect, document=raw, text=text, path=path, source=review.source,
    )  # fmt: skip


def _section(group: str, review: Review, raw: Any, loc: Loc) -> Any:
    return sections.actor(raw, loc, review) if group == "actors" else sections.one(group, raw, loc, review)


def _metrics(raw: dict[str, Any], review: Review) -> list[Any]:
    """The metrics asked for; where none are named every registered one, with its defaults, but those that speak on request alone."""
    if "metrics" in raw:
        return sections.every(raw["metrics"], ("metrics",), review, partial(_section, "metrics", review))
    found = [sections.one("metrics", {"kind": name}, ("metrics",), review) for name in plugins.names("metrics")]
    return [section for section in found if section is not None and not getattr(plugins.load("metrics", section.kind), "on_request", False)]


def _ids(raw: Any) -> list[str]:
    """Ids of sections as written, whether or not the rest of them is right: a claim on a broken one is not another mistake."""
    return [str(item.get("id", item.get("kind"))) for item in raw if isinstance(item, dict)] if isinstance(raw, list) else []


def _limits(document: Document, review: Review) -> None:
    """Limits that concern two fields."""
    if document.step_hz % document.truth_hz:
        review.note(("truth_hz",), f"must divide step_hz, and {document.truth_hz} does not divide {document.step_hz}")
    instants, reports = document.duration_s * document.truth_hz, document.duration_s * document.report_hz
    if instants > MAX_INSTANTS:
        review.note(("duration_s",), f"{instants:,.0f} instants of truth (duration_s × truth_hz), at most {MAX_INSTANTS:,} are kept")
    if reports > MAX_REPORTS:
        review.note(("duration_s",), f"{reports:,.0f} reports (duration_s × report_hz), at most {MAX_REPORTS:,} are kept")


def _limit_runs(whole: Scenario, choices: list[overrides.Choice], review: Review) -> None:
    runs = math.prod((whole.trials, max(1, len(whole.estimators)), *(len(values) for *_, values in choices)))
    if runs > MAX_RUNS:
        place = "sweep" if choices else "trials"
        review.note((place,), f"{runs:,} runs (trials × points × estimators), at most {MAX_RUNS:,} are made", at_key=True)


def _tables(part: Any) -> Iterator[str]:
    """Names of the tables that a part of a document speaks of, as in csv: pattern.csv."""
    for key, value in part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ():
        if key == "csv" and isinstance(value, str):
            yield value
        else:
            yield from _tables(value)


def _with_files(document: dict[str, Any], points: list[Point], source: Source) -> dict[str, Any]:
    """The document with the tables that it and its points name, so that it can be read again without them."""
    plain = {name: value for name, value in document.items() if name != "files"}
    rules = [rule for part in (document, *document.get("actors", [])) for rule in part.get("tags") or []]
    named = {rule["csv"]: source.tables[rule["csv"]] for rule in rules if rule.get("csv") is not None}
    named.update({name: source.tables[name] for name in _tables(document.get("sensors")) if name in source.tables})
    for point in points:
        named.update(point.scenario.document.get("files", {}))
    return {**plain, "files": named} if named else plain
