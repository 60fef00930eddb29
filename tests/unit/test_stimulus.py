"""The figures by which streams of readers are compared, on streams made so that the figures are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from testbed import frames
from testbed.radio.links import Ends
from testbed.sensors.stimulus import ABOUT, BORESIGHT, stream_figures
from testbed.types import Reads


def setting(antennas=((0.0, 0.0, 1.0),), tags=((2.0, 0.0, 1.0),), moving=()):
    def ends(places):
        return Ends(np.full(len(places), -1), np.array([[*place, *frames.from_euler(0.0)] for place in places]))

    far = ends(tags)
    for tag in moving:
        far.body[tag] = 0
    return SimpleNamespace(near=ends(antennas), far=far)


def reads(t, antenna=0, tag=0, channel=0, rssi=-50.0, phase=0.0):
    n = len(t)
    fill = {"antenna": antenna, "tag": tag, "channel": channel, "rssi": rssi, "phase": np.mod(phase, 2 * np.pi)}
    return Reads(t=t, t_arrival=t, **{name: np.broadcast_to(value, n) for name, value in fill.items()})


def test_gaps_are_between_reads_of_one_tag_by_one_antenna():
    stream = Reads.concatenate([reads(np.arange(11) * 0.1), reads(np.arange(11) * 0.3 + 0.05, antenna=1), reads(np.arange(3.0), tag=1)])
    found = stream_figures(stream, setting(((0, 0, 1), (0, 1, 1)), ((2, 0, 1), (2, 1, 1))))
    gaps = [0.1] * 10 + [0.3] * 10 + [1.0] * 2
    for q in (50, 90):
        assert found[f"gap_p{q}_s"] == (pytest.approx(np.percentile(gaps, q)), 22)


def test_the_spread_of_the_phase_is_that_of_each_carrier_and_of_standing_tags_only():
    rng = np.random.default_rng(1)
    parts = [reads(np.arange(400) / 10, channel=c, phase=1.7 * c + s * rng.normal(size=400)) for c, s in enumerate((0.01, 0.03, 0.1))]
    found = stream_figures(Reads.concatenate(parts), setting())
    assert found["phase_std_p50_rad"][0] == pytest.approx(0.03, rel=0.15)
    assert found["phase_std_p90_rad"][0] == pytest.approx(0.086, rel=0.15)
    assert found["phase_std_p10_rad"][1] == 3
    assert np.isnan(stream_figures(Reads.concatenate(parts), setting(moving=[0]))["phase_std_p50_rad"][0])


def test_a_steady_phase_has_no_spread():
    assert stream_figures(reads(np.arange(20.0), phase=1.0), setting())["phase_std_p50_rad"][0] == pytest.approx(0, abs=1e-7)


def test_jumps_are_turns_by_pi_between_consecutive_reads_of_one_link_and_carrier():
    flipped = np.pi * np.isin(np.arange(100), [20, 21, 50])
    found = stream_figures(reads(np.arange(100.0), phase=6.2 + flipped + 0.3 * (-1.0) ** np.arange(100)), setting())
    assert found["phase_jump_share"] == (pytest.approx(4 / 99), 99)
    drift = stream_figures(reads(np.arange(100.0), phase=np.arange(100) * (np.pi - ABOUT - 0.01)), setting())
    assert drift["phase_jump_share"][0] == 0
    two = Reads.concatenate([reads(np.arange(50.0), phase=0.0), reads(np.arange(50.0) + 0.5, channel=1, phase=np.pi)])
    assert stream_figures(two, setting())["phase_jump_share"][0] == 0


def test_rssi_over_carriers_and_over_distance():
    parts = [reads(np.arange(10.0), channel=c, rssi=-50.0 + off) for c, off in enumerate((-1.0, 0.0, 1.0))]
    found = stream_figures(Reads.concatenate(parts), setting())
    assert found["rssi_channel_std_db"] == (pytest.approx(np.sqrt(2 / 3)), 1)
    places = [(1, 0, 1), (2, 0, 1), (3, 0, 1), (4, 0, 1), (1, 3, 1)]
    heard = [-40.0, -55.0, -50.0, -53.0, -20.0]  # the third beats the second by 5 dB; the last is off boresight
    ladder = Reads.concatenate([reads(np.arange(10.0), tag=i, rssi=level) for i, level in enumerate(heard)])
    assert stream_figures(ladder, setting(tags=places))["rssi_inversion_db"][0] == pytest.approx(5.0)
    assert np.arctan2(3, 1) > BORESIGHT
    falling = Reads.concatenate([reads(np.arange(10.0), tag=i, rssi=-40.0 - 5 * i) for i in range(4)])
    assert stream_figures(falling, setting(tags=places))["rssi_inversion_db"][0] == 0


def test_a_stream_without_reads_has_no_figures():
    assert all(np.isnan(value) and weight == 0 for value, weight in stream_figures(Reads.empty(), setting()).values())
