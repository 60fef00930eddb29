"""How a format of reads writes its columns: their names, and the unit of each. A site's `log` section may say otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from testbed.logs.bad import LogError
from testbed.logs.site import LogModel
from testbed.logs.units import ChannelUnit, DopplerUnit, PhaseUnit, RssiUnit, TimeUnit
from testbed.plugins import suggest

NEEDED = ("time", "antenna", "tag")
ROLES = (*NEEDED, "rssi", "phase", "channel", "doppler", "reader")


@dataclass(frozen=True)
class Layout:
    """names : for each role, the column names that it goes by, in small letters, best first."""

    names: Mapping[str, Sequence[str]]
    time_unit: TimeUnit = "us"
    rssi_unit: RssiUnit = "dbm"
    phase_unit: PhaseUnit = "rad"
    channel_unit: ChannelUnit = "index"
    doppler_unit: DopplerUnit = "hz"
    delimiter: str = ","
    comment: str = ""
    units: Mapping[str, str] = field(default_factory=dict)  # of columns whose name says another unit than the layout's

    def declared(self, log: LogModel) -> Layout:
        """As a site's log section has it."""
        given = {name: getattr(log, name) for name in ("time_unit", "rssi_unit", "phase_unit", "channel_unit", "doppler_unit")}
        return replace(self, **{name: value for name, value in given.items() if value is not None})

    def found(self, header: Sequence[str], log: LogModel, path: str) -> tuple[dict[str, str], Layout]:
        """(column by role, the layout with the units that names of columns imply where the site declares none).

        LogError where a column that is needed is not there, or one that the site names.
        """
        plain = {name.strip().strip('"').lower(): name for name in header}
        if len(plain) < len(header):
            raise LogError(f"{path}: two columns have one name: {', '.join(h.strip()[:40] for h in header[:40])}")
        columns: dict[str, str] = {}
        for role, wanted in log.columns.items():
            if role not in self.names:
                raise LogError(f"log.columns: {role!r} means nothing in a log of kind {log.kind}{suggest(role, list(self.names))}")
            if wanted.strip().lower() not in plain:
                raise LogError(f"{path}: there is no column {wanted!r}{suggest(wanted, list(plain)[:100])}")
            columns[role] = plain[wanted.strip().lower()]
        for role, names in self.names.items():
            fitting = next((plain[name] for name in names if name in plain), None)
            if role not in columns and fitting is not None:
                columns[role] = fitting
        missing = [role for role in NEEDED if role not in columns]
        if missing:
            listed = ", ".join(name.strip()[:40] for name in header[:20])
            raise LogError(f"{path}: no column is the {missing[0]} (one of {', '.join(self.names[missing[0]])}); the header has {listed}")
        implied = {f"{role}_unit": self.units[name] for role, c in columns.items() if (name := c.strip().lower()) in self.units}
        implied = {unit: value for unit, value in implied.items() if getattr(log, unit) is None}
        return columns, replace(self.declared(log), **implied)
