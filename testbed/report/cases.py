"""What a kept recording shows: truth, estimates, errors, reads and lines of sight as arrays. Computed here, drawn elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed import archive
from testbed.columns import Array
from testbed.metrics.consistency import squared_mahalanobis
from testbed.metrics.track_error import difference, distance, known_components, usable
from testbed.protocols import Tagged
from testbed.radio.links import Ends
from testbed.recording import Trial
from testbed.report.obstruction import Seer, Sight, antenna_ends, antennas_of
from testbed.report.study import Kept, Study
from testbed.scenario import Scenario
from testbed.scene import Scene
from testbed.types import POSITION, Antennas, Reads, Track

MOST_TARGETS = 3
WIDE = 1.45
MOST_ANTENNAS = 12
TRUTH_HZ, MOST_INSTANTS = 10.0, 3001


@dataclass(frozen=True, eq=False)
class Line:
    """What one estimator says of one target, over K report times; NaN where it says nothing that it stands by.

    position   : (K, 2) m, on the floor; covariance (K, 2, 2) m², of the same
    error      : (K,) m, in `dims` dimensions
    nees       : (K,), χ² with `dof` degrees of freedom for an honest filter
    status     : (K,) `testbed.types.Status`
    cloud      : (K, N, 2) m, the particles of a method that shows them
    """

    estimator: str
    t: Array
    position: Array
    covariance: Array
    error: Array
    dims: int
    nees: Array
    dof: int
    status: Array
    cloud: Array | None = None


@dataclass(frozen=True, eq=False)
class Aim:
    """One target of a recording: where it truly was (t (n,) s, truth (n, 2) m), what was said of it, what was heard of it.

    antennas : indices of those whose view of it is worth a row, those that read it most often; reads and sight speak of them all
    """

    name: str
    t: Array
    truth: Array
    lines: tuple[Line, ...]
    tags: tuple[int, ...]
    reads: Reads
    antennas: Array
    sight: Sight | None


@dataclass(frozen=True, eq=False)
class Case:
    """One recording: the hall, everything that moved in it, and its targets.

    near, far : the true ends of all links, antennas and tags
    left_out  : how many more targets there are than `aims`
    """

    kept: Kept
    scenario: Scenario | None
    trial: Trial
    scene: Scene
    tagged: Tagged
    antennas: Antennas
    near: Ends
    far: Ends
    aims: tuple[Aim, ...]
    left_out: int

    @property
    def duration(self) -> float:
        """s"""
        return self.trial.recording.duration

    @property
    def is_wide(self) -> bool:
        """Whether the hall is so much wider than deep that its plan wants the whole width of a page."""
        x, y = np.ptp(np.asarray(self.scene.bounds)[:, :2], axis=0)
        return bool(x > WIDE * y)

    @property
    def reads(self) -> Reads:
        """All reads, of all tags."""
        return reads_of(self.trial)


def load(study: Study, kept: Kept) -> Case:
    """Read and compute all that is shown of a recording. StoreError where it is damaged."""
    trial, (scene, tagged) = archive.load_trial(kept.folder), archive.load_scene(kept.folder)
    found = archive.load_tracks(kept.folder)
    tracks = {id: found[id] for id in [*study.estimators, *found] if id in found}
    scenario = study.scenario.points()[kept.point].scenario if study.scenario else None
    antennas = antennas_of(scenario, scene, trial.recording.site)
    near = antenna_ends(antennas, scene)
    chosen = _chosen(trial, tracks)
    with Seer(scenario, scene) as seer:
        aims = tuple(_aim(i, trial, tracks, scenario, seer, near, tagged) for i in chosen)
    far = Ends(np.asarray(tagged.body), tagged.pose)
    left_out = len(trial.recording.targets) - len(aims)
    return Case(kept, scenario, trial, scene, tagged, antennas, near, far, aims, left_out)


def reads_of(trial: Trial) -> Reads:
    """The stream of reads, empty where the recording has none."""
    reads = trial.recording.streams.get("reads")
    return reads if isinstance(reads, Reads) else Reads.empty()


def instants(duration: float) -> Array:
    """(n,) s: the times at which truth is shown."""
    return np.linspace(0.0, duration, int(min(MOST_INSTANTS, max(2, round(duration * TRUTH_HZ) + 1))))


def _chosen(trial: Trial, tracks: dict[str, Track]) -> list[int]:
    """Targets to show: all of a few; of many the one that the first estimator finds best, the median one and the worst."""
    names = [str(name) for name in trial.recording.targets.name]
    if len(names) <= MOST_TARGETS or not tracks:
        return list(range(len(names)))[:MOST_TARGETS]
    track = next(iter(tracks.values()))
    error = np.full(len(names), np.inf)
    for row, target in enumerate(track.target):
        i = names.index(str(target))
        error[i] = _mean_error(track, trial, row, i)
    order = np.argsort(error, kind="stable")
    return sorted({int(order[0]), int(order[len(order) // 2]), int(order[-1])})


def _mean_error(track: Track, trial: Trial, row: int, target: int) -> float:
    error = distance(track.take(np.array([row])), trial.target_states(track.t)[:, [target]], _dims(track, 3))
    return float(np.nanmean(error)) if np.isfinite(error).any() else np.inf


def _dims(track: Track, wanted: int) -> int:
    return wanted if set(POSITION[:wanted]) <= set(track.components) else 2


def _aim(target: int, trial: Trial, tracks: dict[str, Track], scenario: Scenario | None, seer: Seer, near: Ends, tagged: Tagged) -> Aim:
    recording = trial.recording
    name, tags = str(recording.targets.name[target]), [int(i) for i in recording.target_tags[target]]
    t = instants(recording.duration)
    lines = []
    for id, track in tracks.items():
        rows = np.flatnonzero(track.target == name)
        if len(rows):
            lines.append(_line(id, track.take(rows[:1]), trial.target_states(track.t)[:, [target]], scenario))
    every = reads_of(trial)
    reads = every.take(np.isin(every.tag, tags))
    antennas = _busiest(reads, len(near.body))
    sight = seer.look(trial.truth, near, tagged, antennas, tags, recording.duration)
    return Aim(name, t, trial.target_states(t)[:, target, :2], tuple(lines), tuple(tags), reads, antennas, sight)


def _busiest(reads: Reads, antennas: int) -> Array:
    """The antennas with the most reads, in the site's order; those without any only where there is room."""
    count = np.bincount(reads.antenna, minlength=antennas)
    return np.sort(np.argsort(-count, kind="stable")[:MOST_ANTENNAS])


