"""What an installer says of a site and of the logs that its readers write: the file behind `testbed replay LOG --site site.yaml`.

    name: dock-7
    log: {kind: sllurp_csv, time_unit: us, lateness_s: 2}      # how the log is written; all but kind has the format's own default
    carriers_mhz: [866.3, 867.5]                               # the hop table, in the reader's order
    antennas:
      - {id: left, port: 1, position_m: [0, -1.2, 1.5], aim_m: [0, 0, 1]}
      - {id: right, port: 2, position_m: [0, 1.2, 1.5], aim_m: [0, 0, 1]}
    tags:
      - {id: lid, epc: 300833b2ddd9014000000000}
    targets:
      - {id: cart, tags: [lid]}                                # without any, each tag is one
    prior: {position_m: [3, 0, 1], position_std_m: 2}
    truth: {kind: tum}                                         # how a truth file is written

Left out: antennas that move with a body.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, ValidationError, model_validator

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from testbed.logs.bad import LogError
from testbed.logs.units import ChannelUnit, DopplerUnit, PhaseUnit, RssiUnit, TimeUnit
from testbed.quantity import Config, DecibelMilliwatts, Decibels, DecibelsIsotropic, Degrees, Hertz, Metres, Point2, Point3, Seconds
from testbed.radio.regions import hop_table
from testbed.scenario.model import ID_PATTERN, PriorModel
from testbed.scenario.nodes import MAX_BYTES, read
from testbed.types import Antennas

Text = Annotated[str, Field(min_length=1, max_length=200)]
M = TypeVar("M", bound=BaseModel)
FAR_M = 1e6  # m: beyond lies no site


class LogModel(Config):
    """How a log is written. `kind` names its format (a file in `testbed/logs/formats`); what is left out is as that format has it.

    time_unit     : s, ms, us, ns since any origin, or iso for dates
    start_s       : the time of the log's clock that is t = 0; its first row where left out
    lateness_s    : rows may come so much later than rows with later times; what comes later still is left out, and counted
    longest_gap_s : a row farther ahead than this is taken for a wrong clock, and left out
    phase_wrap    : 2pi where phase is reported over a whole turn, pi where half a turn wraps it
    phase_sign    : -1 for a reader whose phase falls with distance the other way round
    columns       : names of the file's columns by what they mean (time, antenna, tag, rssi, phase, channel, doppler, ...)
    """

    kind: Text
    time_unit: TimeUnit | None = None
    start_s: Annotated[float, Field(ge=0, le=1e10)] | None = None
    rssi_unit: RssiUnit | None = None
    phase_unit: PhaseUnit | None = None
    phase_wrap: Literal["2pi", "pi"] = "2pi"
    phase_sign: Literal[1, -1] = 1
    channel_unit: ChannelUnit | None = None
    doppler_unit: DopplerUnit | None = None
    lateness_s: Annotated[Seconds, Field(ge=0, le=3600)] = 1.0
    longest_gap_s: Annotated[Seconds, Field(gt=0, le=1e8)] = 3600.0
    columns: Annotated[dict[Text, Text], Field(max_length=40)] = Field(default_factory=dict)


class SiteAntenna(Config):
    """An antenna, or an anchor of ranges: under which name the log knows it (`port`, and `reader` where there are several).

    Without `aim_m` it is the same all round. `reference_dbm`: its level at 1 m on boresight, where that is known better than its power.
    """

    id: Text
    port: str | int | None = None
    reader: Text | None = None
    position_m: Point3
    aim_m: Point3 | None = None
    gain_dbi: Annotated[DecibelsIsotropic, Field(ge=-20, le=40)] = 6.0
    beamwidth_deg: Annotated[Degrees, Field(gt=0, le=360)] | None = None
    front_to_back_db: Annotated[Decibels, Field(ge=0, le=60)] = 20.0
    power_dbm: Annotated[DecibelMilliwatts, Field(ge=-60, le=60)] = 29.0
    reference_dbm: Annotated[DecibelMilliwatts, Field(ge=-150, le=60)] | None = None

    @model_validator(mode="after")
    def _here(self) -> SiteAntenna:
        if max(map(abs, self.position_m)) > FAR_M:
            raise ValueError(f"position_m lies {FAR_M / 1000:g} km off or more: no site is as large")
        if self.aim_m == self.position_m:
            raise ValueError("aim_m is where the antenna is: aim it elsewhere")
        return self


class SiteTag(Config):
    """A tag (or beacon): what the log calls it, and where it is, if that is known and it never moves."""

    id: Text
    epc: Text | None = None
    position_m: Point3 | None = None
    gain_dbi: Annotated[DecibelsIsotropic, Field(ge=-20, le=20)] = 2.0
    sensitivity_dbm: Annotated[DecibelMilliwatts, Field(ge=-60, le=10)] = -19.5


class SiteTarget(Config):
    """Something to be located, by its tags."""

    id: Annotated[str, Field(pattern=ID_PATTERN, max_length=60)]
    tags: Annotated[list[Text], Field(max_length=1000)] = Field(default_factory=list)


class SiteObstacle(Config):
    """A box that stands in the way."""

    center_m: Point3
    size_m: tuple[Annotated[Metres, Field(gt=0, le=1e4)], Annotated[Metres, Field(gt=0, le=1e4)], Annotated[Metres, Field(gt=0, le=1e4)]]
    yaw_deg: Degrees = 0.0


class TruthModel(Config):
    """How a truth file is written: tum (t x y z qx qy qz qw), librsf (point2), or csv with columns t, x, y and perhaps z, target.

    Times are on the log's clock.

    height_m: z where the file has none.
    """

    kind: Literal["tum", "csv", "librsf"] = "tum"
    path: Annotated[str, Field(min_length=1, max_length=500)] | None = None
    time_unit: TimeUnit = "s"
    height_m: Metres = 0.0


class SiteModel(Config):
    """A site file."""

    name: Annotated[str, Field(pattern=ID_PATTERN, max_length=60)] = "site"
    log: LogModel
    antennas: Annotated[list[SiteAntenna], Field(max_length=10_000)] = Field(default_factory=list)
    region: Literal["etsi", "fcc"] | None = None
    carriers_mhz: Annotated[list[Annotated[float, Field(ge=1, le=100_000)]], Field(max_length=1000)] | None = None
    tags: Annotated[list[SiteTag], Field(max_length=100_000)] = Field(default_factory=list)
    targets: Annotated[list[SiteTarget], Field(max_length=1000)] = Field(default_factory=list)
    bounds_m: tuple[Point2, Point2] | None = None
    height_m: Annotated[Metres, Field(gt=0, le=100)] = 3.0
    obstacles: Annotated[list[SiteObstacle], Field(max_length=10_000)] = Field(default_factory=list)
    truth: TruthModel = TruthModel()
    prior: PriorModel | None = None
    report_hz: Annotated[Hertz, Field(gt=0, le=1000)] = 10.0

    @model_validator(mode="after")
    def _apart(self) -> SiteModel:
        named = {"antennas": [a.id for a in self.antennas], "tags": [t.id for t in self.tags], "targets": [t.id for t in self.targets]}
        for group, ids in named.items():
            twice = next((id for i, id in enumerate(ids) if id in ids[:i]), None) if len(ids) < 2000 else None
            if twice is not None or len(set(ids)) < len(ids):
                raise ValueError(f"{group}: the id {twice or 'of one'!r} is used twice")
        ports = [(a.reader, a.name) for a in map(_Named, self.antennas)]
        if len(set(ports)) < len(ports):
            raise ValueError("antennas: two have the same port of the same reader; give each its own port")
        known = set(named["tags"])
        for target in self.targets:
            stranger = next((tag for tag in target.tags if known and tag not in known), None)
            if stranger is not None:
                raise ValueError(f"targets: {target.id} has the tag {stranger!r}, which is not among the tags")
        return self

    def carriers(self) -> Array:
        """(C,) Hz: the hop table as listed, the region's, or none."""
        if self.carriers_mhz is not None:
            return np.array(self.carriers_mhz) * 1e6
        return hop_table(self.region) if self.region is not None else np.empty(0)

    def boxes(self) -> Boxes:
        """The obstacles, in the world frame."""
        if not self.obstacles:
            return Boxes.empty()
        return Boxes(
            center=np.array([o.center_m for o in self.obstacles]),
            quaternion=np.array([frames.from_euler(np.deg2rad(o.yaw_deg)) for o in self.obstacles]),
            half=np.array([o.size_m for o in self.obstacles]) / 2,
        )


