"""Why wasn't this tag read, or why was it? The link at an instant, and what the reader was doing then.

The trial is made again from its scenario, seed and number, which is the same trial; `testbed.explain.link` takes the link apart,
and the reader's diary says whom it asked when, and what became of the answers.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from testbed.api import scenario_of
from testbed.columns import Array
from testbed.explain.counts import Block, block_of
from testbed.explain.link import Budget, budget
from testbed.manifest import describe, differences, rebuilt
from testbed.protocols import Surroundings
from testbed.scenario import Scenario
from testbed.sensors.counting import CountingConfig
from testbed.sensors.rfid import Diary, Rfid
from testbed.simulate import Simulator
from testbed.store import read_manifest


class NotThere(ValueError):
    """Somebody asked about a tag, an antenna, a trial or a time that isn't there; the message says what is nearest."""


class Reason(StrEnum):
    """What decided it."""

    READ = "read"
    NOT_SELECTED = "left out by Select"
    SILENCED = "silenced by its session flag"
    ASLEEP = "too little power at the tag"
    UNHEARD = "too little power at the reader"
    NOT_SERVED = "the antenna was not being served"
    FADED = "the link failed at the moment of its answer"
    LATE = "the link was too weak when the visit began"
    NO_SLOT = "no slot of its own in the visit"


@dataclass(frozen=True)
class Visit:
    """One visit of the reader to the antenna.

    asked       : whether the tag was, by Select and by its session flag
    able        : whether its link was good enough to take part when the visit began; others_able : how many others' were
    reads_s     : when it was read; lost_s : when it answered and the link did not carry it
    others_read : how many other tags were read, in `others_reads` reads; rounds : inventory rounds, one at the most with one target
    collisions  : slots in which several tags answered at once, so that none was read
    """

    start_s: float
    end_s: float
    asked: bool
    able: bool
    others_able: int
    reads_s: tuple[float, ...]
    lost_s: tuple[float, ...]
    others_read: int
    others_reads: int
    rounds: int
    collisions: int


@dataclass(frozen=True)
class Serving:
    """What the reader was doing: how many antennas it serves in turn, whom it asks, and its visits to this one about the time.

    elsewhere  : the antenna that it was serving instead, "" while it served this one or changed from one to the next
    last_read  : when and by which of the reader's antennas the tag was read last before the time, if it was
    next_asked_s : when the reader next begins a visit in which it asks the tag, if it does
    """

    reader: int
    antennas: int
    selected: bool
    select: tuple[str, ...]
    session: int
    dual_target: bool
    now: Visit | None
    before: Visit | None
    after: Visit | None
    elsewhere: str
    last_read_s: float | None
    last_read_by: str
    next_asked_s: float | None


@dataclass(frozen=True)
class Explanation:
    """All that there is to say of one tag, one antenna and one time of a trial.

    serving is None where counts come from the published model (`detection: logistic_beta`): there `block` says what there is.
    headroom_db : what the region still allows; gain_dbi : the antenna's on boresight
    """

    scenario: str
    point: int
    trial: int
    sensor: str
    tag: str
    antenna: str
    t: float
    budget: Budget
    gain_dbi: float
    headroom_db: float
    serving: Serving | None
    block: Block | None

    @property
    def reason(self) -> Reason | None:
        """What decided whether it was read; None where the published model does."""
        return None if self.serving is None else _reason(self.budget, self.serving)

    def document(self) -> dict[str, Any]:
        """All of it for JSON: what is infinite or not a number is null, a complex number is {"re", "im"}."""
        return _plain(self)


def of_run(source: str | Path, sets: Sequence[str] = ()) -> tuple[Scenario, str]:
    """The scenario of a run's output folder, or of a file or a shipped name, with values set; and what has changed since the run, or "".

    StoreError for a folder that holds no run; ScenarioError for mistakes in a scenario.
    """
    if not Path(source).is_dir():
        return scenario_of(source, sets=sets), ""
    manifest = read_manifest(Path(source))
    scenario = rebuilt(manifest)
    return scenario_of(scenario, sets=sets), differences(manifest, describe(scenario, manifest["keep"]))


def explain(scenario: Scenario, *, tag: str, antenna: str, t: float, point: int = 0, trial: int = 0) -> Explanation:
    """Make a trial of a point of the scenario again, and look at one link of it at t s.

    NotThere for a name, a number or a time that the scenario does not have; ScenarioError as `Simulator`.
    """
    points = scenario.points()
    if not 0 <= point < len(points):
        raise NotThere(f"there is no point {point}: the scenario has {len(points)}, counted from 0")
    if not 0 <= trial < scenario.trials:
        raise NotThere(f"there is no trial {trial}: the scenario has {scenario.trials}, counted from 0")
    if not 0 <= t <= scenario.duration_s:
        raise NotThere(f"{t:g} s is outside the trial, which lasts from 0 to {scenario.duration_s:g} s")
    with Simulator(points[point].scenario) as simulator:
        k = _place(tag, [str(id) for id in simulator.tagged.tags.id], "tag")
        sensor, a = _owner(antenna, [s for s in simulator.sensors if isinstance(s, Rfid)])
        return look(sensor, simulator.moved(trial), a, k, t, scenario.name, point)


