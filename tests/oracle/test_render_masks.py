"""Renders of the demo hall against geometry: every body covers the pixels that the projection of its boxes' corners predicts.

The prediction is an independent one: the convex hull of a box's projected corners says which pixels it may cover, the slab method
along each pixel's ray how far away it is there, and the nearest box wins.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from testbed import frames
from testbed.protocols import Renders
from testbed.report import palette
from testbed.report.cameras import OVERVIEW, CameraSpec
from testbed.report.overlay import draw, visible
from testbed.report.placing import place
from testbed.report.sight import crossed
from testbed.report.traces import Trace
from testbed.scenario import load
from testbed.scene import Truth
from testbed.simulate import Simulator
from testbed.view import NOTHING, Camera

pytest.importorskip("pybullet", reason="renders need pybullet: pip install 'warehouse-radio-testbed[sim]'")

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
STUB = 0.12  # m: what is left of a wall that is cut off
POSES = {"t1": (7.6, 3.0, 0.3), "forklift": (7.0, 7.2, -1.5)}  # just through the gate, and coming
CHASE = CameraSpec(id="chase", position_m=(1.0, 0.8, 3.2), look_at_m=(7.5, 4.5, 0.6), field_of_view_deg=55)


class Hall:
    """The demo's scene, with its moving bodies in the midst of the trial, its renderer, and two cameras."""

    def __init__(self):
        with Simulator(load("dock-gate")) as simulator:
            self.scene, world = simulator.scene, simulator._world
        assert isinstance(world, Renders)
        self.renderer = world.renderer(self.scene)
        self.poses = np.array([[x, y, 0.0, *frames.from_euler(yaw)] for x, y, yaw in (POSES[n] for n in self.scene.moving_names)])
        self.truth = Truth(np.zeros(1), self.poses[None], self.scene.moving_names)
        self.placed = {s.id: place(s, self.scene, self.truth, 0.0) for s in (OVERVIEW, CHASE)}
        self.images = {name: self.renderer.render(camera, self.poses, cut, smooth=1) for name, (camera, cut) in self.placed.items()}

    def boxes(self, cut):
        """All boxes in the world frame, of bodies that are cut off only the stubs."""
        boxes, rest = self.scene.boxes, self.scene.rest_poses()
        rest[self.scene.moving] = self.poses
        pose = rest[boxes.body]
        center, half = frames.to_world(pose, boxes.center), boxes.half.copy()
        short = np.isin(boxes.body, list(cut))
        low, high = center[:, 2] - half[:, 2], np.minimum(center[:, 2] + half[:, 2], STUB)  # walls are upright
        center[short, 2], half[short, 2] = ((low + high) / 2)[short], ((high - low) / 2)[short]
        turned = frames.multiply(pose[:, 3:], boxes.quaternion)
        return boxes.with_(center=center, half=np.abs(half), quaternion=turned).take(~short | (high > low))


@pytest.fixture(scope="module")
def hall():
    made = Hall()
    yield made
    made.renderer.close()


def covered(camera, corners):
    """Pixels (n, 2) whose middles lie in the convex hull of the projection of some corners (8, 3).

    Of a box that passes the camera all pixels: its hull says nothing.
    """
    pixels, depth = camera.project(corners)
    if (depth < camera.near).any():
        return np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2)
    hull = cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(np.float64)
    low = np.clip(np.floor(hull.min(axis=0)), 0, [camera.width, camera.height]).astype(int)
    high = np.clip(np.ceil(hull.max(axis=0)) + 1, 0, [camera.width, camera.height]).astype(int)
    u, v = np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)))
    points, inside = np.stack([u.ravel(), v.ravel()], axis=1), np.ones(u.size, dtype=bool)
    sides = np.roll(hull, -1, axis=0) - hull
    turn = np.sign(sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True)))
    for corner, side in zip(hull, sides, strict=True):
        inside &= turn * (side[0] * (points[:, 1] - corner[1]) - side[1] * (points[:, 0] - corner[0])) >= 0
    return points[inside]


def predicted(camera, boxes, truthful=None):
    """(H, W) body and depth: by hulls and slabs. `truthful` is the camera whose rays tell the depth, where `camera` is a wrong one."""
    body, depth = np.full((camera.height, camera.width), NOTHING), np.full((camera.height, camera.width), np.inf)
    rays = (truthful or camera).rays()
    floor = np.where(rays[..., 2] < 0, -camera.position[2] / np.minimum(rays[..., 2], -1e-12), np.inf)
    for i in range(len(boxes)):
        corners = boxes.center[i] + frames.rotate(boxes.quaternion[i], CORNERS * boxes.half[i])
        pixels = covered(camera, corners)
        u, v = pixels.T
        back = frames.conjugate(boxes.quaternion[i])
        origin, along = frames.rotate(back, camera.position - boxes.center[i]), frames.rotate(back, rays[v, u])
        with np.errstate(divide="ignore"):
            enter, leave = ((sign * np.sign(along) * boxes.half[i] - origin) / along for sign in (-1, 1))
        found = enter.max(axis=1, initial=-np.inf)
        nearer = (found < depth[v, u]) & (found < floor[v, u]) & (found >= camera.near)
        if len(u) == camera.width * camera.height:
            nearer &= found < leave.min(axis=1)
        depth[v[nearer], u[nearer]], body[v[nearer], u[nearer]] = found[nearer], boxes.body[i]
    return body, depth