class _Named:
    """An antenna's name in the log."""

    def __init__(self, antenna: SiteAntenna) -> None:
        self.reader, self.name = antenna.reader, port_name(antenna)


def port_name(antenna: SiteAntenna) -> str:
    """What the log calls an antenna: its port, or its id where it has none."""
    return str(antenna.id if antenna.port is None else antenna.port).strip().lower()


def antennas_of(found: list[SiteAntenna]) -> Antennas:
    """The antennas of a site as data."""
    if not found:
        return Antennas.empty()
    position = np.array([a.position_m for a in found], dtype=np.float64)
    aim = np.array([(x + 1.0, y, z) if a.aim_m is None else a.aim_m for a in found for x, y, z in [a.position_m]])
    width = [(360.0 if a.aim_m is None else 70.0) if a.beamwidth_deg is None else a.beamwidth_deg for a in found]
    return Antennas(
        id=np.array([a.id for a in found]),
        position=position,
        quaternion=frames.looking_at(position, aim),
        gain=np.array([a.gain_dbi for a in found]),
        beamwidth=np.deg2rad(width),
        front_to_back=np.array([a.front_to_back_db for a in found]),
        power=np.array([a.power_dbm for a in found]),
        reader=np.array([a.reader or "" for a in found], dtype=np.str_),
        reference=np.array([np.nan if a.reference_dbm is None else a.reference_dbm for a in found]),
    )


def load_site(path: str | Path) -> SiteModel:
    """The site of a YAML file. LogError, with what is wrong and where, for one that can't be used."""
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LogError(f"{path}: over {MAX_BYTES // 1_000_000} MB: too large for a site; move tags to a table")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path} can't be read: {getattr(error, 'strerror', None) or error}") from None
    return checked_site(read(text, str(path)).plain(), str(path))


def checked_site(plain: Any, path: str = "site") -> SiteModel:
    """The site of plain values. LogError with the first mistakes."""
    return checked(SiteModel, plain, path)


def checked(model: type[M], plain: Any, path: str) -> M:
    """A model of plain values; LogError, in one sentence a mistake, for what does not fit."""
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        said = [f"{'.'.join(map(str, e['loc']))}: {e['msg'].removeprefix('Value error, ')}".lstrip(": ") for e in error.errors()[:5]]
        raise LogError(f"{path}: {'; '.join(said)}") from None
