"""Reads as the tools of readers write them: CSV of sllurp and of Impinj ItemTest, with the site that reads them back.

Every number is written with as many digits as its value needs, so that what is read back is what was written, bit for bit. Times are
counted from 1970: a simulated trial begins at no date. When a read arrived is not part of these formats, and is left out.
"""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from testbed import frames
from testbed.columns import Array
from testbed.export.kept import Kept
from testbed.logs.units import PHASE
from testbed.types import Antennas, Site

SLLURP = ("timestamp", "reader", "antenna", "rssi", "epc")
ITEMTEST = ("Timestamp", "EPC", "TID", "Antenna", "RSSI", "Frequency", "Hostname", "PhaseAngle", "DopplerFrequency", "CRHandle")
DIGITS = 6  # of a phase in steps: readers count in sixteenths of a step at the finest


def sllurp(kept: Kept, out: Path) -> list[Path]:
    """`<name>.sllurp.csv` and its site. ValueError for a name that a CSV without quotes can't hold."""
    reads, site = kept.reads, kept.recording.site
    steps = np.round(reads.phase / PHASE["steps4096"], DIGITS)
    whole = bool(np.array_equal(steps * PHASE["steps4096"], reads.phase, equal_nan=True))
    phase = ("phase_angle", steps) if whole else ("phase_rad", reads.phase)
    columns = {
        "timestamp": [_micro(t) for t in reads.t.tolist()],
        "reader": _names(site.antennas.reader[reads.antenna]),
        "antenna": (reads.antenna + 1).tolist(),
        "rssi": _cells(reads.rssi),
        "epc": _names(site.tags.id[reads.tag]),
        phase[0]: _cells(phase[1]),
        "channel_index": (reads.channel + 1).tolist(),
        "doppler_frequency": _cells(reads.doppler * 16),
    }
    return [_table(out / f"{kept.name}.sllurp.csv", "", columns), _site(kept, out, "sllurp", {"kind": "sllurp_csv"})]


def itemtest(kept: Kept, out: Path) -> list[Path]:
    """`<name>.itemtest.csv` and its site. The place in the hop table is written as its carrier."""
    reads, site = kept.reads, kept.recording.site
    carrier = site.frequencies[reads.channel] / 1e6 if len(site.frequencies) else np.full(len(reads), np.nan)
    none = [""] * len(reads)
    columns = dict.fromkeys(ITEMTEST, none) | {
        "Timestamp": [_iso(t) for t in reads.t.tolist()],
        "EPC": _names(site.tags.id[reads.tag]),
        "Antenna": (reads.antenna + 1).tolist(),
        "RSSI": _cells(reads.rssi),
        "Frequency": _cells(carrier),
        "Hostname": _names(site.antennas.reader[reads.antenna]),
        "PhaseAngle": _cells(reads.phase),
        "DopplerFrequency": _cells(reads.doppler),
    }
    settings = f"// {kept.name}, simulated\n// "
    return [_table(out / f"{kept.name}.itemtest.csv", settings, columns), _site(kept, out, "itemtest", {"kind": "itemtest_csv"})]


def _table(path: Path, begin: str, columns: dict[str, list[Any]]) -> Path:
    separator = ", " if begin else ","
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(begin + separator.join(columns) + "\n")
        file.writelines(",".join(map(str, row)) + "\n" for row in zip(*columns.values(), strict=True))
    return path


def _micro(t: float) -> str:
    """Microseconds, with digits behind the point where there are finer parts."""
    whole = round(t * 1e6)
    return str(whole) if whole / 1e6 == t else format(Decimal(repr(t)).scaleb(6), "f")


def _iso(t: float) -> str:
    """ISO 8601 from 1970, with all digits of the second."""
    exact = Decimal(repr(t))
    whole = int(exact)
    fraction = format(exact - whole, "f").partition(".")[2].rstrip("0")
    stamp = np.datetime_as_string(np.datetime64(whole, "s"))
    return f"{stamp}{'.' + fraction if fraction else ''}Z"


def _cells(values: Array) -> list[str]:
    return ["" if v != v else repr(int(v)) if v == int(v) else repr(v) for v in values.tolist()]


def _names(values: Array) -> list[str]:
    odd = next((str(v) for v in np.unique(values) if set(str(v)) & set(',"\n\r') or str(v) != str(v).strip()), None)
    if odd is not None:
        raise ValueError(f"the name {odd!r} can't stand in a reader's CSV: no commas, quotes or gaps at its ends")
    return [str(v) for v in values]


# ---------------------------------------------------------------- the site that reads them back


def _site(kept: Kept, out: Path, ending: str, log: dict[str, Any]) -> Path:
    """What `testbed replay LOG --site` wants beside the log."""
    recording, path = kept.recording, out / f"{kept.name}.{ending}.site.yaml"
    reads = kept.reads
    late = float((np.maximum.accumulate(reads.t) - reads.t).max(initial=0.0)) if len(reads) else 0.0
    document: dict[str, Any] = {
        "name": safe_id(kept.name),
        "log": {**log, "start_s": 0, "lateness_s": late + 1.0, "longest_gap_s": max(recording.duration, 1.0)},
        "antennas": [_antenna(recording.site.antennas, i) for i in range(len(recording.site.antennas))],
        "tags": [_tag(recording.site, i) for i in range(len(recording.site.tags))],
        "targets": [
            {"id": str(name), "tags": [str(recording.site.tags.id[tag]) for tag in tags]}
            for name, tags in zip(recording.targets.name, recording.target_tags, strict=True)
            if safe_id(str(name)) == str(name)
        ],
    }
    if len(recording.site.frequencies):
        document["carriers_mhz"] = [float(f) / 1e6 for f in recording.site.frequencies]
    with path.open("w", encoding="utf-8") as file:
        YAML(typ="safe", pure=True).dump(document, file)
    return path


def safe_id(name: str) -> str:
    """A name as an id of a scenario or site: letters, digits, _ and -, a letter first."""
    found = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "-" for c in name)[:60]
    return found if found[:1].isalpha() else f"t{found}"[:60]


def _antenna(antennas: Antennas, i: int) -> dict[str, Any]:
    ahead = antennas.position[i] + frames.rotate(antennas.quaternion[i], np.array([1.0, 0.0, 0.0]))
    found = {"id": str(antennas.id[i]), "port": i + 1, "position_m": [float(v) for v in antennas.position[i]]}
    found |= {"aim_m": [float(v) for v in ahead], "gain_dbi": float(antennas.gain[i]), "power_dbm": float(antennas.power[i])}
    found["beamwidth_deg"] = float(np.clip(np.rad2deg(antennas.beamwidth[i]), 1e-3, 360))
    found["front_to_back_db"] = float(np.clip(antennas.front_to_back[i], 0, 60))
    return found


def _tag(site: Site, i: int) -> dict[str, Any]:
    found: dict[str, Any] = {"id": str(site.tags.id[i])}
    known = np.flatnonzero(site.references.tag == i)
    if len(known):
        found["position_m"] = [float(v) for v in site.references.position[known[0]]]
    return found
