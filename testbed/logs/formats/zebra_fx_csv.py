"""CSV of a Zebra FX reader's reads, as programs on its RFID3 interface keep them: one row a read, a stray tab after each comma."""

from __future__ import annotations

from testbed.logs.contents import Contents, Job, read_rows
from testbed.logs.layout import Layout

LAYOUT = Layout(
    names={
        "time": ("time_reader", "timestamp", "seentime"),
        "antenna": ("antenna", "antennaid"),
        "tag": ("idhex", "epc", "tagid"),
        "rssi": ("peakrssi", "rssi"),
        "phase": ("phase",),
        "channel": ("channel",),
        "reader": ("hostname",),
    },
    time_unit="s",
    phase_unit="deg",
    channel_unit="mhz",
)


class ZebraFxCsv:
    """Time in s, RSSI in whole dBm, phase in degrees within ±180, carrier in MHz (looked up in the hop table)."""

    says = "CSV of a Zebra FX reader: idHex, antenna, peakRssi, phase (degrees), channel (MHz), time_reader (s)"

    def read(self, job: Job) -> Contents:
        return read_rows(job, LAYOUT)
