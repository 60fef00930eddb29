"""A guided walk as a user writes it: how a person follows instructions, and how badly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from testbed.quantity import Config, Degrees, DegreesPerSecond, Metres, MetresPerSecond, Seconds

if TYPE_CHECKING:
    from testbed.scenario import Scenario
    from testbed.scenario.model import ActorSection


class GuidedWalk(Config):
    """The person of Raptopoulos et al. 2019, Section VI: errors of a step (Eq. 1-2) and of a turn, start, and when the tag is found.

    start_distance_m : from the tag, in any direction, looking anywhere; left out, the actor starts at its position_m and yaw_deg
    step_error       : N(0, step_std_m) along a direction that is uniform (Eq. 2), or on each axis
    found_m          : the tag is found when a step ends so near to it (on the floor)
    detour_*         : with this probability a turn is not the one that was told but off by up to detour_deg, and the guide is told so
    room_m           : how much room to either side the reader wants; what stands in the way is walked round, and the guide is told so
    reads_hz         : how often an rfid reader in the hand asks its one tag (a handheld sensor has a rate of its own)
    walks_on         : so often somebody who is told that the tag does not answer walks on a step and listens there
    A person gives up after most_steps steps or most_turns turns, and where the guide says that it has no direction.
    """

    start_distance_m: Annotated[Metres, Field(gt=0, le=1000)] | None = None
    step_std_m: Annotated[Metres, Field(ge=0, le=1)] = 0.1
    step_error: Literal["ring", "axis"] = "ring"
    turn_std_deg: Annotated[Degrees, Field(ge=0, le=90)] = 11.5
    found_m: Annotated[Metres, Field(gt=0, le=100)] = 0.5
    most_steps: Annotated[int, Field(ge=1, le=10_000)] = 200
    most_turns: Annotated[int, Field(ge=1, le=100_000)] = 1000
    detour_probability: Annotated[float, Field(ge=0, le=1)] = 0.0
    detour_deg: Annotated[Degrees, Field(ge=0, le=180)] = 90.0
    speed_mps: Annotated[MetresPerSecond, Field(gt=0, le=5)] = 0.7
    turn_rate_dps: Annotated[DegreesPerSecond, Field(gt=0, le=720)] = 90.0
    pause_s: Annotated[Seconds, Field(ge=0.05, le=60)] = 0.3
    room_m: Annotated[Metres, Field(ge=0, le=2)] = 0.3
    walks_on: Annotated[int, Field(ge=0, le=1000)] = 0
    reads_hz: Annotated[float, Field(gt=0, le=10_000)] = 300.0


def guided_actor(scenario: Scenario) -> ActorSection | None:
    """The section of the actor that is guided; None where nobody is, and the loop is not closed."""
    return next((actor for actor in scenario.actors if actor.motion == "guided"), None)