def look(sensor: Rfid, around: Surroundings, antenna: int, tag: int, t: float, scenario: str = "", point: int = 0) -> Explanation:
    """The same in surroundings that are there already: antenna of the sensor and tag by index."""
    antennas, counting = sensor.antennas(), isinstance(sensor.config.detection, CountingConfig)
    return Explanation(
        scenario=scenario,
        point=point,
        trial=around.trial,
        sensor=sensor.id,
        tag=str(around.tagged.tags.id[tag]),
        antenna=str(antennas.id[antenna]),
        t=float(t),
        budget=budget(sensor, around, antenna, tag, t),
        gain_dbi=float(antennas.gain[antenna]),
        headroom_db=float(sensor.region.limit_dbm - antennas.power[antenna] - antennas.gain[antenna]),
        serving=None if counting else serving(sensor, around, antenna, tag, t),
        block=block_of(sensor, around, antenna, tag, t) if counting else None,
    )


def _place(name: str, known: Sequence[str], what: str) -> int:
    if name in known:
        return known.index(name)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
    raise NotThere(f"no {what} is named {name!r}; " + (f"the nearest is {near[0]!r}" if near else "the scenario has none"))


def _owner(antenna: str, sensors: Sequence[Rfid]) -> tuple[Rfid, int]:
    """The sensor that has the antenna, and its place there."""
    every = [(str(id), sensor, i) for sensor in sensors for i, id in enumerate(sensor.antennas().id)]
    return every[_place(antenna, [id for id, *_ in every], "antenna of an rfid reader")][1:]


# ---------------------------------------------------------------- the reader


def serving(sensor: Rfid, around: Surroundings, antenna: int, tag: int, t: float) -> Serving:
    """What the antenna's reader was doing about t s, as far as it concerns the tag."""
    diary, profile = sensor.diary(around), sensor.config.reader.resolved()
    rounds, reader = diary.rounds, int(sensor.reader_of(np.array([antenna]))[0])
    of_reader = np.flatnonzero(rounds.reader == reader)
    own = of_reader[rounds.antenna[of_reader] == antenna]
    during = of_reader[(rounds.t_start[of_reader] <= t) & (t <= rounds.t_end[of_reader])]
    now, before, after = np.intersect1d(during, own), own[rounds.t_end[own] < t], own[rounds.t_start[own] > t]
    slots = diary.slots
    mine = np.flatnonzero((slots.tag == tag) & slots.read & np.isin(slots.visit, of_reader) & (slots.t < t))
    last = mine[np.argmax(slots.t[mine])] if len(mine) else None
    asking = of_reader[(rounds.t_start[of_reader] > t) & diary.sets[rounds.asked[of_reader], tag]]

    def visit(rows: Array, which: int) -> Visit | None:
        return _visit(sensor, around, diary, int(rows[which]), tag) if len(rows) else None

    return Serving(
        reader=reader,
        antennas=int((sensor.reader_of(np.arange(len(sensor.antennas()))) == reader).sum()),
        selected=bool(diary.sets[0, tag]),
        select=tuple(sensor.config.reader.select or ()),
        session=profile.session,
        dual_target=profile.dual_target,
        now=visit(now, 0),
        before=visit(before, -1),
        after=visit(after, 0),
        elsewhere="" if len(now) or not len(during) else str(sensor.antennas().id[rounds.antenna[during[0]]]),
        last_read_s=None if last is None else float(slots.t[last]),
        last_read_by="" if last is None else str(sensor.antennas().id[rounds.antenna[slots.visit[last]]]),
        next_asked_s=float(rounds.t_start[asking].min()) if len(asking) else None,
    )


def _visit(sensor: Rfid, around: Surroundings, diary: Diary, visit: int, tag: int) -> Visit:
    rounds, slots, step = diary.rounds, diary.slots, sensor.config.reader.step_s
    start = float(rounds.t_start[visit])
    asked = diary.sets[rounds.asked[visit]]
    middle = (int(start / step) + 0.5) * step
    _, able = sensor.able(around, sensor.channel(around), rounds.antenna[[visit]], np.array([middle]))
    here = slots.take(slots.visit == visit)
    own, others = here.take(here.tag == tag), here.take((here.tag != tag) & here.read)
    return Visit(
        start_s=start,
        end_s=float(rounds.t_end[visit]),
        asked=bool(asked[tag]),
        able=bool((able == tag).any()),
        others_able=int((asked[able] & (able != tag)).sum()),
        reads_s=tuple(own.t[own.read].tolist()),
        lost_s=tuple(own.t[~own.read].tolist()),
        others_read=len(np.unique(others.tag)),
        others_reads=len(others),
        rounds=int(rounds.queries[visit]),
        collisions=int(diary.collisions[visit]),
    )


def _reason(link: Budget, serving: Serving) -> Reason:
    """What rules a read out for good comes first, then the wave, then what the reader made of it."""
    now, near = serving.now, [v for v in (serving.before, serving.after) if v is not None]
    if now is not None and now.reads_s:
        return Reason.READ
    if not serving.selected:
        return Reason.NOT_SELECTED
    if (now is not None and not now.asked) or (now is None and near and not any(v.asked for v in near)):
        return Reason.SILENCED
    if link.forward_db < 0:
        return Reason.ASLEEP
    if link.reverse_db < 0:
        return Reason.UNHEARD
    if now is None:
        return Reason.NOT_SERVED
    if now.lost_s:
        return Reason.FADED
    return Reason.NO_SLOT if now.able else Reason.LATE


# ---------------------------------------------------------------- as JSON


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        derived = [name for name, member in vars(type(value)).items() if isinstance(member, property)]
        return {name: _plain(getattr(value, name)) for name in (*(f.name for f in fields(value)), *derived)}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, complex):
        return {"re": value.real, "im": value.imag}
    return None if isinstance(value, float) and not np.isfinite(value) else value
