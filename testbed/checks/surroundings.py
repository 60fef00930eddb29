"""A made-up hall for sensors: a post, a cart with two tags that drives past it, a tag on the post, and rays that meet nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import WORLD, Boxes, Mounts
from testbed.protocols import Crossings, Obstruction, Surroundings, Tagged
from testbed.scene import Body, Scene, Truth
from testbed.types import Tags

DURATION = 1.0  # s


class ClearSight:
    """A ray caster in a hall where nothing is ever in the way."""

    def static(self, start: Array, end: Array) -> Obstruction:
        """Nothing, on any segment."""
        return Obstruction(np.zeros(len(start)), np.zeros(len(start)))

    def moving(self, start: Array, end: Array, poses: Array, instant: Array) -> Obstruction:
        """Nothing, on any segment."""
        return self.static(start, end)

    def crossings(self, start: Array, end: Array, poses: Array, instant: Array) -> Crossings:
        """None."""
        return Crossings.empty()


def made(trial: int = 0) -> Surroundings:
    """The hall with its cart in motion, as a sensor gets it. The cart is the body "cart", with the antenna mount "cart.front"."""
    tags = Tags(id=np.array(["cart.left", "cart.right", "post.tag"]))
    poses = np.tile(frames.IDENTITY, (3, 1))
    poses[:, :3] = [[0.0, 0.31, 0.5], [0.0, -0.31, 0.5], [4.0, 3.2, 1.2]]
    tagged = Tagged(tags, np.array([0, 0, WORLD]), poses)
    return Surroundings(_scene(), _truth(), tagged, ("cart",), np.array([0, 1]), DURATION, ClearSight(), root=17, trial=trial)


def with_a_tag_first(around: Surroundings, position: Array) -> Surroundings:
    """The same with one more tag, at rest at `position` (3,), put before all others."""
    tags, tagged = around.tagged.tags, around.tagged
    stranger = Tags(id=np.array(["a stranger"]), gain=tags.gain[:1], sensitivity=tags.sensitivity[:1])
    pose = np.concatenate([position, [1.0, 0.0, 0.0, 0.0]])[None]
    more = Tagged(Tags.concatenate([stranger, tags]), np.append(WORLD, tagged.body), np.concatenate([pose, tagged.pose]))
    return replace(around, tagged=more, target_tags=around.target_tags + 1)


def _scene() -> Scene:
    bodies = (Body("post", "post", np.array([4.0, 3.5, 0, 1, 0, 0, 0])), Body("cart", "trolley", _pose(0.0), moving=True))
    boxes = Boxes(
        center=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5]]),
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        half=np.array([[0.1, 0.1, 1.0], [0.5, 0.3, 0.5]]),
        body=np.array([0, 1]),
    )
    mounts = Mounts(
        name=np.array(["post.low", "cart.front"]),
        group=np.array(["post", "cart"]),
        use=np.array(["antenna", "antenna"]),
        body=np.array([0, 1]),
        position=np.array([[0.0, -0.15, 1.0], [0.55, 0.0, 0.8]]),
        quaternion=frames.from_euler(np.array([-np.pi / 2, 0.0])),
    )
    return Scene(bodies, boxes, ("steel",), np.array([[0.0, 0.0, 0.0], [8.0, 6.0, 4.0]]), mounts)


def _pose(t: float) -> Array:
    """The cart after t s: 1 m/s along x, turning slowly."""
    return np.concatenate([[2.0 + t, 2.0 + 0.1 * t, 0.0], frames.from_euler(0.1 * t)])


def _truth() -> Truth:
    t = np.arange(int(DURATION * 120) + 1) / 120
    return Truth(t=t, poses=np.array([_pose(time) for time in t])[:, None], bodies=("cart",))
