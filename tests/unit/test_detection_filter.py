"""Filters on detection counts: motion, geometry, whose silence counts, when a block is taken, what is refused, and long silence."""

import numpy as np
import pytest

from estimators.detection_asynchronous import DetectionAsynchronous
from estimators.detection_centroid import DetectionCentroid
from estimators.detection_cloud import Cloud, View
from estimators.detection_filter import DetectionFilter
from estimators.detection_model import DetectionModel, DetectionModelConfig
from estimators.detection_reports import Readers, Reports
from estimators.detection_synchronous import DetectionSynchronous
from testbed import frames
from testbed.rng import RowRandom
from testbed.types import Antennas, Event, Prior, RoundCounts, Site, Status, Tags

TABLE = DetectionModel(DetectionModelConfig()).table(10)


def antennas(places, aims, readers):
    n, places = len(places), np.column_stack([places, np.full(len(places), 1.5)])
    return Antennas(
        id=[f"a{i}" for i in range(n)], position=places, quaternion=frames.looking_at(places, np.column_stack([aims, np.full(n, 1.5)])),
        gain=np.full(n, 6.0), beamwidth=np.full(n, 1.2), front_to_back=np.full(n, 18.0), power=np.full(n, 29.0), reader=readers,
    )  # fmt: skip


CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
GRID = antennas(
    np.concatenate([CORNERS, CORNERS + np.array([10.0, 0.0])]),
    np.repeat([[5.0, 5.0], [15.0, 5.0]], 4, axis=0),
    np.repeat(["west", "east"], 4),
)
SITE = Site(GRID, Tags(id=["tag"]), np.array([866e6]))


def prior(x=5.0, y=5.0, rows=1, spread=1.0, velocity=(0.0, 0.0)):
    mean = np.tile([x, y, 1.5, *velocity, 0.0], (rows, 1))
    return Prior(np.zeros(rows), mean, np.tile(np.diag([spread, spread, 1e-6, 0.25, 0.25, 1e-6]), (rows, 1, 1)))


def counts(t, antenna, n, round_=0, queries=10):
    return Event("rounds", np.array([0]), RoundCounts([t], [t - 0.5], [round_], [0], [antenna], [0], [queries], [n]))


def made(method, **config):
    one = method(method.Config.model_validate(config), SITE, RowRandom(np.array([5], dtype=np.uint64)))
    one.start(prior())
    return one


def tell(one, t, antenna, n, round_=0, queries=10):
    one.predict(np.array([t]))
    return one.update(counts(t, antenna, n, round_, queries))


# ---------------------------------------------------------------- motion and geometry


def cloud(m=200_000, **start):
    return Cloud(prior(**start), m, 0.1, RowRandom(np.array([9], dtype=np.uint64)))


def test_two_steps_are_distributed_as_one_in_mean_and_covariance():
    """Against the closed form, for the cloud moved at once and in two: 4.5 σ of each moment, which fails once in 10,000 seeds."""
    h, q = 1.0, 0.1
    f = np.eye(4)
    f[0, 2] = f[1, 3] = h
    p0 = np.diag([1.0, 1.0, 0.25, 0.25])
    noise = q * np.array([[h**3 / 3, 0, h**2 / 2, 0], [0, h**3 / 3, 0, h**2 / 2], [h**2 / 2, 0, h, 0], [0, h**2 / 2, 0, h]])
    wanted = f @ p0 @ f.T + noise
    for steps in ([1.0], [0.3, 1.0], [0.1, 0.2, 0.7, 1.0]):
        moved = cloud(velocity=(1.0, -2.0))
        for t in steps:
            moved.advance(np.array([0]), np.array([t]))
        x = moved.x[0]
        error = np.sqrt((wanted**2 + np.outer(np.diag(wanted), np.diag(wanted))) / x.shape[1])
        assert (np.abs(np.cov(x) - wanted) < 4.5 * error).all()
        np.testing.assert_allclose(x.mean(axis=1), [6.0, 3.0, 1.0, -2.0], atol=4.5 * np.sqrt(np.diag(wanted).max() / x.shape[1]))


