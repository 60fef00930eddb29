"""The filter with a rack map: a belief that is a function of the ordered log, maps, modes, and reports of the past."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.interpolate import RegularGridInterpolator

from estimators.detection_flow import GOES, SPREAD, VX, X
from estimators.detection_geometry import DetectionGeometry
from estimators.detection_map import MOST, RackMap, RackMapConfig
from estimators.detection_model import DetectionModel, DetectionModelConfig
from testbed import frames
from testbed.geometry import Boxes
from testbed.rng import RowRandom
from testbed.types import POSITION, Antennas, Event, Prior, RoundCounts, Site, Status, Tags

CORNERS = np.array([[0.0, 0.0, 1.5], [10.0, 0.0, 1.5], [10.0, 10.0, 1.5], [0.0, 10.0, 1.5]])
ANTENNAS = Antennas(
    id=["sw", "se", "ne", "nw"], position=CORNERS, quaternion=frames.looking_at(CORNERS, np.array([5.0, 5.0, 1.5])),
    gain=np.full(4, 6.0), beamwidth=np.full(4, 1.2), front_to_back=np.full(4, 18.0), power=np.full(4, 29.0), reader=["r"] * 4,
)  # fmt: skip
RACK = Boxes(center=[[5.0, 5.0, 1.5]], quaternion=[[1.0, 0, 0, 0]], half=[[2.0, 0.5, 1.5]])


def site(boxes=None):
    return Site(ANTENNAS, Tags(id=["tag"]), np.array([866e6]), obstacles=Boxes.empty() if boxes is None else boxes)


def prior(rows=1, x=5.0, y=2.0, velocity=(0.0, 0.0), spread=1.0):
    mean = np.tile([x, y, 1.5, *velocity, 0.0], (rows, 1))
    return Prior(np.zeros(rows), mean, np.tile(np.diag([spread, spread, 1e-6, 0.25, 0.25, 1e-6]), (rows, 1, 1)))


def made(start=None, boxes=None, seed=5, **config):
    start = start or prior()
    one = DetectionGeometry(
        DetectionGeometry.Config.model_validate({"particles": 300, **config}),
        site(boxes),
        RowRandom(np.arange(start.rows) + np.uint64(seed)),
    )
    one.start(start)
    return one


def tell(one, now, t, antenna, n, round_):
    one.predict(np.array([now]))
    return one.update(Event("rounds", np.array([0]), RoundCounts([t], [t - 0.3], [round_], [0], [antenna], [0], [10], [n])))


def log(seconds=6, seed=2):
    """(t, antenna, n, round) of some counts, in order of time."""
    rng = np.random.default_rng(seed)
    entries = [(k + tau, a, int(rng.integers(0, 8)), k) for k in range(seconds) for a, tau in enumerate(np.sort(rng.uniform(0.2, 0.8, 4)))]
    return sorted(entries)


def belief(one):
    estimate = one.estimate()
    return estimate.mean.copy(), estimate.covariance.copy()


# ---------------------------------------------------------------- late reports


@pytest.mark.parametrize("boxes", [None, RACK])
def test_what_comes_late_leads_to_the_same_belief_as_what_comes_in_time_to_the_last_bit(boxes):
    in_time, late = made(boxes=boxes), made(boxes=boxes)
    for t, antenna, n, round_ in log():
        tell(in_time, t, t, antenna, n, round_)
    delayed = sorted((t + (0.0, 1.0, 2.0)[(3 * i) % 7 % 3], t, a, n, k) for i, (t, a, n, k) in enumerate(log()))
    for i, (now, t, antenna, n, round_) in enumerate(delayed):
        assert tell(late, now, t, antenna, n, round_).used.all()
        if i % 3 == 0:
            late.estimate()  # whoever asks meanwhile changes nothing
    for one in (in_time, late):
        one.predict(np.array([9.0]))
    for a, b in zip(belief(in_time), belief(late), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_report_that_was_left_out_would_have_changed_the_belief():
    whole, less = made(), made()
    for i, (t, antenna, n, round_) in enumerate(log()):
        tell(whole, t, t, antenna, n, round_)
        if i != 4:
            tell(less, t, t, antenna, n, round_)
    assert np.abs(belief(whole)[0] - belief(less)[0]).max() > 1e-6


@pytest.mark.parametrize(("late_s", "taken"), [(0.0, False), (1.0, False), (3.0, True)])
def test_what_comes_later_than_late_s_is_refused(late_s, taken):
    one = made(late_s=late_s)
    tell(one, 0.5, 0.5, 0, 4, 0)
    tell(one, 3.0, 3.0, 1, 4, 3)
    before = belief(one)
    assert tell(one, 3.2, 1.4, 2, 5, 1).used.tolist() == [taken]
    one.predict(np.array([3.0]))
    assert (belief(one)[0] != before[0]).any() == taken


def test_rows_do_not_know_of_each_other():
    both, alone = made(prior(2)), made(prior(1))
    for t, antenna, n, round_ in log(3):
        tell(alone, t, t, antenna, n, round_)
        both.predict(np.array([t, 0.0]))
        both.update(Event("rounds", np.array([0]), RoundCounts([t], [t], [round_], [0], [antenna], [0], [10], [n])))
    np.testing.assert_array_equal(belief(both)[0][0], belief(alone)[0][0])


# ---------------------------------------------------------------- the map


def at(racks, table, x, y):
    i, j = np.round((np.array([x, y]) - racks.origin) / racks.cell).astype(int)
    return table[i, j]


def test_the_map_closes_what_lies_behind_a_rack_and_nothing_else():
    racks = RackMap(RackMapConfig(through=0.0, cell_m=0.25), site(RACK), np.array([1.5]))
    sw = racks.closed[0, 0]
    assert at(racks, sw, 7.0, 8.0) == pytest.approx(MOST)  # behind, as seen from the south-west
    assert at(racks, sw, 3.0, 2.0) == 0
    assert at(racks, sw, 0.5, 9.0) == 0
    assert at(racks, racks.closed[0, 1], 3.0, 8.0) == pytest.approx(MOST)
    assert at(racks, racks.solid, 5.0, 5.0)
    assert not at(racks, racks.solid, 5.0, 6.0)


def test_a_box_lets_through_what_it_is_said_to_and_two_let_less():
    two = Boxes.concatenate([RACK, RACK.with_(center=[[5.0, 7.0, 1.5]])])
    for boxes, closed in ((RACK, 0.7), (two, 0.91)):
        racks = RackMap(RackMapConfig(through=0.3), site(boxes), np.array([1.5]))
        assert at(racks, racks.closed[0, 0], 7.5, 9.5) == pytest.approx(closed, abs=1e-6)


def test_tags_above_the_rack_see_over_it_and_heights_have_maps_of_their_own():
    low = RACK.with_(center=[[5.0, 5.0, 0.5]], half=[[2.0, 0.5, 0.5]])
    racks = RackMap(RackMapConfig(through=0.0), site(low), np.array([0.2, 1.5, 0.2]))
    assert racks.level.tolist() == [0, 1, 0]
    assert at(racks, racks.closed[0, 0], 7.0, 6.5) > 0.9  # at 0.2 m, near behind it
    assert racks.closed[1].max() == 0


def test_a_turned_box_is_where_it_is():
    turned = RACK.with_(quaternion=[frames.from_euler(np.pi / 2)])
    racks = RackMap(RackMapConfig(), site(turned), np.array([1.5]))
    assert at(racks, racks.solid, 5.0, 6.5)
    assert not at(racks, racks.solid, 6.5, 5.0)


@pytest.mark.parametrize("n", [0, 1, 6])
def test_counts_are_weighed_by_the_exact_model_with_what_the_map_closes(n):
    """Particles that stand still, one count: log-weights against P(dead) = 1 - (1 - g)(1 - E λ), by the exact path."""
    mean = np.array([[5.0, 2.5, 1.5, 0, 0, 0]])
    still = Prior(np.zeros(1), mean, np.diag([2.0, 2.0, 1e-6, 0.0, 0.0, 0.0])[None])
    boxes = RACK.with_(center=[[5.0, 1.0, 1.5]], half=[[2.0, 0.1, 1.5]])
    one = made(still, boxes, acceleration_density_m2ps3=0.0, through=0.3, particles=2000)
    tell(one, 0.4, 0.4, 0, n, 0)
    place, weight = one.particles()
    x, y = place[0, :, 0], place[0, :, 1]
    racks = RackMap(RackMapConfig(through=0.3), site(boxes), np.array([1.5]))
    grid = [racks.origin[i] + racks.cell * np.arange(racks.closed.shape[2 + i]) for i in range(2)]
    inside = [np.clip(p, line[0], line[-1]) for p, line in zip((x, y), grid, strict=True)]
    g = RegularGridInterpolator(grid, racks.closed[0, 0])(np.column_stack(inside))
    angle = np.abs(np.rad2deg(np.angle(np.exp(1j * (np.arctan2(y, x) - np.pi / 4)))))
    wanted = DetectionModel(DetectionModelConfig()).log_mass(n, 10, np.hypot(x, y), angle, g)
    free = ~((np.abs(x - 5) < 2.5) & (np.abs(y - 1) < 0.6))  # not inside the rack, which no tag can be
    got = np.log(weight[0])
    off = (got - wanted)[free] - np.median((got - wanted)[free])
    assert np.ptp(g) > 0.6
    assert np.percentile(np.abs(off), 99) < 2e-3 if n == 0 else np.percentile(np.abs(off), 90) < 2e-3


def test_no_particle_with_weight_stands_in_a_rack():
    one = made(prior(y=4.0, spread=2.0), RACK)
    for k in range(3):
        tell(one, k + 0.5, k + 0.5, 0, 3, k)
    place, weight = one.particles()
    inside = (np.abs(place[0, :, 0] - 5) < 1.7) & (np.abs(place[0, :, 1] - 5) < 0.3)
    assert weight[0, inside].sum() < 1e-3


# ---------------------------------------------------------------- motion, modes, the past


def spread_after(steps, **config):
    """x of 100,000 particles moved in some steps by reads that weigh them all alike (far away: their weights are thrown off)."""
    one = made(prior(spread=0.01, velocity=(1.0, 0.0)), particles=20_000, resample_below=1e-9, late_s=0, **config)
    for k, t in enumerate(steps):
        tell(one, t, t, 0, 1, k)
    one.estimate()
    return one._rows.p[0]


def test_integrating_velocities_out_moves_particles_as_the_whole_model_does():
    """Var x after 2 s in one step and in many, and the velocity's variance in two parts: 4.5 σ."""
    wanted_x, wanted_v = 0.01 + 0.25 * 4 + 0.1 * 8 / 3, 0.25 + 0.1 * 2
    for steps in ([2.0], [0.2, 0.7, 1.1, 2.0]):
        p = spread_after(steps)
        close = 4.5 * np.sqrt(2 / p.shape[1])
        assert p[X].var() == pytest.approx(wanted_x, rel=close)
        assert p[VX].var() + p[SPREAD].mean() == pytest.approx(wanted_v, rel=close)