def overlap(a, b):
    """Pixels that both have, as a share of those that either has."""
    return (a & b).sum() / max(1, (a | b).sum())


@pytest.mark.parametrize("name", ["overview", "chase"])
def test_every_body_covers_the_pixels_that_its_corners_predict(hall, name):
    (camera, cut), image = hall.placed[name], hall.images[name]
    assert image.body.shape == (480, 640)
    body, depth = predicted(camera, hall.boxes(cut))
    kinds = set()
    for i, thing in enumerate(hall.scene.bodies):
        wanted, got = body == i, image.body == i
        if wanted.sum() > 40 or got.sum() > 40:
            assert overlap(wanted, got) > 0.98, f"{thing.name}: {overlap(wanted, got):.3f} of {wanted.sum()} px"
            kinds.add(thing.kind)
    assert kinds >= {"rack", "gate", "trolley", "forklift", "wall"}
    both = (body == image.body) & (body != NOTHING)
    apart = np.abs(image.depth[both] - depth[both]) / depth[both]
    assert np.median(apart) < 1e-4
    assert np.quantile(apart, 0.999) < 1e-2


def test_the_floor_is_where_the_pixels_rays_meet_it(hall):
    for name, (camera, _) in hall.placed.items():
        image = hall.images[name]
        points = camera.position + image.depth[..., None] * camera.rays()
        bare = (image.body == NOTHING) & np.isfinite(image.depth)
        assert bare.mean() > 0.15
        np.testing.assert_allclose(points[bare][:, 2], 0.0, atol=1e-4)
        assert (points[~bare & np.isfinite(image.depth)][:, 2] > -1e-3).all()


def test_moving_bodies_are_where_they_were_put(hall):
    camera, cut = hall.placed["overview"]
    index = [b.name for b in hall.scene.bodies].index("t1")
    far = hall.poses.copy()
    far[hall.scene.moving_names.index("t1"), :2] = 9.0, 6.2
    image = hall.renderer.render(camera, far, cut, smooth=1)
    for drawn, pose in ((hall.images["overview"], hall.poses), (image, far)):
        middle = np.argwhere(drawn.body == index).mean(axis=0)[::-1]
        wanted, _ = camera.project(pose[hall.scene.moving_names.index("t1"), :3] + [0.3, 0, 0.8])
        np.testing.assert_allclose(middle, wanted, atol=20)


class Turned(Camera):
    """Its view matrix transposed, as if column-major were row-major."""

    def view_matrix(self):
        matrix = super().view_matrix()
        matrix[:3, :3] = matrix[:3, :3].T
        return matrix


class Swapped(Camera):
    """Right and up exchanged."""

    def view_matrix(self):
        return super().view_matrix()[[1, 0, 2, 3]]


class Flipped(Camera):
    """Rows counted from the bottom."""

    def projection_matrix(self):
        return np.diag([1.0, -1.0, 1.0, 1.0]) @ super().projection_matrix()


class Wide(Camera):
    """The field of view taken for that of the width."""

    def projection_matrix(self):
        return np.diag([0.75, 0.75, 1.0, 1.0]) @ super().projection_matrix()


class Shifted(Camera):
    """Off by one pixel each way, as where corners of pixels are taken for their middles, and once more."""

    def projection_matrix(self):
        matrix = np.eye(4)
        matrix[0, 3], matrix[1, 3] = 2 / self.width, -2 / self.height
        return matrix @ super().projection_matrix()


@pytest.mark.parametrize("wrong", [Turned, Swapped, Flipped, Wide, Shifted])
def test_wrong_matrices_do_not_pass(hall, wrong):
    camera, cut = hall.placed["overview"]
    image = hall.images["overview"]
    mutant = wrong(**{f: getattr(camera, f) for f in ("name", "position", "target", "field_of_view", "width", "height", "near", "far")})
    boxes = hall.boxes(cut)
    for name in ("gate1", "gate2", "forklift"):
        index = [b.name for b in hall.scene.bodies].index(name)
        own = boxes.take(boxes.body == index)
        _, depth = mutant.project(own.center)
        covers = np.zeros(image.body.shape, dtype=bool)
        if (depth > 1.0).all():  # else it is behind such a camera, which sees nothing of it
            body, _ = predicted(mutant, own, truthful=camera)
            covers = body == index
        assert overlap(covers, image.body == index) < 0.9


