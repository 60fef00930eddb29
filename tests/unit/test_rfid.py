"""The RFID sensor in a scene without walls, and with one box, on a caster made for the test."""

import numpy as np
import pytest
from pydantic import ValidationError

from testbed import frames
from testbed.geometry import Boxes, Mounts
from testbed.protocols import Obstruction, Surroundings, Tagged
from testbed.radio.propagation import POLARISATION_DB, direct_path, power_at_reader
from testbed.scene import Body, Scene, Truth
from testbed.sensors.rfid import Rfid
from testbed.types import Tags
from worlds.raycast import BoxCaster

SECONDS = 4.0


class Wall:
    """A caster with one opaque plane x = 3 (metres), moving or not; `None` for a free hall."""

    def __init__(self, loss=40.0, x=3.0, moving=False):
        self.loss, self.x, self.is_moving = loss, x, moving

    def _cut(self, start, end):
        cut = (start[:, 0] < self.x) != (end[:, 0] < self.x) if self.x is not None else np.zeros(len(start), bool)
        return Obstruction(count=cut.astype(np.int32), loss=self.loss * cut)

    def _none(self, start):
        return Obstruction(count=np.zeros(len(start)), loss=np.zeros(len(start)))

    def static(self, start, end):
        return self._none(start) if self.is_moving else self._cut(start, end)

    def moving(self, start, end, poses, instant):
        assert poses.shape[1:] == (1, 7)
        assert instant.max(initial=0) < len(poses)
        return self._cut(start, end) if self.is_moving else self._none(start)


def scene():
    bodies = (Body("gate", "gate", frames.IDENTITY), Body("t1", "trolley", frames.IDENTITY, moving=True))
    q = np.tile(frames.from_euler(0.0), (2, 1))
    mounts = Mounts(
        name=["gate.low", "gate.high"],
        group=["gate"] * 2,
        use=["antenna"] * 2,
        body=[0, 0],
        position=[[0, 0, 0.5], [0, 0, 2]],
        quaternion=q,
    )
    return Scene(bodies, Boxes.empty(), (), np.array([[-9, -9, 0], [9, 9, 3]]), mounts)


def rolling(speed=1.0, x0=1.0):
    t = np.arange(int(SECONDS * 120) + 1) / 120
    poses = np.tile(frames.IDENTITY, (len(t), 1, 1))
    poses[:, 0, 0] = x0 + speed * t
    return Truth(t=t, poses=poses, bodies=("t1",))


def tagged(ids=("a",), places=((0.0, 0.0, 1.0),), body=0):
    poses = np.array([[*p, 1, 0, 0, 0] for p in places])
    return Tagged(Tags(id=np.array(ids), gain=np.full(len(ids), 2.0), sensitivity=np.full(len(ids), -19.5)), np.full(len(ids), body), poses)


def sensed(config=None, tags=None, caster=None, truth=None, trial=0, id="portal", first=0):
    tags = tags or tagged()
    quiet = {
        "antennas": {"position_m": [0, 0, 1]},
        "fading_db": 0,
        "rssi_noise_db": 0,
        "rssi_step_db": 0,
        "phase_noise_rad": 0,
        "phase_offsets": False,
    }
    sensor = Rfid(Rfid.Config.model_validate({**quiet, **(config or {})}), id, scene())
    around = Surroundings(scene(), truth or rolling(), tags, ["t1"], np.array([0]), SECONDS, caster or Wall(x=None), 5, trial)
    return sensor.sense(around, first)


def test_rssi_of_a_quiet_reader_is_the_link_budget():
    reads = sensed().streams["reads"]
    assert len(reads) > 0.9 * 180 * SECONDS * 0.04 / 0.042
    distance = 1.0 + reads.t
    frequency = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])[reads.channel]
    h = direct_path(distance, frequency, 6.0 + 2.0 - POLARISATION_DB, 0.0)
    np.testing.assert_allclose(reads.rssi, power_at_reader(h, 29.0, 8.0), atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * reads.phase), np.exp(2j * np.angle(h)), atol=1e-4)
    assert len(np.unique(reads.channel)) == 4


def test_reads_stop_where_the_wall_begins():
    opaque = sensed(caster=Wall(loss=40.0, x=3.0))
    assert opaque.streams["reads"].t.max() < 2.0  # the tag passes x = 3 m at t = 2 s
    assert opaque.streams["reads"].t.max() > 1.9
    assert opaque.shares["line_of_sight"][0] == pytest.approx(0.5, abs=0.02)


