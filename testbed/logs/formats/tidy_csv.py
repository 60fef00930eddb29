"""The testbed's own table of reads, for whoever writes a converter: one row a read, a name and a unit a column.

    t,antenna,tag,rssi,phase,channel,doppler
    0.0125,left,lid,-51.5,3.0434,7,
    0.0190,right,lid,-58,,7,

t in s from any origin; antenna: a port or an id of the site; rssi in dBm; phase in rad; channel: a place in the hop table, from 0;
doppler in Hz. An empty cell is a quantity that the reader does not report. Only t, antenna and tag are needed; other columns are
passed over. Names and units may be declared otherwise in the site's `log` section.
"""

from __future__ import annotations

from testbed.logs.contents import Contents, Job, read_rows
from testbed.logs.layout import Layout

LAYOUT = Layout(
    names={
        "time": ("t", "time", "t_s"),
        "antenna": ("antenna",),
        "tag": ("tag", "epc"),
        "rssi": ("rssi", "rssi_dbm"),
        "phase": ("phase", "phase_rad"),
        "channel": ("channel",),
        "doppler": ("doppler", "doppler_hz"),
        "reader": ("reader",),
    },
    time_unit="s",
)


class TidyCsv:
    """SI units: s, dBm, rad, Hz."""

    says = "the testbed's own CSV: t (s), antenna, tag, and rssi (dBm), phase (rad), channel (from 0), doppler (Hz)"

    def read(self, job: Job) -> Contents:
        return read_rows(job, LAYOUT)
