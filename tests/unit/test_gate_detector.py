"""The detector at a gate on reads drawn from a model of the tests' own, and what breaks it."""

from __future__ import annotations

import numpy as np
import pytest
from gate_recordings import antennas, recording, said, tracked, walk
from hypothesis import given, settings
from hypothesis import strategies as st

import testbed
from estimators.gate_detector import GateDetector
from testbed.gates import gates_of
from testbed.types import Status

WAYS = {
    "in": walk((-4.2, 0.3), (4.2, -0.2), start=2),
    "out": walk((4.2, 0.4), (-4.2, 0.1), start=2),
    "uturn": walk((-4.2, 0.0), (-1.0, 0.2), (-4.2, 0.2), start=2),
    "pass": walk((2.5, -4.0), (2.5, 4.0), start=2),
    "inside": walk((1.0, 2.05), (1.0, 2.05)),
    "outside": walk((-1.0, -2.1), (-1.0, -2.1)),
}
ROW = {name: i for i, name in enumerate(WAYS)}


@pytest.fixture(scope="module")
def made():
    return recording(list(WAYS.values()), 14.0)


@pytest.fixture(scope="module")
def found(made):
    return tracked([made], GateDetector, hints=[1, 3, 9])


def moves(track, name):
    return [what for what in said(track, ROW[name]) if what in ("in", "out")]


def test_who_goes_in_comes_in_and_who_goes_out_has_left(found):
    assert moves(found, "in") == ["in"]
    assert moves(found, "out") == ["out"]
    for row in (ROW["in"], ROW["out"]):
        t = found.decisions.t[(found.decisions.row == row) & np.isin(found.decisions.what, ("in", "out"))][0]
        assert 6.0 < t < 8.2  # 4.2 m at 1 m/s from 2 s on, and no more than 2 s later


def test_nobody_else_has_moved(found):
    for name in ("uturn", "pass", "inside", "outside"):
        assert moves(found, name) == []
    assert said(found, ROW["inside"]) == said(found, ROW["outside"]) == []
    assert said(found, ROW["pass"]) == ["pass"]


def test_hints_rise_and_decisions_keep_their_odds(found):
    own = found.decisions.take(found.decisions.row == ROW["in"])
    moved = own.take(np.isin(own.what, ("in?", "in")))
    assert moved.what.tolist()[-1] == "in"
    assert len(moved) > 1
    assert (np.diff(moved.probability) > 0).all()
    assert moved.probability[-1] >= 0.99
    assert moved.probability[0] >= 0.5


def test_without_hints_the_decisions_are_the_same(made, found):
    plain = tracked([made], GateDetector).decisions
    assert not np.char.endswith(plain.what, "?").any()
    kept = found.decisions.take(~np.char.endswith(found.decisions.what, "?"))
    assert kept.equals(plain)


def test_an_inward_direction_of_the_wrong_sign_swaps_them(made):
    turned = tracked([made], GateDetector, inward_deg=180)
    assert moves(turned, "in") == ["out"]
    assert moves(turned, "out") == ["in"]


def test_antennas_in_one_plane_that_look_the_same_way_tell_no_side(made):
    flat = tracked([recording(list(WAYS.values()), 14.0, toe_deg=0.0)], GateDetector)
    assert moves(flat, "in") == moves(flat, "out") == []


def test_antennas_taken_for_each_other_swap_in_and_out(made):
    """As if an installer had plugged the low pair into the high pair's ports: the wrong site, and so the wrong answer."""
    reads = made.streams["reads"]
    crossed = reads.with_(antenna=reads.antenna ^ 1)
    wrong = tracked([type(made)(0, made.duration, made.site, {"reads": crossed}, made.targets, made.target_tags)], GateDetector)
    assert moves(wrong, "in") == ["out"]
    assert moves(wrong, "out") == ["in"]


def test_one_that_goes_in_and_out_again_is_announced_twice():
    there_and_back = walk((-4.2, 0.0), (3.6, 0.1), (3.7, 0.0), (-4.2, 0.0), start=1)
    found = tracked([recording([there_and_back], 20.0)], GateDetector)
    assert moves(found, "in") == ["in", "out"]


