"""Packing boxes for ray casting: blocks of near boxes, blocks of near blocks, and once more, as flat arrays.

Lane j of a block is column j of a (6, WIDTH) array whose rows are low x, y, z and high x, y, z: what the caster's loops want.
Splits follow the surface area heuristic: a random line meets a convex shape in proportion to its surface.

J. D. MacDonald, K. S. Booth, "Heuristics for ray tracing using space subdivision", The Visual Computer 6 (1990);
I. Wald et al., "Getting rid of packets: efficient SIMD single-ray traversal using multi-branching BVHs", IEEE RT (2008).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes
from worlds.ray_kernels import WIDTH

UNUSED = -1
_NOWHERE = 1e30  # m: an unused lane is a point out there
_SLACK = 1e-6  # m: bounds across a rotation, and spheres, are wider by this, which covers rounding


class Forest(NamedTuple):
    """Some bodies' boxes, each body packed in its own frame. Blocks (n * 6 * WIDTH,); members (n, WIDTH) int64, -1 where unused."""

    top: Array  # bounds of middle blocks
    middle_of: Array  # the middle block behind each lane
    middle: Array  # bounds of leaves
    leaf_of: Array
    leaf: Array  # boxes in the leaf's frame
    box_of: Array  # index of the box in the scene
    first_top: Array  # (bodies + 1,) int64: where each body's blocks begin
    frame: Array  # (leaves,) int64: the leaf's frame, 0 for the body's own
    rotation: Array  # (frames, 3, 3): columns are the axes of each frame in the body's
    ball: Array  # (lanes, 3) m: centre, in the body's frame, of a ball around all its boxes; lanes are whole vector registers
    reach: Array  # (lanes,) m²: its radius squared; -1 for a ball that nothing meets


class _Layer(NamedTuple):
    """Things packed into blocks: the blocks, whom their lanes stand for, and the bounds (k, 3) of each block."""

    block: Array
    member: Array
    low: Array
    high: Array


def forest(bodies: Sequence[Boxes], index: Sequence[Array]) -> Forest:
    """Packs the boxes of each body, given in its frame. index[i] says where the boxes of bodies[i] are in the scene."""
    tops, middles, leaves = [_empty()], [_empty()], [_empty()]
    frame, rotations, first_top = [np.zeros(0, dtype=np.int64)], [np.eye(3)], [0]
    for boxes, where in zip(bodies, index, strict=True):
        own = []
        for rotation, layer in _leaves(boxes):
            own.append(layer._replace(member=np.where(layer.member == UNUSED, UNUSED, where[layer.member])))
            frame.append(np.full(len(layer.block), 0 if rotation is None else len(rotations)))
            rotations += [] if rotation is None else [rotation]
        leaf = _joined([_empty(), *own])
        middle = _layer(leaf.low, leaf.high, sum(len(a.block) for a in leaves))
        tops.append(_layer(middle.low, middle.high, sum(len(a.block) for a in middles)))
        middles.append(middle)
        leaves.append(leaf)
        first_top.append(first_top[-1] + len(tops[-1].block))
    top, middle, leaf = _joined(tops), _joined(middles), _joined(leaves)
    ball, reach = _balls(bodies)
    return Forest(
        top=top.block.ravel(),
        middle_of=top.member,
        middle=middle.block.ravel(),
        leaf_of=middle.member,
        leaf=leaf.block.ravel(),
        box_of=leaf.member,
        first_top=np.array(first_top, dtype=np.int64),
        frame=np.concatenate(frame),
        rotation=np.array(rotations),
        ball=ball,
        reach=reach,
    )


