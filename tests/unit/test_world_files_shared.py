"""Worlds that others made and that lie beside the project: what each becomes, counted, and what rays see of it. Skipped without them."""

from pathlib import Path

import numpy as np
import pytest

from testbed.radio.materials import losses
from testbed.roads import RoadGraph
from worlds.building_map import BuildingMap
from worlds.importers.files import WorldFileError
from worlds.importers.mesh_files import load_mesh
from worlds.importers.solids import solids, volume
from worlds.occupancy import Occupancy
from worlds.sdf import Sdf

SHARED = Path(__file__).parents[3] / "shared" / "worlds"
AWS, RMF = SHARED / "aws_small_warehouse", SHARED / "open_rmf"
pytestmark = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/worlds is not on this machine")
NOBODY = np.zeros((1, 0, 7))


def warehouse(name="no_roof_small_warehouse", **config):
    return Sdf(Sdf.Config(path=str(AWS / "worlds" / f"{name}.world"), drop_prefix="aws_robomaker_warehouse_", **config))


def desk():
    return Sdf(Sdf.Config(path=str(AWS / "models/aws_robomaker_warehouse_DeskC_01/model.sdf")))


def test_the_warehouse_s_counts():
    """25 models stand in it: four more of the file's 29 includes are commented out, the roof and three desks."""
    hall = warehouse()
    scene = hall.scene([])
    assert len(scene.bodies) == 25
    assert len(scene.boxes) == 38
    assert (len(scene.meshes), int(scene.meshes.closed.sum()), len(scene.meshes.triangles)) == (13, 10, 1144)
    np.testing.assert_allclose(scene.bounds, [[-6.990, -10.453, 0], [6.990, 10.453, 10.018]], atol=1e-3)
    assert hall.notes() == [
        "25 bodies: 38 boxes, and 10 solid meshes of 824 triangles",
        "3 meshes are not watertight, with entry loss alone: PalletJackB_01_001 (3)",
    ]
    roofed = warehouse("small_warehouse").scene([])
    assert (len(roofed.bodies), len(roofed.boxes)) == (26, 39)
    names = {b.name for b in roofed.bodies} - {b.name for b in scene.bodies}
    assert names == {"RoofB_01_001"}


def test_the_warehouse_s_map_s_counts():
    """The map is drawn in another frame than the world, so it is counted alone; it names an image that is not there."""
    place = str(AWS / "maps/005/map.yaml")
    with pytest.raises(WorldFileError, match=r"there is no 'map_rotated\.png' beside it"):
        Occupancy(Occupancy.Config(path=place)).scene([])
    scene = Occupancy(Occupancy.Config(path=place, image="map.pgm")).scene([])
    assert len(scene.boxes) == 412
    assert 4 * scene.boxes.half[:, :2].prod(axis=1).sum() == pytest.approx(4059 * 0.05**2)
    np.testing.assert_allclose(scene.bounds, [[-7, -10.5, 0], [25, 8.7, 3]])


def test_the_desk_is_a_fifth_full_and_rays_pass_through_the_rest():
    points, faces = load_mesh(AWS / "models/aws_robomaker_warehouse_DeskC_01/meshes/aws_robomaker_warehouse_DeskC_01_collision.DAE")
    size = np.ptp(points, axis=0)
    np.testing.assert_allclose(size, [0.882, 1.555, 1.440], atol=1e-3)  # centimetres in the file
    found = solids(points, faces)
    parts = 8 * found.boxes.half.prod(axis=1).sum() + volume(found.meshes.vertices, found.meshes.triangles)
    assert parts / size.prod() == pytest.approx(0.21, abs=0.005)
    world = desk()
    scene = world.scene([])
    caster = world.caster(scene, "boxes", *losses(scene.materials))
    rng = np.random.default_rng(2)
    low, high = points.min(axis=0), points.max(axis=0)
    start = np.stack([np.full(4000, low[0] - 1), *rng.uniform(low[1:], high[1:], (4000, 2)).T], axis=1)
    end = start + np.array([size[0] + 2, 0, 0])
    found_by = caster.static(start, end)
    free = (found_by.count == 0).mean()
    assert 0.2 < free < 0.8  # of its hull, no ray would pass
    inside = np.bincount(caster.crossings(start, end, NOBODY, np.zeros(4000, dtype=int)).segment, minlength=4000)
    np.testing.assert_array_equal(inside, found_by.count)


def test_lengths_inside_the_desk_add_up_to_its_volume():
    """Cavalieri: parallel rays over its front see as much of it as there is."""
    world = desk()
    scene = world.scene([])
    caster = world.caster(scene, "boxes", *losses(scene.materials))
    points = np.concatenate([scene.meshes.vertices, scene.boxes.center + scene.boxes.half, scene.boxes.center - scene.boxes.half])
    low, high = points.min(axis=0), points.max(axis=0)
    n = 160
    y, z = (low[i] + (np.arange(n) + 0.5) / n * (high[i] - low[i]) for i in (1, 2))
    start = np.stack([np.full(n * n, low[0] - 1), *(v.ravel() for v in np.meshgrid(y, z))], axis=1)
    found = caster.crossings(start, start + np.array([5.0, 0, 0]), NOBODY, np.zeros(n * n, dtype=int))
    seen = found.length.sum() * (high[1] - low[1]) * (high[2] - low[2]) / n**2
    true = 8 * scene.boxes.half.prod(axis=1).sum() + volume(scene.meshes.vertices, scene.meshes.triangles)
    assert seen == pytest.approx(true, rel=0.02)


def test_the_office_s_counts():
    office = BuildingMap(BuildingMap.Config(path=str(RMF / "office.building.yaml")))
    scene = office.scene([])
    level = office.level
    assert (len(level.walls), len(level.doors), len(level.items)) == (33, 3, 79)
    assert level.door_names == ("main_door", "coe_door", "hardware_door")
    assert level.scale == pytest.approx(0.0084655, abs=1e-7)
    assert np.hypot(*(level.walls[:, 1] - level.walls[:, 0]).T).sum() == pytest.approx(92.60, abs=0.01)
    assert scene.roads is not None
    graph = RoadGraph(scene.roads)
    assert (len(scene.roads.segments), len(scene.roads.nodes)) == (30, 29)
    assert graph.length[:30].sum() == pytest.approx(68.58, abs=0.01)
    assert not scene.roads.one_way.any()
    assert len(scene.bodies) == 33
    assert office.notes()[0] == "33 walls of 92.6 m at 8.465 mm a pixel, 3 doors open"


def test_the_pod_is_boxes_as_its_collision_shape_says():
    pod = Sdf(Sdf.Config(path=str(SHARED / "pybullet_data_kiva_shelf/model.sdf"))).scene([])
    assert [b.name for b in pod.bodies] == ["Amazon_Pod"]
    assert (len(pod.boxes), len(pod.meshes)) == (21, 0)
    points, faces = load_mesh(SHARED / "pybullet_data_kiva_shelf/meshes/pod_lowres.stl")  # what is seen of it, y up
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.879, 2.367, 0.884], atol=2e-3)
    assert len(faces) == 10_184
    assert solids(points, faces).meshes.closed.tolist() == [True]
