"""From a camera's description to a camera: where it stands at a time, and which walls have to make room for its view."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.report.cameras import CameraSpec
from testbed.report.sight import crossed
from testbed.scene import Body, Scene, Truth
from testbed.view import Camera

WALLS = frozenset({"wall", "roof", "ceiling"})  # kinds that may be cut off without being asked for
OVERVIEW_VIEW, STILL_VIEW, FOLLOW_VIEW, SHOULDER_VIEW = (np.radians(a) for a in (32.0, 60.0, 45.0, 65.0))
OVERVIEW_ELEVATION, FOLLOW_ELEVATION, FOLLOW_DISTANCE = 38.0, 28.0, 7.0  # degrees, m
SIDES = (-60.0, -120.0, 120.0, 60.0, -30.0, -150.0, 150.0, 30.0)  # degrees: where a picture may be taken from, best first
SPARE = 1.06  # of the picture's half sides: a little room at the rim

Placed = tuple[Camera, frozenset[int]]  # a camera, and the bodies (indices) that are cut off for it


def place(spec: CameraSpec, scene: Scene, truth: Truth, t: float, size: tuple[int, int] | None = None) -> Placed:
    """The camera as it stands at `t` s; only one with a body (`spec.body`) moves. `size` (width, height) px overrules the description's.

    ValueError for a body that isn't in the scene.
    """
    if spec.shoulder is not None:
        position, target, view = _over_the_shoulder(scene, _body(spec, scene, spec.shoulder), truth, t)
    elif spec.follow is not None:
        position, target, view = _following(spec, scene, _body(spec, scene, spec.follow), truth, t)
    elif spec.position_m is not None:
        middle = np.array([*scene.bounds[:, :2].mean(axis=0), 1.0])
        position, target, view = np.array(spec.position_m), np.array(spec.look_at_m or middle), STILL_VIEW
    else:
        return _overview(spec, scene, truth, size)
    camera = _camera(spec, scene, position, target, view, size)
    return camera, _cuts(spec, scene, camera)


def _camera(spec: CameraSpec, scene: Scene, position: Array, target: Array, view: float, size: tuple[int, int] | None) -> Camera:
    corners = _corners(scene.bounds)
    far = 1.2 * float(np.linalg.norm(corners - position, axis=1).max()) + 5.0
    width, height = size or (spec.width_px, spec.height_px)
    if spec.field_of_view_deg is not None:
        view = np.radians(spec.field_of_view_deg)
    return Camera(spec.id, position, target, float(view), width, height, far=far)


def _corners(bounds: Array) -> Array:
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


# ---------------------------------------------------------------- with a body


def _body(spec: CameraSpec, scene: Scene, name: str) -> int:
    for i, body in enumerate(scene.bodies):
        if body.name == name:
            return i
    raise ValueError(f"camera {spec.id}: no body is called {name!r}")


def _pose(body: Body, truth: Truth, t: float) -> Array:
    return truth.pose(truth.index(body.name), t) if body.name in truth.bodies else body.pose


def _height(scene: Scene, body: int) -> float:
    """Of the highest box of a body over its origin, m."""
    own = scene.boxes.take(scene.boxes.body == body)
    reach = np.abs(frames.matrix(own.quaternion)[:, 2] * own.half).sum(axis=1)
    return float((own.center[:, 2] + reach).max()) if len(own) else 1.0


def _following(spec: CameraSpec, scene: Scene, body: int, truth: Truth, t: float) -> tuple[Array, Array, float]:
    pose = _pose(scene.bodies[body], truth, t)
    target = pose[:3] + np.array([0.0, 0.0, _height(scene, body) / 2])
    if spec.position_m is not None:
        return np.array(spec.position_m), target, FOLLOW_VIEW
    if spec.offset_m is not None:
        level = frames.from_euler(frames.yaw_of(pose[3:]))  # a rattling body does not shake the camera
        return pose[:3] + frames.rotate(level, np.array(spec.offset_m)), target, FOLLOW_VIEW
    elevation = FOLLOW_ELEVATION if spec.elevation_deg is None else spec.elevation_deg
    sides = SIDES if spec.azimuth_deg is None else (spec.azimuth_deg,)
    ways = [(spec.distance_m or FOLLOW_DISTANCE) * _direction(side, elevation) for side in sides]
    return target + ways[_clearest(scene, body, truth, ways)], target, FOLLOW_VIEW


def _clearest(scene: Scene, body: int, truth: Truth, ways: list[Array]) -> int:
    """From which of some places beside a body it is seen most of the time: one for the whole trial, so that the camera doesn't jump."""
    if len(ways) == 1:
        return 0
    boxes = scene.static_boxes()
    kinds = np.array([b.kind in WALLS for b in scene.bodies])
    boxes = boxes.take(~kinds[boxes.body] & (boxes.body != body))
    name = scene.bodies[body].name
    poses = truth.poses[:: max(1, len(truth.t) // 12), truth.index(name)] if name in truth.bodies else scene.bodies[body].pose[None]
    middles = poses[:, :3] + np.array([0.0, 0.0, _height(scene, body) / 2])
    return int(np.argmax([float((~crossed(middles + way, middles, boxes).any(axis=1)).mean()) for way in ways]))


def _over_the_shoulder(scene: Scene, body: int, truth: Truth, t: float) -> tuple[Array, Array, float]:
    pose, height = _pose(scene.bodies[body], truth, t), _height(scene, body)
    level = np.concatenate([pose[:3], frames.from_euler(frames.yaw_of(pose[3:]))])
    eye, seen = np.array([-0.75, -0.42, 1.06 * height]), np.array([3.0, 0.1, 0.62 * height])
    return frames.to_world(level, eye), frames.to_world(level, seen), SHOULDER_VIEW


def _direction(azimuth: float, elevation: float) -> Array:
    """Unit vector (3,) towards an azimuth and an elevation, degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])


# ---------------------------------------------------------------- overviews


def _overview(spec: CameraSpec, scene: Scene, truth: Truth, size: tuple[int, int] | None) -> Placed:
    sides = SIDES if spec.azimuth_deg is None else (spec.azimuth_deg,)
    found = []
    for azimuth in sides:
        camera = _fitted(spec, scene, azimuth, size)
        cut = _cuts(spec, scene, camera)
        found.append((camera, cut))
    if len(found) == 1:
        return found[0]
    seen = [round(_seen(scene, truth, camera, cut), 2) for camera, cut in found]
    return found[int(np.argmax(seen))]


def _fitted(spec: CameraSpec, scene: Scene, azimuth: float, size: tuple[int, int] | None) -> Camera:
    """As near as it can be with everything but the upper walls in the picture."""
    inner = [i for i, b in enumerate(scene.bodies) if b.kind not in WALLS]
    extent = scene.bounds.copy()
    boxes = scene.static_boxes()
    boxes = boxes.take(np.isin(boxes.body, inner))
    tops = boxes.center[:, 2] + np.abs(frames.matrix(boxes.quaternion)[:, 2] * boxes.half).sum(axis=1)
    extent[1, 2] = min(extent[1, 2], max(2.0, tops.max(initial=0.0)))
    middle = extent.mean(axis=0)
    back = _direction(azimuth, OVERVIEW_ELEVATION if spec.elevation_deg is None else spec.elevation_deg)
    rough = _camera(spec, scene, middle + back, middle, OVERVIEW_VIEW, size)
    right, top, _ = rough.axes
    x, y, toward = rough.axes @ (_corners(extent) - middle).T
    tall = np.tan(rough.field_of_view / 2) / SPARE
    aside, wanted = _balanced(x, toward, tall * rough.width / rough.height)
    upward, other = _balanced(y, toward, tall)
    target = middle + aside * right + upward * top
    return _camera(spec, scene, target + max(wanted, other) * back, target, OVERVIEW_VIEW, size)


def _balanced(across: Array, toward: Array, slope: float) -> tuple[float, float]:
    """How far to aim aside, and the distance from which all points lie within `slope` m a metre of depth on both sides."""
    one, other = float((across / slope + toward).max()), float((-across / slope + toward).max())
    return slope * (one - other) / 2, (one + other) / 2


def _seen(scene: Scene, truth: Truth, camera: Camera, cut: frozenset[int]) -> float:
    """Share of the movers' ways, and with less weight of the floor, that nothing stands before."""
    boxes = scene.static_boxes()
    boxes = boxes.take(~np.isin(boxes.body, list(cut)))
    every = max(1, len(truth.t) // 12)
    ways = truth.poses[::every, :, :3].reshape(-1, 3) + np.array([0.0, 0.0, 0.9])
    free = [~crossed(np.tile(camera.position, (len(p), 1)), p, boxes).any(axis=1) for p in (ways, _floor_points(scene, 6))]
    return 0.7 * (float(free[0].mean()) if len(ways) else 0.0) + 0.3 * float(free[1].mean())


def _floor_points(scene: Scene, across: int) -> Array:
    """(across², 3): points just above the floor, evenly inside the walls."""
    low, high = scene.bounds[:, :2]
    x, y = (np.linspace(low[i], high[i], 2 * across + 1)[1::2] for i in (0, 1))
    return np.stack([*(axis.ravel() for axis in np.meshgrid(x, y)), np.full(across**2, 0.05)], axis=1)


# ---------------------------------------------------------------- what is cut off


def _cuts(spec: CameraSpec, scene: Scene, camera: Camera) -> frozenset[int]:
    if spec.cut is not None:
        return frozenset(i for i, b in enumerate(scene.bodies) if any(fnmatchcase(b.name, g) or fnmatchcase(b.kind, g) for g in spec.cut))
    low, high = scene.bounds
    outside = bool((camera.position < low).any() or (camera.position > high).any())
    if spec.shoulder is not None or (spec.follow is None and not outside):
        return frozenset()  # what someone in the hall sees
    ends = np.concatenate([_floor_points(scene, 6) if outside else np.empty((0, 3)), camera.target[None]])
    boxes = scene.static_boxes()
    boxes = boxes.take(np.isin(boxes.body, [i for i, b in enumerate(scene.bodies) if b.kind in WALLS]))
    in_the_way = crossed(np.tile(camera.position, (len(ends), 1)), ends, boxes).any(axis=0)
    shells = [i for i in scene.meshes.body if outside and scene.bodies[i].kind in WALLS]  # walls in one piece are always in the way
    return frozenset(int(i) for i in [*boxes.body[in_the_way], *shells])
