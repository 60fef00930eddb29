"""The scenario that `testbed init` writes: small, complete, and explained line by line."""

from __future__ import annotations

import re

from testbed.scenario.model import ID_PATTERN

_STARTER = """\
# yaml-language-server: $schema=./scenario.schema.json
# A scenario of the warehouse radio testbed. Run it:        testbed run {file}
# Check it without running:                                 testbed validate {file}
# What else can stand here, while you type:                 testbed schema > scenario.schema.json
#
# A name ends in its unit: speed_mps is in m/s. A text with a unit of its own is converted: "3 km/h".

name: {name}
title: A trolley crosses an open floor between four posts with antennas

seed: 1                       # the same seed gives the same results, bit for bit
trials: 8                     # independent repetitions, each with its own draws
duration_s: 12

# What stands where. `testbed plugins` lists the other worlds, and the other kinds of everything below.
world:
  kind: open_floor
  length_m: 8
  width_m: 6
  posts: 4                    # antenna posts in the corners: post1 to post4

# What moves.
actors:
  - id: t1
    kind: trolley
    motion: kinematic         # dynamic drives it by wheels and friction (needs pybullet); parked leaves it at position_m
    route:
      waypoints_m: [[1.5, 1.5], [6.0, 1.5], [6.0, 4.0]]
      speed_mps: 0.8
      speed_jitter: 0.1       # each trial drives a little faster or slower
    tags:
      - {{id: t1-top, mount: top}}
      # - {{id: t1-low, position_m: [0.3, 0.0, 0.9]}}    # in the trolley's own frame

# Tags on things that stand still. Hundreds are never typed: a table, or so many a group of mounts.
# tags:
#   - {{csv: tags.csv}}         # columns id, x_m, y_m, z_m and, if wanted, on, yaw_deg, model
#   - {{on: "rack*", per_group: 4, prefix: bay}}

# What hears it. Antennas on every post's mounts; `count` takes the first so many.
sensors:
  - id: portal
    kind: rfid
    antennas: [{{on: "post*", count: 8}}]
    power_dbm: 29

# What every estimator is told before it starts: the truth at t = 0 plus a draw with these deviations.
prior:
  position_std_m: 0.5
  velocity_std_mps: 0.25

# The methods to compare, all on the same data. An id is the kind, where it is left out.
estimators:
  - {{kind: ukf, sigma_db: 8}} # how far RSSI strays from free space, there and back
  - {{kind: ekf, sigma_db: 8}}
  - {{kind: centroid}}          # the baseline that anything must beat
  # - {{id: ukf-doubtful, kind: ukf, sigma_db: 12}}    # the same method twice, with other settings

# Figures of merit. Left out: all that are installed.
# metrics:
#   - {{kind: position_error, skip_s: 2}}
#   - {{kind: availability}}

# What must come out; `testbed run` exits with 1 if it doesn't.
expect:
  ukf:
    position_error_m: {{mean: {{max: 1.0}}}}
    availability: {{min: 0.9}}
  "centroid - ukf":           # paired, on the same data: holds where its 95 % confidence limit does
    position_error_m: {{mean: {{min: 0.0}}}}
  world:                      # the stimulus is asserted too: a test that grew easy is no test
    line_of_sight: {{min: 0.5, max: 0.95}}

# Every combination of these values is run as well. A path is a path of --set.
# sweep:
#   actors.t1.route.speed_mps: [0.4, 0.8, 1.6]
"""


def starter(name: str = "my-scenario") -> str:
    """The text of a scenario to begin with, under the name `name`; it is valid as it is. The file is taken to be `<name>.yaml`.

    ValueError for a name that no scenario can have.
    """
    if re.fullmatch(ID_PATTERN, name) is None:
        raise ValueError(f"{name!r} can't be a name: letters, digits, _ and - are, beginning with a letter")
    return _STARTER.format(name=name, file=f"{name}.yaml")
