"""Each artefact alone does what it says and nothing else; all off, a reader says what is. Fixed seeds; false alarms are stated."""

import numpy as np
import pytest

from testbed.radio.artefacts import OFF, Answers, Artefacts, ArtefactsConfig, phase_noise
from testbed.radio.profiles import PROFILES
from testbed.rng import keys_of
from testbed.units import wrap, wrap_positive

N = 20_000
PORTS = keys_of(["a", "b", "c", "d"])
TAGS = keys_of([f"t{i}" for i in range(7)])


def answers(n=N, received=-50.0, same=False, **changes):
    i = np.arange(n)
    told = {
        "antenna": np.zeros(n, int) if same else i % 4,
        "tag": np.zeros(n, int) if same else i % 7,
        "visit": i,
        "count": np.zeros(n, int),
        "channel": np.zeros(n, int) if same else i % 5,
        "t": i * 0.01003,
        "received": np.full(n, received),
        "phase": wrap_positive(0.37 * i),
        "doppler": 3.0 * np.sin(i),
    }
    return Answers(**{**told, **changes})


def reported(said, name="r420", trial=0, ports=PORTS, **on):
    config = ArtefactsConfig(**{**OFF.model_dump(), **on})
    return Artefacts(config, PROFILES[name], 1, trial, "sensors.portal", ports, TAGS).reported(said)


def test_with_everything_off_a_reader_says_what_is():
    said = answers()
    reads = reported(said)
    for name in ("antenna", "tag", "channel", "t", "doppler"):
        assert np.array_equal(getattr(reads, name), getattr(said, name)), name
    assert np.array_equal(reads.rssi, said.received)
    assert np.array_equal(reads.t_arrival, said.t)
    np.testing.assert_allclose(wrap(reads.phase - said.phase), 0.0, atol=1e-12)
    assert (reads.phase >= 0).all()
    assert (reads.phase < 2 * np.pi).all()


@pytest.mark.parametrize(
    ("received", "low", "high"), [(-55.0, 0.0199, 0.0201), (-76.0, 0.05, 0.1), (-84.0, 0.05, 0.11), (-30.0, 0.004, 0.02)]
)
def test_phase_noise_is_small_when_strong_and_larger_near_the_floor(received, low, high):
    assert low <= phase_noise(0.02, np.array(received)) <= high
    said = answers(received=received)
    off = wrap(reported(said, phase_noise_rad=0.02).phase - said.phase)
    # the spread of 20,000 draws has a standard error of 0.5 %: 5 sigma
    assert off.std() == pytest.approx(phase_noise(0.02, np.array(received)), rel=0.025)


def test_a_phase_offset_is_constant_for_reader_port_carrier_and_tag_and_stays_from_trial_to_trial():
    said = answers()
    off = [wrap(reported(said, trial=i, phase_offsets=True).phase - said.phase) for i in (0, 1)]
    np.testing.assert_allclose(wrap(off[0] - off[1]), 0.0, atol=1e-9)
    cell = said.antenna * 100 + said.tag * 10 + said.channel
    for c in np.unique(cell):
        assert np.ptp(np.exp(1j * off[0][cell == c]).real) < 1e-9
    by_cell = np.array([off[0][cell == c][0] for c in np.unique(cell)])
    assert len(np.unique(by_cell.round(6))) > 100
    # 140 sums of uniform angles, the parts of which are shared: their mean resultant is well below that of a constant
    assert abs(np.exp(1j * by_cell).mean()) < 0.5


