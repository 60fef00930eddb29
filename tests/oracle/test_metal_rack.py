"""A trolley is driven past a steel rack: line of sight, RSSI, phase and counts go and come back when geometry says.

When the rack stands in the way is found here, from the boxes and the trolley's way alone, by the slab method in float64 numpy; what
the radio does is read from the streams of a whole run. The figures without the rack are the mutation: nothing of it happens there.
"""

from functools import cache

import numpy as np
import pytest
from scipy.special import fresnel

from testbed import frames
from testbed.scenario import from_dict
from testbed.simulate import Simulator
from testbed.units import SPEED_OF_LIGHT, wrap

QUIET = {"orders": 0, "diffuse": False}
STEP = 0.1  # s: for so long a reader takes who may answer for granted; a read fails at its own time nevertheless
ROUND = 0.01  # s: with one tag and one port two reads are no farther apart


def slab(start, end, low, high):
    """(N,) bool: whether segments (N, 3) meet one axis-parallel box."""
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / way, (high - start) / way
    within = (start >= low) & (start <= high)
    first = np.where(way == 0, np.where(within, -np.inf, np.inf), np.minimum(a, b)).max(axis=1)
    last = np.where(way == 0, np.where(within, np.inf, -np.inf), np.maximum(a, b)).min(axis=1)
    return np.maximum(first, 0.0) <= np.minimum(last, 1.0)


def hidden(scene, truth, antenna, tag, t):
    """(K,) bool: whether anything at all stands between a place and a tag on the trolley at times t (K,)."""
    trolley = truth.pose(np.zeros(len(t), dtype=int), t)
    end = frames.to_world(trolley, np.tile(tag, (len(t), 1)))
    found = np.zeros(len(t), dtype=bool)
    for center, half, body in zip(scene.boxes.center, scene.boxes.half, scene.boxes.body, strict=True):
        if scene.bodies[body].moving:  # in its own frame the box is axis-parallel, whatever the trolley does
            start = frames.to_local(trolley, np.tile(antenna, (len(t), 1)))
            found |= slab(start, np.tile(tag, (len(t), 1)), center - half, center + half)
        else:
            pose = scene.bodies[body].pose
            a, b = (frames.to_local(np.tile(pose, (len(t), 1)), p) for p in (np.tile(antenna, (len(t), 1)), end))
            found |= slab(a, b, center - half, center + half)
    return found


class Run:
    """One trial past one antenna: streams, and what geometry says of them."""

    def __init__(self, rack, channel, artefacts):
        trolley = {"id": "t1", "kind": "trolley", "motion": "kinematic", "tags": [{"id": "left", "mount": "left"}]}
        trolley["route"] = {"waypoints_m": [[1.0, 2.5], [6.4, 2.5]], "speed_mps": 0.8}
        document = {
            "name": "driven-past", "seed": 3, "trials": 1, "duration_s": 7.5, "actors": [trolley],
            "world": {"kind": "rack_portal", "rack": rack},
            "sensors": [
                {"id": "side", "kind": "rfid", "antennas": {"on": "behind2", "mount": "low"}, "channel": channel, "artefacts": artefacts}
            ],
        }  # fmt: skip
        with Simulator(from_dict(document)) as simulator:
            trial = simulator.trial(0)
            scene, tagged = simulator.scene, simulator.tagged
        self.reads, self.rounds, self.counts = (trial.recording.streams[k] for k in ("reads", "rounds", "counts"))
        self.rack = next((body.pose[:3] for body in scene.bodies if body.kind == "rack"), None)
        self.antenna, self.tag = trial.recording.site.antennas.position[0], tagged.pose[0, :3]
        self.truth, self.frequencies = trial.truth, trial.recording.site.frequencies
        self.t = np.linspace(0, 7.5, 7501)
        self.blocked = hidden(scene, trial.truth, self.antenna, self.tag, self.t)

    def shadow(self):
        """(from, to) s of the one time that the tag is hidden."""
        edges = np.flatnonzero(np.diff(self.blocked.astype(int)))
        assert len(edges) == 2
        assert not self.blocked[0]
        return self.t[edges] + 0.0005

    def places(self):
        """(reads, 3) m: where the tag was."""
        t = self.reads.t
        return frames.to_world(self.truth.pose(np.zeros(len(t), dtype=int), t), np.tile(self.tag, (len(t), 1)))

    def off_range(self):
        """(reads,) rad in (-π, π]: the phase less that of the true range."""
        range_ = np.linalg.norm(self.places() - self.antenna, axis=1)
        return wrap(self.reads.phase + 4 * np.pi * self.frequencies[self.reads.channel] * range_ / SPEED_OF_LIGHT)

    def drop(self, other):
        """(reads,) dB less than `other` has at the same time. On a line over the other's reads of half a second: the channel hops."""
        return np.interp(self.reads.t, other.reads.t, other.reads.rssi) - self.reads.rssi

    def rate(self, begin, end):
        """Reads in each round that asked, between two times."""
        here = (self.rounds.t_start >= begin) & (self.rounds.t_end <= end)
        n = self.counts.n[np.isin(self.counts.round, self.rounds.round[here])].sum()
        return n / self.rounds.queries[here].sum()


