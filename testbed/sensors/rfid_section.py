"""The `rfid` section of a scenario: antennas, reader, channel, what the reader makes of a wave, and where counts come from."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from testbed.quantity import Config, DecibelMilliwatts, Decibels, Misplaced, Seconds
from testbed.radio.artefacts import OFF, ArtefactsConfig
from testbed.radio.profiles import PROFILES, Profile, profile
from testbed.radio.regions import hop_table, within_limit
from testbed.radio.setting import ChannelConfig
from testbed.sensors.antenna_rule import AntennaRule
from testbed.sensors.counting import CountingConfig


class ReaderConfig(Config):
    """A reader: the name of its profile (`testbed.radio.profiles`), and what differs from it.

    ports  : antennas that one reader serves in turn; more antennas make more readers, which work at the same time
    select : patterns over tag ids that Select lets through; the others are not asked
    step_s : how long a margin holds, before the channel is asked anew who can answer; reads are checked at their own times
    """

    profile: Annotated[str, Field(json_schema_extra={"enum": list(PROFILES)})] = "fx7500"
    ports: Annotated[int, Field(ge=1, le=10_000)] | None = None
    sensitivity_dbm: Annotated[DecibelMilliwatts, Field(ge=-120, le=0)] | None = None
    session: Literal[0, 1, 2, 3] | None = None
    dual_target: bool | None = None
    start_q: Annotated[int, Field(ge=0, le=12)] | None = None
    between_rounds_s: Annotated[Seconds, Field(ge=0, le=1)] | None = None
    port_switch_s: Annotated[Seconds, Field(ge=0, le=1)] | None = None
    longest_visit_s: Annotated[Seconds, Field(ge=0.002, le=60)] | None = None
    select: Annotated[list[str], Field(min_length=1)] | None = None
    step_s: Annotated[Seconds, Field(ge=0.005, le=10)] = 0.1

    @field_validator("profile")
    @classmethod
    def _known(cls, value: str) -> str:
        profile(value)
        return value

    @field_validator("select", mode="before", json_schema_input_type=str | list[str])
    @classmethod
    def _one_pattern_is_a_list_of_one(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value

    def resolved(self) -> Profile:
        """The profile with what is given here."""
        given = {name.removesuffix("_s"): value for name, value in self.model_dump(exclude={"profile"}).items() if value is not None}
        return profile(self.profile, **{f.name: given[f.name] for f in fields(Profile) if f.name in given})


class RfidConfig(Config):
    """A reader with its antennas, or several of one make. Defaults are of an FX7500-like reader, 35 dBm EIRP."""

    antennas: Annotated[list[AntennaRule], Field(min_length=1, max_length=10_000)]
    region: Literal["etsi", "fcc"] = "etsi"
    carriers_mhz: Annotated[list[float], Field(max_length=50)] | None = None  # the hop table, in its order; without, all of the region's
    power_dbm: Annotated[DecibelMilliwatts, Field(ge=-30, le=40)] = 29.0
    modulation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] = 8.0
    reader: ReaderConfig = Field(default_factory=ReaderConfig)
    channel: ChannelConfig = Field(default_factory=ChannelConfig)
    artefacts: ArtefactsConfig = Field(default_factory=ArtefactsConfig)
    detection: Literal["link"] | CountingConfig = "link"  # logistic_beta: counts alone, from the published model; reader and channel rest

    @field_validator("antennas", mode="before", json_schema_input_type=AntennaRule | list[AntennaRule])
    @classmethod
    def _one_rule_is_a_list_of_one(cls, value: Any) -> Any:
        return [value] if isinstance(value, dict | AntennaRule) else value

    @field_validator("reader", mode="before", json_schema_input_type=ReaderConfig | str)
    @classmethod
    def _a_name_is_a_profile(cls, value: Any) -> Any:
        return {"profile": value} if isinstance(value, str) else value

    @field_validator("artefacts", mode="before", json_schema_input_type=ArtefactsConfig | Literal["off"])
    @classmethod
    def _off_is_all_of_them(cls, value: Any) -> Any:
        return OFF if isinstance(value, str) and value == "off" else value

    @field_validator("detection", mode="before", json_schema_input_type=Literal["link", "logistic_beta"] | CountingConfig)
    @classmethod
    def _a_name_is_a_kind(cls, value: Any) -> Any:
        return CountingConfig() if isinstance(value, str) and value == "logistic_beta" else value

    @model_validator(mode="after")
    def _as_the_region_allows(self) -> RfidConfig:
        hop_table(self.region, self.carriers_mhz)
        for i, antenna in enumerate(self.antennas):
            try:
                within_limit(self.region, self.power_dbm if antenna.power_dbm is None else antenna.power_dbm, antenna.gain_dbi)
            except ValueError as error:
                raise Misplaced(("antennas", i), str(error)) from None
        return self
