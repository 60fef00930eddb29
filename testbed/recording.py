"""One trial as data: what an estimator may see, and apart from it what really happened."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from testbed import frames
from testbed.columns import Array, Table
from testbed.guided.record import Walk
from testbed.scene import WORLD, Truth
from testbed.types import Site, Targets


@dataclass(frozen=True, eq=False)
class Recording:
    """All that estimators get of one trial: the site and the streams, in order of arrival, by kind.

    target_tags : for each target, the tags (indices into `site.tags`) whose reads speak of it
    asked_sets  : (sets, tags) bool, the populations that `Rounds.asked` names
    """

    trial: int
    duration: float  # s
    site: Site
    streams: dict[str, Table]
    targets: Targets
    target_tags: tuple[Array, ...]
    asked_sets: Array = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))


@dataclass(frozen=True, eq=False)
class Trial:
    """A recording together with the truth behind it: for scoring, never for estimating.

    target_body : (targets,) int, moving body of each target in `truth`, -1 for one that stands still
    target_pose : (targets, 7) the target in its body's frame (in the world's where the body is -1)
    stimulus    : what the world offered, by name ("line_of_sight"), asserted by scenarios under `expect: world:`
    walk        : of a guided person, what they really did, action by action
    """

    recording: Recording
    truth: Truth
    target_body: Array
    target_pose: Array
    stimulus: dict[str, float]
    walk: Walk | None = None

    _last: list[tuple[Array, Array]] = field(default_factory=list, init=False, repr=False)

    def target_states(self, t: Array) -> Array:
        """(K, targets, 6): true position (m) and velocity (m/s) of every target at times t (K,), world frame. Read-only.

        NaN where the truth of a recorded log doesn't say it.

        The last answer is kept: all estimators of a trial start and are scored at the same times.
        """
        if not self._last or not np.array_equal(self._last[0][0], t):
            states = self._target_states(t)
            states.flags.writeable = False
            self._last[:] = [(np.array(t), states)]
        return self._last[0][1]

    def _target_states(self, t: Array) -> Array:
        states = np.zeros((len(t), len(self.target_body), 6))
        for i, (body, pose) in enumerate(zip(self.target_body, self.target_pose, strict=True)):
            if body == WORLD:
                states[:, i, :3] = pose[:3]
                continue
            states[:, i, :3] = mounted(self.truth, int(body), pose, t)[..., :3]
            h = 1e-4  # s: a central difference carries the lever arm's turn as well
            ahead, behind = (mounted(self.truth, int(body), pose, t + s)[..., :3] for s in (h, -h))
            states[:, i, 3:] = (ahead - behind) / (2 * h)
            states[~self.truth.known(int(body), t), i] = np.nan
        return states


def mounted(truth: Truth, body: int, pose: Array, t: Array) -> Array:
    """World poses (..., 7) at times `t` (...) of something fixed to the moving body `body` at `pose` (7,) in its frame."""
    return frames.compose(truth.pose(body, t), pose)
