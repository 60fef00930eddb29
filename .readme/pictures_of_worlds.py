"""Makes the README's pictures of worlds that others made: `python .readme/pictures_of_worlds.py`.

Needs the files in ../shared/worlds, and PyBullet.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from testbed.api import scenario_of
from testbed.report.cameras import CameraSpec
from testbed.report.placing import place
from testbed.scene import Truth
from testbed.simulate import Simulator

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
SHARED = ROOT.parent / "shared" / "worlds"
SIZE = (720, 480)  # px
MARKER = {"id": "m", "kind": "marker", "motion": "parked", "position_m": [3.0, 2.0], "tags": [{"id": "t", "position_m": [0, 0, 1]}]}


def around(world: dict, azimuth: float) -> dict:
    """A scenario that is only looked at."""
    camera = {"id": "c", "azimuth_deg": azimuth, "elevation_deg": 42, "cut": []}
    parts = {"actors": [MARKER], "sensors": [], "estimators": [{"kind": "centroid"}], "cameras": [camera]}
    return {"name": "shown", "seed": 1, "trials": 1, "duration_s": 1, "world": world, **parts}


PICTURES = {
    "world-sdf": ROOT / "scenarios/real/aws-warehouse.yaml",
    "world-building-map": ROOT / "scenarios/real/office.yaml",
    "world-occupancy": around(
        {"kind": "occupancy", "path": str(SHARED / "aws_small_warehouse/maps/005/map.yaml"), "image": "map.pgm", "height_m": 1.0}, -60
    ),
    "world-grid": around({"kind": "grid", "path": str(ROOT / "tests/files/worlds/arena.map"), "height_m": 1.0}, -60),
}


def main() -> None:
    """Writes them all as WebP."""
    for name, given in PICTURES.items():
        with Simulator(scenario_of(given)) as simulator:
            scene = simulator.scene
            poses = simulator.moved(0, duration=1.0).truth.poses[0]
            spec: CameraSpec = simulator.scenario.cameras[0]
            camera, cut = place(spec, scene, Truth(np.zeros(1), poses[None], scene.moving_names), 0.0, SIZE)
            with simulator._world.renderer(scene) as renderer:  # pyright: ignore[reportAttributeAccessIssue]  halls can all show themselves
                image = renderer.render(camera, poses, cut)
        cv2.imwrite(str(HERE / f"{name}.webp"), image.rgb[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 82])


if __name__ == "__main__":
    main()
