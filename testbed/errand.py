"""What a trolley does at a gate as a user writes it: go in, go out, pass by, turn back. How it moves is the business of the worlds."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from testbed.quantity import Config, Metres, MetresPerSecond, MetresPerSecond2, Point2, Seconds

Kind = Literal["in", "out", "pass", "uturn"]
Stretch = tuple[Metres, Metres]


class Errand(Config):
    """One event at a gate each trial; which of `kinds` it is, where exactly, how fast and when is drawn anew, each uniformly.

    In the gate's own frame (origin on the floor between the posts, +x is in, +y left): "in" leads from `outside_m` through the gate to
    `inside_m`, "out" back; "uturn" comes from either place, turns on the spot at a distance within `turn_m` of the plane, and goes back;
    "pass" leads along y inside, at a distance within `pass_m` of the plane and from `pass_reach_m` on one side to as far on the other.
    The passage is crossed at y within `lateral_jitter_m` of its middle, and not at a right angle. The body waits until `start_s`
    (plus a draw from U(0, start_jitter_s)), and stands where it ends.
    """

    gate: Annotated[str, Field(min_length=1, max_length=60)] = "gate1"
    kinds: Annotated[tuple[Kind, ...], Field(min_length=1, max_length=20)] = ("in", "out", "pass", "uturn")
    outside_m: Point2 = (-4.2, 0.0)
    inside_m: Point2 = (4.2, 0.0)
    turn_m: Stretch = (1.2, 2.2)
    pass_m: Stretch = (2.2, 3.0)
    pass_reach_m: Annotated[Metres, Field(gt=0.5, le=50)] = 4.0
    lateral_jitter_m: Annotated[Metres, Field(ge=0, le=2)] = 0.35
    speed_mps: Annotated[MetresPerSecond, Field(gt=0, le=20)] = 1.0
    speed_jitter: Annotated[float, Field(ge=0, lt=1)] = 0.2
    acceleration_mps2: Annotated[MetresPerSecond2, Field(gt=0, le=50)] = 0.8
    start_s: Annotated[Seconds, Field(ge=0, le=86_400)] = 0.0
    start_jitter_s: Annotated[Seconds, Field(ge=0, le=3_600)] = 1.0

    @model_validator(mode="after")
    def _sides(self) -> Errand:
        if self.outside_m[0] > -CLEAR or self.inside_m[0] < CLEAR:
            raise ValueError(f"outside_m begins at least {CLEAR:g} m before the gate's plane (x negative), inside_m as far behind it")
        for name in ("turn_m", "pass_m"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise ValueError(f"{name} is a stretch from a smaller to a larger distance from the gate's plane, both above 0")
        if self.turn_m[1] > min(-self.outside_m[0], self.inside_m[0]) - 0.5:
            raise ValueError(
                "turn_m: who turns back has come at least 0.5 m from outside_m or inside_m: turn farther in, or start farther out"
            )
        return self


CLEAR = 2.0  # m from the plane to where an errand starts and ends: anything nearer stands in the gate