def test_moments_carry_the_cloud_on_exactly():
    still = cloud()
    now, (mean, covariance) = still.moments(np.zeros(1)), still.moments(np.array([2.0]))
    f = np.eye(4)
    f[0, 2] = f[1, 3] = 2.0
    np.testing.assert_allclose(mean[0], f @ now[0][0], rtol=1e-12)
    added = covariance[0] - f @ now[1][0] @ f.T
    np.testing.assert_allclose(np.diag(added), [0.1 * 8 / 3, 0.1 * 8 / 3, 0.2, 0.2], rtol=1e-9)


@pytest.mark.parametrize("degrees", [90, 180, 37])
def test_turning_the_layout_and_the_particles_changes_nothing(degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[c, -s], [s, c]])
    turned = antennas(GRID.position[:, :2] @ turn.T, np.repeat([[5.0, 5.0], [15.0, 5.0]], 4, axis=0) @ turn.T, GRID.reader)
    weights = []
    for site, rotation in ((GRID, np.eye(2)), (turned, turn)):
        one = cloud(500, spread=9.0)
        one.x[0, :2] = rotation @ one.x[0, :2]
        entries = np.arange(8)
        one.weigh(np.zeros(8, dtype=np.int64), entries, entries, np.zeros(8), TABLE, View(site, np.array([1.5])))
        weights.append(one.log_weight[0])
    np.testing.assert_allclose(weights[0], weights[1], atol=1e-6)


def test_the_boresight_counts():
    """Behind its antenna a tag is read less: without boresight (the printed arctan of a ratio) both sides would be alike."""
    one, view = cloud(2), View(GRID, np.array([1.5]))
    one.x[0, :2] = [[2.0, -2.0], [2.0, -2.0]]  # before and behind antenna 0, which looks to the north-east
    one.weigh(np.array([0]), np.array([0]), np.array([6]), np.zeros(1), TABLE, view)
    assert one.log_weight[0, 0] > one.log_weight[0, 1] + 10


# ---------------------------------------------------------------- whose silence counts


def sorted_out(events, heard=True):
    reports, found = Reports(1, Readers(SITE, "x"), "x", heard), []
    for antenna, n, round_ in events:
        used, now = reports.sort(np.array([0]), counts(1.0, antenna, n, round_).data)
        assert used.all()
        found.append(sorted(zip(now.antenna.tolist(), now.n.tolist(), strict=True)))
    return found


def test_silence_counts_for_all_antennas_of_a_reader_that_hears_the_tag_in_the_round():
    assert sorted_out([(0, 0, 7), (1, 0, 7), (2, 4, 7), (3, 0, 7)]) == [[], [], [(0, 0), (1, 0), (2, 4)], [(3, 0)]]


def test_silence_of_another_reader_or_of_another_round_does_not_count():
    assert sorted_out([(4, 0, 7), (0, 0, 6), (2, 4, 7)]) == [[], [], [(2, 4)]]
    assert sorted_out([(2, 4, 6), (3, 0, 7)]) == [[(2, 4)], []]


def test_all_silences_count_where_that_is_asked_for():
    assert sorted_out([(4, 0, 7), (0, 0, 6)], heard=False) == [[(4, 0)], [(0, 0)]]


def test_what_is_told_twice_counts_once():
    reports = Reports(1, Readers(SITE, "x"), "x", True)
    first, second = (reports.sort(np.array([0]), counts(1.0, 2, 4, 3).data) for _ in range(2))
    assert first[0].all()
    assert not second[0].any()
    assert len(second[1].row) == 0


# ---------------------------------------------------------------- when a block is taken


def test_blocks_are_taken_in_order_at_their_own_time_and_at_the_slot_s_end_by_the_other():
    taken = {}
    for method in (DetectionAsynchronous, DetectionSynchronous):
        one = made(method)
        times = taken.setdefault(method, [])
        for k, (t, antenna) in enumerate([(0.3, 0), (0.6, 4), (1.25, 0), (1.7, 4)]):
            tell(one, t, antenna, 5, round_=k)
            times.append(float(one._cloud.at[0]))
    assert taken[DetectionAsynchronous] == [0.3, 0.6, 1.25, 1.7]
    assert taken[DetectionSynchronous] == [1.0, 1.0, 2.0, 2.0]


def test_a_report_is_at_the_report_s_time():
    one = made(DetectionAsynchronous, particles=2000)
    one.start(prior(velocity=(2.0, 0.0), spread=0.01))
    tell(one, 0.4, 0, 5)
    before = one.estimate().mean[0, 0]
    one.predict(np.array([1.0]))
    after = one.estimate()
    assert after.mean[0, 0] - before == pytest.approx(0.6 * after.mean[0, 3], rel=1e-9)


