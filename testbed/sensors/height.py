"""How high a body is over the floor: of what stands on wheels that is known, of other things measured (a beam to the ceiling).

Left out: drift; the error is new at each sample.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from testbed.protocols import Sensed, Surroundings
from testbed.quantity import Metres
from testbed.rng import Counter
from testbed.sensors.carrier import Carried, CarriedConfig
from testbed.types import Heights


class HeightConfig(CarriedConfig):
    """height = z of the body's origin + noise."""

    noise_std_m: Annotated[Metres, Field(ge=0, le=100)] = 0.05


class Height(Carried):
    """Samples the height of one body at a fixed rate."""

    Config: ClassVar[type[HeightConfig]] = HeightConfig
    produces: ClassVar[frozenset[str]] = frozenset({"heights"})

    def sense(self, around: Surroundings, first_antenna: int) -> Sensed:
        """The whole trial's samples."""
        body, t, columns = self.samples(around)
        noise = Counter(around.root, around.trial, f"{self._name}.noise").normal(np.arange(len(t)))
        height = around.truth.pose(body, t)[:, 2] + self._config.noise_std_m * noise
        return Sensed({"heights": Heights(**columns, height=height)})
