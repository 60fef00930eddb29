"""What the published detection model made of one antenna, one tag and one slot of time: its count, and the dead zones over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.protocols import Surroundings
from testbed.radio import logistic_beta
from testbed.sensors.counting import CountingConfig, Model, Shade, blocks_of, but_for_dead_zones
from testbed.sensors.rfid import Rfid


@dataclass(frozen=True)
class Block:
    """A block of queries of `detection: logistic_beta`.

    probability : mean of the model at that distance and angle; alive : of the queries those answered, dead zones aside
    geometry    : share g that geometry closes; residual : r; dead : whether the count is nought for one of them
    count       : how often the tag was read
    """

    start_s: float
    end_s: float
    queries: int
    distance_m: float
    angle_deg: float
    probability: float
    alive: int
    geometry: float
    residual: float
    dead: bool

    @property
    def count(self) -> int:
        """Reads in the block."""
        return 0 if self.dead else self.alive

    @property
    def dead_probability(self) -> float:
        """1 - (1 - g)(1 - r)."""
        return 1 - (1 - self.geometry) * (1 - self.residual)


def block_of(sensor: Rfid, around: Surroundings, antenna: int, tag: int, t: float) -> Block | None:
    """The block of the slot that t s falls into; None after the trial's last whole slot. ValueError for a sensor without such counts."""
    config = sensor.config.detection
    if not isinstance(config, CountingConfig):
        raise ValueError(f"{sensor.id} counts what its link carries: there are no blocks of the published model")
    blocks = blocks_of(config, sensor.id, sensor.antennas(), around)
    slot = int(t / config.period_s)
    place = np.flatnonzero((blocks.antenna == antenna) & (blocks.slot == slot))
    if not len(place):
        return None
    which, end = np.array([tag]), blocks.end[place]
    model = Model(config, sensor.id, sensor.antennas(), sensor.ends, around)
    g = np.zeros(1)
    shade = Shade(around, sensor.antennas(), sensor.ends, sensor.frequencies()) if config.geometry else None
    if shade is not None and config.geometry == "averaged":
        g[:] = but_for_dead_zones(config, sensor.id, sensor.antennas(), sensor.ends, around, shade, blocks)[3][:1].sum()
    elif shade is not None:
        g = shade.of(around, blocks.antenna[place], which, end)
    alive, distance, angle = model.alive(blocks, place, which)
    dead, residual = model.dead(blocks, place, which, g)
    return Block(
        start_s=slot * config.period_s,
        end_s=float(end[0]),
        queries=config.queries,
        distance_m=float(distance[0]),
        angle_deg=float(np.rad2deg(angle[0])),
        probability=float(logistic_beta.mean(distance, angle)[0]),
        alive=int(alive[0]),
        geometry=float(g[0]),
        residual=float(residual[0]),
        dead=bool(dead[0]),
    )
