"""What halls are furnished with: racks, gates, walls, cartons, pallets, posts. Plain data, no physics.

Every part is built in its own frame (origin on the floor, z up) from axis-parallel boxes, and stands at a pose. Mounts lie
STAND_OFF outside the surface that they belong to, so that no ray starts inside a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes, Mounts

MATERIALS = ("steel", "rack_bay", "carton", "liquid_pallet", "person", "wood", "plastic", "concrete", "rubber", "glass")
STAND_OFF = 0.02  # m between a surface and a mount on it


def floor_pose(x: float, y: float, yaw: float = 0.0) -> Array:
    """(7,) pose on the floor at (x, y) m, turned by `yaw` rad."""
    return np.concatenate([[x, y, 0.0], frames.from_euler(yaw)])


@dataclass(frozen=True, eq=False)
class Part:
    """One standing thing: boxes, mounts and meshes in its own frame, materials as indices into MATERIALS. What moves has no meshes."""

    name: str
    kind: str
    pose: Array
    boxes: Boxes
    mounts: Mounts
    meshes: Meshes = field(default_factory=Meshes.empty)


class Builder:
    """Collects the boxes and mounts of one body in its own frame."""

    def __init__(self) -> None:
        self._boxes: list[tuple[Array, Array, int]] = []
        self._mounts: list[tuple[str, str, str, Array, Array]] = []

    def box(self, material: str, low: ArrayLike, high: ArrayLike) -> None:
        """An axis-parallel box between two opposite corners (3,), m."""
        a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        if not (b > a).all():
            raise ValueError(f"a box of {material} wants its corners ordered, low {a.tolist()} below high {b.tolist()}")
        self._boxes.append(((a + b) / 2, (b - a) / 2, MATERIALS.index(material)))

    def mount(self, name: str, at: ArrayLike, yaw: float = 0.0, pitch: float = 0.0, use: str = "tag", group: str = "") -> None:
        """A place at `at` (3,) m whose +x points along `yaw` and `pitch` (rad, positive downwards), away from the surface."""
        self._mounts.append((name, group, use, np.asarray(at, dtype=np.float64), frames.from_euler(yaw, pitch)))

    def boxes(self) -> Boxes:
        """All boxes so far; `material` indexes MATERIALS, `body` is 0."""
        if not self._boxes:
            return Boxes.empty()
        center, half, material = zip(*self._boxes, strict=True)
        upright = np.tile(frames.IDENTITY[3:], (len(center), 1))
        return Boxes(np.array(center), upright, np.array(half), body=np.zeros(len(center)), material=np.array(material))

    def mounts(self) -> Mounts:
        """All mounts so far; `body` is 0."""
        if not self._mounts:
            return Mounts.empty()
        name, group, use, position, quaternion = zip(*self._mounts, strict=True)
        names, groups, uses = (np.array(text, dtype=np.str_) for text in (name, group, use))
        return Mounts(names, groups, uses, np.zeros(len(name)), np.array(position), np.array(quaternion))

    def part(self, name: str, kind: str, pose: Array) -> Part:
        """The body, standing at `pose` (7,)."""
        return Part(name, kind, pose, self.boxes(), self.mounts())


# ---------------------------------------------------------------- racks

UPRIGHT, BEAM_DEPTH, BEAM_HEIGHT, BOARD = 0.10, 0.05, 0.12, 0.025  # m: usual pallet racking
PALLET = 0.144  # m, height of a EUR pallet (EN 13698-1), 1.2 x 0.8 m
TAGS_ACROSS = 4  # mounts side by side on each level of a bay


@dataclass(frozen=True)
class RackSize:
    """Measures of a pallet rack, m; its front looks along its own -y, the bays stand along x."""

    bays: int = 4
    levels: int = 3
    bay_length: float = 2.7
    depth: float = 1.1
    level_height: float = 1.5

    @property
    def length(self) -> float:
        """Over all uprights, m."""
        return self.bays * (self.bay_length + UPRIGHT) + UPRIGHT

    @property
    def height(self) -> float:
        """Of the uprights, m: the top level is open."""
        return self.levels * self.level_height


def rack(name: str, pose: Array, size: RackSize, fill: float, liquid: float, random: np.random.Generator) -> Part:
    """A pallet rack: steel uprights and beams, wooden boards, bays of which a share `fill` is loaded.

    Of the loaded ones a share `liquid` holds pallets of liquid, the others are half and half packed full or hold cartons on pallets.
    Mounts: TAGS_ACROSS a level and bay, in groups "bay1", "bay2", ... from the left as seen from the back.
    """
    built = Builder()
    front, back, pitch = -size.depth / 2, size.depth / 2, size.bay_length + UPRIGHT
    lefts = -size.length / 2 + pitch * np.arange(size.bays + 1)
    for x in lefts:
        for y in (front, back - UPRIGHT):
            built.box("steel", (x, y, 0.0), (x + UPRIGHT, y + UPRIGHT, size.height))
    for bay, x in enumerate(lefts[:-1] + UPRIGHT, start=1):
        number = 0
        for level in range(size.levels):
            floor = level * size.level_height
            if level:
                for y in (front, back - BEAM_DEPTH):
                    built.box("steel", (x, y, floor - BOARD - BEAM_HEIGHT), (x + size.bay_length, y + BEAM_DEPTH, floor - BOARD))
                built.box("wood", (x, front, floor - BOARD), (x + size.bay_length, back, floor))
            loaded = random.random() < fill
            if loaded:
                _load_bay(built, x, floor, size, liquid, random)
            # a tag hangs on the goods; where there are none, on the beam, or just above the floor
            height = floor + 0.4 if loaded else floor - BOARD - BEAM_HEIGHT / 2 if level else 0.06
            for across in (np.arange(TAGS_ACROSS) + 0.5) / TAGS_ACROSS * size.bay_length:
                number += 1
                built.mount(f"bay{bay}.{number}", (x + across, front - STAND_OFF, height), yaw=-np.pi / 2, group=f"bay{bay}")
    return built.part(name, "rack", pose)


def _load_bay(built: Builder, x: float, floor: float, size: RackSize, liquid: float, random: np.random.Generator) -> None:
    """Fill one compartment whose left edge is at x: packed full, or with pallets side by side that carry cartons or liquid."""
    clear = size.level_height - BOARD - BEAM_HEIGHT - 0.1  # m, up to the beam of the next level
    front, back = -size.depth / 2, size.depth / 2
    kind, heights = random.random(), random.uniform(0.55, 1.0, 3)
    if kind >= liquid and kind < (1 + liquid) / 2:
        built.box("rack_bay", (x + 0.05, front, floor), (x + size.bay_length - 0.05, back - 0.02, floor + clear))
        return
    places = max(1, int(size.bay_length / 0.9))
    for place in range(places):
        left = x + size.bay_length * place / places + 0.05
        right = x + size.bay_length * (place + 1) / places - 0.05
        goods = "liquid_pallet" if kind < liquid else "carton"
        pallet(built, (left, front), (right, back - 0.02), floor, goods, clear * heights[place % 3])


def pallet(built: Builder, low: ArrayLike, high: ArrayLike, floor: float, goods: str, height: float) -> None:
    """A wooden pallet between two floor points (2,) m with a block of `goods`, `height` m over all."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    built.box("wood", (x0, y0, floor), (x1, y1, floor + PALLET))
    if height > PALLET:
        built.box(goods, (x0, y0, floor + PALLET), (x1, y1, floor + height))


