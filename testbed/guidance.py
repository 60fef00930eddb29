"""What passes between a guided person and their guide: actions one way, advice the other.

A person with a handheld reader turns and steps. Each action is reported when it is complete, as the person's button says, and the
guide answers with a turn and a step. These are plain data, so a log of a real reader can be guided through, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from testbed.columns import Array, Columns, Table, column


@dataclass(frozen=True, eq=False)
class Actions(Table):
    """One row per completed action of the person: a turn (`step` 0) or a step.

    turn is what was asked for, or what the person says they did instead; nobody knows what they really did. A turn of 0 without a
    step is a pause in which the reader only listened. `change` is how far the phase turned over a step, positive where the tag got
    further away (the sign of Raptopoulos et al. 2019, Eq. 6); NaN where the guide has to find it in the reads since `began`.
    """

    t: Array = column("float64", unit="s, when it was complete")
    t_arrival: Array = column("float64", unit="s")
    began: Array = column("float64", unit="s")
    target: Array = column("int32")
    turn: Array = column("float64", unit="rad, counter-clockwise")
    step: Array = column("float64", unit="m, as asked for")
    heard: Array = column("bool")
    change: Array = column("float64", unit="rad", default=np.nan)


@dataclass(frozen=True, eq=False)
class Advice(Columns):
    """What B rows are told to do next: turn, then walk `step` if the tag still answers. A turn of NaN is none, a step of 0 none.

    led says that whoever hears nothing should go that way all the same, for the guide relies on what was heard before.
    aim is where the method believes the tag to be, rad counter-clockwise from where the person looks, NaN where it has no idea.
    said is empty, or a sentence that tells why there is no direction, or what to do about it.
    """

    turn: Array = column("float64", ("B",), "rad, counter-clockwise")
    step: Array = column("float64", ("B",), "m")
    aim: Array = column("float64", ("B",), "rad", default=np.nan)
    said: Array = column("str", ("B",), default="")
    led: Array = column("bool", ("B",), default=False)


@runtime_checkable
class FollowsPhase(Protocol):
    """A guide that can say how far it believes the phase to have turned over the last step."""

    def followed(self) -> tuple[Array, Array]:
        """(B,) rad, NaN where it does not know, and whether it trusts that (B,)."""
        ...


def wrapped(angle: Array) -> Array:
    """Angles brought into [-π, π)."""
    return np.mod(np.asarray(angle) + np.pi, 2 * np.pi) - np.pi


def in_words(turn: float, step: float, said: str = "", usual_m: float = 0.5) -> str:
    """An instruction as the person hears or reads it: "turn left 35°, one step".

    A sentence of the guide's own (`said`) comes first. Turns are told to 5°, and a step that is shorter than `usual_m` in centimetres.
    """
    parts = []
    if np.isfinite(turn):
        degrees = 5 * round(abs(float(np.rad2deg(wrapped(np.array(turn))))) / 5)
        side = "left" if wrapped(np.array(turn)) > 0 else "right"
        parts.append("turn round" if degrees == 180 else f"turn {side} {degrees}°" if degrees else "straight ahead")
    if step > 0:
        parts.append("one step" if step > 0.9 * usual_m else f"a short step of {100 * step:.0f} cm")
    told = ", ".join(parts)
    if said and told:
        return f"{said} {told[0].upper()}{told[1:]}."
    return said or told
