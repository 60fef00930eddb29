"""What is written down of B guided walks while they are under way, and put together for each of them at the end."""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.estimate import thinned
from testbed.guidance import Actions, Advice, FollowsPhase
from testbed.guided.ears import Heard
from testbed.guided.record import Walk
from testbed.guided.walkers import Walkers
from testbed.protocols import HasParticles
from testbed.scene import Truth
from testbed.types import Estimate, Reads, Track, UpdateInfo

IN_THE_PLANE = ("x", "y")


class Log:
    """Actions of B people in the order in which they happen, with what the guide believed after each."""

    def __init__(self, people: Walkers, particles: int) -> None:
        self._people, self._particles = people, particles
        self._actions: list[dict[str, Array]] = []
        self._beliefs: list[dict[str, Array]] = []
        self._reads: list[tuple[int, Reads]] = []

    def add(
        self,
        rows: Array,
        kind: str,
        actions: Actions,
        heard: Heard,
        advice: Advice | None,
        length: Array,
        found: Array,
        guide: Any,
        info: UpdateInfo,
    ) -> None:
        """An action of some rows, when the guide has been told of it."""
        people, n = self._people, len(rows)
        blank = np.zeros(n)
        self._actions.append({
            "row": rows, "kind": np.full(n, kind), "began": actions.began, "t": actions.t,
            "turn_asked": np.full(n, np.nan) if advice is None else advice.turn[rows],
            "step_asked": blank if advice is None else advice.step[rows],
            "said": np.full(n, "") if advice is None else advice.said[rows],
            "informed": actions.turn, "x": people.place[rows, 0].copy(), "y": people.place[rows, 1].copy(),
            "heading": people.heading[rows].copy(), "range": people.range(rows), "bearing": people.bearing(rows), "length": length,
            "heard": actions.heard, "used": info.used, "aim": np.full(n, np.nan), "change": actions.change, "found": found,
            **_followed(guide, rows, kind),
        })  # fmt: skip
        self._beliefs.append(self._belief(rows, guide))
        self._reads += [(int(r), reads) for r, reads in zip(rows, heard.reads, strict=bool(heard.reads)) if len(reads)]

    def aimed(self, advice: Advice) -> None:
        """What the guide believes after the last action written down."""
        if self._actions:
            last = self._actions[-1]
            last["aim"] = np.asarray(advice.aim)[last["row"]]

    def _belief(self, rows: Array, guide: Any) -> dict[str, Array]:
        """Where the guide believes the tag to be, put on the floor by the person's true place and heading: for scoring and drawing."""
        estimate: Estimate = guide.estimate()
        place, a = self._people.place[rows], self._people.heading[rows]
        turn = np.stack([np.stack([np.cos(a), -np.sin(a)], axis=1), np.stack([np.sin(a), np.cos(a)], axis=1)], axis=1)
        found = {
            "mean": place + (turn @ np.asarray(estimate.mean)[rows, :, None])[..., 0],
            "covariance": turn @ np.asarray(estimate.covariance)[rows] @ turn.transpose(0, 2, 1),
            "status": np.asarray(estimate.status)[rows],
        }
        if self._particles and isinstance(guide, HasParticles):
            cloud, weight = guide.particles()
            few = thinned(cloud[rows], weight[rows], self._particles)
            flat = place[:, None] + few[..., :2] @ turn.transpose(0, 2, 1)
            found["particles"] = np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2).astype(np.float32)
        return found

    # ------------------------------------------------------------ put together

    def split(self, number: Array, target: str, seconds: float) -> list[tuple[Walk, Track, Reads]]:
        """For each row its walk, the track of its guide's belief about the tag `target`, and all reads; number (B,) of the trials."""
        columns = {name: np.concatenate([a[name] for a in self._actions]) for name in self._actions[0]}
        beliefs = {name: np.concatenate([b[name] for b in self._beliefs]) for name in self._beliefs[0]}
        row = columns.pop("row")
        order = np.argsort(row, kind="stable")
        cuts = np.searchsorted(row[order], np.arange(len(number) + 1))
        found = []
        for b in range(len(number)):
            mine = order[cuts[b] : cuts[b + 1]]
            walk = Walk(**{name: values[mine] for name, values in columns.items()})
            share = seconds * len(mine) / max(1, len(row))
            found.append((walk, _track(walk, {n: v[mine] for n, v in beliefs.items()}, int(number[b]), target, share), self._reads_of(b)))
        return found

    def _reads_of(self, row: int) -> Reads:
        reads = Reads.concatenate([r for of, r in self._reads if of == row])
        return reads.take(np.argsort(reads.t, kind="stable"))


def _followed(guide: Any, rows: Array, kind: str) -> dict[str, Array]:
    if kind != "step" or not isinstance(guide, FollowsPhase):
        return {"followed": np.full(len(rows), np.nan), "trusted": np.zeros(len(rows), dtype=bool)}
    change, trusted = guide.followed()
    return {"followed": change[rows], "trusted": trusted[rows]}


def _track(walk: Walk, belief: dict[str, Array], trial: int, target: str, seconds: float) -> Track:
    """The belief of one guide after each action, as a track of one row whose report times are those of the actions."""
    n = len(walk)
    used = int(walk.used.sum())
    particles = belief["particles"][:, None] if "particles" in belief else np.zeros((n, 1, 0, 3), dtype=np.float32)
    return Track(
        t=walk.t, mean=belief["mean"][:, None], covariance=belief["covariance"][:, None], status=belief["status"][:, None],
        trial=np.array([trial]), target=np.array([target]), used=np.array([used]), refused=np.array([n - used]), late=np.zeros(1),
        update_seconds=np.array([seconds]), components=IN_THE_PLANE, particles=particles,
    )  # fmt: skip


def actions_of(walk: Walk) -> Actions:
    """A walk as the guide was told of it."""
    step = np.where(walk.kind == "step", walk.step_asked, 0.0)
    return Actions(walk.t, walk.t, walk.began, np.zeros(len(walk)), walk.informed, step, walk.heard, walk.change)


def along(walk: Walk, t: Array, pause: float = 0.0) -> Array:
    """Poses (K, 7) on the floor of the person at times t (K,) s: turning or stepping evenly, with a pause (s) after each action."""
    heading = np.unwrap(walk.heading)
    knots = np.stack([walk.began[1:], np.maximum(walk.t[1:] - pause, walk.began[1:])], axis=1).ravel()
    knots = np.maximum.accumulate(np.concatenate([[walk.t[0]], knots]))

    def value(column: Array) -> Array:
        return np.interp(t, knots, np.concatenate([column[:1], np.stack([column[:-1], column[1:]], axis=1).ravel()]))

    place = np.stack([value(walk.x), value(walk.y), np.zeros(len(t))], axis=1)
    return np.concatenate([place, frames.from_euler(value(heading))], axis=1)


def truth_of(walk: Walk, others: Truth, id: str, pause: float) -> Truth:
    """The motion of everything in a trial, with the guided person's own: `others` holds them standing still."""
    poses = np.array(others.poses)
    poses[:, others.index(id)] = along(walk, others.t, pause)
    return others.with_(poses=poses)