def test_a_thin_wall_costs_twice_its_decibels():
    thin, free = (sensed(caster=Wall(loss=4.0, x=x)).streams["reads"] for x in (3.0, None))
    assert np.array_equal(thin.t, free.t)  # neither margins nor draws change
    np.testing.assert_allclose(free.rssi - thin.rssi, np.where(thin.t > 2.0, 8.0, 0.0), atol=1e-9)


def test_a_moving_obstacle_counts_as_well():
    assert sensed(caster=Wall(x=3.0, moving=True)).streams["reads"].t.max() < 2.0


def test_beyond_its_sensitivity_a_tag_is_silent_and_its_rounds_are_still_there():
    far = sensed(truth=rolling(speed=0.0, x0=60.0)).streams
    assert len(far["reads"]) == 0
    assert len(far["counts"]) == 0
    assert len(far["rounds"]) == len(sensed().streams["rounds"]) > 0


def test_counts_are_the_reads_of_the_rounds():
    streams = sensed({"antennas": {"on": "gate"}}).streams
    rounds, counts, reads = streams["rounds"], streams["counts"], streams["reads"]
    assert counts.n.sum() == len(reads)
    assert (counts.n <= rounds.queries[counts.round]).all()
    assert np.array_equal(rounds.antenna[counts.round], counts.antenna)
    of_first = reads.t[(reads.t >= rounds.t_start[counts.round[0]]) & (reads.t <= rounds.t_end[counts.round[0]])]
    assert len(of_first) == counts.n[0]


def test_many_tags_read_each_other_down():
    ids = [f"tag{i}" for i in range(60)]
    many = sensed(tags=tagged(ids, [(0.0, i / 100, 1.0) for i in range(60)]), truth=rolling(0.0)).streams["reads"]
    alone = sensed(truth=rolling(0.0)).streams["reads"]
    assert len(many) == pytest.approx(len(alone), rel=0.05)
    assert (many.tag == 0).sum() < len(alone) / 30


def test_adding_a_tag_out_of_reach_or_a_sensor_changes_no_read():
    noisy = {"fading_db": 2.0, "rssi_noise_db": 1.0, "phase_noise_rad": 0.1, "phase_offsets": True}
    one = sensed(noisy).streams["reads"]
    two = sensed(noisy, tags=tagged(("a", "far"), ((0, 0, 1), (0, 500, 1)))).streams["reads"]
    assert one.equals(two)
    assert not one.equals(sensed(noisy, id="other").streams["reads"])
    assert one.equals(sensed(noisy, first=3).streams["reads"].with_(antenna=np.zeros(len(one))))


def test_adding_an_antenna_moves_no_draw_of_another():
    noisy = {"fading_db": 2.0, "rssi_noise_db": 1.0, "phase_noise_rad": 0.1, "region": "etsi"}
    here = {"id": "x", "position_m": [0, 0, 1]}
    still = rolling(0.0, 2.0)
    alone = sensed({**noisy, "antennas": [here]}, truth=still).streams["reads"]
    both = sensed({**noisy, "antennas": [here, {"id": "y", "position_m": [0, 1, 1]}]}, truth=still).streams["reads"]
    mine = both.take(both.antenna == 0)
    # the antenna is served half as often, its n-th visit draws what it drew alone; only the carrier differs with the time
    np.testing.assert_allclose(mine.rssi, alone.rssi[: len(mine)], atol=0.05)


def test_the_chunk_size_changes_nothing(monkeypatch):
    config = {"fading_db": 2.0, "rssi_noise_db": 1.0, "antennas": {"on": "gate"}}
    tags = tagged(("a", "b", "c"), ((0, 0, 1), (0, 1, 1), (0, 2, 1)))
    whole = sensed(config, tags=tags)
    monkeypatch.setattr("testbed.sensors.rfid.CELLS", 7)
    cut = sensed(config, tags=tags)
    for kind in whole.streams:
        assert whole.streams[kind].equals(cut.streams[kind]), kind
    assert whole.shares == cut.shares


def empty_hall():
    return BoxCaster(scene(), np.empty(0), np.empty(0))


STRAIGHT = {"orders": 0, "diffuse": False, "edges": False}