def test_one_that_lingers_in_the_gate_is_not_announced_back_and_forth():
    lingering = walk((-4.2, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.2, 0.0), (-0.2, 0.1), (0.2, 0.0), (4.2, 0.0), speed=0.7, start=1)
    found = tracked([recording([lingering], 20.0)], GateDetector)
    assert moves(found, "in") == ["in"]


def test_each_of_several_gates_has_its_own():
    ways = [walk((-4.2, 9.0), (4.2, 9.2), start=1), walk((4.2, 0.0), (-4.2, 0.2), start=1)]
    found = tracked([recording(ways, 12.0, gates=2)], GateDetector)
    assert said(found, 0) == ["in"]
    assert said(found, 1) == ["out"]
    k = np.argmin(np.abs(found.t - 6.0))
    np.testing.assert_allclose(found.mean[k, :, 1], [9.1, 0.1], atol=0.9)


def test_rows_together_are_rows_alone(made, found):
    again = recording(list(WAYS.values()), 14.0, seed=2, trial=1)
    both = tracked([made, again], GateDetector, hints=[1, 3, 9])
    np.testing.assert_array_equal(both.mean[:, : len(WAYS)], found.mean)
    assert both.take(np.arange(len(WAYS))).decisions.equals(found.decisions)


def test_a_tag_that_is_never_read_is_lost_and_never_announced():
    silent = recording([walk((40.0, 40.0), (40.0, 40.0)), WAYS["in"]], 8.0)
    found = tracked([silent], GateDetector)
    assert (found.status[:, 0] == Status.LOST).all()
    assert said(found, 0) == []
    assert np.isfinite(found.mean).all()


def test_levels_that_are_none_are_not_used(made):
    reads = made.streams["reads"]
    bad = reads.with_(rssi=np.full(len(reads), np.nan))
    found = tracked([type(made)(0, made.duration, made.site, {"reads": bad}, made.targets, made.target_tags)], GateDetector)
    assert found.used.sum() == 0
    assert len(found.decisions) == 0


def test_the_estimate_follows_through_the_gate(found):
    k = np.flatnonzero((found.t >= 6.2) & (found.t <= 8))  # before it, what lies left and right of the passage is alike to the antennas
    truth = WAYS["in"](found.t[k])
    error = np.hypot(*(found.mean[k, ROW["in"], :2] - truth[:, :2]).T)
    assert error.mean() < 1.0


def test_it_keeps_the_rules_of_estimators():
    testbed.check_estimator(GateDetector)


def test_cells_that_a_step_leads_over_are_refused(made):
    with pytest.raises(ValueError, match="make cell_m larger"):
        tracked([made], GateDetector, speed_mps=4.0, step_s=0.1)


# ---------------------------------------------------------------- gates


def test_antennas_hang_together_by_name():
    found = gates_of(antennas(gates=3), 0.0)
    assert found.name == ("gate1", "gate2", "gate3")
    np.testing.assert_array_equal(found.antenna_gate, np.repeat([0, 1, 2], 4))
    np.testing.assert_array_equal(found.antenna_place, np.tile(np.arange(4), 3))
    np.testing.assert_allclose(found.origin, [[0, 0], [0, 9], [0, 18]], atol=1e-12)
    loose = antennas().with_(id=["a", "b", "c", "d"], reader=["north", "north", "south", "south"])
    assert gates_of(loose, 0.0).name == ("north", "south")


@given(inward=st.floats(-360, 360), x=st.floats(-20, 20), y=st.floats(-20, 20), gate=st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_a_gate_s_frame_and_the_world_s_are_one_turn_apart(inward, x, y, gate):
    gates, here = gates_of(antennas(gates=3), inward), np.array([x, y])
    local = gates.local(np.array(gate), here)
    np.testing.assert_allclose(gates.world(np.array(gate), local), here, atol=1e-9)
    assert np.hypot(*local) == pytest.approx(np.hypot(*(here - gates.origin[gate])), abs=1e-9)
    ahead = gates.origin[gate] + 2 * np.array([np.cos(np.radians(inward)), np.sin(np.radians(inward))])
    np.testing.assert_allclose(gates.local(np.array(gate), ahead), [2, 0], atol=1e-9)
