"""Pictures of a scene, without a display: PyBullet's TinyRenderer for the bodies, exact geometry for the floor under them.

Nothing is simulated here: moving bodies stand where they are told to. What never moves is drawn once a camera and kept, and the
moving bodies are drawn apart and laid over it by depth, which makes an animation several times faster.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from testbed import frames
from testbed.columns import Array
from testbed.geometry import Boxes, Meshes
from testbed.scene import Scene
from testbed.view import MAX_SIDE, NOTHING, Camera, Image
from worlds.bullet import Handle
from worlds.ground import Ground, corners
from worlds.paint import BACKGROUND, colour
from worlds.stage import VisualClient, Window

STUB = 0.12  # m: what is left of a body that is cut off
SHADOWLESS = frozenset({"wall", "roof", "ceiling"})  # a hall is lit from inside
EDGE_GAIN, EDGE_DARKNESS = 0.35, 0.45  # how strongly a crease is drawn; how dark at most


@dataclass(frozen=True, eq=False)
class Layer:
    """What one client draws: rgb (H, W, 3) uint8, depth (H, W) float32 m or inf, body (H, W) int32 or NOTHING."""

    rgb: Array
    depth: Array
    body: Array

    def before(self, other: Layer, window: Window) -> Layer:
        """The two as one, where this one fills a window of the other: at each pixel whichever is nearer, this one on a tie."""
        part = np.s_[window.top : window.top + window.height, window.left : window.left + window.width]
        wins = np.nonzero((self.depth <= other.depth[part]) & (self.body != NOTHING))
        rgb, depth, body = other.rgb.copy(), other.depth.copy(), other.body.copy()
        rgb[part][wins], depth[part][wins], body[part][wins] = self.rgb[wins], self.depth[wins], self.body[wins]
        return Layer(rgb, depth, body)


class SceneRenderer:
    """Draws a scene for any camera, its moving bodies at any poses. Holds two physics clients: close it, or use it in a `with`.

    PybulletMissing (an ImportError) where there is no PyBullet.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._moving = [int(i) for i in scene.moving]
        self._ground = Ground(scene.bounds, scene.zones)
        self._still = _Bodies(scene)
        self._movers = _Bodies(scene)
        for body in self._moving:
            self._movers.add(body, scene.boxes.take(scene.boxes.body == body))
        self._cut: frozenset[int] | None = None
        self._shadow = np.zeros(0)
        self._kept: dict[tuple[object, ...], _Backdrop] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the memory back. Closing twice is harmless."""
        self._still.close()
        self._movers.close()

    def render(self, camera: Camera, poses: Array, cut: Collection[int] = (), smooth: int = 2) -> Image:
        """The scene with its moving bodies at `poses` (moving bodies, 7), in the order of `scene.moving`.

        cut    : bodies (indices) of which only the lowest STUB m are drawn, as walls that would hide everything
        smooth : colours are averaged over smooth x smooth samples a pixel; depth and body are those of the pixel's middle
        """
        poses = np.asarray(poses, dtype=np.float64)
        if poses.shape != (len(self._moving), 7):
            raise ValueError(f"poses of {len(self._moving)} moving bodies are wanted, (…, 7), got an array {poses.shape}")
        self._stand(frozenset(int(i) for i in cut))
        for body, pose in zip(self._moving, poses, strict=True):
            self._movers.place(body, pose)
        moved = self._moved(poses)
        smooth = max(1, min(int(smooth), MAX_SIDE // max(camera.width, camera.height)))
        fine = replace(camera, width=camera.width * smooth, height=camera.height * smooth)
        exact = self._drawn(camera, moved)
        large = exact if smooth == 1 else self._drawn(fine, moved)
        rgb = self._painted(large, self._backdrop(fine), self._floor(moved))
        if smooth > 1:
            rgb = cv2.resize(rgb, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return Image(camera, rgb, exact.depth.astype(np.float64), exact.body)

    # ------------------------------------------------------------ what stands still

    def _stand(self, cut: frozenset[int]) -> None:
        """Build what never moves, anew where other bodies are cut off than before."""
        if cut == self._cut:
            return
        self._still.clear()
        boxes = self._scene.static_boxes()
        boxes = Boxes.concatenate([boxes.take(~np.isin(boxes.body, list(cut))), stubs(boxes.take(np.isin(boxes.body, list(cut))))])
        meshes = self._scene.static_meshes()
        meshes = Meshes.concatenate(
            [meshes.take(~np.isin(meshes.body, list(cut))), mesh_stubs(meshes.take(np.isin(meshes.body, list(cut))))]
        )
        for body in np.union1d(boxes.body, meshes.body):
            self._still.add(int(body), boxes.take(boxes.body == body), in_world=True)
            self._still.add_meshes(int(body), meshes.take(meshes.body == body))
        lit = [i for i, b in enumerate(self._scene.bodies) if b.kind in SHADOWLESS]
        dark = meshes.take(~np.isin(meshes.body, lit)).corners()
        self._shadow = self._ground.shadow(boxes.take(~np.isin(boxes.body, lit)), dark)
        self._cut = cut
        self._kept.clear()

    def _backdrop(self, camera: Camera) -> _Backdrop:
        key = (*camera.position, *camera.target, camera.field_of_view, camera.width, camera.height, camera.near, camera.far)
        if key not in self._kept:
            if len(self._kept) >= 2:  # one camera in two resolutions
                self._kept.clear()
            self._kept[key] = _Backdrop(camera, self._still.drawn(camera), self._ground)
        return self._kept[key]

    # ------------------------------------------------------------ the picture

    def _moved(self, poses: Array) -> Boxes:
        """The boxes of all moving bodies, in the world frame."""
        boxes = self._scene.boxes.take(np.isin(self._scene.boxes.body, self._moving))
        if not len(boxes):
            return boxes
        pose = poses[np.searchsorted(self._moving, boxes.body)]
        return boxes.with_(center=frames.to_world(pose, boxes.center), quaternion=frames.multiply(pose[:, 3:], boxes.quaternion))

    def _drawn(self, camera: Camera, moved: Boxes) -> Layer:
        """Everything but the floor's colours; floor pixels have the floor's depth."""
        backdrop = self._backdrop(camera)
        layer = backdrop.layer
        window = covering(camera, moved)
        if window is not None:
            layer = self._movers.drawn(camera, window).before(layer, window)
        seen = layer.depth <= backdrop.floor
        return Layer(layer.rgb, np.minimum(layer.depth, backdrop.floor), np.where(seen, layer.body, NOTHING))

    def _floor(self, moved: Boxes) -> Array:
        """(rows, columns, 3) uint8: the floor with the shadows of everything on it."""
        shadow = self._shadow
        if len(moved):
            shadow = np.maximum(shadow, self._ground.shadow(moved))
        return self._ground.shaded(shadow)

    def _painted(self, layer: Layer, backdrop: _Backdrop, floor: Array) -> Array:
        """(H, W, 3) uint8: bodies, floor and background with their edges drawn."""
        ground = cv2.remap(floor, backdrop.columns, backdrop.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        rgb = cv2.copyTo(layer.rgb, (layer.body != NOTHING).astype(np.uint8), ground)
        rgb[np.isinf(layer.depth)] = BACKGROUND
        bright = edges(layer.depth, backdrop.angle)
        return cv2.multiply(rgb, cv2.merge([bright, bright, bright]), dtype=cv2.CV_8U)


class _Backdrop:
    """What a camera sees of all that never moves: the bodies, how far the floor is, and which of its cells each pixel shows."""

    def __init__(self, camera: Camera, layer: Layer, ground: Ground) -> None:
        self.layer = layer
        self.angle = 2 * np.tan(camera.field_of_view / 2) / camera.height  # of one pixel, rad
        rays = camera.rays()
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[..., 2] < 0, -camera.position[2] / rays[..., 2], np.inf)
            cells = ground.cells(camera.position[:2] + depth[..., None] * rays[..., :2])
        inside = (cells >= -0.5).all(axis=-1) & (cells <= ground.size - 0.5).all(axis=-1) & (depth >= camera.near)
        self.floor = np.where(inside, depth, np.inf).astype(np.float32)
        cells = np.where(inside[..., None], cells, 0.0).astype(np.float32)
        self.columns, self.rows = np.ascontiguousarray(cells[..., 0]), np.ascontiguousarray(cells[..., 1])


class _Bodies:
    """A client with some bodies of a scene, each one mesh a material."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._client = VisualClient()
        self._handles: dict[int, list[Handle]] = {}

    def close(self) -> None:
        self._client.close()

    def clear(self) -> None:
        self._client.reset()
        self._handles.clear()

    def add(self, body: int, boxes: Boxes, in_world: bool = False) -> None:
        """A body made of `boxes`, in its own frame unless `in_world`."""
        of = self._scene.bodies[body] if body >= 0 else None
        pose = frames.IDENTITY if in_world or of is None else of.pose
        for material in np.unique(boxes.material):
            paint = colour(of.kind if of else "", self._scene.materials[material])
            shown = self._client.show(boxes.take(boxes.material == material), of.name if of else "world", paint, pose)
            self._handles.setdefault(body, []).extend(shown)

    def add_meshes(self, body: int, meshes: Meshes) -> None:
        """Meshes of a body that never moves, in the world frame."""
        of = self._scene.bodies[body] if body >= 0 else None
        for material in np.unique(meshes.material):
            paint = colour(of.kind if of else "", self._scene.materials[material])
            shown = self._client.show_mesh(meshes.take(meshes.material == material), of.name if of else "world", paint)
            self._handles.setdefault(body, []).extend(shown)

    def place(self, body: int, pose: Array) -> None:
        for handle in self._handles.get(body, ()):
            self._client.place(handle, pose)

    def drawn(self, camera: Camera, window: Window | None = None) -> Layer:
        rgb, depth, number = self._client.picture(camera, window)
        whose = np.full(max((h.uid for hs in self._handles.values() for h in hs), default=-1) + 2, NOTHING, dtype=np.int32)
        for body, handles in self._handles.items():
            for handle in handles:
                whose[handle.uid] = body
        return Layer(rgb, depth, whose[number])  # the last entry, found by -1, is NOTHING


