"""The map-matching filters as estimators: their bad input, the order of events, and when they say that they seek."""

import numpy as np
import pytest
from road_recordings import W3, by_hand, heard, made, nowhere, site, step, tracked, trials

from estimators.mapmatch_grid import MapmatchGrid
from estimators.mapmatch_particles import MapmatchParticles
from estimators.mapmatch_particles_bias import MapmatchParticlesBias
from testbed.estimate import run
from testbed.geometry import Roads
from testbed.rng import RowRandom
from testbed.types import Status

METHODS = (MapmatchParticles, MapmatchGrid, MapmatchParticlesBias)


@pytest.mark.parametrize("method", METHODS)
def test_bad_input_is_refused_with_its_place(method):
    with pytest.raises(ValueError, match=f"{method.__name__}: the site has no roads"):
        method(method.Config(), site(None), RowRandom(np.arange(1)))
    with pytest.raises(ValueError, match=r"no way leads from node 0 at \(0, 0\) to node 2"):
        made(method, roads=Roads(np.array([[0, 0], [1, 0], [5, 5], [6, 5]]), np.array([[0, 1], [2, 3]])))
    one = made(method)
    with pytest.raises(ValueError, match=r"heading of row 0 at t = 0.3 s is 93.2: radians .* degrees"):
        one.update(heard("heading", 0.3, 93.2))
    with pytest.raises(ValueError, match=r"row 0: the prior's place \(20, 60\) is off the network, 35.0 m"):
        made(method, prior=nowhere(x=20, y=60), start="prior")


@pytest.mark.parametrize("method", METHODS)
def test_nothing_counts_before_the_first_move_or_without_a_number(method):
    one = made(method)
    assert not one.update(heard("heading", 0.0, 0.0)).used[0]
    assert not one.update(heard("odometry", 0.0, 2.0)).used[0]
    assert not one.update(heard("odometry", 0.2, np.nan)).used[0]
    assert not one.update(heard("heading", 0.2, np.nan)).used[0]
    assert one.update(heard("odometry", 0.2, 2.0)).used[0]


@pytest.mark.parametrize("method", METHODS)
def test_compass_and_odometer_make_one_step_whichever_comes_first(method):
    tracks = []
    for kinds in (("heading", "odometry"), ("odometry", "heading")):
        one = made(method)
        for k in range(1, 20):
            one.predict(np.array([k / 10]))
            for kind in kinds:
                one.update(heard(kind, k / 10, 0.2 if kind == "heading" else 2.0))
        tracks.append(one.estimate().mean)
    if method is MapmatchGrid:  # without draws both are the same to rounding
        np.testing.assert_allclose(tracks[0], tracks[1], atol=1e-9)
    else:
        assert np.isfinite(tracks).all()


def test_the_heading_counts_after_the_move():
    # a particle at the end of an eastward edge is carried round the corner, and weighed there
    roads = Roads(np.array([[0, 0], [4, 0], [4, 4], [0, 4]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]), np.ones(4, dtype=bool))
    one = made(MapmatchParticles, roads=roads, spread_mps=0.0, particles=2, kappa=2.0)
    one.cloud.edge[:], one.cloud.offset[:] = [[0, 1]], [[3.9, 0.0]]
    step(one, 0.1, 2.0, np.pi / 2)
    np.testing.assert_allclose(one.cloud.weight, 0.5)  # both on the northward edge by now


def test_a_silent_odometer_is_told():
    one = made(MapmatchGrid, silent_s=5.0)
    step(one, 0.1, 2.0, 0.0)
    one.predict(np.array([4.0]))
    assert one.estimate().status[0] != Status.LOST
    one.predict(np.array([6.0]))
    assert one.estimate().status[0] == Status.LOST


def test_slow_samples_count_whole_and_fast_ones_in_proportion():
    counted = []

    class Spy(MapmatchParticles):
        def weigh(self, rows, heading, kappa, since):
            counted.append(float(kappa[0]))
            return super().weigh(rows, heading, kappa, since)

    one = Spy(Spy.Config(kappa=2.0, correlation_s=2.0), site(W3), RowRandom(np.arange(1)))
    one.start(nowhere())
    for t in (0.1, 0.2, 5.0):
        step(one, t, 2.0, 0.0)
    np.testing.assert_allclose(counted, [0.1, 0.1, 2.0])


# ---------------------------------------------------------------- seeking and tracking


@pytest.fixture(scope="module")
def runs():
    return trials(3, duration_s=120)


@pytest.mark.parametrize(("kind", "config"), [("mapmatch_grid", {}), ("mapmatch_particles_bias", {})])
def test_it_seeks_before_it_tracks_and_is_right_when_it_says_so(runs, kind, config):
    track = tracked(runs, kind, **config)
    assert (track.status[0] == Status.COASTING).all()
    assert (track.status[-1] == Status.OK).all()
    truth = np.concatenate([t.target_states(track.t)[..., :2] for t in runs], axis=1)
    error = np.hypot(*np.moveaxis(track.mean - truth, -1, 0))
    assert (error[track.status == Status.OK] < 3.0).mean() > 0.95


@pytest.mark.parametrize(("kind", "config"), [("mapmatch_grid", {}), ("mapmatch_particles", {}), ("mapmatch_particles_bias", {})])
def test_a_vehicle_that_is_carried_elsewhere_is_sought_again(kind, config):
    t = np.arange(1, 1401) / 10
    # a rectangle of 26 x 19 m whose sides are told apart by their lengths, and a loop at one corner where the vehicle is put down
    nodes = [[0, 0], [26, 0], [26, 19], [0, 19], [-7, 19], [-7, 24], [0, 24]]
    segments = [[0, 1], [1, 2], [2, 3], [3, 0], [3, 4], [4, 5], [5, 6], [6, 3]]
    lap = np.repeat([0, np.pi / 2, np.pi, -np.pi / 2], [130, 95, 130, 95])
    loop = np.repeat([np.pi, np.pi / 2, 0, -np.pi / 2], [35, 25, 35, 25])
    heading = np.concatenate([lap, lap, np.tile(loop, 5)])[: len(t)]
    recording = by_hand(nodes, segments, t, 2.0, heading)
    method = {m.__name__.lower(): m for m in METHODS}[kind.replace("_", "")]
    track = run([recording], method, method.Config(**config), nowhere(), np.array([11], dtype=np.uint64))
    seeks = track.status[:, 0] == Status.COASTING
    settled = (t[0] + 60 <= track.t) & (track.t < 88)
    after = (track.t > 92) & (track.t < 115)
    assert seeks[settled].mean() < 0.2
    assert seeks[after].any()


def test_the_cloud_shrinks_once_the_place_is_known(runs):
    sizes = []

    class Spy(MapmatchParticlesBias):
        def renew(self, rows):
            super().renew(rows)
            sizes.append(self.cloud.count.max())

    recordings = [r.recording for r in runs[:1]]
    run(recordings, Spy, Spy.Config(particles_min=300), nowhere(), np.array([3], dtype=np.uint64))
    assert sizes[0] == 4000
    assert np.median(sizes[-300:]) < 2000
    assert min(sizes) >= 300
