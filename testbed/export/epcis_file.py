"""Decisions of estimators at gates as a document of EPCIS 2.0, one file an estimator (`testbed.export.epcis` has the content)."""

from __future__ import annotations

import json
from pathlib import Path

from testbed.export import epcis
from testbed.export.kept import Kept
from testbed.gates import gates_of


def write(kept: Kept, out: Path) -> list[Path]:
    """`<name>.<estimator>.epcis.json`. ValueError where no estimator decided anything, or the decisions have no place."""
    gates, found = gates_of(kept.recording.site.antennas, 0.0), []  # where a gate is does not depend on which way is in
    for estimator, track in kept.tracks.items():
        if not len(track.decisions):
            continue
        path = out / f"{kept.name}.{estimator}.epcis.json"
        path.write_text(json.dumps(epcis.document(epcis.events(track, gates)), indent=1) + "\n", encoding="utf-8")
        found.append(path)
    if not found:
        raise ValueError(f"{kept.name}: no estimator announced that anything came in or went out, so there are no events")
    return found
