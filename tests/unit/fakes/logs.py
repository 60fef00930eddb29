"""Small logs and sites, as texts."""

import json

from testbed.logs.site import checked_site

EPC = "300833b2ddd9014000000000"
OTHER = "000233b2ddd9014000000000"


def site(kind, **changes):
    """A site of two antennas on ports 1 and 2; `log` values go to its log section."""
    log = {"kind": kind, **changes.pop("log", {})}
    plain = {
        "name": "test",
        "log": log,
        "region": "fcc",
        "antennas": [{"id": "left", "port": 1, "position_m": [0, -1, 1]}, {"id": "right", "port": 2, "position_m": [0, 1, 1]}],
    }
    return checked_site({**plain, **changes})


SLLURP = f"""timestamp,reader,antenna,rssi,epc,phase_angle,channel_index,doppler_frequency
1700000000000000,r1,1,-51.5,b'{EPC}',0,1,16
1700000000012500,r1,2,-60,b'{EPC}',2048,50,-8
1700000000025000,r1,1,-52,{EPC.upper()},4095,2,
"""

ITEMTEST = f"""// 4/9/2026 2:15:32 PM
// ReaderName=impinj, AntennaIDs=1,2
// Timestamp, EPC, TID, Antenna, RSSI, Frequency, Hostname, PhaseAngle, DopplerFrequency, CRHandle
2026-04-09T14:24:20.255-05:00,{EPC.upper()},,1,-65.5,927.25,r1,0.5,1.25,
2026-04-09T14:24:20.2675-05:00,{EPC.upper()},,2,-61,902.75,r1,6.25,0,
"""

FIRST = {"AntennaID": 1, "EPC-96": EPC, "PeakRSSI": -68, "ChannelIndex": 43}
FIRST |= {"LastSeenTimestampUTC": 1745881649612720, "ImpinjRFPhaseAngle": 2592}
SECOND = {"AntennaID": 2, "EPC": f"b'{EPC}'", "ImpinjPeakRSSI": -6850, "ChannelIndex": 1}
SECOND |= {"LastSeenTimestampUTC": 1745881649612820, "ImpinjRFDopplerFrequency": 16}
JSONL = json.dumps(FIRST) + "\n" + json.dumps(SECOND) + "\n"

REPORT = {"EPC-96": OTHER, "AntennaID": {"AntennaID": 2}, "PeakRSSI": {"PeakRSSI": -61}}
REPORT |= {"LastSeenTimestampUTC": {"Microseconds": 1745881649712720}}
LLRP = "2025-04-28 19:07:29 inventory: INFO: starting\n"
LLRP += f"2025-04-28 19:07:29 inventory: INFO: saw tag(s): {[FIRST | {'EPC-96': EPC.encode()}]!r}\n"
LLRP += json.dumps({"RO_ACCESS_REPORT": {"TagReportData": [REPORT]}}) + "\n"

TIDY = """t,antenna,tag,rssi,phase,channel,doppler
0.0125,left,lid,-51.5,3.0434,7,
0.0190,2,lid,-58,,7,1.5
"""

RANGES = """t,anchor,range
0.0,left,1.5
0.1,right,2.5
"""

RSF = """range2 0.125 2.5 0.01 -0.02 -0.01 1 0
odom2diff 0.125 0.3 0.35 0 0.0785 0.0001 0.0001 0.0001
range2 0.250 1.5 0.01 2.0 2.0 2 0
"""

MBD = "".join(f"{1581249601.4 + i / 10},{1 + i % 2},e78f135624ce,-7{i},1{i}.5,8.25,1.8,1,0,0,0,1,0,0,0,1\n" for i in range(5))

WIDE = """,ts,x,heading,y,rssi_1,rssi_2
0,1.628008099976e+18,0.6,5.2,5.8,-72.5,-53.8
1,1.6280081003e+18,0.6,5.2,5.8,,-54
2,1.6280081006e+18,0.5,5.2,5.9,-70.25,
"""

ZEBRA = f"""peakRssi,phase,channel,antenna,idHex,hostName,time_reader
-57,\t54.5213165283203,\t902.75,\t1,\t{EPC},\tFX,\t1752091555.853
-65,\t-60.4980621337891,\t927.25,\t2,\t{OTHER},\tFX,\t1752091555.855
"""

SAMPLES = {
    "sllurp_csv": SLLURP,
    "sllurp_jsonl": JSONL,
    "itemtest_csv": ITEMTEST,
    "llrp_reports": LLRP,
    "zebra_fx_csv": ZEBRA,
    "tidy_csv": TIDY,
    "ranges_csv": RANGES,
    "librsf": RSF,
    "ble_mbd": MBD,
    "rssi_wide_csv": WIDE,
}