@cache
def run(rack, kind):
    channel, artefacts = {
        "straight": ({**QUIET, "edges": False}, "off"),
        "edges": (QUIET, "off"),
        "whole": ({}, "off"),
        "real": ({}, {}),
    }[kind]
    return Run(rack, channel, artefacts)


def between(t, begin, end):
    return (t > begin) & (t < end)


def edge_loss(case):
    """Of the rack's nearer end as a knife edge, for each read: dB one way by the exact Fresnel integrals, of the corner that is more in
    the way and of both corners together; and the ν of the first.

    In plan, for the edges are upright and both ends are of one height. In the first half of the shadow it is the end at low x.
    """
    wavelength = SPEED_OF_LIGHT / case.frequencies.mean()
    a, end, middle = case.antenna[:2], case.places()[:, :2], case.rack[:2] - case.antenna[:2]
    side = np.where(case.reads.t < np.mean(case.shadow()), -0.6, 0.6)
    along = end - a
    d = np.linalg.norm(along, axis=1)
    nu = []
    for depth in (-0.25, 0.25):
        x, y = middle[0] + side, middle[1] + depth
        d1 = (x * along[:, 0] + y * along[:, 1]) / d
        aside = (along[:, 0] * y - along[:, 1] * x) / d
        inner = (along[:, 0] * middle[1] - along[:, 1] * middle[0]) / d
        nu.append(-np.sign(inner - aside) * aside * np.sqrt(2 / wavelength * (1 / d1 + 1 / (d - d1))))
    s, c = fresnel(np.array(nu))
    loss = -20 * np.log10(np.hypot(1 - c - s, c - s) / 2)
    return loss.max(axis=0), np.maximum(loss, 0).sum(axis=0), np.max(nu, axis=0)


# ---------------------------------------------------------------- when


def test_the_rack_hides_the_tag_once_for_as_long_as_its_corners_say():
    """By hand: the stand is at x = 4.4 with its mount at y = 5.53, the tag at y = 2.87; the rack ends at x = 3.4 and 4.6."""
    case = run(True, "straight")
    begin, until = case.shadow()
    places = frames.to_world(case.truth.pose(np.zeros(2, dtype=int), np.array([begin, until])), np.tile(case.tag, (2, 1)))
    to_tag, front, back = case.antenna[1] - places[0, 1], case.antenna[1] - (3.8 - 0.25), case.antenna[1] - (3.8 + 0.25)
    first = min(case.antenna[0] + (3.4 - case.antenna[0]) * to_tag / y for y in (front, back))
    last = max(case.antenna[0] + (4.6 - case.antenna[0]) * to_tag / y for y in (front, back))
    assert places[:, 0] == pytest.approx([first, last], abs=1e-3)
    assert not run(False, "straight").blocked.any()


def test_with_straight_rays_reads_end_and_begin_with_the_line_of_sight():
    """No read from the first hidden instant to the last; before and after at most a round, or a step of the reader's, is missing."""
    case = run(True, "straight")
    begin, until = case.shadow()
    t = case.reads.t
    assert not between(t, begin, until).any()
    assert 0 <= begin - t[t <= begin].max() < STEP / 2 + ROUND
    assert 0 <= t[t >= until].min() - until < STEP / 2 + ROUND
    assert case.rate(begin + STEP, until - STEP) == 0
    assert case.rate(begin - 1.0, begin - STEP) > 0.7
    assert case.rate(until + STEP, until + 1.0) == 1.0
    assert np.abs(case.off_range()).max() < 4 * np.pi / 0.346 * 1e-4  # 0.1 mm


def test_reads_are_asked_for_all_the_time_and_counted_as_none_in_the_shadow():
    case = run(True, "straight")
    begin, until = case.shadow()
    inside = between(case.rounds.t_start, begin, until)
    assert case.rounds.queries[inside].sum() > 100
    assert not np.isin(case.counts.round, case.rounds.round[inside & (case.rounds.t_end < until)]).any()
    assert case.counts.n.sum() == len(case.reads)


# ---------------------------------------------------------------- how much


