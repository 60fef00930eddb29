"""What Impinj ItemTest exports: lines of // with settings, the last of which names the columns, then reads."""

from __future__ import annotations

from collections.abc import Sequence

from testbed.logs.cells import split_row
from testbed.logs.contents import Contents, Job, read_rows
from testbed.logs.layout import Layout

LAYOUT = Layout(
    names={
        "time": ("timestamp",),
        "antenna": ("antenna",),
        "tag": ("epc",),
        "rssi": ("rssi",),
        "phase": ("phaseangle",),
        "channel": ("frequency",),
        "doppler": ("dopplerfrequency",),
        "reader": ("hostname",),
    },
    time_unit="iso",
    phase_unit="rad",
    channel_unit="mhz",
    comment="//",
)


class ItemtestCsv:
    """Time in ISO 8601, RSSI in dBm, carrier in MHz (looked up in the hop table), phase in rad, Doppler in Hz."""

    says = "CSV of Impinj ItemTest: // Timestamp, EPC, TID, Antenna, RSSI, Frequency, Hostname, PhaseAngle, DopplerFrequency, CRHandle"

    def read(self, job: Job) -> Contents:
        return read_rows(job, LAYOUT, header_of)


def header_of(lines: Sequence[str]) -> tuple[int, list[str]]:
    """(line of the header, its names): the last of the leading // lines that speaks of an EPC."""
    found: tuple[int, list[str]] = (0, [])
    for number, text in enumerate(lines, start=1):
        if not text.startswith("//"):
            break
        names = [name.strip() for name in split_row(text.removeprefix("//"), ",")]
        if "epc" in [name.lower() for name in names]:
            found = (number, names)
    return found