def pallet_stack(name: str, pose: Array, goods: str = "carton", height: float = 1.4) -> Part:
    """A EUR pallet on the floor with a block of goods; tag mounts on its four sides: front, left, back, right."""
    built = Builder()
    pallet(built, (-0.6, -0.4), (0.6, 0.4), 0.0, goods, height)
    sides = (("front", 0.6, 0.0, 0.0), ("left", 0.0, 0.4, np.pi / 2), ("back", -0.6, 0.0, np.pi), ("right", 0.0, -0.4, -np.pi / 2))
    for side, x, y, yaw in sides:
        out = STAND_OFF * np.array([np.cos(yaw), np.sin(yaw)])
        built.mount(side, (x + out[0], y + out[1], 0.75 * height), yaw)
    return built.part(name, "pallet", pose)


# ---------------------------------------------------------------- gates, walls, posts


@dataclass(frozen=True)
class GateSize:
    """Measures of a portal, m and rad; one walks through it along its +x."""

    clear_width: float = 2.6
    height: float = 2.5
    post: float = 0.12
    low: float = 0.7
    high: float = 1.7
    toe: float = 0.44


def gate(name: str, pose: Array, size: GateSize) -> Part:
    """Two steel posts and a crossbar, with antenna mounts that look across the passage.

    left_low and right_low look `toe` backwards (to where one comes from), left_high and right_high forwards: antennas in one
    plane with one aim can't tell in from out. top_left and top_right look down. Four tag mounts (left_out, ...) for reference tags.
    """
    built = Builder()
    half, p = size.clear_width / 2, size.post
    for side in (1, -1):
        inner, outer = sorted((side * half, side * (half + p)), key=abs)
        built.box("steel", (-p / 2, min(inner, outer), 0.0), (p / 2, max(inner, outer), size.height))
        word, aim = ("left", -np.pi / 2) if side > 0 else ("right", np.pi / 2)
        face = inner - side * STAND_OFF
        built.mount(f"{word}_low", (0.0, face, size.low), aim - side * size.toe, use="antenna", group="antennas")
        built.mount(f"{word}_high", (0.0, face, size.high), aim + side * size.toe, use="antenna", group="antennas")
        middle = (inner + outer) / 2
        built.mount(f"{word}_out", (-p / 2 - STAND_OFF, middle, 1.2), np.pi, group="references")
        built.mount(f"{word}_in", (p / 2 + STAND_OFF, middle, 1.2), 0.0, group="references")
        built.mount(f"top_{word}", (0.0, side * half / 2, size.height - STAND_OFF), pitch=np.pi / 2, use="antenna", group="top")
    built.box("steel", (-p / 2, -half - p, size.height), (p / 2, half + p, size.height + 0.1))
    return built.part(name, "gate", pose)


