"""From what a scenario says of antennas to where they are: bodies and mounts by pattern, aim and tilt."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.plugins import suggest
from testbed.quantity import Misplaced
from testbed.radio.antenna import DEGREES, half_power_width
from testbed.radio.links import Ends
from testbed.scene import WORLD, Scene
from testbed.sensors.antenna_rule import AntennaRule
from testbed.sensors.rfid_section import RfidConfig
from testbed.solid import holders
from testbed.types import Antennas


def bodies_matching(scene: Scene, pattern: str) -> list[int]:
    """Indices of the bodies whose name fits the pattern. ValueError, with the nearest name, where none does."""
    found = [i for i, body in enumerate(scene.bodies) if fnmatchcase(body.name, pattern)]
    if not found:
        raise ValueError(f"no body is named {pattern!r}{suggest(pattern, [b.name for b in scene.bodies])}")
    return found


def in_truth(scene: Scene, body: int, pose: np.ndarray) -> tuple[int, np.ndarray]:
    """(index in the truth, pose (7,)) of something at `pose` in the frame of a body: the world's where the body never moves."""
    if body == WORLD:
        return WORLD, pose
    if scene.bodies[body].moving:
        return int(np.searchsorted(scene.moving, body)), pose
    return WORLD, frames.compose(scene.bodies[body].pose, pose)


def rolled(quaternion: Array, roll_deg: float) -> Array:
    """(4,): turned further about its own +x. Bit for bit as it was where there is nothing to turn."""
    return quaternion if roll_deg == 0 else frames.multiply(quaternion, frames.from_euler(0.0, 0.0, np.deg2rad(roll_deg)))


def inside_of(scene: Scene, box: int) -> tuple[str, str]:
    """(body, material) of a piece of the scene, a box or a mesh, by name."""
    body = int(scene.piece_body[box])
    return "a box" if body == WORLD else scene.bodies[body].name, scene.materials[int(scene.piece_material[box])]


def place_antennas(config: RfidConfig, sensor: str, scene: Scene) -> tuple[Antennas, Ends]:
    """The antennas of a reader, and their ends of the links. Misplaced, at its rule, for what the scene does not have or can't hold."""
    rows: list[tuple[str, int, np.ndarray, AntennaRule]] = []
    by: list[int] = []  # the rule of each row
    for i, rule in enumerate(config.antennas):
        try:
            rows += _placed(rule, scene, default_id=f"{sensor}.{i + 1}")
        except ValueError as error:
            raise Misplaced(("antennas", i), str(error)) from None
        by += [i] * (len(rows) - len(by))
    names = [row[0] for row in rows]
    first: dict[str, int] = {}
    for name, i in zip(names, by, strict=True):
        if name in first:
            raise Misplaced(("antennas", i), f"the antenna {name!r} would be there twice, first by antennas.{first[name]}: give it an id")
        first[name] = i
    ends = [in_truth(scene, body, pose) for _, body, pose, _ in rows]
    poses = np.array([pose for _, pose in ends]).reshape(-1, 7)
    bodies = np.array([body for body, _ in ends], dtype=np.int64)
    _in_the_open(scene, names, by, bodies, poses[:, :3])
    rules = [rule for *_, rule in rows]
    tables = [rule.pattern.knots() if rule.pattern else None for rule in rules]
    antennas = Antennas(
        id=np.array(names),
        position=poses[:, :3],
        quaternion=poses[:, 3:],
        gain=np.array([r.gain_dbi for r in rules]),
        beamwidth=np.array([np.deg2rad(r.beamwidth_deg) if p is None else half_power_width(p) for r, p in zip(rules, tables, strict=True)]),
        front_to_back=np.array([r.front_to_back_db if p is None else -p[-1] for r, p in zip(rules, tables, strict=True)]),
        power=np.array([config.power_dbm if r.power_dbm is None else r.power_dbm for r in rules]),
        carrier=np.array(["" if body == WORLD else scene.moving_names[body] for body, _ in ends]),
        reader=np.array([sensor] * len(rows)),
        polarisation=np.array([r.polarisation for r in rules]),
        pattern=np.array([np.full(len(DEGREES), np.nan) if p is None else p for p in tables]),
    )
    return antennas, Ends(bodies, poses)


def _in_the_open(scene: Scene, names: list[str], by: list[int], body: Array, position: Array) -> None:
    """Misplaced for the first antenna inside a solid body: no ray would meet the box that it starts in."""
    boxes = holders(scene, body, position)
    for k in np.flatnonzero(boxes >= 0):
        owner, material = inside_of(scene, int(boxes[k]))
        raise Misplaced(
            ("antennas", by[k]), f"{names[k]!r} is inside {owner} ({material}): put it outside, some centimetres off the surface"
        )


def _placed(rule: AntennaRule, scene: Scene, default_id: str) -> list[tuple[str, int, np.ndarray, AntennaRule]]:
    if rule.position_m is None:
        return _on_mounts(rule, scene)
    body = WORLD
    if rule.on is not None:
        matching = bodies_matching(scene, rule.on)
        if len(matching) > 1:
            raise ValueError(f"{rule.on!r} fits {len(matching)} bodies, and position_m places one antenna on one")
        body = matching[0]
    if rule.aim_m is not None:
        if rule.aim_m == rule.position_m:
            raise ValueError("aim_m is where the antenna is: aim it elsewhere")
        quaternion = rolled(frames.looking_at(rule.position_m, rule.aim_m), rule.roll_deg)
    else:
        quaternion = frames.from_euler(np.deg2rad(rule.yaw_deg), -np.deg2rad(rule.tilt_deg), np.deg2rad(rule.roll_deg))
    return [(rule.id or default_id, body, np.concatenate([rule.position_m, quaternion]), rule)]


def _on_mounts(rule: AntennaRule, scene: Scene) -> list[tuple[str, int, np.ndarray, AntennaRule]]:
    found, mounts = [], scene.mounts
    for body in bodies_matching(scene, rule.on or "*"):
        prefix = scene.bodies[body].name + "."
        for i in np.flatnonzero((mounts.body == body) & (mounts.use == "antenna")):
            name = str(mounts.name[i])
            if fnmatchcase(name.removeprefix(prefix), rule.mount or "*"):
                found.append((name, body, np.concatenate([mounts.position[i], rolled(mounts.quaternion[i], rule.roll_deg)]), rule))
    wanted = len(found) if rule.count is None else rule.count
    if not found or wanted > len(found):
        raise ValueError(f"{rule.on!r} offers {len(found)} antenna mounts that fit {rule.mount or '*'!r}, {max(wanted, 1)} are wanted")
    return found[:wanted]
