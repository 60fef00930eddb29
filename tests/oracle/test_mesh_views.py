"""Scenes with meshes in a render, on the plan, in the physics engine and in a kept recording; the depth of each pixel against rays."""

from pathlib import Path

import numpy as np
import pytest

from testbed.api import scenario_of
from testbed.archive import load_scene, save
from testbed.protocols import ActorPlan
from testbed.radio.materials import losses
from testbed.report.cameras import CameraSpec
from testbed.report.placing import place
from testbed.report.plan import standing
from testbed.route import Route
from testbed.scene import Truth
from testbed.simulate import Simulator
from testbed.view import NOTHING, Camera
from worlds.actors.trolley import Trolley
from worlds.camera import STUB, mesh_stubs
from worlds.parts import floor_pose
from worlds.sdf import Sdf

FILES = Path(__file__).parents[1] / "files" / "worlds"
BARE = Truth(np.zeros(1), np.zeros((1, 0, 7)), ())


def hall(**config):
    return Sdf(Sdf.Config(path=str(FILES / "hall.sdf"), **config))


def test_a_render_is_as_deep_as_rays_are_long():
    """Every pixel's ray through the box caster's first crossing: the same body, at the same depth, but at outlines."""
    pytest.importorskip("pybullet")
    world = hall()
    scene = world.scene([])
    camera = Camera("c", np.array([1.0, 0.5, 2.2]), np.array([6.5, 4.0, 0.6]), np.radians(60), 160, 120)
    with world.renderer(scene) as renderer:
        image = renderer.render(camera, np.zeros((0, 7)), smooth=1)
    rays = camera.rays().reshape(-1, 3)
    caster = world.caster(scene, "boxes", *losses(scene.materials))
    start = np.tile(camera.position, (len(rays), 1))
    found = caster.crossings(start, start + 30 * rays, np.zeros((1, 0, 7)), np.zeros(len(rays), dtype=int))
    first = found.take(np.unique(found.segment, return_index=True)[1])
    depth, body = np.full(len(rays), np.inf), np.full(len(rays), NOTHING)
    depth[first.segment] = first.enter / np.linalg.norm(rays[first.segment], axis=1)
    body[first.segment] = scene.piece_body[first.box]
    floor = np.where(rays[:, 2] < 0, -camera.position[2] / rays[:, 2], np.inf)
    body[depth > floor] = NOTHING
    seen = image.body.ravel()
    assert (seen == body).mean() > 0.985
    both = (seen == body) & (body != NOTHING)
    assert both.sum() > 3000
    assert set(np.unique(body[both])) >= {1, 2, 3, 4}  # crates, bracket, tank, wall
    assert np.quantile(np.abs(image.depth.ravel()[both] - depth[both]), 0.99) < 0.02


def test_a_mesh_that_is_cut_off_leaves_a_stub():
    scene = hall().scene([])
    stubs = mesh_stubs(scene.static_meshes())
    assert stubs.vertices[:, 2].max() == pytest.approx(STUB)
    assert set(stubs.mesh) == {0, 2}  # the lidless one hangs at 1.2 m
    pytest.importorskip("pybullet")
    with hall().renderer(scene) as renderer:
        camera = Camera("c", np.array([1.0, 0.5, 2.2]), np.array([6.5, 4.0, 0.6]), np.radians(60), 160, 120)
        whole = renderer.render(camera, np.zeros((0, 7)), smooth=1)
        cut = renderer.render(camera, np.zeros((0, 7)), cut=[3], smooth=1)
    assert (whole.body == 3).sum() > 4 * (cut.body == 3).sum() > 0


def test_walls_in_one_piece_make_room_for_a_camera_outside():
    scene = hall(kinds={"tank": "wall"}).scene([])
    for position, cut in (((5.0, -8.0, 6.0), {3}), ((5.0, 4.0, 2.0), set())):
        spec = CameraSpec(id="c", position_m=position, look_at_m=(5.0, 5.0, 0.5))
        assert place(spec, scene, BARE, 0.0)[1] == cut


def test_the_plan_shows_what_can_t_be_walked_through():
    prints = {p.name: p for p in standing(hall().scene([]))}
    assert set(prints) == {"rack", "stack", "bracket", "tank", "north_wall"}
    assert len(prints["tank"].overhead) == 0
    assert len(prints["bracket"].solid) == 2 + 4  # the lidless box's floor at 1.2 m, and the angle's four triangles
    np.testing.assert_allclose([prints["tank"].outline.min(), prints["tank"].outline.max()], [4.6, 6.9], atol=0.01)


def test_a_trolley_is_stopped_by_a_mesh():
    pytest.importorskip("pybullet")
    world = hall(leave_out=["rack", "stack", "bracket", "north*"])
    route = Route(waypoints_m=[(2.5, 6.5), (8.0, 6.5)], speed_mps=1.0)
    plan = ActorPlan("t", "trolley", "dynamic", Trolley(Trolley.Config()), route, floor_pose(2.5, 6.5))
    scene = world.scene([plan])
    truth = world.move(scene, [plan], 6.0, 1, 0)
    free = Sdf(Sdf.Config(path=str(FILES / "hall.sdf"), leave_out=["rack", "stack", "bracket", "tank"]))
    empty = free.scene([plan])
    assert free.move(empty, [plan], 6.0, 1, 0).poses[-1, 0, 0] > 7.0
    assert truth.poses[:, 0, 0].max() < 4.7  # the tank begins at x = 4.6 m
    inside = ActorPlan("t", "trolley", "dynamic", plan.actor, Route(waypoints_m=[(4.6, 6.5), (8.0, 6.5)]), floor_pose(4.6, 6.5))
    with pytest.raises(ValueError, match=r"actor t starts .* m inside tank: move its first way point"):
        world.move(world.scene([inside]), [inside], 1.0, 1, 0)
    world.close()
    free.close()


def test_a_kept_recording_holds_the_meshes_and_a_tag_in_a_metal_one_is_refused(tmp_path):
    marker = {"id": "m", "kind": "marker", "motion": "parked", "position_m": [1, 4], "tags": [{"id": "t", "position_m": [0, 0, 1]}]}
    reader = {"id": "r", "kind": "rfid", "antennas": [{"position_m": [9, 6.5, 1], "aim_m": [1, 5, 1]}]}
    document = {"name": "x", "seed": 1, "trials": 1, "duration_s": 1, "world": {"kind": "sdf", "path": str(FILES / "hall.sdf")}}
    document |= {"actors": [marker], "sensors": [reader], "estimators": [{"kind": "centroid"}]}
    with Simulator(scenario_of(document)) as simulator:
        save(tmp_path / "kept", simulator.trial(0), {}, simulator.scene, simulator.tagged)
        assert load_scene(tmp_path / "kept")[0].meshes.equals(simulator.scene.meshes)
    inside = {**document, "tags": [{"id": "shut", "position_m": [5, 6.5, 0.6]}]}
    with pytest.raises(ValueError, match=r"the tag 'shut' is inside tank \(steel\)"), Simulator(scenario_of(inside)):
        pass
    reader["antennas"][0]["position_m"] = [5, 6.5, 0.6]
    with pytest.raises(ValueError, match=r"is inside tank \(steel\): put it outside"), Simulator(scenario_of(document)):
        pass