def covering(camera: Camera, boxes: Boxes) -> Window | None:
    """The part of the picture that some boxes in the world frame can be seen in; None where there is no such part."""
    if not len(boxes):
        return None
    pixels, depth = camera.project(corners(boxes))
    if (depth < camera.near).all():
        return None
    side = np.array([camera.width, camera.height])
    if (depth < camera.near).any():  # one of them passes the camera: it may cover anything
        return Window(0, 0, *side.tolist())
    low = np.clip(np.floor(pixels.min(axis=(0, 1))) - 1, 0, side - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=(0, 1))) + 2, 1, side).astype(int)
    # a sliver would make the engine's square tiles of work large: at least 8 px a side
    low = np.minimum(low, side - 8)
    return Window(*low.tolist(), *np.maximum(high - low, 8).tolist())


def stubs(boxes: Boxes) -> Boxes:
    """What is left of boxes in the world frame when all above STUB m is cut off. One that doesn't stand upright goes wholly or stays."""
    upright = np.abs(frames.matrix(boxes.quaternion)[..., 2, 2]) > 1 - 1e-9
    points = corners(boxes)[..., 2]
    low, high = points.min(axis=1), points.max(axis=1)
    short = np.minimum(high, STUB)
    stays = (low < STUB) & (upright | (high <= STUB))
    center, half = np.array(boxes.center), np.array(boxes.half)
    center[:, 2], half[:, 2] = np.where(upright, (low + short) / 2, center[:, 2]), np.where(upright, (short - low) / 2, half[:, 2])
    return boxes.with_(center=center, half=np.maximum(half, 0.0)).take(stays)


