"""The RFID sensor in a scene without walls, and with one box, on a caster made for the test."""

import numpy as np
import pytest
from pydantic import ValidationError

from testbed import frames
from testbed.geometry import Boxes, Mounts
from testbed.protocols import Obstruction, Surroundings, Tagged
from testbed.radio.propagation import POLARISATION_DB, direct_path, power_at_reader
from testbed.scene import Body, Scene, Truth
from testbed.sensors.rfid import Rfid, _Trial
from testbed.types import Tags
from testbed.units import SPEED_OF_LIGHT
from worlds.raycast import BoxCaster

SECONDS = 4.0
STRAIGHT = {"orders": 0, "diffuse": False, "edges": False}
NOISY = {"artefacts": {"rssi_noise_db": 1.0, "phase_noise_rad": 0.1}}
CARRIERS = np.array([865.7e6, 866.3e6, 866.9e6, 867.5e6])


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


def surrounded(tags=None, caster=None, truth=None, trial=0):
    return Surroundings(
        scene(), truth or rolling(), tags or tagged(), ["t1"], np.array([0]), SECONDS, caster or Wall(x=None), 5, trial
    )  # fmt: skip


def reader(config=None, id="portal"):
    quiet = {"antennas": {"position_m": [0, 0, 1]}, "channel": STRAIGHT, "artefacts": "off"}
    return Rfid(Rfid.Config.model_validate({**quiet, **(config or {})}), id, scene())


def sensed(config=None, tags=None, caster=None, truth=None, trial=0, id="portal", first=0):
    return reader(config, id).sense(surrounded(tags, caster, truth, trial), first)


def test_rssi_and_phase_of_a_quiet_reader_are_the_link_budget():
    reads = sensed().streams["reads"]
    assert len(reads) > 150 * SECONDS
    distance = 1.0 + reads.t
    h = direct_path(distance, CARRIERS[reads.channel], 6.0 + 2.0 - POLARISATION_DB, 0.0)
    np.testing.assert_allclose(reads.rssi, power_at_reader(h, 29.0, 8.0), atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * reads.phase), np.exp(2j * np.angle(h)), atol=1e-4)
    assert len(np.unique(reads.channel)) == 4


@pytest.mark.parametrize("speed", [0.7, -0.2])
def test_with_every_artefact_off_the_phase_gives_back_the_change_of_range_to_a_tenth_of_a_millimetre(speed):
    reads = sensed({"antennas": {"position_m": [0, 0, 1.0]}}, truth=rolling(speed, 2.0)).streams["reads"]
    for channel in range(4):
        mine = reads.take(reads.channel == channel)
        apart = np.diff(mine.t) < 0.05  # where the reader stays on the carrier: less than a quarter of a wavelength
        change = -np.diff(np.unwrap(mine.phase))[apart] * SPEED_OF_LIGHT / (4 * np.pi * CARRIERS[channel])
        assert apart.sum() > 50
        np.testing.assert_allclose(change, speed * np.diff(mine.t)[apart], atol=1e-4)


@pytest.mark.parametrize("speed", [2.0, -0.2])
def test_doppler_is_positive_for_what_comes_nearer(speed):
    reads = sensed(truth=rolling(speed, 3.0)).streams["reads"]
    np.testing.assert_allclose(reads.doppler, -speed * CARRIERS[reads.channel] / SPEED_OF_LIGHT, rtol=1e-6)
    np.testing.assert_allclose(sensed(truth=rolling(0.0, 3.0)).streams["reads"].doppler, 0, atol=1e-9)


