"""Where a scenario puts a reader's antennas, and what they are."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from testbed.quantity import Config, DecibelMilliwatts, Decibels, DecibelsIsotropic, Degrees, Point3


class AntennaRule(Config):
    """One antenna at a place, or some of the antenna mounts that bodies offer.

    With `position_m` (in the frame of the body `on`, else the world) it looks along yaw and tilt, or at `aim_m`. Without,
    `on` and `mount` are patterns over bodies and their mounts, and `count` takes the first so many.
    """

    id: str | None = None
    on: str | None = None
    mount: str | None = None
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None
    position_m: Point3 | None = None
    aim_m: Point3 | None = None
    yaw_deg: Degrees = 0.0
    tilt_deg: Degrees = 0.0  # positive looks up
    power_dbm: DecibelMilliwatts | None = None  # the reader's, where left out
    gain_dbi: Annotated[DecibelsIsotropic, Field(ge=-20, le=30)] = 6.0
    beamwidth_deg: Annotated[Degrees, Field(gt=1, lt=179)] = 68.0
    front_to_back_db: Annotated[Decibels, Field(ge=0, le=60)] = 18.0

    @model_validator(mode="after")
    def _one_way_of_placing(self) -> AntennaRule:
        if self.position_m is None and self.on is None:
            raise ValueError("says neither where it is (position_m) nor which body's mounts it takes (on)")
        if self.position_m is not None and (self.mount is not None or self.count is not None):
            raise ValueError("position_m places one antenna; mount and count choose among mounts: give one or the other")
        if self.aim_m is not None and self.position_m is None:
            raise ValueError("aim_m belongs to an antenna with position_m; a mount has its own direction")
        if self.id is not None and self.position_m is None:
            raise ValueError("an antenna on a mount is named after the mount: leave id out")
        return self
