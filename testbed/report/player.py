"""What the player in the page moves: a recording's tracks, bodies and reads, packed small for the page's script (template/player.js).

Arrays are base64 of little-endian numbers: "u2", whole numbers of 16 bits that stand for `o + s n`, with 65535 for "nothing" and
65534 for "beyond the range"; or "f4", single precision, where small values count beside large ones. The resolution of a place is
1/22,000 of the plan's side (below a pixel on any screen), of a read's time 1/65,000 of the duration.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.guided.words import instructions
from testbed.report import plan
from testbed.report.cases import Aim, Case, Line, instants
from testbed.report.figures import Drawing, Frame, Styles
from testbed.types import Reads

NOTHING, BEYOND, LAST = 65535, 65534, 65533
MOST_REPORTS = 3000  # of a track: of more, every n-th is taken
MOST_READS = 30_000  # a quarter of a megabyte
CLOUD = 100  # particles shown, of each method at each time
CLOUDS = 150  # times at which a cloud is shown
AROUND = 1.0  # plans: so far beyond the plan places are kept


def data(case: Case, styles: Styles, drawn: Drawing, errors: Drawing | None) -> dict[str, Any]:
    """All that the player needs, as JSON: `drawn` is the plan and `errors` the error over time, which it draws into."""
    frame = drawn.frames[0]
    ranges = _ranges(frame)
    sides = [high - low for low, high in ranges]
    shown = dict.fromkeys(line.estimator for aim in case.aims for line in aim.lines)
    every = max([1, *(-(-len(line.t) // MOST_REPORTS) for aim in case.aims for line in aim.lines)])
    reads, thinned = _fewer(case)
    return {
        "duration": case.duration,
        "plan": {"figure": drawn.name, **_frame(frame)},
        "errors": {"figure": errors.name, "panels": [_frame(f) for f in errors.frames]} if errors else None,
        "targets": [
            {"name": aim.name, "t": _times(aim.t), "x": _place(aim.truth, 0, ranges), "y": _place(aim.truth, 1, ranges)}
            for aim in case.aims
        ],
        "estimators": [
            {
                "id": id,
                "layer": styles.place(id),
                "colour": styles.colour(id),
                "marker": styles.marker(id),
                "targets": [_line(aim, id, every, ranges, max(sides)) for aim in case.aims],
            }
            for id in styles.ids
            if id in shown
        ],
        "every": every,
        "bodies": _bodies(case, ranges),
        "antennas": _ends(case.near.body, case.near.pose, case.antennas.id),
        "tags": _ends(case.far.body, case.far.pose, case.tagged.tags.id),
        "reads": {
            "t": packed(reads.t, 0.0, case.duration),
            "antenna": packed(reads.antenna, 0, LAST),
            "tag": packed(reads.tag, 0, LAST),
            "thinned": thinned,
        },
        "wanted": sorted({tag for aim in case.aims for tag in aim.tags}),
        "told": _told(case),
    }


def text(content: dict[str, Any]) -> str:
    """JSON that can stand inside a script element: no "<" ends it early."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c").replace("\u2028", "\\u2028")


# ---------------------------------------------------------------- packing


def packed(values: Array, low: float, high: float) -> dict[str, Any]:
    """Numbers as 16 bits between low and high: NaN as nothing, what lies outside as beyond."""
    values = np.asarray(values, dtype=np.float64)
    step = (high - low) / LAST or 1.0
    with np.errstate(invalid="ignore", over="ignore"):
        whole = np.round((values - low) / step)
        whole = np.where((whole < 0) | (whole > LAST), BEYOND, whole)
    whole = np.where(np.isnan(values), NOTHING, whole)
    return {"k": "u2", "o": low, "s": step, "d": base64.b64encode(whole.astype("<u2").tobytes()).decode()}


def unpacked(column: dict[str, Any]) -> Array:
    """What the script makes of a packed array; NaN for nothing, inf for beyond."""
    raw = base64.b64decode(column["d"])
    if column["k"] == "f4":
        return np.frombuffer(raw, dtype="<f4").astype(np.float64)
    whole = np.frombuffer(raw, dtype="<u2").astype(np.float64)
    values = column["o"] + column["s"] * whole
    return np.where(whole == NOTHING, np.nan, np.where(whole == BEYOND, np.inf, values))


def _single(values: Array) -> dict[str, Any]:
    with np.errstate(over="ignore"):
        return {"k": "f4", "d": base64.b64encode(np.asarray(values).astype("<f4").tobytes()).decode()}


