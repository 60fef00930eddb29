"""What really happened in a guided walk: one row per action. Truth: for scoring and drawing only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array, Table, column


@dataclass(frozen=True, eq=False)
class Walk(Table):
    """The actions of one guided person, in order. Row 0 is the start, when they only listened.

    An instruction is a turn, then a step if the tag answers: up to two rows have the same turn_asked, step_asked and said. x, y, heading,
    range and bearing are true, as they are when the action is complete; bearing and aim are from where the person looks, and aim is where
    the guide believed the tag to be then. kind is "start", "turn" or "step", and "end" where the guide had no direction to give: then
    nothing was done, and said tells why.
    """

    kind: Array = column("str")
    began: Array = column("float64", unit="s")
    t: Array = column("float64", unit="s")
    turn_asked: Array = column("float64", unit="rad, NaN for none")
    step_asked: Array = column("float64", unit="m, 0 for none")
    said: Array = column("str")
    informed: Array = column("float64", unit="rad, what the person said they turned")
    x: Array = column("float64", unit="m")
    y: Array = column("float64", unit="m")
    heading: Array = column("float64", unit="rad")
    range: Array = column("float64", unit="m, on the floor")
    bearing: Array = column("float64", unit="rad")
    length: Array = column("float64", unit="m, of the true step")
    heard: Array = column("bool")
    used: Array = column("bool", unit="whether the guide took it as it was told")
    aim: Array = column("float64", unit="rad, NaN where it has no idea", default=np.nan)
    change: Array = column("float64", unit="rad, of phase; NaN where it is in the reads", default=np.nan)
    followed: Array = column("float64", unit="rad, what the guide made of the phase", default=np.nan)
    trusted: Array = column("bool", unit="whether it trusts that", default=False)
    found: Array = column("bool", default=False)