def test_who_may_stop_does_so_at_the_rates_given():
    """Share of those that move, in the long run: go/(go + stop). 4.5 σ."""
    p = spread_after([3.0, 6.0, 9.0, 30.0], stop_s=2.0, go_s=6.0, speed_mps=1.5)
    share = p[GOES].mean()
    assert share == pytest.approx(0.75, abs=4.5 * np.sqrt(0.75 * 0.25 / p.shape[1]))
    assert (p[VX, p[GOES] == 0] == 0).all()


def test_a_report_with_a_lag_is_where_the_target_was():
    one = made(prior(velocity=(1.0, 0.5), spread=0.01), lag_s=2.0, particles=4000, acceleration_density_m2ps3=0.0, resample_below=1e-9)
    for k in range(5):
        tell(one, k + 0.75, k + 0.75, 0, 0, k)
    one.predict(np.array([5.0]))
    estimate = one.estimate()
    assert estimate.components == POSITION
    place, weight = one.particles()
    np.testing.assert_allclose(estimate.mean[0, :2], np.einsum("mi,m->i", place[0, :, :2], weight[0]), atol=1e-9)
    now, w = one._rows.places(np.array([5.0]))
    back = one._rows.p[0]
    np.testing.assert_allclose(place[0, :, 0], now[0, 0] - 2.0 * back[VX], atol=1e-6)  # without noise all ways are straight
    assert w.shape == weight.shape


