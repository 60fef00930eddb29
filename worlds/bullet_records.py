"""What `worlds.bullet` hands out: bodies by name and number, what rays met, what touches. Plain data."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.columns import Array


@dataclass(frozen=True, eq=False)
class Handle:
    """A body in a client: PyBullet's number, joints and links by name (the base is -1), and where its centre of mass is."""

    name: str
    uid: int
    joints: dict[str, int]
    links: dict[str, int]
    com: Array  # (7,) PyBullet's body frame in the base's own frame


@dataclass(frozen=True, eq=False)
class StaticPart:
    """The boxes of one material of one body of a scene that never moves."""

    handle: Handle
    body: int
    material: int


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays met. body is PyBullet's number, or -1; fraction is 1 where nothing was hit, else in [0, 1] of the way."""

    body: Array  # (N,) int64
    link: Array  # (N,) int64
    fraction: Array  # (N,) float64
    position: Array  # (N, 3) m
    normal: Array  # (N, 3)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Touching pairs: PyBullet's numbers of body and link on both sides, the place on b, the gap (negative where they overlap)."""

    body: Array  # (N, 2) int64
    link: Array  # (N, 2) int64
    position: Array  # (N, 3) m, world frame
    gap: Array  # (N,) m
    force: Array  # (N,) N, normal force
