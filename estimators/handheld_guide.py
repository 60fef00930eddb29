"""What guides of a person with a handheld reader share: who hears what, when there is nothing to say, and what was done since.

A guide works on rows. It is told of every action (`testbed.guidance.Actions`) and of the reads of the sought tag in between, and
answers with a turn and a step. It never learns the true heading.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from estimators.phase_stream import PhaseStream, StreamConfig
from testbed import quantity
from testbed.guidance import Actions, Advice
from testbed.quantity import Degrees, Metres
from testbed.rng import RowRandom
from testbed.types import Array, Estimate, Event, Prior, Site, Status, UpdateInfo
from testbed.units import SPEED_OF_LIGHT

NO_ANSWER = "The tag does not answer: walk on a few metres, then turn slowly."
NO_READS = "No reads during the step: hold the reader up and wait for the tag."
NOT_TRUSTED = "The phase could not be followed during the step: walk more slowly."
MISDECLARED = "The reader wraps its phase otherwise than declared: check its settings. No direction is given."
COMPONENTS = ("ahead", "left")  # m, the tag in the person's frame: +x where they look


class GuideConfig(quantity.Config):
    """What every guide is told of the person, the antenna and the reader.

    frequency_mhz : the carrier where the site has no hop table
    search_deg    : what the person is to turn while the tag is silent
    patience      : how many silent turns in a row say that the tag does not answer
    stream        : how reads become a change of phase
    """

    step_m: Annotated[Metres, Field(gt=0, le=2)] = 0.5
    frequency_mhz: Annotated[float, Field(ge=100, le=6000)] = 865.7
    search_deg: Annotated[Degrees, Field(ge=-180, le=180)] = 180.0
    patience: Annotated[int, Field(ge=1, le=1000)] = 12
    stream: StreamConfig = Field(default_factory=StreamConfig)


class Guide(ABC):
    """Base of the guides: B rows of people, each on the way to one tag.

    Subclasses keep a belief and answer four questions about some rows. Until a tag is heard they are asked for a search turn only.
    """

    Config: ClassVar[type[GuideConfig]]
    consumes: ClassVar[frozenset[str]] = frozenset({"actions", "reads"})

    def __init__(self, config: Any, site: Site, rng: RowRandom) -> None:
        self.config, self.rng = config, rng
        frequencies = np.asarray(site.frequencies) if len(site.frequencies) else np.array([config.frequency_mhz * 1e6])
        self.wavenumber = 4 * np.pi * float(frequencies.mean()) / SPEED_OF_LIGHT  # K, rad of phase a metre of range
        self._stream = PhaseStream(config.stream, frequencies)

    def start(self, prior: Prior) -> None:
        """Forget everything. The prior is not used: nobody knows where the tag is."""
        rows = prior.rows
        self.rows, self.moved = rows, np.zeros(rows, dtype=bool)
        self._heard, self._silent = np.zeros(rows, dtype=bool), np.zeros(rows, dtype=np.int64)
        self._blind = np.zeros(rows, dtype=np.int64)  # steps in a row without an answer
        self._said, self._known = np.zeros(rows, dtype=np.int8), np.zeros(rows, dtype=bool)
        self._stepping = np.zeros(rows, dtype=bool)  # whether the last action was a step
        self._change, self._trusted = np.full(rows, np.nan), np.zeros(rows, dtype=bool)
        self._stream.start(rows)
        self._begin()

    def predict(self, t: Array) -> None:
        """Nothing moves between actions; only the time is noted."""
        self.now = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        """Keep reads until the action that they belong to is complete; take actions."""
        if event.kind == "reads":
            return UpdateInfo(self._stream.take(event.row, event.data))
        actions: Actions = event.data
        stepping = np.asarray(actions.step) > 0
        self._known[event.row] = True
        if stepping.all():
            self._step(event.row, actions)
        elif not stepping.any():
            self._turn(event.row, actions)
        else:
            self._turn(event.row[~stepping], actions.take(~stepping))
            self._step(event.row[stepping], actions.take(stepping))
        return UpdateInfo.accepted(len(event))

    def _turn(self, rows: Array, actions: Actions) -> None:
        self._stream.forget(rows)
        before = self._heard[rows].copy()
        self._heard[rows] = actions.heard
        self._silent[rows] = np.where(actions.heard, 0, self._silent[rows] + 1)
        self._stepping[rows] = False
        self._turned(rows, np.asarray(actions.turn), np.asarray(actions.heard), before)

    def _step(self, rows: Array, actions: Actions) -> None:
        change, spread, trusted = np.array(actions.change), np.zeros(len(rows)), np.ones(len(rows), dtype=bool)
        missing = np.flatnonzero(np.isnan(change))
        self._said[rows] = np.where(self._said[rows] == _WRAP, _WRAP, _FINE)  # a reader that lies once is not believed again
        if len(missing):
            found = self._stream.change(rows[missing], np.asarray(actions.began)[missing], np.asarray(actions.t)[missing])
            change[missing], spread[missing], trusted[missing] = found.change, found.spread, found.trusted
            said = np.where(found.misdeclared, _WRAP, np.where(found.reads == 0, _SILENT, np.where(found.trusted, _FINE, _DOUBT)))
            self._said[rows[missing]] = np.maximum(said, self._said[rows[missing]])
        self._heard[rows], self._stepping[rows], self.moved[rows] = actions.heard, True, True
        self._silent[rows] = ~np.asarray(actions.heard)
        self._blind[rows] = np.where(actions.heard, 0, self._blind[rows] + 1)
        self._change[rows], self._trusted[rows] = change, trusted & np.isfinite(change)
        self._stepped(rows, np.asarray(actions.step), change, spread, self._trusted[rows])

    # ------------------------------------------------------------ answers

    def suggest(self) -> Advice:
        """What each row should do now. Pure.

        Whoever hears the tag turns to where the method believes it to be and steps; whoever doesn't turns to search. Where the tag does
        not answer all round, or the reader wraps otherwise than declared, there is no turn and no step but a sentence: no direction is
        made up.
        """
        aim, lost, stopped = self._aim(), self._silent >= self.config.patience, self._said == _WRAP
        told = np.where(self._heard, np.where(self._stepping, aim, np.nan), self._search())
        mute = ~self._known | lost | stopped
        said = np.where(lost & ~stopped, NO_ANSWER, np.array(_SENTENCES, dtype=np.str_)[self._said])
        nowhere = mute | ~self._heard | ~self.moved
        led = self._led() & ~mute
        return Advice(np.where(mute, np.nan, told), np.where(mute, 0.0, self._length()), np.where(nowhere, np.nan, aim), said, led)

    def followed(self) -> tuple[Array, Array]:
        """Of the last step: how far the phase turned (B,) rad, and whether that is trusted (B,)."""
        return self._change.copy(), self._trusted.copy()

    def estimate(self) -> Estimate:
        """Where the tag is in the person's own frame."""
        mean, covariance = self._belief()
        status = np.where(self.moved & (self._said != _WRAP), np.where(self._heard, Status.OK, Status.COASTING), Status.LOST)
        return Estimate(COMPONENTS, mean, covariance, status.astype(np.int8), frame="person")

    def _search(self) -> Array:
        """(B,) rad: what a silent row turns by."""
        return np.full(self.rows, np.deg2rad(self.config.search_deg))

    def _led(self) -> Array:
        """(B,) whether a silent row should go on where it is told: not unless a method knows why."""
        return np.zeros(self.rows, dtype=bool)

    def _length(self) -> Array:
        """(B,) m: the step to ask for."""
        return np.full(self.rows, self.config.step_m)

    @abstractmethod
    def _begin(self) -> None:
        """Make the belief of `self.rows` rows."""

    @abstractmethod
    def _turned(self, rows: Array, turn: Array, heard: Array, before: Array) -> None:
        """Rows turned, by their own account; `heard` whether the tag answers now, `before` whether it did."""

    @abstractmethod
    def _stepped(self, rows: Array, step: Array, change: Array, spread: Array, trusted: Array) -> None:
        """Rows stepped; change (E,) rad with an error of `spread` rad beyond the configured one, not to be used where not trusted."""

    @abstractmethod
    def _aim(self) -> Array:
        """(B,) rad: the turn to advise after a step."""

    @abstractmethod
    def _belief(self) -> tuple[Array, Array]:
        """Mean (B, 2) and covariance (B, 2, 2) of COMPONENTS."""


_FINE, _DOUBT, _SILENT, _WRAP = range(4)
_SENTENCES = ["", NOT_TRUSTED, NO_READS, MISDECLARED]