def test_reads_rssi_and_phase_at_one_instant_all_come_from_h():
    sensor, around = reader({"channel": {}}), surrounded(caster=empty_hall(), trial=2)
    reads = sensor.sense(around, 0).streams["reads"]
    response = sensor.channel(around).respond(reads.antenna, reads.tag, reads.t, reads.channel)
    np.testing.assert_allclose(reads.rssi, 29.0 + 40 * np.log10(np.abs(response.h)) - 8.0, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * reads.phase), (response.h / np.abs(response.h)) ** 2, atol=1e-9)
    assert (29.0 + 20 * np.log10(np.abs(response.h)) >= -19.5).all()  # whoever is read was awake
    later = sensor.channel(around).respond(reads.antenna, reads.tag, reads.t + 1e-3, reads.channel).h
    np.testing.assert_allclose(reads.doppler, np.angle(later / response.h) / (2 * np.pi * 1e-3), atol=1e-6)
    assert np.ptp(reads.rssi - 40 * np.log10(1 / response.distance)) > 3.0  # and h is not free space


def test_who_can_answer_is_read_whenever_asked_and_who_cannot_never():
    """Counts follow from h too: a round without a read is one in whose time the tag is not above its sensitivity throughout."""
    sensor = reader({"channel": {}, "power_dbm": 20})
    around = surrounded(caster=empty_hall(), truth=rolling(0.5, 2.0))
    streams = sensor.sense(around, 0).streams
    rounds, channel = streams["rounds"], sensor.channel(around)
    n = np.bincount(streams["counts"].round, streams["counts"].n, len(rounds))
    t = np.linspace(rounds.t_start, rounds.t_end, 9).ravel()
    zero = np.zeros(len(t), dtype=int)
    margin = 20.0 + 20 * np.log10(np.abs(channel.respond(zero, zero, t, sensor.carrier(around, zero, t)).h)) + 19.5
    margin = margin.reshape(9, -1)
    assert (n[margin.max(axis=0) < 0] == 0).all()
    assert (margin.max(axis=0) < 0).any()
    strong = margin.min(axis=0) > 3.0
    assert strong.any()
    assert (n[strong] == rounds.queries[strong]).all()


def test_a_reader_may_use_some_carriers_in_an_order_of_its_own():
    reads = sensed({"carriers_mhz": [867.5, 865.7]}).streams["reads"]
    assert set(reads.channel) == {0, 1}
    h = direct_path(1.0 + reads.t, np.array([867.5e6, 865.7e6])[reads.channel], 0.0, 0.0)
    np.testing.assert_allclose(np.exp(1j * reads.phase), np.exp(2j * np.angle(h)), atol=1e-4)


def test_counts_of_the_published_model_have_no_reads_beside_them():
    config = {"detection": {"kind": "logistic_beta", "queries": 7}, "antennas": {"on": "gate"}}
    made = sensed(config, caster=empty_hall(), truth=rolling(0.0, 2.0))
    assert len(made.streams["reads"]) == 0
    assert (made.streams["rounds"].queries == 7).all()
    assert made.streams["counts"].n.sum() > 0
    assert not sensed({"detection": "link"}, caster=empty_hall()).streams["counts"].equals(made.streams["counts"])


def test_reads_stop_where_the_wall_begins():
    opaque = sensed(caster=Wall(loss=40.0, x=3.0))
    assert opaque.streams["reads"].t.max() < 2.0  # the tag passes x = 3 m at t = 2 s
    assert opaque.streams["reads"].t.max() > 1.9
    assert opaque.shares["line_of_sight"][0] == pytest.approx(0.5, abs=0.06)  # of nine looks


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
    assert len(far["rounds"]) > 0
    assert (far["rounds"].queries > 0).all()