def test_before_the_lag_is_over_the_report_is_of_the_start():
    one = made(prior(spread=0.01), lag_s=3.0)
    tell(one, 0.5, 0.5, 0, 0, 0)
    one.predict(np.array([1.0]))
    np.testing.assert_allclose(one.estimate().mean[0, :2], [5.0, 2.0], atol=0.05)


def test_a_minute_of_silence_widens_coasts_and_loses():
    one = made()
    tell(one, 0.5, 0.5, 0, 5, 0)
    said, widths = [], []
    for t in (1.0, 10.0, 60.0):
        one.predict(np.array([t]))
        said.append(Status(one.estimate().status[0]))
        widths.append(np.trace(one.estimate().covariance[0, :2, :2]))
    assert said == [Status.OK, Status.COASTING, Status.LOST]
    assert widths[0] < widths[1] < widths[2]


def test_blocks_of_different_numbers_of_queries_have_tables_of_their_own():
    one = made()
    for k, queries in enumerate((10, 4, 10, 25)):
        one.predict(np.array([k + 0.5]))
        data = RoundCounts([k + 0.5], [k + 0.2], [k], [0], [0], [0], [queries], [min(3, queries)])
        one.update(Event("rounds", np.array([0]), data))
    assert np.isfinite(one.estimate().mean).all()


def test_more_than_memory_holds_is_refused():
    with pytest.raises(ValidationError, match="gigabyte"):
        DetectionGeometry.Config(particles=1_000_000, lag_s=30)