def wall(
    name: str,
    start: tuple[float, float],
    end: tuple[float, float],
    height: float,
    thickness: float = 0.2,
    openings: Sequence[tuple[float, float]] = (),
    door_height: float = 3.0,
    antennas: int = 0,
) -> Part:
    """A concrete wall from `start` to `end`, m, with door openings (from, to) in m along it, ascending and apart.

    `antennas` mounts ("a1", ...) stand evenly along its left side (seen from start to end), 2.5 m high, tilted 20° down.
    """
    (x0, y0), (x1, y1) = start, end
    length, built = float(np.hypot(x1 - x0, y1 - y0)), Builder()
    edge, half = 0.0, thickness / 2
    for a, b in [*openings, (length, length)]:
        if a < edge - 1e-9 or b > length + 1e-9:
            raise ValueError(f"{name}: openings must be ascending and lie within {length:g} m, got {list(openings)}")
        if a > edge:
            built.box("concrete", (edge, -half, 0.0), (a, half, height))
        if b > a and height > door_height:
            built.box("concrete", (a, -half, door_height), (b, half, height))
        edge = b
    for i in range(antennas):
        at = (length * (i + 0.5) / antennas, half + STAND_OFF, min(2.5, height - 0.1))
        built.mount(f"a{i + 1}", at, np.pi / 2, np.radians(20.0), use="antenna", group="antennas")
    return built.part(name, "wall", floor_pose(x0, y0, np.arctan2(y1 - y0, x1 - x0)))


def post(name: str, x: float, y: float, look_at: tuple[float, float], height: float = 3.0, side: float = 0.1) -> Part:
    """A steel post with two antenna mounts that look at `look_at` on the floor: "low" at 1 m and "high" 0.2 m below its top."""
    built = Builder()
    half = side / 2
    built.box("steel", (-half, -half, 0.0), (half, half, height))
    yaw = float(np.arctan2(look_at[1] - y, look_at[0] - x))
    away = float(np.hypot(look_at[0] - x, look_at[1] - y))
    for word, z in (("low", 1.0), ("high", height - 0.2)):
        built.mount(word, (half + STAND_OFF, 0.0, z), 0.0, np.arctan2(z - 1.0, away), use="antenna", group="antennas")
    return built.part(name, "post", floor_pose(x, y, yaw))


def carton(name: str, pose: Array, size: tuple[float, float, float] = (0.6, 0.4, 0.4)) -> Part:
    """A carton on the floor, length x width x height m, with tag mounts "front" (+x) and "top"."""
    length, width, height = size
    built = Builder()
    built.box("carton", (-length / 2, -width / 2, 0.0), (length / 2, width / 2, height))
    built.mount("front", (length / 2 + STAND_OFF, 0.0, height / 2))
    built.mount("top", (0.0, 0.0, height + STAND_OFF), pitch=-np.pi / 2)
    return built.part(name, "carton", pose)


def tray(name: str, start: tuple[float, float], end: tuple[float, float], height: float, antennas: int) -> Part:
    """A cable tray under the ceiling from `start` to `end`, with `antennas` mounts ("a1", ...) that look straight down."""
    (x0, y0), (x1, y1) = start, end
    length, built = float(np.hypot(x1 - x0, y1 - y0)), Builder()
    built.box("steel", (0.0, -0.1, height), (length, 0.1, height + 0.06))
    for i in range(antennas):
        at = (length * (i + 0.5) / antennas, 0.0, height - STAND_OFF)
        built.mount(f"a{i + 1}", at, pitch=np.pi / 2, use="antenna", group="antennas")
    return built.part(name, "tray", floor_pose(x0, y0, np.arctan2(y1 - y0, x1 - x0)))
