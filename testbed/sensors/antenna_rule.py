"""Where a scenario puts a reader's antennas, and what they are."""

from __future__ import annotations

import csv
import io
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from testbed.columns import Array
from testbed.quantity import Config, DecibelMilliwatts, Decibels, DecibelsIsotropic, Degrees, Point3
from testbed.radio.antenna import tabulated

MAX_ROWS = 10_000  # of a pattern
LEAST = -200  # dB: no measuring chamber sees less
_COLUMNS = ["angle_deg", "gain_db"]

_Angles = Annotated[list[Degrees], Field(max_length=MAX_ROWS)]
_Gains = Annotated[list[Annotated[Decibels, Field(ge=LEAST, le=-LEAST)]], Field(max_length=MAX_ROWS)]


class PatternTable(Config):
    """Gain relative to boresight over the angle off it, the same all round: two lists, or a table with these columns beside the scenario.

    Angles ascend from 0 to 180, or end before with `beyond_db` for what is behind them; the gain is 0 at 0° and nowhere greater.
    """

    csv: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    angle_deg: _Angles = Field(default_factory=list)
    gain_db: _Gains = Field(default_factory=list)
    beyond_db: Annotated[Decibels, Field(ge=LEAST)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        """What a table holds stands in its place, so that equal patterns are equal wherever they came from."""
        if not isinstance(data, dict) or not isinstance(name := data.get("csv"), str):
            return data
        if {"angle_deg", "gain_db"} & data.keys():
            raise ValueError("csv brings angle_deg and gain_db: give one or the other")
        if not info.context or "table" not in info.context:
            raise ValueError(f"there is no folder to look for {name!r} in: give angle_deg and gain_db, or load a scenario from a file")
        angle, gain = _columns(name, info.context["table"](name))
        return {**data, "csv": None, "angle_deg": angle, "gain_db": gain}

    @model_validator(mode="after")
    def _sound(self) -> PatternTable:
        self.knots()
        return self

    def knots(self) -> Array:
        """(181,) dB at whole degrees. ValueError, in one sentence, for a table that is none."""
        return tabulated(self.angle_deg, self.gain_db, self.beyond_db)


def _columns(name: str, text: str) -> tuple[list[float], list[float]]:
    """The two columns of a table. ValueError, naming the line, for what is no number."""
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    found: list[list[float]] = []
    try:
        header = [word.strip() for word in next(rows, [])]
        if sorted(header) != sorted(_COLUMNS):
            raise ValueError(f"{name}:1: a pattern's columns are angle_deg,gain_db, not {','.join(header)[:80]!r}")
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            try:
                angle, gain = (float(row[header.index(column)]) for column in _COLUMNS if len(row) == len(header))
                if not (0 <= angle <= 180 and LEAST <= gain <= 0):
                    raise ValueError
            except ValueError:
                wanted = f"an angle from 0 to 180 and a gain from {LEAST} to 0 dB"
                raise ValueError(f"{name}:{rows.line_num}: {wanted} are wanted, not {','.join(row)[:80]!r}") from None
            if len(found) == MAX_ROWS:
                raise ValueError(f"{name}:{rows.line_num}: over {MAX_ROWS:,} rows")
            found.append([angle, gain])
    except csv.Error as error:
        raise ValueError(f"{name}:{rows.line_num}: not a table of values with commas between them: {error}") from None
    columns = np.array(found).reshape(-1, 2).T.tolist()
    return columns[0], columns[1]


class AntennaRule(Config):
    """One antenna at a place, or some of the antenna mounts that bodies offer.

    With `position_m` (in the frame of the body `on`, else the world) it looks along yaw and tilt, or at `aim_m`. Without,
    `on` and `mount` are patterns over bodies and their mounts, and `count` takes the first so many. `roll_deg` turns it about its
    boresight: the field of a linear antenna is upright at 0 and level at 90.
    """

    id: str | None = None
    on: str | None = None
    mount: str | None = None
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None
    position_m: Point3 | None = None
    aim_m: Point3 | None = None
    yaw_deg: Degrees = 0.0
    tilt_deg: Degrees = 0.0  # positive looks up
    roll_deg: Degrees = 0.0
    power_dbm: DecibelMilliwatts | None = None  # the reader's, where left out
    gain_dbi: Annotated[DecibelsIsotropic, Field(ge=-20, le=30)] = 6.0
    polarisation: Literal["circular", "linear"] = "circular"
    beamwidth_deg: Annotated[Degrees, Field(gt=1, lt=179)] = 68.0
    front_to_back_db: Annotated[Decibels, Field(ge=0, le=60)] = 18.0
    pattern: PatternTable | None = None  # in the place of the two

    @model_validator(mode="after")
    def _one_way_of_placing(self) -> AntennaRule:
        if self.position_m is None and self.on is None:
            raise ValueError("says neither where it is (position_m) nor which body's mounts it takes (on)")
        if self.position_m is not None and (self.mount is not None or self.count is not None):
            raise ValueError("position_m places one antenna; mount and count choose among mounts: give one or the other")
        if self.aim_m is not None and self.position_m is None:
            raise ValueError("aim_m belongs to an antenna with position_m; a mount has its own direction")
        if self.aim_m is not None and {"yaw_deg", "tilt_deg"} & self.model_fields_set:
            raise ValueError("aim_m says where the antenna looks, and so do yaw_deg and tilt_deg: give one or the other")
        if self.position_m is None and (turned := {"yaw_deg", "tilt_deg"} & self.model_fields_set):
            raise ValueError(f"{min(turned)} belongs to an antenna with position_m; a mount has its own direction")
        if self.id is not None and self.position_m is None:
            raise ValueError("an antenna on a mount is named after the mount: leave id out")
        return self

    @model_validator(mode="after")
    def _one_pattern(self) -> AntennaRule:
        shaped = {"beamwidth_deg", "front_to_back_db"} & self.model_fields_set
        if self.pattern is not None and shaped:
            raise ValueError(f"{min(shaped)} is of an antenna without a table: pattern says it all")
        return self
