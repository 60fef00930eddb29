"""The filters of the trolley study: two tags, reference tags, beams; LANDMARC; what they do with bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.measurements import Linear, Power, Range
from estimators.neighbours import nearest
from testbed import frames, plugins
from testbed.estimate import run
from testbed.recording import Recording
from testbed.types import Antennas, Prior, Reads, References, Site, Status, Tags, Targets

PLACES = np.array([[0.5, 3.0, 0.5], [4.5, 2.5, 3.0], [3.5, 1.5, 0.5], [0.5, 3.0, 3.5]])
AIM = np.array([2.5, 2.5, 1.0])
GRID = np.array([[x, y, 0.5] for x in range(6) for y in range(6)], dtype=float)
METRES = {"together": True, "measure": "distance", "reference_dbm": -40.0, "gate": "none"}
KINDS = {
    "ekf": METRES,
    "ukf": METRES,
    "ukf_pair": METRES,
    "ukf_reference": METRES,
    "ukf_angle": METRES,
    "batch_map": {"together": True, "reference_dbm": -40.0, "correlation_s": 0.0, "sigma_db": 1.0},
    "imm": {"together": True, "reference_dbm": -40.0, "correlation_s": 0.0, "sigma_db": 1.0},
    "landmarc": {"lost_s": 10.0},
}


def site(places=PLACES, references=GRID):
    n = len(places)
    antennas = Antennas(
        id=np.array([f"gate.{i + 1}" for i in range(n)], dtype=np.str_), position=places, quaternion=frames.looking_at(places, AIM),
        gain=np.zeros(n), beamwidth=np.full(n, np.pi / 2), front_to_back=np.full(n, 200.0), power=np.zeros(n),
    )  # fmt: skip
    tags = Tags(id=np.array(["low", "high", *(f"ref{i}" for i in range(len(references)))]))
    return Site(antennas, tags, np.empty(0), References(tag=2 + np.arange(len(references)), position=references))


def recorded(where=(2.0, 3.0, 1.2), *, at=None, beams=False, silent=(), spoilt=(), seconds=4.0, noise=0.0, seed=0):
    """A target with two tags, the second 0.5 m above the first, and the references, read by all antennas ten times a second."""
    at = site() if at is None else at
    t = np.arange(int(seconds * 10) + 1) / 10
    places = np.concatenate([[where, np.add(where, [0, 0, 0.5])], at.references.position])
    k, m, tag = (a.ravel() for a in np.meshgrid(t, np.arange(len(at.antennas)), np.arange(len(places)), indexing="ij"))
    apart = places[tag] - at.antennas.position[m]
    distance = np.linalg.norm(apart, axis=1)
    if beams:
        axis = frames.rotate(at.antennas.quaternion, np.array([1.0, 0.0, 0.0]))[m]
        ahead = np.einsum("ni,ni->n", apart, axis)
        distance = distance**2 / np.where(ahead > 0.05 * distance, ahead, np.nan)  # nothing is heard behind a beam
    rssi = -40 - 40 * np.log10(distance) + noise * np.random.default_rng(seed).normal(size=len(k))
    rssi[np.isin(tag, spoilt)] = np.nan
    heard = ~np.isin(tag, silent)
    reads = Reads(k, k, m, tag, rssi=rssi).take(heard)
    target = Targets(np.array(["trolley"]), np.array(["trolley"]))
    return Recording(0, seconds, at, {"reads": reads}, target, (np.array([0, 1]),))


def tracked(kind, recording, start=(2.5, 2.5, 1.5), std=1.0, **options):
    method = plugins.load("estimators", kind)
    covariance = np.diag([std**2] * 3 + [0.0625] * 3)[None]
    prior = Prior(np.zeros(1), np.array([[*start, 0, 0, 0]], dtype=float), covariance)
    return run([recording], method, method.Config(**{**KINDS[kind], **options}), prior, np.zeros(1, dtype=np.uint64))


def error(track, where):
    return np.linalg.norm(track.mean[-1, 0, :3] - where)


# ---------------------------------------------------------------- what each is for


@pytest.mark.parametrize(
    ("kind", "options", "beams", "limit"),
    [
        ("ekf", {"tags": "low", "curvature_noise": False}, False, 0.1),
        ("ukf", {"tags": "low"}, False, 0.1),
        ("ukf_pair", {}, False, 0.1),
        ("ukf_reference", {"tags": "low"}, False, 0.5),
        ("ukf_angle", {"tags": "low", "distance_std_m": 0.1}, True, 0.1),
        ("batch_map", {"tags": "low", "use_pattern": False}, False, 0.02),
        ("imm", {"tags": "low", "use_pattern": False}, False, 0.1),
    ],
)
def test_a_tag_that_stands_still_is_found_without_noise(kind, options, beams, limit):
    where = (2.0, 3.0, 1.2)
    assert error(tracked(kind, recorded(where, beams=beams), **options), where) < limit


def test_knowing_how_antennas_look_is_what_finds_a_tag_by_their_beams():
    where = (3.0, 3.0, 0.5)
    made = recorded(where, beams=True)
    knowing, ignorant = (tracked(kind, made, tags="low", distance_std_m=0.1) for kind in ("ukf_angle", "ukf"))
    assert error(knowing, where) < 0.1 * error(ignorant, where)


def test_the_second_tag_helps_and_a_wrong_offset_hurts():
    made = recorded(noise=1.2)
    where = (2.0, 3.0, 1.2)
    right, wrong = tracked("ukf_pair", made), tracked("ukf_pair", made, offset_m=(0.0, 0.0, -0.5))
    assert error(right, where) < error(wrong, where)


def test_a_pair_is_carried_by_the_tag_that_is_heard():
    where = (2.0, 3.0, 1.2)
    assert error(tracked("ukf_pair", recorded(where, silent=[0])), where) < 0.1
    assert error(tracked("ukf_pair", recorded(where, silent=[1])), where) < 0.1


def test_references_pull_towards_the_places_that_sound_alike():
    """Antennas all of one height leave z open; references stand at 0.5 m and know better."""
    flat = site(places=PLACES[[0, 2]])
    made, where = recorded((2.0, 3.0, 0.5), at=flat), np.array([2.0, 3.0, 0.5])
    options = {"tags": "low", "start": (2.5, 2.5, 1.5)}
    assert error(tracked("ukf_reference", made, **options), where) < 0.6 * error(tracked("ukf", made, **options), where)


def test_without_references_heard_the_tags_own_levels_are_taken_alone():
    silent = recorded(silent=range(2, 38))
    a, b = tracked("ukf_reference", silent, tags="low"), tracked("ukf", silent, tags="low")
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-12)


def in_turn(made):
    """The same reads, but each at a time of its own: antennas and tags take turns within a tenth of a second."""
    reads = made.streams["reads"]
    n = len(made.site.antennas) * (2 + len(made.site.references))
    t = reads.t + 0.09 * (np.arange(len(reads)) % n) / n
    made.streams["reads"] = reads.with_(t=t, t_arrival=t)
    return made


def test_references_are_compared_also_where_antennas_take_turns():
    """As every real reader's do: a snapshot is one read, and the newest levels of the others are still how tags sound."""
    flat = site(places=PLACES[[0, 2]])
    where = np.array([2.0, 3.0, 0.5])
    options = {"tags": "low", "start": (2.5, 2.5, 1.5), "gate": 0.999}
    together, alone = recorded(where, at=flat), in_turn(recorded(where, at=flat))
    knowing, without = tracked("ukf_reference", alone, **options), tracked("ukf", alone, **options)
    assert error(knowing, where) < 0.6 * error(without, where)
    forgetful = tracked("ukf_reference", alone, **options, memory_s=1e-4)
    assert error(knowing, where) < error(forgetful, where)
    assert error(knowing, where) < error(tracked("ukf", together, **options), where)


