"""What `sllurp log` writes, and programs like it that keep the reports of an LLRP reader as CSV."""

from __future__ import annotations

from testbed.logs.contents import Contents, Job, read_rows
from testbed.logs.layout import Layout

LAYOUT = Layout(
    names={
        "time": ("timestamp", "timestamp_us", "lastseentimestamputc", "last_seen_timestamp", "firstseentimestamputc"),
        "antenna": ("antenna", "antennaid", "antenna_id"),
        "tag": ("epc", "epc-96", "epc96"),
        "rssi": ("rssi", "peakrssi", "peak_rssi", "impinjpeakrssi"),
        "phase": ("phase_angle", "phase_rad", "impinj_phase", "impinjrfphaseangle", "phase"),
        "channel": ("channel_index", "channelindex", "channel"),
        "doppler": ("doppler_frequency", "doppler_hz", "impinj_doppler", "impinjrfdopplerfrequency", "doppler"),
        "reader": ("reader",),
    },
    time_unit="us",
    phase_unit="steps4096",
    channel_unit="index1",
    doppler_unit="hz16",
    units={"impinjpeakrssi": "cdbm", "phase_rad": "rad", "doppler_hz": "hz"},
)


class SllurpCsv:
    """Time in µs of UTC, RSSI in dBm, phase in 4096 steps a turn, channel as LLRP counts it (from 1), Doppler in 1/16 Hz."""

    says = "CSV of sllurp: timestamp (µs), reader, antenna, rssi, epc, and of Impinj readers phase_angle, channel_index, doppler_frequency"

    def read(self, job: Job) -> Contents:
        return read_rows(job, LAYOUT)
