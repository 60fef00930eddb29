"""Reads as fixes on roads: at standing antennas, of surveyed tags by a reader that rides along, and what a reader alone makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from road_recordings import W3, nowhere

from estimators.mapmatch_grid import MapmatchGrid
from estimators.mapmatch_landmarks import MapmatchLandmarks
from estimators.mapmatch_particles import MapmatchParticles
from estimators.mapmatch_particles_bias import MapmatchParticlesBias
from estimators.roads_fixes import AHEAD, Fixes, FixesConfig
from testbed.rng import RowRandom
from testbed.types import Antennas, Event, Reads, References, Site, Status, Tags

# antenna 0 stands at (20.5, 1.3) and looks south across the road to (26, 0); antenna 1 rides on the forklift. Tags 1 and 2 are surveyed
SITE = Site(
    antennas=Antennas(
        id=np.array(["gate", "own"]), position=np.array([[20.5, 1.3, 1.0], [0.4, 0.0, 2.0]]),
        quaternion=np.array([[np.sqrt(0.5), 0, 0, -np.sqrt(0.5)], [1.0, 0, 0, 0]]), gain=np.full(2, 6.0), beamwidth=np.full(2, 1.2),
        front_to_back=np.full(2, 18.0), power=np.full(2, 24.0), carrier=np.array(["", "f"]),
    ),
    tags=Tags(id=np.array(["load", "shelf1", "shelf2"])),
    frequencies=np.array([866e6]),
    references=References(np.array([1, 2]), np.array([[10.0, 2.2, 1.0], [30.0, 2.2, 1.0]])),
    roads=W3,
)  # fmt: skip
METHODS = (MapmatchGrid, MapmatchParticles, MapmatchParticlesBias)


def read(kind, t, antenna, tag):
    return Event(kind, np.array([0]), Reads(np.array([t]), np.array([t]), np.array([antenna]), np.array([tag])))


def fixes(**config):
    made = Fixes(FixesConfig(**config), SITE)
    made.start(1)
    return made


def test_a_read_at_a_standing_antenna_is_a_fix_in_the_middle_of_its_beam():
    used, place, ahead = fixes(fix_std_m=2.0, fix_ahead_m=3.0).taken(read("reads", 1.0, 0, 0))
    assert used[0]
    assert ahead == 0.0
    np.testing.assert_allclose(place[0], [20.5, 1.3 - AHEAD])


def test_a_read_of_a_surveyed_tag_by_an_own_antenna_is_a_fix_ahead():
    used, place, ahead = fixes(fix_std_m=2.0, fix_ahead_m=3.0).taken(read("reference_reads", 1.0, 1, 2))
    assert used[0]
    assert ahead == 3.0
    np.testing.assert_allclose(place[0], [30.0, 2.2])


def test_what_tells_nothing_of_the_vehicle_s_place_is_refused():
    made = fixes(fix_std_m=2.0)
    assert not made.taken(read("reads", 1.0, 1, 0))[0][0]  # its own tag, read by its own antenna
    assert not made.taken(read("reference_reads", 1.0, 0, 1))[0][0]  # a shelf's tag, read by a gate
    assert not fixes().taken(read("reads", 1.0, 0, 0))[0][0]  # fixes were not asked for


def test_reads_that_repeat_each_other_count_once():
    made = fixes(fix_std_m=2.0, fix_every_s=0.5)
    said = [made.taken(read("reads", t, 0, 0))[0][0] for t in (1.0, 1.2, 1.49, 1.5, 1.9, 2.1)]
    assert said == [True, False, False, True, False, True]
    assert made.taken(read("reference_reads", 1.1, 1, 1))[0][0]  # another source


@pytest.mark.parametrize("method", METHODS)
def test_a_fix_ends_the_seeking_of_a_place(method):
    one = method(method.Config(fix_std_m=1.5, fix_floor=1e-4), SITE, RowRandom(np.arange(1)))
    one.start(nowhere())
    before = np.hypot(*(one.estimate().mean[0] - [20.5, 0.0]))
    one.predict(np.array([0.5]))
    assert one.update(read("reads", 0.5, 0, 0)).used[0]
    estimate = one.estimate()
    assert np.hypot(*(estimate.mean[0] - [20.5, 0.0])) < min(before, 1.0)
    assert estimate.extras["near_share"][0] > 0.8


def test_a_tag_ahead_puts_the_vehicle_behind_it_in_either_direction():
    one = MapmatchGrid(MapmatchGrid.Config(fix_std_m=0.8, fix_floor=0.0, fix_ahead_m=4.0), SITE, RowRandom(np.arange(1)))
    one.start(nowhere())
    one.update(read("reference_reads", 0.5, 1, 2))
    whole = one.mass[0].sum(axis=0)
    east = np.isclose(one.graph.direction[one.cells.edge], 0.0) & (one.cells.y == 0)
    west = np.isclose(np.abs(one.graph.direction[one.cells.edge]), np.pi) & (one.cells.y == 0)
    assert (whole * one.cells.x)[east].sum() / whole[east].sum() == pytest.approx(26.2, abs=0.5)
    assert (whole * one.cells.x)[west].sum() / whole[west].sum() == pytest.approx(33.5, abs=0.7)  # 34, where the road ends


# ---------------------------------------------------------------- a reader alone


def landmarks(**config):
    one = MapmatchLandmarks(MapmatchLandmarks.Config(**config), SITE, RowRandom(np.arange(1)))
    one.start(nowhere())
    return one


def test_a_reader_alone_is_at_the_mean_of_what_it_hears_on_the_nearest_road():
    one = landmarks()
    assert one.estimate().status[0] == Status.LOST
    for tag in (1, 2, 1):  # a tag that is read twice counts once
        one.update(read("reference_reads", 0.5, 1, tag))
    one.predict(np.array([0.5]))
    np.testing.assert_allclose(one.estimate().mean[0], [20.0, 0.0], atol=1e-9)
    one.update(read("reference_reads", 3.0, 1, 2))
    one.predict(np.array([3.0]))
    np.testing.assert_allclose(one.estimate().mean[0], [30.0, 0.0], atol=1e-9)
    one.predict(np.array([14.0]))
    assert one.estimate().status[0] == Status.LOST


def test_a_reader_alone_wants_roads_and_tags():
    for missing, message in (({"roads": None}, "no roads"), ({"references": References.empty()}, "no reference tags")):
        with pytest.raises(ValueError, match=message):
            MapmatchLandmarks(MapmatchLandmarks.Config(), replace(SITE, **missing), RowRandom(np.arange(1)))
