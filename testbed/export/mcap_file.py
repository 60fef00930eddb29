"""A recording as MCAP with JSON channels, for Foxglove: poses of truth and estimates, reads, and what stands in the hall.

Poses are `foxglove.PoseInFrame` and the hall `foxglove.SceneUpdate`, which its 3D panel shows; reads have a schema of their own, which
its plots show. Time 0 is the start of the trial. Needs the extra `viz` (mcap).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from testbed.columns import Array
from testbed.export.kept import Kept, lines, plain

NANO = 1_000_000_000
FRAME = "world"
_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_POINT = {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)}
_QUATERNION = {"type": "object", "properties": dict.fromkeys("xyzw", _NUMBER)}
_POSE = {"type": "object", "properties": {"position": _POINT, "orientation": _QUATERNION}}
_CUBE = {
    "type": "object",
    "properties": {"pose": _POSE, "size": _POINT, "color": {"type": "object", "properties": dict.fromkeys("rgba", _NUMBER)}},
}
_ENTITY = {"type": "object", "properties": {"timestamp": _TIME, "frame_id": _TEXT, "id": _TEXT, "cubes": {"type": "array", "items": _CUBE}}}
SCHEMAS = {
    "foxglove.PoseInFrame": {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE},
    "foxglove.SceneUpdate": {"deletions": {"type": "array", "items": {"type": "object"}}, "entities": {"type": "array", "items": _ENTITY}},
    "testbed.Read": {"timestamp": _TIME, "antenna": _TEXT, "tag": _TEXT, "channel": {"type": "integer"}, "rssi_dbm": _NUMBER,
                     "phase_rad": _NUMBER, "doppler_hz": _NUMBER},
}  # fmt: skip
Message = tuple[int, str, str, dict[str, Any]]  # (ns, topic, schema, content)


def write(kept: Kept, out: Path) -> list[Path]:
    """`<name>.mcap`. ImportError, saying what to install, without the extra."""
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        raise ImportError("MCAP needs a package that is not there: pip install 'warehouse-radio-testbed[viz]'") from None
    path = out / f"{kept.name}.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="", library="testbed")
        schemas = {name: writer.register_schema(name, "jsonschema", _schema(name, fields)) for name, fields in SCHEMAS.items()}
        channels: dict[str, int] = {}
        for number, (ns, topic, schema, content) in enumerate(sorted(_messages(kept), key=lambda m: (m[0], m[1]))):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schemas[schema])
            writer.add_message(channels[topic], ns, json.dumps(content, allow_nan=False).encode(), ns, number)
        writer.finish()
    return [path]


def _schema(name: str, fields: dict[str, Any]) -> bytes:
    return json.dumps({"title": name, "type": "object", "properties": fields}).encode()


def _messages(kept: Kept) -> Iterator[Message]:
    t = kept.true_times()
    yield 0, "/hall", "foxglove.SceneUpdate", {"deletions": [], "entities": [_hall(kept)]}
    for i, target in enumerate(kept.recording.targets.name):
        poses = kept.true_poses(i, t)
        if np.isfinite(poses).all():
            yield from _poses(f"/truth/{target}", t, poses[:, :3], poses[:, 3:])
    for line in lines(kept):
        yield from _poses(f"/estimate/{line.estimator}/{line.target}", line.t, line.position, line.quaternion)
    yield from _reads(kept)


def _poses(topic: str, t: Array, position: Array, quaternion: Array) -> Iterator[Message]:
    for when, place, turn in zip(t.tolist(), position.tolist(), quaternion.tolist(), strict=True):
        yield _ns(when), topic, "foxglove.PoseInFrame", {"timestamp": _stamp(when), "frame_id": FRAME, "pose": _pose(place, turn)}


def _reads(kept: Kept) -> Iterator[Message]:
    reads, site = kept.reads, kept.recording.site
    for i in range(len(reads)):
        content: dict[str, Any] = {"timestamp": _stamp(float(reads.t[i])), "antenna": str(site.antennas.id[reads.antenna[i]])}
        content |= {"tag": str(site.tags.id[reads.tag[i]]), "channel": int(reads.channel[i]), "rssi_dbm": plain(reads.rssi[i])}
        content |= {"phase_rad": plain(reads.phase[i]), "doppler_hz": plain(reads.doppler[i])}
        yield _ns(float(reads.t[i])), "/reads", "testbed.Read", content


def _hall(kept: Kept) -> dict[str, Any]:
    """The boxes of what never moves, and a small cube for each antenna that stands still."""
    boxes, antennas = kept.scene.static_boxes(), kept.recording.site.antennas
    still = antennas.take(antennas.carrier == "")
    cubes = [
        _cube(*b, (0.6, 0.6, 0.65, 0.7))
        for b in zip(boxes.center.tolist(), boxes.quaternion.tolist(), (2 * boxes.half).tolist(), strict=True)
    ]
    cubes += [
        _cube(p, q, [0.05, 0.3, 0.3], (0.1, 0.35, 0.75, 1.0))
        for p, q in zip(still.position.tolist(), still.quaternion.tolist(), strict=True)
    ]
    return {"timestamp": _stamp(0.0), "frame_id": FRAME, "id": "hall", "lifetime": _stamp(0.0), "frame_locked": True, "cubes": cubes}


def _cube(center: Sequence[float], quaternion: Sequence[float], size: Sequence[float], colour: Sequence[float]) -> dict[str, Any]:
    return {"pose": _pose(center, quaternion), "size": dict(zip("xyz", size, strict=True)), "color": dict(zip("rgba", colour, strict=True))}


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> dict[str, Any]:
    w, x, y, z = quaternion
    return {"position": dict(zip("xyz", position, strict=True)), "orientation": {"x": x, "y": y, "z": z, "w": w}}


def _ns(t: float) -> int:
    return max(0, round(t * NANO))


def _stamp(t: float) -> dict[str, int]:
    seconds, rest = divmod(_ns(t), NANO)
    return {"sec": seconds, "nsec": rest}
