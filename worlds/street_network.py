"""A street network about a path that was driven: the path thinned, its nodes moved, and wrong branches at every corner, by a seed."""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.geometry import Roads
from testbed.roads import check_roads

CORNER = np.deg2rad(15)  # a node where the path turns by less is a bend of the street, not a corner


def thinned(path: Array, tolerance: float) -> Array:
    """The fewest corners of a path (N, 2) m that leave all of it within `tolerance` m (Ramer 1972; Douglas, Peucker 1973)."""
    keep, stack = {0, len(path) - 1}, [(0, len(path) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        chord = path[b] - path[a]
        share = np.clip((path[a:b] - path[a]) @ chord / max(chord @ chord, 1e-12), 0.0, 1.0)
        apart = np.hypot(*(path[a:b] - path[a] - share[:, None] * chord).T)
        k = a + int(apart.argmax())
        if apart.max() > tolerance and a < k < b:
            keep.add(k)
            stack += [(a, k), (k, b)]
    return path[sorted(keep)]


def street_network(
    path: Array, seed: int, tolerance: float = 3.0, moved: float = 1.5, branches: int = 2, length: tuple[float, float] = (40.0, 120.0)
) -> tuple[Roads, int]:
    """Roads: the thinned path, its nodes moved by `moved` m in a random direction, and `branches` wrong streets at each corner.

    The first wrong street goes straight on, the next ones to a side that the path did not take; each has a bend in its middle, and ends
    dead. Returns the roads and how many streets are wrong.
    """
    random = np.random.default_rng(seed)
    corners = thinned(path, tolerance)
    away = random.uniform(0, 2 * np.pi, len(corners))
    nodes = list(corners + moved * np.stack([np.cos(away), np.sin(away)], axis=1))
    segments = [(i, i + 1) for i in range(len(nodes) - 1)]
    course = np.arctan2(*np.diff(np.array(nodes), axis=0).T[::-1])
    turns = (np.diff(course) + np.pi) % (2 * np.pi) - np.pi
    wrong = 0
    for i in np.flatnonzero(np.abs(turns) > CORNER) + 1:
        other = course[i - 1] - np.sign(turns[i - 1]) * np.pi / 2
        for direction in (course[i - 1], other)[:branches]:
            at, last = np.array(nodes[i]), int(i)
            for _ in range(2):
                angle = direction + random.uniform(-0.3, 0.3)
                at = at + random.uniform(*length) / 2 * np.array([np.cos(angle), np.sin(angle)])
                nodes.append(at)
                segments.append((last, len(nodes) - 1))
                last = len(nodes) - 1
            wrong += 1
    roads = Roads(np.array(nodes), np.array(segments))
    check_roads(roads)
    return roads, wrong