def _times(t: Array) -> dict[str, Any]:
    """Evenly spaced times as three numbers, others one by one."""
    step = (t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else 1.0
    if np.allclose(np.diff(t), step, rtol=0, atol=1e-6):
        return {"first": float(t[0]), "step": float(step), "n": len(t)}
    return {"list": _single(t), "n": len(t)}


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "u": [float(frame.u0), float(frame.u_scale)],
        "v": [float(frame.v0), float(frame.v_scale)],
        "box": [float(side) for side in (frame.left, frame.top, frame.right, frame.bottom)],
        "log": frame.log,
    }


def _ranges(frame: Frame) -> list[tuple[float, float]]:
    """Between which x and which y places are kept: the plan, and as much again on every side."""
    spans = [
        ((frame.left - frame.u0) / frame.u_scale, (frame.right - frame.u0) / frame.u_scale),
        ((frame.bottom - frame.v0) / frame.v_scale, (frame.top - frame.v0) / frame.v_scale),
    ]
    return [(float(a - AROUND * (b - a)), float(b + AROUND * (b - a))) for a, b in spans]


def _place(points: Array, axis: int, ranges: list[tuple[float, float]]) -> dict[str, Any]:
    return packed(points[..., axis].ravel(), *ranges[axis])


# ---------------------------------------------------------------- what moves


def _line(aim: Aim, id: str, every: int, ranges: list[tuple[float, float]], side: float) -> dict[str, Any] | None:
    """One estimator's track of one target; None where it has none."""
    line = next((line for line in aim.lines if line.estimator == id), None)
    if line is None:
        return None
    k = slice(None, None, every)
    a, b, angle = plan.axes(line.covariance[k])
    return {
        "t": _times(line.t[k]),
        "x": _place(line.position[k], 0, ranges),
        "y": _place(line.position[k], 1, ranges),
        "a": packed(a, 0.0, side),
        "b": packed(b, 0.0, side),
        "angle": packed(angle, -np.pi, np.pi),
        "error": _single(line.error[k]),
        "status": "".join(str(int(s)) for s in line.status[k]),
        "cloud": _cloud(line, ranges),
    }


def _cloud(line: Line, ranges: list[tuple[float, float]]) -> dict[str, Any] | None:
    if line.cloud is None:
        return None
    times = np.unique(np.linspace(0, len(line.t) - 1, min(CLOUDS, len(line.t))).astype(int))
    who = np.unique(np.linspace(0, line.cloud.shape[1] - 1, min(CLOUD, line.cloud.shape[1])).astype(int))
    cloud = line.cloud[times][:, who]
    return {"t": _single(line.t[times]), "n": len(who), "x": _place(cloud, 0, ranges), "y": _place(cloud, 1, ranges)}


def _bodies(case: Case, ranges: list[tuple[float, float]]) -> list[dict[str, Any]]:
    """Moving bodies: outline in their own frame, place and yaw at the times of the truth shown."""
    truth, found = case.trial.truth, []
    t = instants(case.duration)
    for i, (name, outline) in enumerate(zip(truth.bodies, plan.outlines(case.scene), strict=True)):
        pose = truth.pose(i, t)
        found.append(
            {
                "name": name,
                "outline": np.round(outline, 3).tolist(),
                "t": _times(t),
                "x": _place(pose[:, :2], 0, ranges),
                "y": _place(pose[:, :2], 1, ranges),
                "yaw": packed(frames.yaw_of(pose[:, 3:]), -np.pi, np.pi),
            }
        )
    return found


def _ends(body: Array, pose: Array, ids: Array) -> list[list[Any]]:
    """[id, body (-1 for the world), x, y] of antennas or tags, in the frame of what carries them."""
    return [[str(id), int(b), round(float(p[0]), 3), round(float(p[1]), 3)] for id, b, p in zip(ids, body, pose, strict=True)]


def _told(case: Case) -> dict[str, Any] | None:
    """What a guided person was told, and from when on; None for other recordings."""
    if case.trial.walk is None:
        return None
    every = [one for one in instructions(case.trial.walk) if one.text]
    return {"t": [one.t for one in every], "text": [one.text for one in every]}


def _fewer(case: Case) -> tuple[Reads, str]:
    """The reads to show, and in words which ones those are."""
    reads = case.reads
    reads = reads.take(np.argsort(reads.t, kind="stable"))
    if len(reads) <= MOST_READS:
        return reads, ""
    wanted = reads.take(np.isin(reads.tag, [tag for aim in case.aims for tag in aim.tags]))
    if len(wanted) <= MOST_READS:
        return wanted, "Only reads of the targets' tags are shown."
    every = -(-len(wanted) // MOST_READS)
    return wanted.take(slice(None, None, every)), f"Of the reads of the targets' tags one in {every} is shown."
