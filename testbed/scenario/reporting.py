"""What a scenario wants to see in its report, besides what every report has: `report: {coverage: {height_m: [1.0]}}`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, field_validator

from testbed.columns import Array
from testbed.plugins import suggest
from testbed.quantity import Config, Metres
from testbed.radio.tags import tag_model


def _listed(value: Any) -> Any:
    """One height, or one id, is a list of one."""
    return value if isinstance(value, list | tuple) else [value]


Heights = Annotated[list[Metres], Field(min_length=1, max_length=6), BeforeValidator(_listed, json_schema_input_type=Metres | list[Metres])]
Ids = Annotated[list[str], Field(max_length=1000), BeforeValidator(_listed, json_schema_input_type=str | list[str])]


class CoverageModel(Config):
    """A map of where the site's readers hear a tag (`testbed.coverage`). sensors: ids of rfid sensors; all, where left out."""

    step_m: Annotated[Metres, Field(ge=0.02, le=100)] = 0.25
    height_m: Heights = Field(default_factory=lambda: [1.0])
    tag: Annotated[str, Field(min_length=1, max_length=60)] = "monza_4"
    sensors: Ids = Field(default_factory=list)

    @field_validator("tag")
    @classmethod
    def _known(cls, value: str) -> str:
        tag_model(value)
        return value


class ReportModel(Config):
    """The `report` section."""

    coverage: CoverageModel | None = None


def mistakes(asked: CoverageModel, bounds: Array, readers: Sequence[str]) -> Iterator[tuple[str, str]]:
    """(field, what is wrong with it) of a map that can't be made in a hall with these bounds (2, 3) and ids of rfid sensors."""
    if not readers:
        yield "sensors", "there is no sensor of kind rfid whose coverage could be shown"
        return
    for id in asked.sensors:
        if id not in readers:
            yield "sensors", f"no rfid sensor is called {id!r}{suggest(id, list(readers))}"
    for height in asked.height_m:
        if not bounds[0][2] <= height <= bounds[1][2]:
            yield "height_m", f"a height of {height:g} m is not in the hall, which goes from {bounds[0][2]:g} to {bounds[1][2]:g} m"