def test_no_method_goes_back_in_time(monkeypatch):
    steps = []
    advance = Cloud.advance

    def watched(self, rows, t):
        steps.append((t - self.at[rows]).min(initial=np.inf))
        advance(self, rows, t)

    monkeypatch.setattr(Cloud, "advance", watched)
    one = made(DetectionAsynchronous, silence="all")
    for k in range(40):
        tell(one, 0.25 * (k + 1), k % 8, (3 * k) % 11, round_=k)
    assert min(steps) >= 0


# ---------------------------------------------------------------- bad input, and none


@pytest.mark.parametrize("method", [DetectionAsynchronous, DetectionSynchronous, DetectionCentroid])
@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"n": 11}, "between 0 and its queries"),
        ({"n": -1}, "between 0"),
        ({"queries": 0, "n": 0}, "at least one query"),
        ({"antenna": 8}, "doesn't have"),
    ],
)
def test_counts_that_can_not_be_are_refused_with_the_row_named(method, wrong, says):
    with pytest.raises(ValueError, match=f"row 0, .*{says}"):
        tell(made(method), **{"t": 0.5, "antenna": 1, "n": 3, **wrong})


@pytest.mark.parametrize("method", [DetectionAsynchronous, DetectionCentroid])
def test_readers_of_unknown_place_are_refused(method):
    position = np.array(GRID.position)
    position[5] = np.nan
    with pytest.raises(ValueError, match="a5 of reader east is not known"):
        method(method.Config(), Site(GRID.with_(position=position), SITE.tags, SITE.frequencies), RowRandom(np.zeros(1)))


def test_a_reader_whose_boresights_are_parallel_stands_nowhere():
    rail = antennas(CORNERS, CORNERS + np.array([1.0, 0.0]), ["rail"] * 4)
    with pytest.raises(ValueError, match=r"reader rail .*reader_place: antennas"):
        DetectionCentroid(DetectionCentroid.Config(), Site(rail, SITE.tags, SITE.frequencies), RowRandom(np.zeros(1)))


@pytest.mark.parametrize("method", [DetectionAsynchronous, DetectionSynchronous])
def test_a_minute_of_silence_widens_coasts_and_loses_the_track(method):
    one = made(method)
    tell(one, 0.5, 0, 6)
    widths, said = [], []
    for t in (1.0, 5.0, 20.0, 60.0):
        one.predict(np.array([t]))
        estimate = one.estimate()
        widths.append(np.trace(estimate.covariance[0, :2, :2]))
        said.append(Status(estimate.status[0]))
    assert said == [Status.OK, Status.COASTING, Status.COASTING, Status.LOST]
    assert (np.diff(widths) > 0).all()
    assert widths[-1] > 100 * widths[0]


# ---------------------------------------------------------------- the centroid


def test_the_centroid_is_the_mean_of_the_readers_of_the_slot_and_is_held():
    one = made(DetectionCentroid)
    np.testing.assert_allclose(one.estimate().mean[0], [5.0, 5.0, 1.5])  # the prior, before the first read
    one.start(prior(3.0, 4.0))
    np.testing.assert_allclose(one.estimate().mean[0, :2], [3.0, 4.0])
    tell(one, 0.3, 5, 1, 0)
    np.testing.assert_allclose(one.estimate().mean[0, :2], [15.0, 5.0])
    tell(one, 0.6, 1, 9, 1)
    tell(one, 0.6, 2, 1, 1)
    np.testing.assert_allclose(one.estimate().mean[0, :2], [10.0, 5.0])  # unweighted
    tell(one, 1.5, 0, 0, 3)
    np.testing.assert_allclose(one.estimate().mean[0, :2], [10.0, 5.0])  # held in silence
    tell(one, 1.6, 0, 2, 4)
    np.testing.assert_allclose(one.estimate().mean[0, :2], [5.0, 5.0])  # a slot of its own


def test_filters_want_a_prior_over_position_and_velocity():
    one = made(DetectionAsynchronous)
    with pytest.raises(ValueError, match="position and velocity"):
        one.start(Prior(np.zeros(1), np.zeros((1, 3)), np.eye(3)[None], components=("x", "y", "z")))
    assert issubclass(DetectionAsynchronous, DetectionFilter)
