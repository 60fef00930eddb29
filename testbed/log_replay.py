"""Estimators on a customer's log: `testbed replay LOG --site site.yaml`. With a truth it is a run like any other, scored and reported.

Without one there are tracks, and what the estimators say of themselves.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed import batch, tables
from testbed.archive import StoreError
from testbed.estimate import row_seeds, run
from testbed.logs.bad import BadRows, LogError
from testbed.logs.library import Piece, pieces
from testbed.logs.recordings import bodiless, recording_of
from testbed.logs.site import SiteModel, load_site
from testbed.plugins import load
from testbed.prior import draw_prior
from testbed.progress import Progress
from testbed.scenario import Scenario, from_dict
from testbed.types import POSITION, Status, Track

LEFT_OUT = "left-out.csv"
PROTOCOL = "the log is replayed through the site as it is described; nothing is fitted on it"


@dataclass(frozen=True)
class LogReplay:
    """What came of a log. `result` is the scored run where there is a truth; tracks by estimator where there is none."""

    log: Piece
    scenario: Scenario
    result: batch.RunResult | None
    tracks: Mapping[str, Track]

    @property
    def bad(self) -> BadRows:
        """The rows that were left out."""
        return self.log.log.bad

    def said(self) -> list[dict[str, Any]]:
        """Without a truth: of each estimator and target where it was last seen, and how often it had an estimate."""
        return [row for id, track in self.tracks.items() for row in _said(id, track)]


def replay_log(
    path: str | Path,
    site: SiteModel | str | Path,
    estimators: Sequence[str | Mapping[str, Any]],
    *,
    truth: str | Path | None = None,
    out: Path | None = None,
    seed: int = 0,
    force: bool = False,
    command: Sequence[str] = ("testbed.replay_log",),
    progress: Progress | None = None,
) -> LogReplay:
    """Run `estimators` (kinds, or sections as in a scenario) on the log at `path`, as `site` describes it.

    truth : a file as `site.truth` says; out : the output folder, as `testbed run` writes it; without a truth, tracks.
    LogError for a log or a site that can't be used, ScenarioError for an estimator, StoreError for the folder.
    """
    described = site if isinstance(site, SiteModel) else load_site(site)
    if not estimators:
        raise LogError("no estimator is named: give --estimator KIND, as in --estimator ukf")
    found = pieces(str(path), _given(truth, described), described, progress=progress)[0]
    scenario = from_dict(_document(path, described, estimators, truth, found, seed))
    if found.truth:
        result = batch.run(scenario, out=out, force=force, jobs=1, keep="all", command=command)
        if out is not None:
            write_left_out(found.log.bad, out)
        return LogReplay(found, scenario, result, {})
    tracks = _tracks(scenario, described, found)
    if out is not None:
        _write(tracks, found.log.bad, out)
    return LogReplay(found, scenario, None, tracks)


def _given(truth: str | Path | None, site: SiteModel) -> str | None:
    return str(truth) if truth is not None else site.truth.path


def _document(
    path: str | Path, site: SiteModel, estimators: Sequence[str | Mapping[str, Any]], truth: str | Path | None, piece: Piece, seed: int
) -> dict[str, Any]:
    """The scenario that plays this log: what `testbed run` would be given."""
    given = _given(truth, site)
    world: dict[str, Any] = {"kind": "recorded", "protocol": PROTOCOL, "logs": [str(Path(path).resolve())]}
    world |= {"truths": [str(Path(given).resolve())]} if given else {}
    world["site"] = site.model_dump(mode="json", exclude_unset=True)
    document: dict[str, Any] = {
        "name": site.name,
        "seed": seed,
        "trials": 1,
        "block": 1,
        "duration_s": max(piece.log.duration, 1e-3),
        "world": world,
        "estimators": [{"kind": e} if isinstance(e, str) else dict(e) for e in estimators],
        "report_hz": site.report_hz,
        "hold_s": site.log.lateness_s,
        "prior": _prior(site, piece),
    }
    if not piece.truth:
        document["metrics"] = [{"kind": "event_counts"}]
    return document


def _prior(site: SiteModel, piece: Piece) -> dict[str, Any]:
    """As the site says; else somewhere among its antennas and true places, as wide as they are apart, at rest."""
    if site.prior is not None and site.prior.position_m is not None:
        prior = site.prior.model_dump(mode="json")
    else:
        places = np.array([a.position_m for a in site.antennas] or [(0.0, 0.0, 1.0)])
        middle, width = (places.min(axis=0) + places.max(axis=0)) / 2, np.ptp(places, axis=0)
        prior = site.prior.model_dump(mode="json") if site.prior else {"position_std_m": [float(max(w / 2, 1.0)) for w in width]}
        prior["position_m"] = [float(v) for v in middle]
    return {**prior, "velocity_mps": prior.get("velocity_mps") or [0.0, 0.0, 0.0]}


def _tracks(scenario: Scenario, site: SiteModel, piece: Piece) -> dict[str, Track]:
    recording = recording_of(0, site, piece)
    trial = bodiless(recording, {})
    return {
        section.id: run(
            [recording],
            load("estimators", section.kind),
            section.config,
            draw_prior(scenario.prior, [trial], scenario.seed),
            row_seeds(scenario.seed, [recording], section.id),
            report_hz=scenario.report_hz,
            hold_s=scenario.hold_s,
        )
        for section in scenario.estimators
    }


def _said(estimator: str, track: Track) -> list[dict[str, Any]]:
    """One row a target."""
    axes = [track.components.index(name) for name in POSITION if name in track.components]
    found = []
    for b, target in enumerate(track.target):
        fine = (track.status[:, b] != Status.LOST) & np.isfinite(track.mean[:, b][:, axes]).all(axis=1)
        last = int(np.flatnonzero(fine)[-1]) if fine.any() else -1
        place = [round(float(v), 4) for v in track.mean[last, b, axes]] if fine.any() else None
        row: dict[str, Any] = {
            "estimator": estimator,
            "target": str(target),
            "last_s": float(track.t[last]) if fine.any() else None,
            "last_m": place,
        }
        row |= {"available": float(fine.mean()), "used": int(track.used[b]), "refused": int(track.refused[b]), "late": int(track.late[b])}
        found.append(row)
    return found


def _write(tracks: Mapping[str, Track], bad: BadRows, out: Path) -> None:
    try:
        out.mkdir(parents=True)
        for id, track in tracks.items():
            tables.write(track, out / f"{id}.parquet")
    except FileExistsError:
        raise StoreError(f"{out} is there already: choose another folder") from None
    except OSError as error:
        raise StoreError(f"the tracks can't be written to {out}: {error.strerror}") from None
    write_left_out(bad, out)


def write_left_out(bad: BadRows, out: Path) -> None:
    """The list of rows that were left out, as a table, where there are any. StoreError where the disk refuses."""
    if not len(bad):
        return
    try:
        with (out / LEFT_OUT).open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["line", "reason"])
            rows.writerows((row.line, row.reason) for row in bad.in_order())
    except OSError as error:
        raise StoreError(f"{out / LEFT_OUT} can't be written: {error.strerror}") from None
