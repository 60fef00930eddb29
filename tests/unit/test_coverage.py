"""Coverage: Friis in the open, a dead zone behind steel, what counts as floor, several readers, published counts, bad input."""

import numpy as np
import pytest

from testbed import frames
from testbed.coverage import DEAD, HEARD, CoverageError, coverage
from testbed.coverage import links as coverage_links
from testbed.coverage.links import answering
from testbed.radio import logistic_beta
from testbed.radio.propagation import POLARISATION_DB
from testbed.radio.rice import exceeding, mean_db
from testbed.rng import Counter
from testbed.scenario import ScenarioError
from testbed.units import SPEED_OF_LIGHT
from worlds import open_floor
from worlds.parts import Builder, Part

CARRIERS = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])
STRAIGHT = {"orders": 0, "diffuse": False, "edges": False}
ANTENNA = np.array([0.0, 10.0, 1.5])


def site(sensors=None, actors=(), **section):
    """A floor of 20 m by 20 m with one antenna at the middle of its west side, looking east."""
    reader = {"id": "west", "kind": "rfid", "antennas": {"position_m": ANTENNA.tolist()}, **section}
    return {
        "name": "site",
        "seed": 1,
        "trials": 1,
        "duration_s": 1,
        "world": {"kind": "open_floor", "length_m": 20, "width_m": 20, "posts": 0},
        "sensors": [reader] if sensors is None else sensors,
        "actors": list(actors),
    }


@pytest.fixture
def steel(monkeypatch):
    """A plate of steel, 4 m wide and 3 m high, 4 m before the antenna."""

    def parts(self):
        built = Builder()
        built.box("steel", (-0.15, -2.0, 0.0), (0.15, 2.0, 3.0))
        return [Part("plate", "wall", np.concatenate([[4.0, 10.0, 0.0], frames.IDENTITY[3:]]), built.boxes(), built.mounts())]

    monkeypatch.setattr(open_floor.OpenFloor, "parts", parts)


def at(found, x, y):
    """Index (row, column) of the point of the grid nearest to (x, y)."""
    return int(np.abs(found.y - y).argmin()), int(np.abs(found.x - x).argmin())


# ---------------------------------------------------------------- what is known of |h| without drawing it


def test_probabilities_of_a_rayleigh_and_of_a_settled_channel():
    x = np.geomspace(0.01, 9, 20)
    np.testing.assert_allclose(exceeding(0.0, 1.5, x), np.exp(-x / 1.5**2), rtol=1e-12)
    np.testing.assert_array_equal(exceeding(2.0, 0.0, [3.9, 4.0, 4.1]), [1, 1, 0])
    np.testing.assert_array_equal(exceeding(2.0, 1e-9, [3.9, 4.1]), [1, 0])


@pytest.mark.parametrize("k", [0.1, 1.0, 10.0])
def test_probability_and_mean_level_of_a_rician_channel_against_quadrature(k):
    # D = r e^{ja}, r² exponential: the mean over its quantiles and over the angle, without Bessel functions
    radius = np.sqrt(-np.log1p(-(np.arange(4000) + 0.5) / 4000))
    turn = 2 * np.pi * (np.arange(500) + 0.5) / 500
    mean, spread = np.sqrt(k / (k + 1)), np.sqrt(1 / (k + 1))
    power = np.abs(mean + spread * radius[:, None] * np.exp(1j * turn)) ** 2
    assert mean_db(mean, spread) == pytest.approx(np.mean(10 * np.log10(power)), abs=5e-3)
    for least in (0.2, 1.0, 2.0):
        assert exceeding(mean * np.exp(2j), spread, least) == pytest.approx(np.mean(power >= least), abs=5e-4)


def test_levels_go_over_into_those_without_a_mean_and_without_a_spread():
    assert mean_db(0.0, 2.0) == pytest.approx(10 * np.log10(4.0) - 10 / np.log(10) * np.euler_gamma)
    assert mean_db(1e-5, 2.0) == pytest.approx(mean_db(0.0, 2.0), abs=1e-6)
    assert mean_db(3.0, 0.0) == pytest.approx(mean_db(3.0, 1e-3), abs=1e-6)
    assert mean_db(3.0, 0.0) == pytest.approx(20 * np.log10(3.0))


# ---------------------------------------------------------------- the map


