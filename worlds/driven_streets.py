"""A real vehicle's odometer on a street network about the way it drove: nothing is simulated but the map.

    world: {kind: driven_streets, odometer: ../odom.txt, truth: ../truth.txt, network: 0, protocol: ...}

The network is the true path thinned, with its nodes moved, and wrong streets at every corner (`worlds.street_network`), drawn by the
number `network`. The heading is the yaw rate integrated from the course over the first `course_m` of the true path.
Left out: other streets than those at corners, one-way streets, and everything that a camera or GPS would add.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as Place
from typing import Annotated

import numpy as np
from pydantic import Field

from testbed import frames, quantity
from testbed.columns import Array
from testbed.geometry import Boxes, Mounts, Roads, Zones
from testbed.logs.bad import LogError
from testbed.logs.library import located
from testbed.protocols import ActorPlan, Tagged
from testbed.quantity import Hertz, Metres
from testbed.recording import Recording, Trial
from testbed.roads import nearest_segment
from testbed.scene import Body, Scene, Truth
from testbed.tagging import Aims
from testbed.types import Antennas, Site, Tags, Targets
from testbed.vehicle_log import VehicleLog, read_vehicle_log
from worlds.hall import BaseHall
from worlds.parts import MATERIALS, Part
from worlds.street_network import street_network

MARGIN_M = 10.0
TALL_M = 5.0
NAME = "vehicle"
Path = Annotated[str, Field(min_length=1, max_length=500)]


class DrivenStreetsConfig(quantity.Config):
    """The two files of a vehicle's log (`testbed.vehicle_log`), and how the network about its way is drawn.

    protocol : what may be known of what, in words; it is printed in the report
    network  : a number: each is another network. thinned_m, moved_m: how far the true path's corners stray from it
    branches : wrong streets at every corner. course_m: of the true path, from whose start and direction the heading begins
    truth_hz : of the true path as it is kept
    """

    odometer: Path
    truth: Path
    protocol: Annotated[str, Field(min_length=10, max_length=2000)]
    network: Annotated[int, Field(ge=0, le=2**32 - 1)] = 0
    thinned_m: Annotated[Metres, Field(gt=0, le=100)] = 3.0
    moved_m: Annotated[Metres, Field(ge=0, le=100)] = 1.5
    branches: Annotated[int, Field(ge=0, le=2)] = 2
    course_m: Annotated[Metres, Field(gt=0, le=1000)] = 15.0
    truth_hz: Annotated[Hertz, Field(gt=0, le=100)] = 10.0


class DrivenStreets(BaseHall):
    """Plays one log in every trial (`testbed.protocols.PlaysBack`): trials differ by the draws of priors and estimators alone."""

    Config = DrivenStreetsConfig
    config: DrivenStreetsConfig

    def __init__(self, config: DrivenStreetsConfig) -> None:
        super().__init__(config)
        self._log: VehicleLog | None = None

    def _read(self) -> VehicleLog:
        """The log, read once. LogError where it can't be, LogMissing where it is not there."""
        if self._log is None:
            odometer, truth = self.files()
            try:
                self._log = read_vehicle_log(odometer, truth)
                self._heading = self._log.heading(*reversed(self._log.course(self.config.course_m)))
            except (ValueError, OSError) as error:
                raise LogError(str(error)) from None
            c = self.config
            self._roads, self._wrong = street_network(self._log.truth, c.network, c.thinned_m, c.moved_m, c.branches)
        return self._log

    def files(self) -> list[Place]:
        """The odometer and the truth. LogMissing where one is not there."""
        return [located(self.config.odometer), located(self.config.truth)]

    def parts(self) -> list[Part]:
        """None: a street has nothing that a reader could look past."""
        return []

    def roads(self) -> Roads:
        """The network about the way that was driven."""
        self._read()
        return self._roads

    def bounds(self) -> Array:
        """What holds the network."""
        nodes = self.roads().nodes
        return np.array([[*(nodes.min(axis=0) - MARGIN_M), 0.0], [*(nodes.max(axis=0) + MARGIN_M), TALL_M]])

    def scene(self, actors: Sequence[ActorPlan]) -> Scene:
        """The streets, and the vehicle as a body without extent."""
        self._read()
        vehicle = Body(NAME, "target", frames.IDENTITY, True)
        return Scene((vehicle,), Boxes.empty(), MATERIALS, self.bounds(), Mounts.empty(), Zones.empty(), self._roads)

    def tagged(self) -> tuple[Tagged, Aims]:
        """No tag; the vehicle is what is to be located."""
        nobody = (np.empty(0, dtype=np.int64),)
        aims = Aims(Targets(np.array([NAME]), np.array([NAME])), nobody, np.zeros(1, dtype=np.int64), frames.IDENTITY[None])
        return Tagged(Tags.empty(), np.empty(0, dtype=np.int64), np.empty((0, 7))), aims

    def played(self, trial: int) -> Trial:
        """The log, with the roads in its site, and how many of them are wrong among what the world offered."""
        log = self._read()
        site = Site(Antennas.empty(), Tags.empty(), np.empty(0), roads=self._roads)
        _, aims = self.tagged()
        recording = Recording(trial, float(log.t[-1]), site, {**log.streams(self._heading)}, aims.targets, aims.tags)
        t = np.arange(int(np.ceil(recording.duration * self.config.truth_hz - 1e-9)) + 1) / self.config.truth_hz
        poses = np.zeros((len(t), 1, 7))
        poses[:, 0, :2], poses[..., 3] = log.position(t), 1.0
        truth = Truth(t, poses, (NAME,), segment=nearest_segment(self._roads, poses[..., :2]))
        return Trial(recording, truth, aims.body, aims.pose, {"wrong_streets": float(self._wrong)})