def test_references_are_compared_no_more_often_than_told():
    made, options = recorded(noise=1.2), {"tags": "low"}
    always, never = tracked("ukf_reference", made, **options), tracked("ukf", made, **options)
    once = tracked("ukf_reference", made, **options, every_s=3600)
    np.testing.assert_allclose(once.mean[0], always.mean[0], atol=1e-12)
    assert np.abs(once.mean[-1] - never.mean[-1]).max() < np.abs(always.mean[-1] - never.mean[-1]).max()


def test_landmarc_puts_a_tag_among_its_neighbours():
    track = tracked("landmarc", recorded((2.4, 3.3, 0.5)), tags="low")
    assert error(track, (2.4, 3.3, 0.5)) < 1.0  # a step of the grid
    on_one = tracked("landmarc", recorded((2.0, 3.0, 0.5)), tags="low")
    assert error(on_one, (2.0, 3.0, 0.5)) < 1e-6


# ---------------------------------------------------------------- neighbours


def test_weights_are_the_inverse_squares_of_signal_distance_nearest_first():
    which, weight = nearest(np.array([[0.0]]), np.array([[[9.0], [2.0], [1.0]]]), 2)
    assert which.tolist() == [[2, 1]]
    np.testing.assert_allclose(weight, [[0.8, 0.2]])


