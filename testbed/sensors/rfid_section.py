"""The `rfid` section of a scenario: antennas, reader and channel."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from testbed.quantity import Config, DecibelMilliwatts, Decibels, DecibelsIsotropic, Degrees, Hertz, Point3, Seconds
from testbed.radio.regions import REGIONS
from testbed.radio.setting import ChannelConfig


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


class RfidConfig(Config):
    """A reader. Defaults are of an FX7500-like reader over several tags, 35 dBm EIRP."""

    antennas: Annotated[list[AntennaRule], Field(min_length=1, max_length=10_000)]
    region: Literal["etsi", "fcc"] = "etsi"
    power_dbm: Annotated[DecibelMilliwatts, Field(ge=-30, le=40)] = 29.0
    sensitivity_dbm: Annotated[DecibelMilliwatts, Field(ge=-120, le=0)] = -84.0
    modulation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] = 8.0
    read_rate_hz: Annotated[Hertz, Field(gt=0, le=2000)] = 180.0
    dwell_s: Annotated[Seconds, Field(ge=0.001, le=10)] = 0.04
    switch_s: Annotated[Seconds, Field(ge=0, le=1)] = 0.002
    latency_s: Annotated[Seconds, Field(ge=0, le=60)] = 0.0
    channel: ChannelConfig | None = None  # edges, reflections, diffuse part; without, the straight path through obstacles and fading_db
    fading_db: Annotated[Decibels, Field(ge=0, le=20)] | None = None  # of the one-way gain, from dwell to dwell: 1, with a channel 0
    rssi_noise_db: Annotated[Decibels, Field(ge=0, le=20)] = 0.5
    rssi_step_db: Annotated[Decibels, Field(ge=0, le=10)] = 0.5
    phase_noise_rad: Annotated[float, Field(ge=0, le=4)] = 0.05
    phase_offsets: bool = True

    @field_validator("antennas", mode="before", json_schema_input_type=AntennaRule | list[AntennaRule])
    @classmethod
    def _one_rule_is_a_list_of_one(cls, value: Any) -> Any:
        return [value] if isinstance(value, dict | AntennaRule) else value

    @property
    def fade_db(self) -> float:
        """Standard deviation of the fading from dwell to dwell: a channel brings a diffuse part of its own."""
        return self.fading_db if self.fading_db is not None else 1.0 if self.channel is None else 0.0

    @model_validator(mode="after")
    def _within_the_limit(self) -> RfidConfig:
        region = REGIONS[self.region]
        for i, antenna in enumerate(self.antennas):
            eirp = (self.power_dbm if antenna.power_dbm is None else antenna.power_dbm) + antenna.gain_dbi
            if eirp > region.limit_dbm + 1e-9:
                raise ValueError(
                    f"antennas.{i} radiates {eirp:g} dBm EIRP, over the limit of {region.limit_dbm:g} dBm ({region.limit_says})"
                )
        return self
