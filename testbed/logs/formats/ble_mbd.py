"""RSSI of Bluetooth beacons with the beacon's true pose in each row: time, sensor, beacon, RSSI, x, y, z and nine numbers of a rotation.

The files of the Position-Annotated BLE RSSI Dataset (tetam). The sensor is the antenna; its name is a port of the site.
"""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.logs.blocks import blocks
from testbed.logs.cells import parse
from testbed.logs.contents import Contents, Job, finished
from testbed.logs.layout import Layout
from testbed.logs.samples import FAR_M, path_of
from testbed.logs.units import Clock, numbers

NAMES = ["time", "sensor", "beacon", "rssi", "x", "y", "z", *(f"r{i}{j}" for i in range(3) for j in range(3))]
LAYOUT = Layout(names={}, time_unit="s")
COLUMNS = {"time": "time", "antenna": "sensor", "tag": "beacon", "rssi": "rssi"}


class BleMbd:
    """Time in s, RSSI in dBm, places in m. The true path is that of the only beacon."""

    says = "Position-Annotated BLE RSSI Dataset (.mbd): time (s), sensor, beacon, RSSI (dBm), x, y, z (m), rotation; the truth is in it"

    def read(self, job: Job) -> Contents:
        layout = LAYOUT.declared(job.site.log)
        taker = job.taker(layout)
        times: list[Array] = []
        places: list[Array] = []
        for block in blocks(job.path, job.progress):
            cells = parse(block, NAMES, NAMES[:7], ",", job.bad)
            if not len(cells):
                continue
            taker.take(cells, COLUMNS, layout)
            times.append(Clock(taker.clock.unit, taker.clock.start).seconds(cells.columns["time"]))
            places.append(np.stack([numbers(cells.columns[axis])[0] for axis in "xyz"], axis=1))
        contents = finished(job, taker, layout)
        if not contents.tags:
            return contents
        t, position = np.concatenate(times), np.concatenate(places)
        sound = np.isfinite(t) & np.isfinite(position).all(axis=1) & (np.abs(np.nan_to_num(position)) < FAR_M).all(axis=1)
        sound &= (t >= 0) & (t <= float(contents.streams["reads"].t.max(initial=0.0)))  # pyright: ignore[reportAttributeAccessIssue]
        truth = {contents.tags[0]: path_of(t[sound], position[sound])} if len(contents.tags) == 1 and sound.any() else {}
        return Contents(contents.streams, contents.tags, contents.start_s, contents.notes, truth, layout)