def mesh_stubs(meshes: Meshes) -> Meshes:
    """What is left of meshes in the world frame when all above STUB m is cut off: open on top, which nobody but a camera minds."""
    corners, low = meshes.corners(), meshes.vertices[meshes.triangles][..., 2].min(axis=1, initial=np.inf)
    kept, owner = [], []
    for triangle, m in zip(corners[low < STUB], meshes.mesh[low < STUB], strict=True):
        outline = []
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            if a[2] <= STUB:
                outline.append(a)
            if (a[2] - STUB) * (b[2] - STUB) < 0:
                outline.append(a + (b - a) * (STUB - a[2]) / (b[2] - a[2]))
        kept += [(outline[0], outline[i], outline[i + 1]) for i in range(1, len(outline) - 1)]
        owner += [m] * (len(outline) - 2)
    points = np.array(kept).reshape(-1, 3)
    return meshes.with_(vertices=points, triangles=np.arange(len(points)).reshape(-1, 3), mesh=np.array(owner, dtype=np.int64))


def edges(depth: Array, angle: float) -> Array:
    """(H, W) float32 in [0, 1]: how bright edges leave each pixel. `angle` is one pixel's, rad.

    Over any plane the inverse of the depth along the optical axis is linear in pixel coordinates, so its Laplacian is zero but at
    creases and steps.
    """
    inverse = (1.0 / depth).astype(np.float32)  # the background is 0
    bent = np.abs(cv2.Laplacian(inverse, cv2.CV_32F)) / (np.maximum(inverse, 1e-4) * np.float32(angle))
    bent[[0, -1]] = bent[:, [0, -1]] = 0.0  # beyond the rim nothing is known
    return 1.0 - np.clip(EDGE_GAIN * (bent - 0.15), 0.0, EDGE_DARKNESS).astype(np.float32)
