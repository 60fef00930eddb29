"""A site as it was recorded: nothing is simulated, each trial plays a log of real readers with its true path.

    world:
      kind: recorded
      protocol: levels are fitted on the other tracks, the slope is fixed; the start is unknown
      logs: [../shared/data/a.mbd, ../shared/data/b.mbd]
      fit: others
      site: {log: {kind: ble_mbd}, antennas: [...]}

The first `draws` trials play the first of the judged logs (or pieces of logs), each with other draws of the estimators, the next ones the
second, and after the last it begins again. Trials of one log may share a block.
Left out: what the true path does not say (which way a target looks), and bodies that stood in the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path as Place
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed import quantity
from testbed.columns import Array
from testbed.geometry import Boxes, Mounts
from testbed.logs.bad import LogError
from testbed.logs.decisions import StillModel, judged
from testbed.logs.library import Piece, located, pieces
from testbed.logs.recordings import fitted_levels, recording_of, trial_of
from testbed.logs.site import SiteModel, antennas_of
from testbed.protocols import ActorPlan, Tagged
from testbed.quantity import Hertz, Seconds
from testbed.recording import Trial
from testbed.scene import WORLD, Body, Scene
from testbed.tagging import Aims
from testbed.types import Antennas
from worlds.hall import BaseHall
from worlds.parts import MATERIALS, Part

MARGIN_M = 1.0
TALL_M = 3.0
Path = Annotated[str, Field(min_length=1, max_length=500)]


class RecordedConfig(quantity.Config):
    """`protocol`: what may be fitted on what, in words; it is printed in the report.

    truths   : a file for each log, where the log does not hold its truth; `site.truth` says how they are written
    pieces   : each log is cut into so many of equal length. judged : pattern over names of logs (or pieces: NAME.1, NAME.2)
    fit      : others: levels at 1 m of each antenna from all logs or pieces but the one that is judged, with `path_loss_exponent` fixed
    truth_hz : of the true path as it is kept
    truth_gap_s : between true places farther apart in time nothing is scored; without it, straight lines join them all
    still    : tags that stand still, and what was so: decisions about them are figures of the world (`testbed.logs.decisions`)
    """

    protocol: Annotated[str, Field(min_length=10, max_length=2000)]
    logs: Annotated[list[Path], Field(min_length=1, max_length=1000)]
    truths: Annotated[list[Path], Field(max_length=1000)] = Field(default_factory=list)
    site: SiteModel
    pieces: Annotated[int, Field(ge=1, le=100)] = 1
    judged: Annotated[str, Field(min_length=1, max_length=200)] = "*"
    fit: Literal["nothing", "others"] = "nothing"
    path_loss_exponent: Annotated[float, Field(gt=0, le=12)] = 2.0
    draws: Annotated[int, Field(ge=1, le=100_000)] = 1
    truth_hz: Annotated[Hertz, Field(gt=0, le=1000)] = 10.0
    truth_gap_s: Annotated[Seconds, Field(gt=0, le=1e6)] | None = None
    still: StillModel | None = None

    @model_validator(mode="after")
    def _a_truth_each(self) -> RecordedConfig:
        if self.truths and len(self.truths) != len(self.logs):
            raise ValueError(f"there are {len(self.logs)} logs and {len(self.truths)} truths: give one for each log, or none")
        if self.still is not None:
            if self.pieces > 1:
                raise ValueError("still speaks of whole logs: leave pieces out")
            self.still.check(self.site, len(self.logs))
        return self


class Recorded(BaseHall):
    """Plays logs (`testbed.protocols.PlaysBack`). Actors, sensors and tags of the scenario have no part in it."""

    Config = RecordedConfig
    config: RecordedConfig

    def __init__(self, config: RecordedConfig) -> None:
        super().__init__(config)
        self._pieces: list[Piece] = []

    def _read(self) -> None:
        """Read the logs, once. LogError where one can't be, LogMissing where one is not there."""
        if self._pieces:
            return
        config = self.config
        truths = config.truths or [None] * len(config.logs)
        logs = zip(config.logs, truths, strict=True)
        found = [piece for log, truth in logs for piece in pieces(log, truth, config.site, config.pieces)]
        self._judged = [piece for piece in found if fnmatchcase(piece.name, config.judged)]
        if not self._judged:
            raise LogError(f"judged: no log is called {config.judged!r}; there are {', '.join(p.name for p in found)}")
        if config.fit == "others" and len(found) < 2:
            raise LogError("fit: others needs a second log, or pieces: 2")
        self._pieces, self._bounds = found, _bounds(config.site, found)

    def files(self) -> list[Place]:
        """The logs and truths. LogMissing where one is not there."""
        every = [*self.config.logs, *self.config.truths]
        return [located(path) for path in every]

    def parts(self) -> list[Part]:
        """None: what stands in the way is in `site.obstacles`."""
        return []

    def bounds(self) -> Array:
        """As the site says, or what holds its antennas and true paths."""
        return self._bounds

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The site's obstacles, and its targets as bodies without extent."""
        self._read()
        recording = recording_of(0, self.config.site, self._judged[0])
        moving = tuple(Body(str(name), "target", _at_rest(), True) for name in recording.targets.name)
        boxes = self.config.site.boxes()
        solid = boxes.with_(body=np.full(len(boxes), WORLD), material=np.full(len(boxes), MATERIALS.index("concrete")))
        return Scene(moving, solid if len(boxes) else Boxes.empty(), MATERIALS, self._bounds, Mounts.empty())

    def tagged(self) -> tuple[Tagged, Aims]:
        """The tags of the log and what is to be located, each tag where its target is."""
        self._read()
        recording = recording_of(0, self.config.site, self._judged[0])
        body, pose = np.full(len(recording.site.tags), WORLD), np.tile(_at_rest(), (len(recording.site.tags), 1))
        pose[recording.site.references.tag, :3] = recording.site.references.position
        for i, tags in enumerate(recording.target_tags):
            body[tags] = i
        aims = Aims(
            recording.targets, recording.target_tags, np.arange(len(recording.targets)), np.tile(_at_rest(), (len(recording.targets), 1))
        )
        return Tagged(recording.site.tags, body, pose), aims

    def played(self, trial: int) -> Trial:
        """The trial's log, with what its protocol lets the site know."""
        self._read()
        piece = self._judged[trial // self.config.draws % len(self._judged)]
        recording = recording_of(trial, self.config.site, piece, self._antennas(piece))
        bad = {"bad_rows": float(len(piece.log.bad)), "rows": float(piece.log.rows), "log": float(self._pieces.index(piece))}
        if self.config.still is not None:
            which = self._pieces.index(piece)
            bad |= judged(self.config.still, self.config.site, self._pieces, which)
            piece = replace(piece, truth=self.config.still.paths(which, piece.log.duration) | piece.truth)
        return trial_of(recording, piece, self.config.truth_hz, bad, self.config.truth_gap_s or np.inf)

    def _antennas(self, judged: Piece) -> Antennas:
        antennas = antennas_of(self.config.site.antennas)
        if self.config.fit == "nothing":
            return antennas
        others = [piece for piece in self._pieces if piece is not judged]
        return fitted_levels(antennas, others, self.config.site, self.config.path_loss_exponent)


def _at_rest() -> Array:
    return np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def _bounds(site: SiteModel, found: Sequence[Piece]) -> Array:
    if site.bounds_m is not None:
        (x0, y0), (x1, y1) = site.bounds_m
        return np.array([[min(x0, x1), min(y0, y1), 0.0], [max(x0, x1), max(y0, y1), site.height_m]])
    places = [np.array([a.position_m for a in site.antennas]).reshape(-1, 3)]
    places += [path.position for piece in found for path in piece.truth.values()]
    every = np.concatenate([*places, np.zeros((1, 3))]) if not sum(map(len, places)) else np.concatenate(places)
    low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    return np.array([[low[0], low[1], min(0.0, low[2])], [high[0], high[1], max(TALL_M, high[2])]])