def test_rssi_falls_and_rises_as_over_a_knife_edge():
    """One way, against the exact integrals: 6.0 dB when the edge is grazed (within 0.2 dB), and within 1.5 dB for ν in [-1, 0.3].

    The 1.4 dB by which a wave that passes an edge is stronger are left out by the model. Deeper in, a rack 0.5 m thick has a second
    corner in the way: no less than the first one's loss, no more than both together.
    """
    case, free = run(True, "edges"), run(False, "edges")
    loss, both, nu = edge_loss(case)
    found = case.drop(free) / 2
    for half in (case.reads.t < 3.8, case.reads.t > 3.8):
        near = (nu > -1) & (nu < 0.3) & half
        assert near.sum() > 100
        assert np.abs(found - loss)[near].max() < 1.5
        grazing = np.argmin(np.where(half, np.abs(nu), np.inf))
        assert found[grazing] == pytest.approx(6.02, abs=0.2)
    deep = nu > 0.3
    assert deep.sum() > 30
    assert (found > loss - 0.5)[deep].all()
    assert (found < both + 0.5)[deep].all()


def test_the_edge_is_grazed_when_the_slab_test_says_so():
    case = run(True, "edges")
    begin, until = case.shadow()
    _, _, nu = edge_loss(case)
    t = case.reads.t
    assert np.interp(0, nu[t < 3], t[t < 3]) == pytest.approx(begin, abs=0.01)
    assert np.interp(0, -nu[t > 4.8], t[t > 4.8]) == pytest.approx(until, abs=0.01)


def test_the_phase_follows_the_range_outside_and_a_longer_way_inside():
    """A way round is longer, so the phase lags: nothing outside, more the deeper in the shadow, over half a turn before it is lost."""
    case = run(True, "edges")
    begin, until = case.shadow()
    t, off = case.reads.t, case.off_range()
    outside = (t < begin - 0.02) | (t > until + 0.02)
    assert np.abs(off[outside]).max() < 4 * np.pi / 0.346 * 1e-4
    inside = between(t, until - 0.45, until - 0.02)
    assert inside.sum() > 50
    assert off[inside].max() < 0
    lag = np.interp(until - np.array([0.1, 0.2, 0.3, 0.4]), t, np.unwrap(off))
    assert (np.diff(lag) < -0.1).all()
    assert lag[-1] < -1.0


def test_in_the_middle_of_the_shadow_nothing_is_heard():
    case = run(True, "edges")
    begin, until = case.shadow()
    quarter = (until - begin) / 4
    assert case.rate(begin + quarter, until - quarter) == 0


# ---------------------------------------------------------------- with everything that a hall does


def test_with_reflections_and_diffuse_parts_the_shadow_is_still_there():
    """Fading lifts the tag above its threshold now and then: fewer than a third of the rounds in the middle half, nearly all outside."""
    case, free = run(True, "whole"), run(False, "whole")
    begin, until = case.shadow()
    quarter, t = (until - begin) / 4, case.reads.t
    assert case.rate(begin + quarter, until - quarter) < 0.33
    assert min(case.rate(begin - 1.5, begin - 0.3), case.rate(until + 0.3, until + 1.5)) > 0.85
    drop = case.drop(free)
    assert np.abs(drop[(t < begin - 1.1) | (t > until + 0.7)]).max() < 1.0  # beyond the zone nothing has changed
    assert drop[between(t, begin + 0.2, until - 0.2)].mean() > 15
    assert drop[between(t, begin - 0.05, begin + 0.05)].mean() == pytest.approx(12, abs=3)
    assert drop[between(t, until - 0.05, until + 0.05)].mean() == pytest.approx(12, abs=3)


def test_with_reflections_the_phase_keeps_to_the_range_in_sight_alone():
    """Mean cosine of phase less range: K of 10 dB and a floor leave most of 1; of waves that came round an edge nothing is left."""
    case = run(True, "whole")
    begin, until = case.shadow()
    t, level = case.reads.t, np.cos(case.off_range())
    assert min(level[t < begin - 0.3].mean(), level[t > until + 0.3].mean()) > 0.75
    assert level[between(t, begin + 0.3, until - 0.3)].mean() < 0.2


def test_a_real_reader_sees_it_come_and_go():
    case = run(True, "real")
    begin, until = case.shadow()
    quarter = (until - begin) / 4
    assert case.rate(begin + quarter, until - quarter) < 0.33
    assert min(case.rate(begin - 1.5, begin - 0.3), case.rate(until + 0.3, until + 1.5)) > 0.85


# ---------------------------------------------------------------- mutation: no rack


@pytest.mark.parametrize("kind", ["straight", "edges", "whole", "real"])
def test_without_the_rack_nothing_of_it_happens(kind):
    case = run(False, kind)
    begin, until = run(True, kind).shadow()
    inside = between(case.reads.t, begin, until)
    assert case.rate(begin, until) > 0.97
    gaps = np.diff(case.reads.t[inside])
    assert gaps.max() < (ROUND if kind in ("straight", "edges") else 0.2)
    if kind in ("straight", "edges"):
        assert np.abs(case.off_range()[inside]).max() < 4 * np.pi / 0.346 * 1e-4
        assert case.reads.rssi[inside].min() > case.reads.rssi[~inside].min()