def _line(id: str, track: Track, truth: Array, scenario: Scenario | None) -> Line:
    """One row of a track (K, 1, n) against the truth (K, 1, 6)."""
    stands = usable(track)[:, 0]
    names, parts = known_components(track), list(POSITION[:2])
    position, covariance = np.full((len(track.t), 2), np.nan), np.full((len(track.t), 2, 2), np.nan)
    if set(parts) <= set(track.components):
        places = [track.components.index(name) for name in parts]
        position[stands] = track.mean[stands, 0][:, places]
        covariance[stands] = track.covariance[stands, 0][:, places][:, :, places]
    if _setting(scenario, "consistency", "components", "all") == "position":
        names = [name for name in names if name in POSITION]
    judged = [track.components.index(name) for name in names]
    nees = np.full(len(track.t), np.nan)
    if names:
        with np.errstate(invalid="ignore", over="ignore"):
            apart = difference(track, truth, names)
            every = squared_mahalanobis(apart, track.covariance[..., judged, :][..., judged])[:, 0]
        nees[stands] = every[stands]
    dims = _dims(track, _setting(scenario, "position_error", "dims", 3))
    error = distance(track, truth, dims)[:, 0]
    cloud = _cloud(track)
    return Line(id, track.t, position, covariance, error, dims, nees, len(names), track.status[:, 0], cloud)


def _setting(scenario: Scenario | None, metric: str, name: str, otherwise: Any) -> Any:
    """What the scenario's own metric is told, so that figures show what the table says."""
    sections: Sequence[Any] = scenario.metrics if scenario else ()
    return next((getattr(s.config, name, otherwise) for s in sections if s.kind == metric), otherwise)


def _cloud(track: Track) -> Array | None:
    """(K, N, 2) m of a track that keeps its particles."""
    return np.asarray(track.particles, dtype=np.float64)[:, 0, :, :2] if track.particles.size else None