def test_counts_are_the_reads_of_the_rounds():
    streams = sensed({"antennas": {"on": "gate"}}).streams
    rounds, counts, reads = streams["rounds"], streams["counts"], streams["reads"]
    assert counts.n.sum() == len(reads)
    assert (counts.n <= rounds.queries[counts.round]).all()
    assert np.array_equal(rounds.antenna[counts.round], counts.antenna)
    for k in (0, len(counts) // 2, len(counts) - 1):
        first, last = rounds.t_start[counts.round[k]], rounds.t_end[counts.round[k]]
        assert ((reads.t > first) & (reads.t <= last)).sum() == counts.n[k]


def test_visits_take_turns_and_never_overlap():
    rounds = sensed({"antennas": {"on": "gate"}}).streams["rounds"]
    assert np.array_equal(rounds.antenna, np.arange(len(rounds)) % 2)
    assert (rounds.t_start[1:] > rounds.t_end[:-1]).all()
    assert rounds.t_end[-1] <= SECONDS


def test_readers_with_a_port_each_work_at_the_same_time():
    config = {"antennas": {"on": "gate"}, "reader": {"ports": 1}}
    rounds = sensed(config, truth=rolling(0.0)).streams["rounds"]
    assert set(rounds.reader) == {0, 1}
    both = [rounds.take(rounds.antenna == a) for a in (0, 1)]
    assert (both[0].t_start[1:] < both[1].t_end[:-1]).any()
    one = sensed({"antennas": {"on": "gate"}}, truth=rolling(0.0)).streams["reads"]
    assert len(sensed(config, truth=rolling(0.0)).streams["reads"]) > 1.8 * len(one)


def test_many_tags_read_each_other_down():
    ids = [f"tag{i}" for i in range(60)]
    many = sensed(tags=tagged(ids, [(0.0, i / 100, 1.0) for i in range(60)]), truth=rolling(0.0)).streams["reads"]
    alone = sensed(truth=rolling(0.0)).streams["reads"]
    assert 0.5 * len(alone) < len(many) < 3 * len(alone)
    assert (many.tag == 0).sum() < len(alone) / 20


def test_select_and_a_session_flag_leave_tags_out_and_say_so():
    tags = tagged(("a1", "a2", "b1"), ((0, 0, 1), (0, 0.5, 1), (0, 1, 1)))
    chosen = sensed({"reader": {"select": "a*"}}, tags=tags, truth=rolling(0.0))
    assert set(chosen.streams["reads"].tag) == {0, 1}
    assert np.array_equal(chosen.asked_sets[chosen.streams["rounds"].asked[0]], [True, True, False])
    single = sensed({"reader": {"profile": "r420", "session": 1, "dual_target": False}}, tags=tags, truth=rolling(0.0))
    rounds, reads = single.streams["rounds"], single.streams["reads"]
    for visit in range(len(rounds)):
        silent = np.flatnonzero(~single.asked_sets[rounds.asked[visit]])
        inside = (reads.t > rounds.t_start[visit]) & (reads.t <= rounds.t_end[visit])
        assert not np.isin(silent, reads.tag[inside]).any()
    assert (rounds.asked > 0).sum() > len(rounds) / 2  # most of the time all flags are set
    assert len(reads) < 3 * SECONDS / 0.5 + 3


def test_adding_a_tag_out_of_reach_or_a_sensor_changes_no_read():
    one = sensed(NOISY).streams["reads"]
    two = sensed(NOISY, tags=tagged(("a", "far"), ((0, 0, 1), (0, 500, 1)))).streams["reads"]
    assert one.equals(two)
    assert not one.equals(sensed(NOISY, id="other").streams["reads"])
    assert one.equals(sensed(NOISY, first=3).streams["reads"].with_(antenna=np.zeros(len(one))))


def test_adding_an_antenna_moves_no_draw_of_another():
    here = {"id": "x", "position_m": [0, 0, 1]}
    still = rolling(0.0, 2.0)
    quiet = {
        "artefacts": {"rssi_step_db": 0, "rssi_channel_db": 0, "rssi_noise_db": 1.0, "late_probability": 0},
        "reader": {"longest_visit_s": 0.01},
    }
    alone = sensed({**quiet, "antennas": [here, {"id": "y", "position_m": [0, 1, 1]}]}, truth=still).streams["reads"]
    more = sensed({**quiet, "antennas": [here, {"id": "z", "position_m": [0, 2, 1]}, {"id": "y", "position_m": [0, 1, 1]}]}, truth=still)
    mine, reads = more.streams["reads"].take(more.streams["reads"].antenna == 0), alone.take(alone.antenna == 0)
    # the antenna is served less often, its n-th visit draws what it drew before; only the carrier differs with the time
    np.testing.assert_allclose(mine.rssi, reads.rssi[: len(mine)], atol=0.05)


def test_the_size_of_the_blocks_changes_nothing(monkeypatch):
    config = {**NOISY, "antennas": {"on": "gate"}}
    tags = tagged(("a", "b", "c"), ((0, 0, 1), (0, 1, 1), (0, 2, 1)))
    whole = sensed(config, tags=tags)
    monkeypatch.setattr("testbed.sensors.rfid.CELLS", 7)
    cut = sensed(config, tags=tags)
    for kind in whole.streams:
        assert whole.streams[kind].equals(cut.streams[kind]), kind
    assert whole.shares == cut.shares


def test_a_reader_of_many_ports_is_asked_only_for_those_it_may_come_by(monkeypatch):
    antennas = [{"id": f"x{i}", "position_m": [0, i / 10, 1]} for i in range(24)]
    config = {**NOISY, "antennas": antennas, "reader": "r420"}
    narrow = sensed(config, truth=rolling(1.5, 0.5))
    asked = []
    monkeypatch.setattr(_Trial, "_blocks", lambda self: asked.append(0) or [(0, 20), (20, 40)])
    wide = sensed(config, truth=rolling(1.5, 0.5))
    assert asked
    for kind in wide.streams:
        assert wide.streams[kind].equals(narrow.streams[kind]), kind
    assert len(np.unique(narrow.streams["rounds"].antenna)) == 24


def empty_hall():
    return BoxCaster(scene(), np.empty(0), np.empty(0))


def test_the_channel_of_a_link_does_not_depend_on_other_tags_or_on_blocks(monkeypatch):
    config, hall = {"channel": {}, **NOISY}, empty_hall()
    one, other_trial = (sensed(config, trial=i, caster=hall).streams["reads"] for i in (0, 1))
    assert one.equals(sensed(config, caster=hall, tags=tagged(("a", "far"), ((0, 0, 1), (0, 500, 1)))).streams["reads"])
    assert not one.equals(other_trial)
    monkeypatch.setattr("testbed.sensors.rfid.CELLS", 7)
    assert one.equals(sensed(config, caster=hall).streams["reads"])


def test_a_floor_and_a_diffuse_part_make_rssi_wave_where_free_space_falls():
    free, full = sensed().streams["reads"], sensed({"channel": {}}, caster=empty_hall()).streams["reads"]
    assert np.all(np.diff(free.rssi[free.channel == 0]) < 0)  # the tag rolls away
    assert np.ptp(np.diff(full.rssi[full.channel == 0])) > 1.0


def test_trials_differ_and_repeat():
    first, again, other = (sensed(NOISY, trial=i).streams["reads"] for i in (0, 0, 1))
    assert first.equals(again)
    assert not first.equals(other)


def test_phase_offsets_belong_to_the_hardware_and_stay_from_trial_to_trial():
    still = rolling(0.0, 2.0)
    config = {"artefacts": {"phase_noise_rad": 0, "flip_probability": 0, "phase_steps": 0}}
    a, b = (sensed(config, trial=i, truth=still).streams["reads"] for i in (0, 1))
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
        ({"antennas": {"on": "gate"}, "reader": "r42"}, "did you mean r420"),
        ({"antennas": {"on": "gate"}, "reader": {"session": 4}}, "session"),
        ({"antennas": {"on": "gate"}, "artefacts": "of"}, "artefacts"),
        ({"antennas": {"on": "gate"}, "carriers_mhz": [866.3, 902.75]}, "902.75 MHz is no carrier of the region 'etsi'"),
    ],
)
def test_a_reader_that_is_not_allowed_is_refused(config, message):
    with pytest.raises(ValidationError, match=message):
        Rfid.Config.model_validate(config)


def test_an_antenna_on_a_moving_body_rides_with_it():
    reads = sensed({"antennas": {"on": "t1", "position_m": [-1.0, 0, 1]}}).streams["reads"]
    assert np.ptp(reads.rssi[reads.channel == 0]) < 1e-9  # always one metre from its own tag
