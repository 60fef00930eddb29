"""The `rfid` section of a scenario: antennas, reader and channel."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from testbed.quantity import Config, DecibelMilliwatts, Decibels, Hertz, Seconds
from testbed.radio.regions import REGIONS
from testbed.radio.setting import ChannelConfig
from testbed.sensors.antenna_rule import AntennaRule


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