@pytest.mark.parametrize("caster", [Wall(x=None), Wall(loss=4.0), Wall(loss=40.0), Wall(loss=40.0, moving=True)])
def test_a_channel_without_edges_reflections_and_diffuse_part_is_the_straight_path(caster):
    plain = sensed(caster=caster).streams["reads"]
    full = sensed({"channel": STRAIGHT}, caster=caster).streams["reads"]
    assert np.array_equal(plain.t, full.t)
    np.testing.assert_allclose(full.rssi, plain.rssi, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * full.phase), np.exp(1j * plain.phase), atol=1e-9)


def test_the_channel_of_a_link_does_not_depend_on_other_tags_or_on_chunks(monkeypatch):
    config, hall = {"channel": {}, "rssi_noise_db": 1.0}, empty_hall()
    one, other_trial = (sensed(config, trial=i, caster=hall).streams["reads"] for i in (0, 1))
    assert one.equals(sensed(config, caster=hall, tags=tagged(("a", "far"), ((0, 0, 1), (0, 500, 1)))).streams["reads"])
    assert not one.equals(other_trial)
    monkeypatch.setattr("testbed.sensors.rfid.CELLS", 7)
    assert one.equals(sensed(config, caster=hall).streams["reads"])


def test_a_floor_and_a_diffuse_part_make_rssi_wave_where_free_space_falls():
    free, full = sensed().streams["reads"], sensed({"channel": {}}, caster=empty_hall()).streams["reads"]
    assert np.all(np.diff(free.rssi[free.channel == 0]) < 0)  # the tag rolls away
    assert np.ptp(np.diff(full.rssi[full.channel == 0])) > 1.0


def test_fading_from_dwell_to_dwell_is_left_to_the_channel_where_there_is_one():
    antennas = {"position_m": [0, 0, 1]}
    assert Rfid.Config.model_validate({"antennas": antennas}).fade_db == 1.0
    assert Rfid.Config.model_validate({"antennas": antennas, "channel": {}}).fade_db == 0.0
    assert Rfid.Config.model_validate({"antennas": antennas, "channel": {}, "fading_db": 2}).fade_db == 2.0


def test_trials_differ_and_repeat():
    config = {"fading_db": 2.0}
    first, again, other = (sensed(config, trial=i).streams["reads"] for i in (0, 0, 1))
    assert first.equals(again)
    assert not first.equals(other)


def test_phase_offsets_belong_to_the_hardware_and_stay_from_trial_to_trial():
    still = rolling(0.0, 2.0)
    a, b = (sensed({"phase_offsets": True}, trial=i, truth=still).streams["reads"] for i in (0, 1))
    for channel in range(4):
        spread = np.concatenate([r.phase[r.channel == channel] for r in (a, b)])
        assert np.ptp(spread) < 1e-9


@pytest.mark.parametrize(
    ("antennas", "message"),
    [
        ({"on": "gat"}, "did you mean gate"),
        ({"on": "gate", "count": 3}, "offers 2 antenna mounts"),
        ({"on": "gate", "mount": "mid*"}, "offers 0 antenna mounts"),
        ({"on": "*", "position_m": [0, 0, 0]}, "fits 2 bodies"),
        ({"position_m": [0, 0, 1], "aim_m": [0, 0, 1]}, "aim it elsewhere"),
        ([{"id": "x", "position_m": [0, 0, 1]}, {"id": "x", "position_m": [0, 0, 2]}], "there twice"),
    ],
)
def test_an_antenna_that_cannot_be_placed_is_named(antennas, message):
    with pytest.raises(ValueError, match=message):
        Rfid(Rfid.Config.model_validate({"antennas": antennas}), "portal", scene())


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"antennas": []}, "at least 1"),
        ({"antennas": {"on": "gate"}, "power_dbm": 31}, "ETSI EN 302 208"),
        ({"antennas": {"on": "gate", "gain_dbi": 9}, "region": "fcc"}, "FCC 15.247"),
        ({"antennas": {"mount": "low"}}, "says neither where it is"),
        ({"antennas": {"on": "gate", "id": "a"}}, "named after the mount"),
    ],
)
def test_a_reader_that_is_not_allowed_is_refused(config, message):
    with pytest.raises(ValidationError, match=message):
        Rfid.Config.model_validate(config)


def test_an_antenna_on_a_moving_body_rides_with_it():
    reads = sensed({"antennas": {"on": "t1", "position_m": [-1.0, 0, 1]}}).streams["reads"]
    assert np.ptp(reads.rssi[reads.channel == 0]) < 1e-9  # always one metre from its own tag
