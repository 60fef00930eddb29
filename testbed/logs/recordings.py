"""Logs to recordings: what an estimator gets of a piece of a log, with a site that knows what may have been fitted on other pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.logs.bad import LogError
from testbed.logs.contents import Path3
from testbed.logs.library import Piece, at, of_target
from testbed.logs.read import Log
from testbed.logs.site import SiteModel, antennas_of
from testbed.recording import Recording, Trial
from testbed.scene import UNKNOWN, WORLD, Truth
from testbed.types import Antennas, References, Site, Tags, Targets

LEAST_READS = 10  # of an antenna, below which no level is fitted to it
NEAR_M = 0.1


def site_of(site: SiteModel, log: Log, antennas: Antennas | None = None) -> Site:
    """The site as data, for the tags that the log speaks of."""
    listed = {tag.id: tag for tag in site.tags}
    gains = [listed[id].gain_dbi if id in listed else 2.0 for id in log.tags]
    sensitivities = [listed[id].sensitivity_dbm if id in listed else -19.5 for id in log.tags]
    known = [(i, listed[id].position_m) for i, id in enumerate(log.tags) if id in listed and listed[id].position_m is not None]
    references = References(np.array([i for i, _ in known]), np.array([p for _, p in known]).reshape(-1, 3))
    tags = Tags(np.array(log.tags, dtype=np.str_), np.array(gains), np.array(sensitivities)) if log.tags else Tags.empty()
    found = antennas_of(site.antennas) if antennas is None else antennas
    return Site(found, tags, site.carriers(), references, site.boxes())


def targets_of(site: SiteModel, log: Log) -> tuple[Targets, tuple[Array, ...]]:
    """The targets and the tags of each: those of the site; else every tag that is no reference, or one thing where there are no tags."""
    place = {id: i for i, id in enumerate(log.tags)}
    if site.targets:
        chosen = [(t.id, [place[tag] for tag in t.tags if tag in place] or _all_of(site, log)) for t in site.targets]
    else:
        references = {tag.id for tag in site.tags if tag.position_m is not None}
        chosen = [(id, [i]) for id, i in place.items() if id not in references] or [("target", [])]
    names = np.array([name for name, _ in chosen], dtype=np.str_)
    return Targets(names, names), tuple(np.array(tags, dtype=np.int32) for _, tags in chosen)


def _all_of(site: SiteModel, log: Log) -> list[int]:
    """All tags, for the only target that names none."""
    return list(range(len(log.tags))) if len(site.targets) == 1 and not site.targets[0].tags else []


def recording_of(trial: int, site: SiteModel, piece: Piece, antennas: Antennas | None = None) -> Recording:
    """What estimators get of a piece. LogError where there is nothing to locate."""
    targets, tags = targets_of(site, piece.log)
    if not len(targets):
        raise LogError(f"{piece.name}: there is nothing to locate")
    return Recording(trial, piece.log.duration, site_of(site, piece.log, antennas), dict(piece.log.streams), targets, tags)


def truth_of(recording: Recording, piece: Piece, hz: float, gap: float = np.inf) -> tuple[Truth, Array, Array]:
    """(truth, body of each target, pose of each in its body): every target is a body that goes along its true path, without turning.

    Between samples more than `gap` s apart, before the first and after the last nobody knows where it was, and no metric counts it.
    LogError for a target without one.
    """
    t = np.arange(int(np.ceil(recording.duration * hz - 1e-9)) + 1) / hz
    poses = np.zeros((len(t), len(recording.targets), 7))
    poses[..., 3] = 1.0
    zone = np.full(poses.shape[:2], -1)
    for i, name in enumerate(recording.targets.name):
        path = of_target(piece.truth, str(name), len(recording.targets) > 1)
        if path is None:
            raise LogError(f"{piece.name}: there is no true path of {name}; there are {', '.join(piece.truth) or 'none'}")
        poses[:, i, :3] = at(path, t)
        zone[:, i] = np.where(known(path, t, gap), -1, UNKNOWN)
    bodies = tuple(str(name) for name in recording.targets.name)
    return Truth(t, poses, bodies, zone=zone), np.arange(len(bodies)), np.tile(frames.IDENTITY, (len(bodies), 1))


def known(path: Path3, t: Array, gap: float) -> Array:
    """(K,) bool: whether a time is between two samples of a path at most `gap` s apart; anything is, for an infinite gap."""
    if not np.isfinite(gap):
        return np.ones(len(t), dtype=bool)
    k = np.searchsorted(path.t, t, side="right")
    before, after = path.t[np.clip(k - 1, 0, len(path.t) - 1)], path.t[np.clip(k, 0, len(path.t) - 1)]
    on_one = np.abs(t - before) < 1e-9
    return on_one | ((k > 0) & (k < len(path.t)) & (after - before <= gap))


def trial_of(recording: Recording, piece: Piece, hz: float, stimulus: dict[str, float], gap: float = np.inf) -> Trial:
    """The recording with its truth."""
    truth, body, pose = truth_of(recording, piece, hz, gap)
    return Trial(recording, truth, body, pose, stimulus)


def bodiless(recording: Recording, stimulus: dict[str, float]) -> Trial:
    """A trial whose truth nobody knows: its targets stand nowhere (NaN)."""
    nowhere = np.full((len(recording.targets), 7), np.nan)
    nowhere[:, 3:] = frames.IDENTITY[3:]
    truth = Truth(np.array([0.0, max(recording.duration, 1e-3)]), np.zeros((2, 0, 7)))
    return Trial(recording, truth, np.full(len(recording.targets), WORLD), nowhere, stimulus)


# ---------------------------------------------------------------- what may be fitted


def fitted_levels(antennas: Antennas, others: Sequence[Piece], site: SiteModel, exponent: float) -> Antennas:
    """The antennas with their levels at 1 m as the median over the reads of `others`, whose truth is known: rssi + 10 n log10(d).

    The slope n stays what physics says: with a few metres of distances a fitted one takes up what walls do. An antenna with fewer than
    ten reads there has the median of all others. LogError where no read has a true place.
    """
    level: list[list[float]] = [[] for _ in range(len(antennas))]
    for piece in others:
        recording = recording_of(0, site, piece)
        for i, name in enumerate(recording.targets.name):
            path = of_target(piece.truth, str(name), len(recording.targets) > 1)
            if path is None:
                continue
            reads = piece.log.reads
            reads = reads.take(np.isin(reads.tag, recording.target_tags[i]) & np.isfinite(reads.rssi))
            reads = reads.take((reads.t >= path.t[0]) & (reads.t <= path.t[-1]))
            apart = np.linalg.norm(at(path, reads.t) - antennas.position[reads.antenna], axis=1)
            at_1m = reads.rssi + 10 * exponent * np.log10(np.maximum(apart, NEAR_M))
            for antenna in np.unique(reads.antenna):
                level[antenna] += at_1m[reads.antenna == antenna].tolist()
    found = np.array([np.median(values) if len(values) >= LEAST_READS else np.nan for values in level])
    if not np.isfinite(found).any():
        raise LogError("no level can be fitted: no other log has enough reads with a true place")
    return replace(antennas, reference=np.where(np.isfinite(found), found, np.nanmedian(found)))
