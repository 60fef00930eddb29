"""LLRP tag reports as programs show them: RO_ACCESS_REPORT as JSON, or Python's own way of showing a list of tags in a log's lines.

    {"RO_ACCESS_REPORT": {"TagReportData": [{"EPC-96": "3008...", "AntennaID": {"AntennaID": 1}, "PeakRSSI": {"PeakRSSI": -61}, ...}]}}
    2025-04-28 19:07:29 inventory: INFO: saw tag(s): [{'AntennaID': 3, 'ChannelIndex': 43, 'EPC-96': b'3008...', 'PeakRSSI': -68, ...}]

Parameters may be plain values or objects with one value (LLRP 1.1, section 14: "TagReportData").
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from testbed.logs.contents import Contents, Job
from testbed.logs.formats.sllurp_csv import LAYOUT
from testbed.logs.records import Row, literal, nested, read_records, small

SAW = "saw tag(s):"


class LlrpReports:
    """Units as in `sllurp_csv`, which are those of LLRP. Lines that hold no report are passed over, unless they look like one."""

    says = "LLRP tag reports: RO_ACCESS_REPORT as JSON a line, or lines with `saw tag(s): [{...}]`"

    def read(self, job: Job) -> Contents:
        return read_records(job, LAYOUT, unpack, _record)


def _record(text: str) -> Any:
    """The record in a line; an empty list for a line that speaks of something else."""
    if SAW in text:
        return literal(text.partition(SAW)[2].strip())
    begin = text.lstrip()[:1]
    if begin in ("{", "["):
        return json.loads(text)
    return []


def unpack(record: Any) -> Iterator[Row]:
    """The reads of a report, each of its parameters as a plain value."""
    for one in nested(record, ("RO_ACCESS_REPORT", "TagReportData", "tags")):
        row = {key: _value(value) for key, value in small(one).items()}
        for name in ("epcdata", "epcparameter"):
            if isinstance(row.get(name), str):
                row.setdefault("epc", row[name])
        if "peakrssi" not in row and isinstance(row.get("impinjpeakrssi"), int | float):
            row["peakrssi"] = row.pop("impinjpeakrssi") / 100
        yield row


def _value(value: Any) -> Any:
    """A parameter's value: LLRP's parameters are objects, mostly of one field."""
    for _ in range(4):
        if isinstance(value, bytes):
            return value.decode("ascii", "replace")
        if not isinstance(value, dict) or len(value) != 1:
            break
        value = next(iter(value.values()))
    if isinstance(value, dict):
        return next((v for k, v in value.items() if str(k).lower() in ("epc", "microseconds", "id")), value)
    return value