def test_silence_of_one_of_two_is_a_difference_and_of_both_is_none():
    silent, weak = np.array([[np.nan, -60.0]]), np.array([[-80.0, -60.0]])
    reference = np.array([[[-80.0, -60.0], [np.nan, -60.0]]])
    assert nearest(silent, reference, 1)[0].tolist() == [[1]]
    assert nearest(weak, reference, 1)[0].tolist() == [[0]]


def test_an_exact_match_takes_it_all_and_stays_finite():
    which, weight = nearest(np.array([[-60.0, -50.0]]), np.array([[[-60.0, -50.0], [-59.0, -50.0]]]), 2)
    assert which[0, 0] == 0
    assert weight[0, 0] == pytest.approx(1.0)
    assert np.isfinite(weight).all()


def test_a_reference_that_nobody_heard_is_nobodys_neighbour():
    which, weight = nearest(np.array([[-60.0]]), np.array([[[np.nan], [-90.0]]]), 2)
    assert which[0, 0] == 1
    assert weight[0].tolist() == [1.0, 0.0]


@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_weights_sum_to_one_whatever_was_heard(k, seed):
    rng = np.random.default_rng(seed)
    signal = rng.uniform(-80, -40, (12, 3))
    signal[rng.random(signal.shape) < 0.4] = np.nan
    _, weight = nearest(signal[:5], np.tile(signal[5:], (5, 1, 1)), k)
    known = np.isfinite(signal[:5]).any(axis=1) & np.isfinite(signal[5:]).any()
    np.testing.assert_allclose(weight[known].sum(axis=1), 1.0)
    assert np.isnan(weight[~known]).all()


# ---------------------------------------------------------------- pieces of a measurement


@pytest.mark.parametrize("first", [0, 6])
def test_jacobians_are_the_slopes_of_what_is_expected(first):
    rng = np.random.default_rng(3)
    mean = rng.uniform(0.5, 4.0, (5, 12))
    origin = rng.uniform(0.0, 5.0, (5, 4, 3))
    pieces = [Range(np.zeros((5, 4)), origin, np.ones((5, 4)), first), Linear(np.zeros((5, 2)), rng.normal(size=(2, 12)), np.ones((5, 2)))]
    for piece in pieces:
        h, jacobian, _ = piece.linearised(mean, None)
        np.testing.assert_allclose(piece.expected(mean[:, None])[:, 0], h)
        shifted = mean[:, None] + 1e-6 * np.eye(12)
        np.testing.assert_allclose(jacobian, (piece.expected(shifted) - h[:, None]).transpose(0, 2, 1) / 1e-6, atol=1e-5)


def test_levels_of_a_second_point_come_from_the_second_points_position():
    assert Power.__dataclass_fields__["first"].default == 0
    mean = np.zeros((1, 12))
    mean[0, 6:9] = [1.0, 2.0, 2.0]
    piece = Range(np.zeros((1, 1)), np.zeros((1, 1, 3)), np.ones((1, 1)), 6)
    assert piece.linearised(mean, None)[0] == pytest.approx(3.0)


