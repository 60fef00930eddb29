"""Errands at a gate: what is drawn is what happens, in the gate's frame, and in a scenario file."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed import frames
from testbed.checks.world import check_world
from testbed.errand import Errand
from testbed.scenario import ScenarioError, from_text
from testbed.simulate import Simulator
from worlds.errands import drawn, errand_trip
from worlds.mail_hall import MailHall
from worlds.parts import floor_pose

GATES = [floor_pose(0, 0), floor_pose(6, 4.5), floor_pose(-3, 8, 2.0)]


def along(errand, gate, seed):
    """(K, 2) m: where the trip leads, in the gate's frame, from before its start to after its end."""
    trip = errand_trip(errand, gate, np.random.default_rng(seed))
    at = trip.pose(np.linspace(0, trip.arrival + 1, 400))[:, :3]
    return frames.to_local(np.broadcast_to(gate, (400, 7)), at)[:, :2]


@given(seed=st.integers(0, 10_000), gate=st.sampled_from(GATES), kind=st.sampled_from(["in", "out", "pass", "uturn"]))
@settings(max_examples=60, deadline=None)
def test_each_kind_does_what_its_name_says(seed, gate, kind):
    x, y = along(Errand(kinds=[kind]), gate, seed).T
    if kind in ("in", "out"):
        assert (x[0] < -2) == (kind == "in")
        assert np.sign(x[0]) == -np.sign(x[-1])
        through = np.abs(x) < 0.3
        assert through.any()
        assert (np.abs(y[through]) < 0.7).all()
    elif kind == "pass":
        assert (x > 2).all()
        assert np.sign(y[0]) == -np.sign(y[-1])
    else:
        assert (np.sign(x) == np.sign(x[0])).all()
        assert 1.1 < np.abs(x).min() < 2.3
        assert abs(x[-1]) > 4


def test_each_kind_is_drawn_about_as_often_as_the_others():
    kinds = [drawn(Errand(), np.random.default_rng(i))[0] for i in range(2000)]
    counts = [kinds.count(kind) for kind in ("in", "out", "pass", "uturn")]
    # χ² with 3 degrees of freedom: 16.3 is passed once in a thousand seeds
    assert sum((c - 500) ** 2 / 500 for c in counts) < 16.3


def test_the_draw_does_not_depend_on_the_kinds_that_are_allowed():
    both, alone = Errand(kinds=["in", "out"]), Errand(kinds=["in"])
    seed = next(s for s in range(50) if drawn(both, np.random.default_rng(s))[0] == "in")
    assert np.array_equal(drawn(both, np.random.default_rng(seed))[1], drawn(alone, np.random.default_rng(seed))[1])


TEXT = """
name: hall
seed: 3
trials: 2
duration_s: 16
world: {kind: mail_hall}
actors:
  - {id: t1, kind: trolley, motion: kinematic, errand: %s, tags: [{id: tag, mount: left}]}
sensors: []
"""


def test_a_scenario_sends_a_trolley_through_a_gate():
    with Simulator(from_text(TEXT % "{kinds: [in]}"), rays=False) as simulator:
        truth = simulator._world.move(simulator.scene, simulator._actors, 16.0, 3, 0)
    x = truth.poses[:, 0, 0] - 6
    assert x[0] < -4
    assert x[-1] > 4


@pytest.mark.parametrize(
    ("errand", "message"),
    [
        ("{gate: gate7}", "actor t1: its errand is at 'gate7', and the hall's gates are gate1"),
        ("{kinds: [through]}", "errand.kinds"),
        ("{outside_m: [1, 0]}", "outside_m begins at least 2 m before"),
        ("{turn_m: [2, 1]}", "turn_m is a stretch from a smaller to a larger"),
        ("{turn_m: [1, 4]}", "turn farther in, or start farther out"),
    ],
)
def test_mistakes_are_told(errand, message):
    with pytest.raises((ScenarioError, ValueError), match=message):
        Simulator(from_text(TEXT % errand), rays=False).close()


def test_the_hall_is_a_world():
    check_world(MailHall, MailHall.Config(gates=2))


def test_parked_trolleys_look_at_the_passage():
    hall = MailHall(MailHall.Config(parked_trolleys=8))
    gate = hall.scene([]).bodies[[b.kind for b in hall.scene([]).bodies].index("gate")].pose
    for part in hall.parts():
        if part.kind == "trolley":
            front = part.mounts.position[list(part.mounts.name).index("front")]
            at = frames.to_local(gate, frames.to_world(part.pose, front))
            middle = frames.to_local(gate, part.pose[:3])
            assert 1.4 < abs(at[1]) < abs(middle[1])