def test_between_two_carriers_the_offset_changes_alike_for_all_tags_of_a_port():
    n = 28
    said = answers(n, antenna=np.zeros(n, int), tag=np.arange(n) % 7, channel=np.arange(n) // 7)
    off = wrap(reported(said, phase_offsets=True).phase - said.phase).reshape(4, 7)
    np.testing.assert_allclose(wrap(np.diff(off, axis=0) - np.diff(off, axis=0)[:, :1]), 0.0, atol=1e-9)


@pytest.mark.parametrize(("ports", "received", "low", "high"), [(1, -50.0, 0, 0.005), (1, -80.0, 0.02, 0.06), (4, -50.0, 0.08, 0.2)])
def test_consecutive_reads_jump_by_pi_as_often_as_on_real_readers(ports, received, low, high):
    # of 20,000 pairs: a share of 0.13 has a standard error of 0.0024, and the range is farther off than 5 of them
    said = answers(received=received, same=True)
    off = wrap(reported(said, ports=PORTS[:ports], flip_probability=None).phase - said.phase)
    jumps = np.abs(np.abs(wrap(np.diff(off))) - np.pi) < 0.5
    assert low <= jumps.mean() <= high
    assert jumps.any() == (high > 0.01)


def test_a_flip_is_by_pi_exactly_and_as_often_as_asked():
    said = answers()
    off = np.abs(wrap(reported(said, flip_probability=0.25).phase - said.phase))
    assert set(off.round(9)) <= {0.0, round(np.pi, 9)}
    assert (off > 1).mean() == pytest.approx(0.25, abs=5 * np.sqrt(0.25 * 0.75 / N))


def test_a_reader_that_wraps_at_pi_reports_half_a_turn():
    said = answers()
    reads = reported(said, "sargas", phase_wrapped=True)
    assert reads.phase.max() < np.pi
    np.testing.assert_allclose(wrap(2 * (reads.phase - said.phase)), 0.0, atol=1e-9)
    flipped = reported(said, "sargas", phase_wrapped=True, flip_probability=0.5)
    np.testing.assert_allclose(wrap(2 * (flipped.phase - reads.phase)), 0.0, atol=1e-9)  # a flip can't be seen there


@pytest.mark.parametrize(("name", "steps"), [("r420", 1024), ("fx7500", 65536), ("sargas", 360)])
def test_phases_come_in_the_readers_steps_and_below_a_whole_turn(name, steps):
    said = answers()
    phase = reported(said, name, phase_steps=None, phase_wrapped=True).phase
    place = phase / (2 * np.pi) * steps
    np.testing.assert_allclose(place, np.round(place), atol=1e-6)
    assert place.max().round() < steps * PROFILES[name].phase_turns
    assert np.abs(wrap((phase - said.phase) / PROFILES[name].phase_turns)).max() <= (np.pi / steps) / PROFILES[name].phase_turns + 1e-9


def test_levels_doppler_and_time_come_in_steps():
    said = answers(received=-50.13)
    reads = reported(said, rssi_step_db=None, doppler_step_hz=None, time_step_s=None)
    assert (reads.rssi == -50.0).all()
    assert np.array_equal(reads.doppler * 16, np.round(reads.doppler * 16))
    assert np.abs(reads.doppler - said.doppler).max() <= 1 / 32
    np.testing.assert_allclose(reads.t * 1e6, np.round(reads.t * 1e6), atol=1e-3)
    assert (reported(said, "fx7500", rssi_step_db=None).rssi == -50.0).all()


def test_rssi_spreads_a_little_within_a_carrier_and_more_between_them():
    # 400 reads on each of 50 carriers of one port; within: 0.3 (standard error 1 %); between: 50 draws (10 %): 5 sigma
    n = 20_000
    said = answers(n, same=True, channel=np.arange(n) % 50)
    rssi = reported(said, rssi_noise_db=0.3, rssi_channel_db=0.8).rssi.reshape(-1, 50)
    assert 0.2 < rssi.std(axis=0).mean() < 0.5
    assert 0.4 < rssi.mean(axis=0).std() < 1.9
    again = reported(said, trial=3, rssi_noise_db=0.3, rssi_channel_db=0.8).rssi.reshape(-1, 50)
    np.testing.assert_allclose(again.mean(axis=0), rssi.mean(axis=0), atol=0.1)


def test_doppler_noise_is_7_hz_when_strong_and_18_at_the_floor():
    for received, expected in ((-50.0, 7.0), (-84.0, 17.5)):
        said = answers(received=received)
        noise = reported(said, doppler_noise_hz=7.0).doppler - said.doppler
        assert noise.std() == pytest.approx(expected, rel=0.025)  # 5 sigma


def test_some_rows_arrive_late_and_out_of_order():
    said = answers(n=4000)
    reads = reported(said, latency_s=0.1, late_probability=0.05, late_s=0.5)
    late = reads.t_arrival - said.t - 0.1
    assert (late >= -1e-12).all()
    assert late.max() <= 0.5
    assert (late > 1e-9).mean() == pytest.approx(0.05, abs=5 * np.sqrt(0.05 * 0.95 / 4000))
    assert (np.diff(reads.t_arrival) < 0).any()


def test_a_read_draws_by_its_own_keys_alone():
    said = answers(200)
    on = {"phase_noise_rad": 0.1, "rssi_noise_db": 1.0, "flip_probability": 0.2, "doppler_noise_hz": 5.0, "late_probability": 0.3}
    whole = reported(said, **on)
    some = np.arange(40, 90)
    part = Answers(**{name: getattr(said, name)[some] for name in Answers.__dataclass_fields__})
    assert reported(part, **on).equals(whole.take(some))
    assert not reported(said, trial=1, **on).equals(whole)


def test_one_artefact_moves_no_draw_of_another():
    said = answers(500)
    alone = reported(said, rssi_noise_db=1.0)
    both = reported(said, rssi_noise_db=1.0, phase_noise_rad=0.3, flip_probability=0.5, late_probability=0.5)
    assert np.array_equal(alone.rssi, both.rssi)
