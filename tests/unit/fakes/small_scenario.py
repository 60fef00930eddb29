"""A scenario of two trials that runs in a blink, as the text of a file, for tests that need real figures."""

SMALL = """\
name: small
seed: 3
trials: 2
duration_s: 2
world: {kind: open_floor}
actors:
  - id: anna
    kind: person
    motion: kinematic
    route: {waypoints_m: [[1, 1], [6, 1]], speed_mps: 1.0}
    tags: [{id: badge, mount: chest}]
sensors:
  - {id: posts, kind: rfid, antennas: {on: "post*"}}
metrics: [{kind: position_error}, {kind: availability}]
estimators:
  - {kind: centroid}
  - {id: slow, kind: centroid}
"""

EXPECT = """\
expect:
  centroid:
    position_error_m:
      mean: {max: 9}
      p95: {max: 0.01}
    availability: {min: 0.5}
  world: {line_of_sight: {min: 0}}
"""
