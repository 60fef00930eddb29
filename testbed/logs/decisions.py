"""Decisions about tags that stand still, judged against what whoever recorded the logs says was so (`testbed.logs.still`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from testbed.logs.bad import LogError
from testbed.logs.contents import Path3
from testbed.logs.library import Piece
from testbed.logs.site import SiteModel
from testbed.logs.still import moved, shares_an_epc, side
from testbed.plugins import suggest
from testbed.quantity import Config, Point3
from testbed.types import Reads

Tag = Annotated[str, Field(min_length=1, max_length=200)]


class StillModel(Config):
    """What was so in logs of tags that stand still; no decision sees it.

    between : ids of two antennas, to one of which a tag is nearer. places_m : by tag, where it truly lay in each log
    moved   : by tag, whether it was elsewhere in each later log than in the first
    two_tags : ids under which two tags answer; all others are one
    """

    between: tuple[Tag, Tag]
    places_m: Annotated[dict[Tag, list[Point3]], Field(max_length=1000)] = Field(default_factory=dict)
    moved: Annotated[dict[Tag, bool], Field(max_length=1000)] = Field(default_factory=dict)
    two_tags: Annotated[list[Tag], Field(max_length=1000)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _two(self) -> StillModel:
        if self.between[0] == self.between[1]:
            raise ValueError(f"between: {self.between[0]} is named twice: two antennas are wanted")
        return self

    def check(self, site: SiteModel, logs: int) -> None:
        """ValueError for an antenna or tag that the site does not have, or places that are not one for each log."""
        antennas, tags = [a.id for a in site.antennas], [t.id for t in site.tags]
        for known, named, what in ((antennas, self.between, "antenna"), (tags, [*self.places_m, *self.moved, *self.two_tags], "tag")):
            stranger = next((name for name in named if name not in known), None)
            if stranger is not None:
                raise ValueError(f"still: the site has no {what} {stranger!r}{suggest(stranger, known)}")
        for tag, places in self.places_m.items():
            if len(places) != logs:
                raise ValueError(f"still.places_m: {tag} has {len(places)} places, and there are {logs} logs: give one for each")

    def paths(self, which: int, duration: float) -> dict[str, Path3]:
        """The true paths of tags in log number `which`, which are none: they stay where they are."""
        t = np.array([0.0, max(duration, 1e-3)])
        return {tag: Path3(t, np.array([places[which]] * 2)) for tag, places in self.places_m.items()}


def judged(still: StillModel, site: SiteModel, logs: Sequence[Piece], which: int) -> dict[str, float]:
    """Shares of decisions on log number `which` that are right: side_right, moved_right (later logs against the first), epc_right.

    A figure without any decision in that log is left out. LogError for a tag that a log does not have.
    """
    ids, position = [a.id for a in site.antennas], np.array([a.position_m for a in site.antennas])
    first, second = (ids.index(name) for name in still.between)
    here, begin = logs[which], logs[0]
    apart = {tag: np.linalg.norm(position - np.array(places[which]), axis=1) for tag, places in still.places_m.items()}
    sides = [side(_of(here, tag), first, second) == np.sign(d[first] - d[second]) for tag, d in apart.items()]
    steps = [moved(_of(begin, tag), _of(here, tag)) == said for tag, said in still.moved.items()] if which else []
    shared = [shares_an_epc(_of(here, tag)) == (tag in still.two_tags) for tag in here.log.tags if len(_of(here, tag))]
    found = {"side_right": sides, "moved_right": steps, "epc_right": shared}
    return {name: sum(right) / len(right) for name, right in found.items() if right}


def _of(piece: Piece, tag: str) -> Reads:
    if tag not in piece.log.tags:
        raise LogError(f"{piece.name}: the log has no reads of {tag}")
    reads = piece.log.reads
    return reads.take(reads.tag == piece.log.tags.index(tag))