def test_in_free_space_a_tag_is_read_where_friis_says_so():
    found = coverage(site(channel=STRAIGHT), step_m=0.5, height_m=[1.5])
    x, y = np.meshgrid(found.x, found.y)
    distance, angle = np.hypot(x - ANTENNA[0], y - ANTENNA[1]), np.arctan2(y - ANTENNA[1], x - ANTENNA[0])
    n = np.log(0.5) / np.log(np.cos(np.deg2rad(34)))
    gain = 6.0 + np.maximum(10 * n * np.log10(np.maximum(np.cos(angle), 1e-9)), -18) + 2.0 - POLARISATION_DB
    one_way = gain + 20 * np.log10(SPEED_OF_LIGHT / CARRIERS[:, None, None] / (4 * np.pi * distance))
    awake = (29 + one_way >= -19.5) & (29 + 2 * one_way - 8 >= -84)
    np.testing.assert_allclose(found.probability[0, :, :, 0], awake.mean(axis=0), atol=1e-12)
    assert 0.05 < awake.mean() < 0.5  # the edge of the lobe is in the hall
    heard = ~np.isnan(found.rssi[0, :, :, 0])
    assert heard[awake.all(axis=0)].all()
    np.testing.assert_allclose(found.rssi[0, :, :, 0][heard], (29 + 2 * one_way - 8).mean(axis=0)[heard], atol=1e-9)
    assert found.shares()[0].tolist() == [(awake.mean(axis=0) >= HEARD).mean(), 0.0, 0.0]


def test_a_deaf_reader_hears_nothing_that_it_wakes():
    deaf = coverage(site(channel=STRAIGHT, reader={"sensitivity_dbm": -40}), step_m=1.0, height_m=[1.5])
    keen = coverage(site(channel=STRAIGHT), step_m=1.0, height_m=[1.5])
    assert deaf.shares()[0, 0] < 0.5 * keen.shares()[0, 0]
    assert np.nanmin(deaf.rssi[deaf.probability == 1]) >= -40


def test_behind_steel_there_is_a_dead_zone(steel):
    found = coverage(site(), step_m=0.5)
    row, column = at(found, 6.0, 10.0)
    assert found.dead[0, row, column]
    assert found.read[0, row, column] < 0.05
    assert found.read[0, at(found, 2.5, 10.0)[0], at(found, 2.5, 10.0)[1]] > 0.9  # before it
    assert found.clear[0, row, column, 0] < 0.1
    zone = next(z for z in found.dead_zones(0) if z.bounds_m[0][0] < 6 < z.bounds_m[1][0] and z.bounds_m[0][1] < 10 < z.bounds_m[1][1])
    assert zone.area_m2 > 4


def test_without_the_steel_there_is_none():
    found = coverage(site(), step_m=0.5)
    row, column = at(found, 6.0, 10.0)
    assert not found.dead[0, row, column]
    assert found.read[0, row, column] > 0.9


def test_points_inside_of_things_are_no_floor(steel):
    found = coverage(site(), step_m=0.25, height_m=[1.0, 4.0])
    low, high = np.array([3.85, 8.0]), np.array([4.15, 12.0])
    x, y = np.meshgrid(found.x, found.y)
    expected = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    np.testing.assert_array_equal(found.inside[0], expected)
    assert expected.sum() > 10
    assert not found.inside[1].any()  # over its top
    for field in (found.read, found.antennas, found.level, found.probability[..., 0]):
        assert np.isnan(field[found.inside]).all()
    assert not found.dead[found.inside].any()
    floor = ~found.inside[0]
    assert found.shares()[0, 0] == (found.probability[0, :, :, 0][floor] >= HEARD).mean()


def test_where_all_is_inside_of_something_there_is_no_share(monkeypatch):
    def parts(self):
        built = Builder()
        built.box("concrete", (-50, -50, 0.0), (50, 50, 1.0))
        return [Part("slab", "wall", frames.IDENTITY, built.boxes(), built.mounts())]

    monkeypatch.setattr(open_floor.OpenFloor, "parts", parts)
    found = coverage(site(), step_m=2.0, height_m=[0.5, 2.0])
    assert np.isnan(found.shares()[0]).all()
    assert np.isfinite(found.shares()[1]).all()
    assert found.dead_zones(0) == []


def test_readers_together_are_each_by_itself(steel):
    west = {"id": "west", "kind": "rfid", "antennas": {"position_m": ANTENNA.tolist()}}
    east = {"id": "east", "kind": "rfid", "antennas": {"position_m": [20, 10, 1.5], "yaw_deg": 180}, "power_dbm": 20}
    both = coverage(site([west, east]), step_m=1.0)
    alone = [coverage(site([west, east]), step_m=1.0, sensors=[id]) for id in ("west", "east")]
    assert both.antenna.tolist() == ["west.1", "east.1"]
    assert both.sensor.tolist() == ["west", "east"]
    np.testing.assert_array_equal(both.probability, np.concatenate([a.probability for a in alone], axis=-1))
    np.testing.assert_allclose(both.read, 1 - (1 - alone[0].read) * (1 - alone[1].read), rtol=1e-12)
    np.testing.assert_array_equal(both.antennas, alone[0].antennas + alone[1].antennas)
    np.testing.assert_array_equal(both.level, np.fmax(alone[0].level, alone[1].level))
    assert np.all(both.dead <= (alone[0].dead & alone[1].dead))


