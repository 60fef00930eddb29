"""Tag reports of sllurp as JSON lines: one report, or a list of them, a line, with the keys that sllurp gives them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from testbed.logs.contents import Contents, Job
from testbed.logs.formats.sllurp_csv import LAYOUT
from testbed.logs.records import Row, nested, read_records, small


class SllurpJsonl:
    """Units as in `sllurp_csv`; `ImpinjPeakRSSI` is 1/100 dBm and is used where there is no `PeakRSSI`."""

    says = (
        "JSON lines of sllurp: AntennaID, EPC, PeakRSSI, ChannelIndex, LastSeenTimestampUTC, ImpinjRFPhaseAngle, ImpinjRFDopplerFrequency"
    )

    def read(self, job: Job) -> Contents:
        return read_records(job, LAYOUT, unpack)


def unpack(record: Any) -> Iterator[Row]:
    """The reads of a record."""
    for one in nested(record, ("TagReportData", "tags")):
        row = small(one)
        if "rssi" not in row and "peakrssi" not in row and isinstance(row.get("impinjpeakrssi"), int | float):
            row["rssi"] = row.pop("impinjpeakrssi") / 100
        yield row
