"""Estimators on recordings that are kept: the same streams again, through the same or other estimators. Needs no physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed import archive, tables
from testbed.estimate import row_seeds, run
from testbed.evaluate import Rows, Summary, score, summarise
from testbed.guided.section import guided_actor
from testbed.manifest import rebuilt
from testbed.plugins import load
from testbed.prior import draw_prior
from testbed.scenario import Scenario, Section
from testbed.store import StoreError, read_manifest
from testbed.types import Track
from testbed.worker import PARTICLES, config_hash, stack


@dataclass(frozen=True)
class Replay:
    """What came of it: the scenario, tracks by (point, trial, estimator), and their figures as a run's."""

    scenario: Scenario
    tracks: dict[tuple[int, int, str], Track]
    rows: Rows
    summaries: tuple[Summary, ...]


def replay(folder: str | Path, estimators: Sequence[str] = (), out: str | Path | None = None) -> Replay:
    """Run estimators on the recordings under `folder`: an output folder of `testbed run`, or one trial's folder in it.

    estimators : ids of the scenario's, or kinds of others, which are taken with their defaults; all of the scenario's where left out
    out        : a folder for the tracks, one Parquet file each; it must not be there yet

    The figures equal the run's own for the same estimator, bit for bit where a block holds one trial and to 1e-9 otherwise.
    StoreError for a folder that holds no recording; UnknownPlugin for an estimator that nobody knows.
    """
    folder = Path(folder)
    home = next((f for f in (folder, *folder.resolve().parents) if (f / "manifest.json").is_file()), None)
    if home is None:
        raise StoreError(f"{folder} is no output folder of a run, nor inside one: there is no manifest.json")
    scenario = rebuilt(read_manifest(home))
    places = _recordings(folder)
    if not places:
        raise StoreError(f"{folder} holds no recordings: run with --keep first:N or all")
    if guided_actor(scenario) is not None:
        raise StoreError(f"{folder} is of a guided person: each guide makes its own data, so there is nothing to replay; use testbed rerun")
    points = scenario.points()
    tracks: dict[tuple[int, int, str], Track] = {}
    rows: list[Rows] = []
    for point, trial, place in places:
        here = points[point].scenario
        for section in _sections(here, estimators):
            track, figures = _one(here, section, place)
            tracks[point, trial, section.id] = track
            keys = {"point": point, "trial": trial, "estimator": section.id, "seed": here.seed, "kind": section.kind}
            keys |= {"config": config_hash(section), "scenario": here.hash}
            rows.append({**{name: np.full(len(track.target), value) for name, value in keys.items()}, **figures})
    if out is not None:
        _write(Path(out), tracks)
    whole = stack(rows)
    return Replay(scenario, tracks, whole, tuple(summarise(whole)))


def _recordings(folder: Path) -> list[tuple[int, int, Path]]:
    """(point, trial, folder) of what is kept under an output folder, or of the one trial whose folder it is."""
    found = sorted(folder.glob("recordings/point-*/trial-*"))
    if not found and folder.name.startswith("trial-"):
        found = [folder.resolve()]
    return [(int(f.parent.name.removeprefix("point-")), int(f.name.removeprefix("trial-")), f) for f in found]


def _sections(scenario: Scenario, wanted: Sequence[str]) -> list[Section]:
    own = {section.id: section for section in scenario.estimators}
    if not wanted:
        return list(own.values())
    return [own[id] if id in own else Section(id, id, load("estimators", id).Config(), ("estimators",)) for id in wanted]


def _one(scenario: Scenario, section: Section, place: Path) -> tuple[Track, Rows]:
    trial = archive.load_trial(place)
    recordings = [trial.recording]
    track = run(
        recordings,
        load("estimators", section.kind),
        section.config,
        draw_prior(scenario.prior, [trial], scenario.seed),
        row_seeds(scenario.seed, recordings, section.id),
        report_hz=scenario.report_hz,
        hold_s=scenario.hold_s,
        particles=PARTICLES,
    )
    metrics = {s.id: load("metrics", s.kind)(s.config) for s in scenario.metrics}
    return track, score(track, trial, metrics)


def _write(out: Path, tracks: dict[tuple[int, int, str], Track]) -> None:
    try:
        out.mkdir(parents=True)
        for (point, trial, estimator), track in tracks.items():
            tables.write(track, out / f"point-{point:04d}.trial-{trial:06d}.{estimator}.parquet")
    except FileExistsError:
        raise StoreError(f"{out} is there already: choose another folder") from None
    except OSError as error:
        raise StoreError(f"the tracks can't be written to {out}: {error.strerror}") from None
