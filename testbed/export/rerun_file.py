"""A recording for the viewer of Rerun (.rrd): paths of truth and estimates over time, the hall, antennas, and RSSI of each link.

Needs the extra `viz` (rerun-sdk).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from testbed.export.kept import Kept, lines

TIMELINE = "time"
COLOURS = ((230, 120, 20), (40, 110, 200), (120, 60, 160), (20, 150, 110), (200, 60, 90))
TRUE = (40, 40, 40)


def write(kept: Kept, out: Path) -> list[Path]:
    """`<name>.rrd`. ImportError, saying what to install, without the extra."""
    try:
        import rerun as rr
    except ImportError:
        raise ImportError("Rerun needs a package that is not there: pip install 'warehouse-radio-testbed[viz]'") from None
    path = out / f"{kept.name}.rrd"
    stream = rr.RecordingStream("testbed", recording_id=kept.name)
    stream.save(path)
    _hall(rr, stream, kept)
    _paths(rr, stream, kept)
    _levels(rr, stream, kept)
    stream.flush()
    stream.disconnect()
    return [path]


def _hall(rr: Any, stream: Any, kept: Kept) -> None:
    boxes, antennas = kept.scene.static_boxes(), kept.recording.site.antennas
    turns = [rr.Quaternion(xyzw=[x, y, z, w]) for w, x, y, z in boxes.quaternion.tolist()]
    if len(boxes):
        stream.log(
            "hall", rr.Boxes3D(centers=boxes.center, half_sizes=boxes.half, quaternions=turns, colors=[(150, 150, 160)]), static=True
        )
    still = antennas.take(antennas.carrier == "")
    if len(still):
        names = [str(id) for id in still.id]
        stream.log("antennas", rr.Points3D(still.position, radii=0.08, labels=names, colors=[(25, 90, 190)]), static=True)


def _paths(rr: Any, stream: Any, kept: Kept) -> None:
    t = kept.true_times()
    for i, target in enumerate(kept.recording.targets.name):
        places = kept.true_poses(i, t)[:, :3]
        if np.isfinite(places).all():
            _moving(rr, stream, f"truth/{target}", t, places, TRUE)
    colours = {estimator: COLOURS[i % len(COLOURS)] for i, estimator in enumerate(kept.tracks)}
    for line in lines(kept):
        _moving(rr, stream, f"estimate/{line.estimator}/{line.target}", line.t, line.position, colours[line.estimator])


def _moving(rr: Any, stream: Any, entity: str, t: Any, places: Any, colour: tuple[int, int, int]) -> None:
    if not len(t):
        return
    stream.log(f"{entity}/path", rr.LineStrips3D([places], colors=[colour], radii=0.01), static=True)
    stream.log(entity, rr.Points3D.from_fields(colors=[colour], radii=[0.07]), static=True)
    stream.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, duration=t)], columns=rr.Points3D.columns(positions=places))


def _levels(rr: Any, stream: Any, kept: Kept) -> None:
    reads, site = kept.reads, kept.recording.site
    for antenna in np.unique(reads.antenna).tolist():
        for tag in np.unique(reads.tag[reads.antenna == antenna]).tolist():
            link = reads.take((reads.antenna == antenna) & (reads.tag == tag) & np.isfinite(reads.rssi))
            if len(link):
                entity = f"rssi/{site.antennas.id[antenna]}/{site.tags.id[tag]}"
                stream.send_columns(
                    entity, indexes=[rr.TimeColumn(TIMELINE, duration=link.t)], columns=rr.Scalars.columns(scalars=link.rssi)
                )
