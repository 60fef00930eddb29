"""Numbers with a unit at the edge: the types of configuration fields, and the check that a unit fits.

A field's name ends in its unit (`range_m`, `power_dbm`, `tilt_deg`) and its value is a plain number in that unit, or a
text with a unit of its own ("3 km/h" for `speed_mps`), which is converted or, if it is no such quantity, refused. Never NaN,
never infinite.
"""

from __future__ import annotations

import math
import re
from functools import cache, partial
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema


class Config(BaseModel):
    """Base of all configuration models: unknown keys are errors, values can't be changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)


class UnusableFile(ValueError):
    """A section names a file that can't be used; the message names the file, and the place in it."""


class FileMissing(UnusableFile):
    """A section names a file that is not on this machine: the section may be right all the same."""


class Misplaced(ValueError):
    """A mistake with a place of its own: `place` are the keys and indices that lead to it from the section that is judged."""

    def __init__(self, place: tuple[str | int, ...], message: str) -> None:
        super().__init__(message)
        self.place = place


_UNIT_TEXT = re.compile(r"[A-Za-zµμ°%]+[A-Za-z0-9µμ°/^* -]*")
_LOGARITHMIC = {"dB", "dBm", "dBi"}  # levels and gains: no conversion makes sense, the unit must be the field's own


@cache
def _registry() -> Any:
    import pint  # 0.7 s: only when a file gives a text for a number

    return pint.UnitRegistry()


def convert(value: Any, unit: str) -> Any:
    """A number in `unit` from a number or from text such as "30 cm"; other types pass through for pydantic to judge.

    ValueError, in one sentence, for text that is no number with a fitting unit.
    """
    if not isinstance(value, str):
        return value
    text = value.strip()
    if unit in _LOGARITHMIC:
        number, _, given = text.partition(" ")
        if given.strip() != unit:
            raise ValueError(f"{value!r} is not a number in {unit}")
        return _number(number, value, unit)
    import pint

    if len(text) > 60:
        raise ValueError(f"a number in {unit} is wanted, not a text of {len(text)} characters")
    number, _, given = text.partition(" ")
    size = _number(number, value, unit)
    if not given:
        return size
    if not _UNIT_TEXT.fullmatch(given):  # only the unit goes to pint's parser, and only what can be a unit
        raise ValueError(_unknown(value, unit))
    try:
        return float(_registry().Quantity(size, _registry().Unit(given.strip())).to(unit or "dimensionless").magnitude)
    except pint.DimensionalityError:
        raise ValueError(f"{value!r} is not a quantity in {unit or 'plain numbers'}: the units don't fit") from None
    except Exception:  # the parser of units raises whatever its tokens make it raise
        raise ValueError(_unknown(value, unit)) from None


def _unknown(value: str, unit: str) -> str:
    wanted = f'as in "1.5 {unit}"' if unit else "a plain number is wanted"
    return f"{value!r} is not a number with a known unit ({wanted})"


def _number(text: str, value: str, unit: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise ValueError(f"{value!r} is not a number{f' in {unit}' if unit else ''}") from None
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not a finite number")
    return number


class Unit:
    """The mark of a field's unit: text with a unit is converted, and JSON Schema says what the number means."""

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(partial(convert, unit=self.unit), handler(source))

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        number = handler(schema)
        return {"anyOf": [number, {"type": "string"}], "unit": self.unit}


Metres = Annotated[float, Unit("m")]
Seconds = Annotated[float, Unit("s")]
Hertz = Annotated[float, Unit("Hz")]
MetresPerSecond = Annotated[float, Unit("m/s")]
MetresPerSecond2 = Annotated[float, Unit("m/s^2")]
Degrees = Annotated[float, Unit("deg")]
DegreesPerSecond = Annotated[float, Unit("deg/s")]
Decibels = Annotated[float, Unit("dB")]
DecibelsIsotropic = Annotated[float, Unit("dBi")]
DecibelMilliwatts = Annotated[float, Unit("dBm")]
Kilograms = Annotated[float, Unit("kg")]

Point2 = tuple[Metres, Metres]
Point3 = tuple[Metres, Metres, Metres]