def test_the_matrices_are_what_pybullet_would_compute():
    import pybullet

    camera = Camera("c", np.array([3.0, -7.0, 5.0]), np.array([1.0, 2.0, 0.5]), np.radians(40), 640, 480, 0.1, 100.0)
    view = pybullet.computeViewMatrix(camera.position.tolist(), camera.target.tolist(), [0, 0, 1])
    projection = pybullet.computeProjectionMatrixFOV(40, 640 / 480, 0.1, 100.0)
    np.testing.assert_allclose(np.reshape(view, (4, 4)).T, camera.view_matrix(), atol=1e-6)
    np.testing.assert_allclose(np.reshape(projection, (4, 4)).T, camera.projection_matrix(), rtol=1e-6, atol=1e-6)


def test_smoothing_changes_colours_only(hall):
    camera, cut = hall.placed["chase"]
    rough, fine = hall.images["chase"], hall.renderer.render(camera, hall.poses, cut, smooth=2)
    np.testing.assert_array_equal(rough.body, fine.body)
    np.testing.assert_array_equal(rough.depth, fine.depth)
    assert (rough.rgb != fine.rgb).any()
    assert np.abs(cv2.blur(rough.rgb, (15, 15)).astype(int) - cv2.blur(fine.rgb, (15, 15))).max() < 25


def test_a_picture_depends_on_nothing_that_was_drawn_before(hall):
    camera, cut = hall.placed["chase"]
    hall.renderer.render(hall.placed["overview"][0], hall.poses + np.eye(7)[0], {7}, smooth=1)
    again = hall.renderer.render(camera, hall.poses, cut, smooth=1)
    for field in ("rgb", "depth", "body"):
        np.testing.assert_array_equal(getattr(again, field), getattr(hall.images["chase"], field))


def test_a_body_that_passes_the_camera_is_drawn_without_errors(hall):
    camera, cut = hall.placed["chase"]
    poses = hall.poses.copy()
    poses[0, :2] = camera.position[:2] + 0.3
    close = replace(camera, position=np.array([*camera.position[:2], 1.0]), target=np.array([6.0, 3.0, 1.0]))
    image = hall.renderer.render(close, poses, cut, smooth=1)
    assert image.depth.min() >= close.near * 0.99
    assert (image.body == hall.scene.moving[0]).sum() > 1000


def test_poses_of_another_number_of_bodies_are_refused(hall):
    with pytest.raises(ValueError, match="poses of 2 moving bodies are wanted"):
        hall.renderer.render(hall.placed["chase"][0], hall.poses[:1])


# ---------------------------------------------------------------- tracks behind racks


def rack_in_view(hall):
    """A camera in the hall before rack1, and points on a line 0.8 m before and behind the rack, 1 m above the floor."""
    rack = next(i for i, b in enumerate(hall.scene.bodies) if b.name == "rack3")
    x, y = hall.scene.bodies[rack].pose[:2]
    spec = CameraSpec(id="c", position_m=(x, y - 4.0, 1.6), look_at_m=(x, y, 1.0), field_of_view_deg=60)
    camera, cut = place(spec, hall.scene, hall.truth, 0.0)
    away = hall.poses.copy()
    away[:, :2] = [[1.0, 10.0], [2.5, 10.5]]
    across = np.linspace(-1.6, 1.6, 81)
    line = np.column_stack([x + across, np.full(81, y), np.full(81, 0.7)])
    aside = np.array([0.0, 0.8, 0.0])
    return rack, hall.renderer.render(camera, away, cut, smooth=1), line + aside, line - aside


def test_a_track_behind_a_rack_is_drawn_as_hidden(hall):
    rack, image, behind, before = rack_in_view(hall)
    for points in (behind, before):
        pixels, depth = image.camera.project(points)
        u, v = np.round(pixels).astype(int).T
        surface = image.depth[v, u]
        clear = np.abs(depth - surface) > 0.1
        steady = cv2.dilate(image.depth, np.ones((3, 3))) - cv2.erode(image.depth, np.ones((3, 3))) < 0.2
        sure = clear & steady[v, u]  # not at the very rim of a post or a carton
        assert sure.sum() > 20
        np.testing.assert_array_equal(visible(image, points)[sure], (depth < surface)[sure])
    boxes = hall.boxes(())
    own = boxes.take(boxes.body == rack)
    covered_by_rack = crossed(np.tile(image.camera.position, (81, 1)), behind, own).any(axis=1)
    assert covered_by_rack.sum() > 30
    assert (visible(image, behind) & covered_by_rack).sum() <= 0.15 * covered_by_rack.sum()  # at the rims of posts and cartons
    assert visible(image, before).all()


def test_what_is_hidden_has_no_solid_line(hall):
    _, image, behind, before = rack_in_view(hall)
    t = np.linspace(0, 1, 81)
    solid = {}
    for name, points in (("behind", behind), ("before", before)):
        rgb = draw(image, [Trace("ukf", "t", palette.VERMILLION, t, points)], legend=False)
        u, v = np.round(image.camera.project(points)[0]).astype(int).T
        solid[name] = np.abs(rgb[v, u].astype(int) - palette.rgb(palette.VERMILLION)).max(axis=1) < 20
    assert solid["before"].mean() > 0.95
    hidden = ~visible(image, behind)
    assert not solid["behind"][hidden & np.roll(hidden, 1) & np.roll(hidden, -1)].any()
