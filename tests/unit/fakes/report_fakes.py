"""Runs to report on: small, without physics, and bent where a test wants something rare."""

import copy

import testbed
from testbed import archive, tables

QUICK = {
    "name": "quick",
    "title": "A trolley <b>passes</b> & goes",
    "seed": 3,
    "trials": 3,
    "duration_s": 4,
    "world": {"kind": "open_floor"},
    "actors": [
        {
            "id": "t1",
            "kind": "trolley",
            "motion": "kinematic",
            "route": {"waypoints_m": [[1, 1], [6, 1]]},
            "tags": [{"id": "lid", "mount": "top"}],
        }
    ],
    "sensors": [{"id": "posts", "kind": "rfid", "antennas": {"on": "post*"}}],
    "tags": [{"id": "still", "position_m": [4, 3, 1]}],
    "targets": ["lid"],
    "estimators": [{"kind": "ekf"}, {"kind": "ukf"}, {"kind": "centroid"}],
    "expect": {"ekf": {"position_error_m": {"mean": {"max": 5.0}}}, "ekf - ukf": {"position_error_m": {"mean": {"max": -9.0}}}},
}


def quick(out, changes=None, **options):
    """Run the quick scenario with some of its sections replaced (None removes one) into the folder `out`."""
    document = copy.deepcopy(QUICK) | (changes or {})
    testbed.run({k: v for k, v in document.items() if v is not None}, out=out, **options)
    return out


def place(folder, point=0, trial=0):
    return archive.place(folder, point, trial)


def rewrite(folder, estimator, change, point=0, trial=0):
    """Replace an estimator's track in a kept recording by what `change` makes of it."""
    tracks = archive.load_tracks(place(folder, point, trial))
    tables.write(change(tracks[estimator]), place(folder, point, trial) / "tracks" / f"{estimator}.parquet")