def test_at_the_antenna_itself_a_distance_has_no_slope_and_nothing_is_nan():
    h, jacobian, variance = Range(np.ones((1, 1)), np.zeros((1, 1, 3)), np.ones((1, 1))).linearised(np.zeros((1, 6)), np.eye(6)[None])
    assert h == 0
    assert not jacobian.any()
    assert np.isfinite(variance).all()


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize("kind", ["ekf", "ukf", "ukf_pair", "ukf_reference", "ukf_angle"])
@pytest.mark.parametrize(
    ("places", "sentence"),
    [
        (PLACES[:1], "distances to 2 antennas at least are needed, and it has 1 \\(gate.1\\)"),
        (PLACES[[0, 1, 0]], "antennas gate.1 and gate.3 are at one place"),
    ],
)
def test_too_few_antennas_or_two_at_one_place_are_refused_by_name(kind, places, sentence):
    with pytest.raises(ValueError, match=f"{kind}: {sentence}"):
        tracked(kind, recorded(at=site(places)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_tag_that_is_never_read_is_lost_and_no_number_is_nan(kind):
    track = tracked(kind, recorded(silent=[0, 1]), lost_s=2.0)
    assert track.status[-1, 0] == Status.LOST
    assert np.isfinite(track.mean).all()
    assert np.isfinite(track.covariance).all()


@pytest.mark.parametrize("kind", KINDS)
def test_reads_without_a_level_are_as_good_as_none(kind):
    spoilt, silent = tracked(kind, recorded(spoilt=[0, 1])), tracked(kind, recorded(silent=[0, 1]))
    np.testing.assert_allclose(spoilt.mean, silent.mean, atol=1e-12)
    assert spoilt.used[0] == silent.used[0]
    assert np.isfinite(spoilt.mean).all()


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in ("landmarc", "ukf_reference")])
def test_one_antenna_gone_deaf_leaves_a_vector_of_the_others(kind):
    made = recorded()
    reads = made.streams["reads"]
    made.streams["reads"] = reads.with_(rssi=np.where(reads.antenna == 3, np.nan, reads.rssi))
    track = tracked(kind, made, tags="*" if kind == "ukf_pair" else "low")
    assert np.isfinite(track.mean).all()
    assert track.used[0] > 30


@pytest.mark.parametrize(
    ("kind", "options", "sentence"),
    [
        ("ukf", {"tags": "hi"}, "ukf: no tag is named 'hi'; there are low, high, ref0"),
        ("ukf", {"antennas": "door*"}, "ukf: no antenna is named 'door\\*'"),
        ("ukf_pair", {"together": False}, "together must be true"),
        ("ukf_reference", {"together": False}, "together must be true"),
        ("ukf_reference", {"neighbours": 50}, "50 neighbours are wanted, and the site has 36"),
        ("landmarc", {"neighbours": 50}, "landmarc: 50 neighbours are wanted"),
        ("ukf_angle", {"measure": "power"}, "measure must be distance"),
        ("batch_map", {"smooth": False}, "smooth must be true"),
        ("batch_map", {"phase_noise_rad": 0.1}, "batch_map: changes of phase need one carrier, and the site has 0"),
    ],
)
def test_what_a_method_can_not_work_with_is_refused_in_a_sentence(kind, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        tracked(kind, recorded(), **options)


@pytest.mark.parametrize(
    ("kind", "options", "sentence"),
    [("imm", {"smooth": True}, "goes forward alone"), ("batch_map", {"measure": "distance"}, "works on power")],
)
def test_settings_that_exclude_each_other_are_refused(kind, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        plugins.load("estimators", kind).Config(**options)


@pytest.mark.parametrize("kind", ["ekf_filterpy", "ukf_filterpy"])
def test_the_twins_refuse_what_they_do_not_have(kind):
    method = plugins.load("estimators", kind)
    for options in ({"smooth": True}, {"height_std_m": 0.1}):
        with pytest.raises(ValueError, match="neither smoothing nor height here"):
            method(method.Config(reference_dbm=-40.0, **options), site(), np.random.default_rng(0))