def test_the_grid_lies_in_the_middle_and_chunks_change_nothing(steel, monkeypatch):
    found = coverage(site(), step_m=0.7, height_m=[1.0, 1.0, 2.0])
    assert found.z.tolist() == [1.0, 2.0]
    assert found.x[0] - (-0.2) == pytest.approx(20.2 - found.x[-1])
    np.testing.assert_allclose(np.diff(found.x), 0.7)
    monkeypatch.setattr(coverage_links, "CHUNK", 97)
    again = coverage(site(), step_m=0.7, height_m=[1.0, 2.0])
    np.testing.assert_array_equal(again.probability, found.probability)
    np.testing.assert_array_equal(again.rssi, found.rssi)


def test_moving_bodies_stand_where_they_start():
    forklift = {"id": "f", "kind": "forklift", "motion": "kinematic"}
    near = coverage(site(actors=[{**forklift, "route": {"waypoints_m": [[5, 10], [15, 10]]}}]), step_m=0.5)
    far = coverage(site(actors=[{**forklift, "route": {"waypoints_m": [[15, 10], [5, 10]]}}]), step_m=0.5)
    for found, here in ((near, 5.0), (far, 15.0)):
        columns = np.nonzero(found.inside[0])[1]
        assert np.abs(found.x[columns] - here).max() < 3
    behind = at(near, 8.0, 10.0)
    assert near.loss[0, *behind, 0] > far.loss[0, *behind, 0] + 6


def test_antennas_that_are_carried_look_from_where_their_carrier_starts():
    forklift = {"id": "f", "kind": "forklift", "motion": "kinematic", "route": {"waypoints_m": [[5, 10], [15, 10]]}}
    carried = {"id": "r", "kind": "rfid", "antennas": {"on": "f", "position_m": [0, 0, 4], "tilt_deg": -30}, "channel": STRAIGHT}
    found = coverage(site([carried], [forklift]), step_m=1.0)
    x, y = np.meshgrid(found.x, found.y)
    asked = ~np.isnan(found.distance[0, :, :, 0])
    assert asked.sum() > 100
    np.testing.assert_allclose(found.distance[0, :, :, 0][asked], np.sqrt((x - 5) ** 2 + (y - 10) ** 2 + 9)[asked])


def test_a_tag_that_wakes_more_easily_is_read_farther():
    plain, keen = (coverage(site(power_dbm=22), step_m=1.0, tag=tag) for tag in ("monza_4", "monza_r6"))
    assert np.all(keen.probability >= plain.probability)
    assert keen.shares()[0, 0] > plain.shares()[0, 0]


# ---------------------------------------------------------------- counts of the published model


def test_probability_of_an_answer_in_the_published_model():
    # 40,000 blocks a case: a standard error of at most 0.0025; 5 sigma over 5 cases: false alarm 3e-6
    distance, angle = np.array([1.0, 4.0, 5.5, 7.0, 10.5]), np.deg2rad([0.0, 20.0, 10.0, 30.0, 0.0])
    for i, (d, a) in enumerate(zip(distance, angle, strict=True)):
        n = 40_000
        drawn = logistic_beta.alive(np.full(n, d), np.full(n, a), 10, Counter(1, 0, "x"), (np.arange(n), np.full(n, i)))
        assert answering(distance, angle, 10)[i] == pytest.approx((drawn > 0).mean(), abs=5 * 0.0025)


def test_counts_of_the_published_model_have_a_map_without_levels(steel):
    found = coverage(site(detection="logistic_beta"), step_m=0.5, height_m=[1.5])
    row, column = at(found, 2.75, 10.0)
    distance, angle = np.hypot(found.x[column], found.y[row] - 10), abs(np.arctan2(found.y[row] - 10, found.x[column]))
    expected = (17.1 / 18.0) * answering(np.array([distance]), np.array([angle]), 10)[0]
    assert found.probability[0, row, column, 0] == pytest.approx(expected * found.clear[0, row, column, 0])
    assert expected > 0.9
    assert np.isnan(found.rssi).all()
    behind = at(found, 5.0, 10.0)
    assert found.read[0, *behind] < 0.1
    through = coverage(site(detection={"kind": "logistic_beta", "geometry": False}), step_m=0.5, height_m=[1.5])
    assert through.read[0, *behind] > DEAD


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"step_m": 0}, "the step must be more than 0 m, and is 0"),
        ({"step_m": float("nan")}, "the step must be more than 0 m"),
        ({"step_m": 0.001}, "take a larger step"),
        ({"height_m": []}, "at least one"),
        ({"height_m": [1.0, 7.0]}, "a height of 7 m is not in the hall, which goes from 0 to 5 m"),
        ({"tag": "monza_r7"}, "monza_r6"),
        ({"sensors": ["wst"]}, "did you mean west"),
    ],
)
def test_mistakes_are_told_in_a_sentence(wrong, said):
    with pytest.raises(CoverageError, match=said):
        coverage(site(), **wrong)


def test_a_site_without_a_reader_has_nothing_to_cover():
    with pytest.raises(CoverageError, match="site has no sensor of kind rfid"):
        coverage(site([]))
    with pytest.raises(ScenarioError):
        coverage(site(power_dbm=60))
