"""Trajectories as TUM text, one file a target: t x y z qx qy qz qw, in s and m; evo and most SLAM tools read it.

Written with as many digits as a number needs. An estimate is written where its estimator stands by it; one without z lies on the floor,
one without a heading is not turned.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from testbed.columns import Array
from testbed.export.kept import Kept, lines, safe

HEADER = "# t x y z qx qy qz qw\n"


def write(kept: Kept, out: Path) -> list[Path]:
    """`<name>.truth.<target>.tum`, and `<name>.<estimator>.<target>.tum` of each estimate."""
    t, found = kept.true_times(), []
    for i, target in enumerate(kept.recording.targets.name):
        poses = kept.true_poses(i, t)
        if np.isfinite(poses).all():
            found.append(_file(out / f"{kept.name}.truth.{safe(str(target))}.tum", t, poses[:, :3], poses[:, 3:]))
    for line in lines(kept):
        found.append(_file(out / f"{kept.name}.{line.estimator}.{safe(line.target)}.tum", line.t, line.position, line.quaternion))
    return found


def _file(path: Path, t: Array, position: Array, quaternion: Array) -> Path:
    rows = np.column_stack([t, position, quaternion[:, 1:], quaternion[:, :1]]).tolist()
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(HEADER)
        file.writelines(" ".join(map(repr, row)) + "\n" for row in rows)
    return path


def read(path: Path) -> tuple[Array, Array, Array]:
    """(t (K,) s, position (K, 3) m, quaternion (K, 4) w x y z) of a TUM file."""
    rows = np.loadtxt(path, ndmin=2, dtype=np.float64).reshape(-1, 8)
    return rows[:, 0], rows[:, 1:4], rows[:, [7, 4, 5, 6]]