def _leaves(boxes: Boxes) -> Iterator[tuple[Array | None, _Layer]]:
    """The boxes packed by orientation: (axes of the leaf's frame or None for the body's own, the layer). Bounds are in the body's."""
    rotation = frames.matrix(boxes.quaternion)
    extent = np.einsum("nij,nj->ni", np.abs(rotation), boxes.half)
    low, high = boxes.center - extent, boxes.center + extent
    # a box turned by quarters is an upright one with its edges renamed
    upright = (np.minimum(np.abs(rotation), np.abs(np.abs(rotation) - 1)) < 1e-12).all(axis=(1, 2))
    if upright.any():
        own = np.flatnonzero(upright)
        layer = _layer(low[own], high[own])
        yield None, layer._replace(member=np.where(layer.member == UNUSED, UNUSED, own[layer.member]))
    rest = np.flatnonzero(~upright)
    _, kind = np.unique(np.round(rotation[rest], 12).reshape(-1, 9), axis=0, return_inverse=True)
    for k in range(kind.max(initial=-1) + 1):
        own = rest[kind.ravel() == k]
        axes = rotation[own[0]]
        center = boxes.center[own] @ axes
        layer = _layer(center - boxes.half[own], center + boxes.half[own])
        member = np.where(layer.member == UNUSED, UNUSED, own[layer.member])
        around = [(low[m[m != UNUSED]].min(axis=0) - _SLACK, high[m[m != UNUSED]].max(axis=0) + _SLACK) for m in member]
        yield axes, _Layer(layer.block, member, np.array([a for a, _ in around]), np.array([b for _, b in around]))


def _layer(low: Array, high: Array, first: int = 0) -> _Layer:
    """Packs n things with bounds (n, 3) into blocks; thing i is called `first` + i."""
    groups = list(_split(np.arange(len(low)), low, high)) if len(low) else []
    block = np.full((len(groups), 6, WIDTH), _NOWHERE)
    member = np.full((len(groups), WIDTH), UNUSED, dtype=np.int64)
    for k, group in enumerate(groups):
        block[k, :3, : len(group)], block[k, 3:, : len(group)] = low[group].T, high[group].T
        member[k, : len(group)] = group + first
    bounds = [(low[g].min(axis=0), high[g].max(axis=0)) for g in groups]
    return _Layer(block, member, np.array([a for a, _ in bounds]).reshape(-1, 3), np.array([b for _, b in bounds]).reshape(-1, 3))


def _split(group: Array, low: Array, high: Array) -> Iterator[Array]:
    """Cuts a group of things in two where surface times blocks is least, and on, until each part fills one block at most."""
    if len(group) <= WIDTH:
        yield group
        return
    best = (np.inf, group, group)
    for axis in range(3):
        order = group[np.argsort((low + high)[group, axis], kind="stable")]
        left = _surface(np.minimum.accumulate(low[order]), np.maximum.accumulate(high[order]))[:-1]
        right = _surface(np.minimum.accumulate(low[order][::-1]), np.maximum.accumulate(high[order][::-1]))[::-1][1:]
        many = np.arange(1, len(order))
        cost = left * np.ceil(many / WIDTH) + right * np.ceil((len(order) - many) / WIDTH)
        cut = int(np.argmin(cost))
        if cost[cut] < best[0]:
            best = (cost[cut], order[: cut + 1], order[cut + 1 :])
    yield from _split(best[1], low, high)
    yield from _split(best[2], low, high)


def _surface(low: Array, high: Array) -> Array:
    x, y, z = np.moveaxis(high - low, -1, 0)
    return x * y + y * z + z * x


def _joined(layers: Sequence[_Layer]) -> _Layer:
    return _Layer(*(np.concatenate(parts) for parts in zip(*layers, strict=True)))


def _empty() -> _Layer:
    return _layer(np.zeros((0, 3)), np.zeros((0, 3)))


def _balls(bodies: Sequence[Boxes]) -> tuple[Array, Array]:
    """Centres (lanes, 3) and squared radii (lanes,) of one ball a body, filled up to whole registers with balls that nothing meets."""
    lanes = -(-len(bodies) // 8) * 8
    ball, reach = np.zeros((lanes, 3)), np.full(lanes, -1.0)
    sign = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    for m, boxes in enumerate(bodies):
        if len(boxes):
            corners = (boxes.center[:, None] + frames.rotate(boxes.quaternion[:, None], sign * boxes.half[:, None])).reshape(-1, 3)
            ball[m] = (corners.min(axis=0) + corners.max(axis=0)) / 2
            reach[m] = (np.linalg.norm(corners - ball[m], axis=1).max() + _SLACK) ** 2
    return ball, reach
