"""The reader as a formula: levels, beams, noise that two sorts of antennas share, antennas that move from trial to trial."""

import copy

import numpy as np
import pytest
from pydantic import ValidationError

from testbed.scenario import ScenarioError, from_dict
from testbed.sensors.log_distance import LogDistanceConfig
from testbed.simulate import Simulator
from testbed.units import SPEED_OF_LIGHT, wrap

PLACES = [([0.5, 3.0, 0.5], [4.0, 3.5, 1.5]), ([4.5, 2.5, 3.0], [2.5, 2.0, 0.5]), ([3.5, 1.5, 0.5], [2.5, 3.0, 1.5])]
DOCUMENT = {
    "name": "law", "seed": 5, "trials": 2, "duration_s": 2.0, "step_hz": 10, "truth_hz": 10,
    "world": {"kind": "open_floor", "posts": 0},
    "actors": [
        {
            "id": "t1", "kind": "marker", "motion": "kinematic",
            "route": {"pace": "steady", "waypoints_m": [[3, 1.5], [3, 2.5]], "heights_m": [0.75, 1.75], "speed_mps": 0.5},
            "tags": [{"id": "low", "position_m": [0, 0, 0]}, {"id": "high", "position_m": [0, 0, 0.5]}],
        }
    ],
    "tags": [{"id": "ref0", "position_m": [1, 1, 0.5]}, {"id": "ref1", "position_m": [2, 1, 0.5]}],
    "targets": ["t1"],
    "references": ["ref*"],
}  # fmt: skip


def trial(number=0, *, references=("ref*",), **sensor):
    document = copy.deepcopy(DOCUMENT)
    document["references"] = list(references)
    antennas = [{"position_m": place, "aim_m": aim} for place, aim in PLACES]
    document["sensors"] = [{"id": "gate", "kind": "log_distance", "antennas": antennas, "sigma_db": 0.0} | sensor]
    with Simulator(from_dict(document)) as simulator:
        return simulator.trial(number)


def reads(made, antenna, tag):
    stream, site = made.recording.streams["reads"], made.recording.site
    a, k = (np.flatnonzero(ids == id)[0] for ids, id in ((site.antennas.id, antenna), (site.tags.id, tag)))
    return stream.take((stream.antenna == a) & (stream.tag == k))


def test_every_antenna_reads_every_tag_at_every_instant():
    made = trial()
    assert len(made.recording.streams["reads"]) == 21 * 3 * 4
    np.testing.assert_array_equal(reads(made, "gate.2", "low").t, np.arange(21) / 10)
    assert list(made.recording.site.antennas.id) == ["gate.1", "gate.2", "gate.3"]


def test_levels_follow_the_law_from_where_the_tag_truly_is():
    made = trial(reference_dbm=-35.0, path_loss_exponent=3.0)
    where = made.target_states(np.arange(21) / 10)[:, 0, :3] + [0, 0, 0.5]
    expected = -35.0 - 30.0 * np.log10(np.linalg.norm(where - PLACES[1][0], axis=1))
    np.testing.assert_allclose(reads(made, "gate.2", "high").rssi, expected, atol=1e-9)


def test_a_beam_weakens_a_tag_off_its_axis_as_if_it_were_further_away():
    made = trial(beams="both")
    where = made.target_states(np.arange(21) / 10)[:, 0, :3]
    place, aim = (np.array(p) for p in PLACES[0])
    r = np.linalg.norm(where - place, axis=1)
    cosine = (where - place) @ (aim - place) / np.linalg.norm(aim - place) / r
    np.testing.assert_allclose(reads(made, "gate.1", "low").rssi, -40 - 40 * np.log10(r), atol=1e-9)
    np.testing.assert_allclose(reads(made, "gate.beam1", "low").rssi, -40 - 40 * np.log10(r / cosine), atol=1e-9)


def test_a_beam_hears_nothing_behind_it():
    blind = [{"position_m": [3.0, 2.0, 1.25], "aim_m": [3.0, 9.0, 1.25]}]
    t = reads(trial(beams="all", antennas=blind), "gate.beam1", "low").t
    assert 0 < len(t) < 21
    assert t.min() > 0.8


def test_the_site_describes_the_beam_by_its_half_power_width():
    site = trial(beams="both").recording.site
    np.testing.assert_allclose(site.antennas.beamwidth, [np.pi] * 3 + [np.pi / 2] * 3)  # n = 4: cos² is a half at 45°


def test_both_sorts_of_antenna_have_the_same_noise():
    noisy, clean = trial(beams="both", sigma_db=1.2), trial(beams="both")
    error = {a: reads(noisy, a, "low").rssi - reads(clean, a, "low").rssi for a in ("gate.1", "gate.beam1", "gate.2")}
    np.testing.assert_allclose(error["gate.1"], error["gate.beam1"], atol=1e-9)
    assert not np.allclose(error["gate.1"], error["gate.2"])


@pytest.mark.parametrize(
    "change", [{"count": 1}, {"beams": "both"}, {"tags": "low"}, {"antennas": [{"position_m": p, "aim_m": a} for p, a in PLACES[:2]]}]
)
def test_other_antennas_and_tags_change_no_draw(change):
    np.testing.assert_array_equal(
        reads(trial(sigma_db=1.0, references=()), "gate.1", "low").rssi,
        reads(trial(sigma_db=1.0, references=(), **change), "gate.1", "low").rssi,
    )


def test_noise_is_standard_normal_times_sigma():
    # 4 tags, 3 antennas, 21 instants, 20 trials: 5040 draws; a mean beyond 4.4 sigma/√n has probability 1e-5
    made = [trial(k, sigma_db=2.0).recording.streams["reads"].rssi for k in range(20)]
    error = (np.array(made) - trial().recording.streams["reads"].rssi).ravel() / 2.0
    assert abs(error.mean()) < 4.4 / np.sqrt(len(error))
    assert error.std() == pytest.approx(1.0, abs=4.4 / np.sqrt(2 * len(error)))


def test_antennas_move_from_trial_to_trial_and_the_installer_knows_where_to():
    jitter = {"jitter_m": [0.5, 0.5, 0.0], "aim_jitter_m": [1.0, 0.0, 0.0]}
    first, second = trial(0, **jitter), trial(1, **jitter)
    a, b = first.recording.site.antennas, second.recording.site.antennas
    assert (a.position != b.position)[:, :2].all()
    assert np.abs(a.position - [p for p, _ in PLACES]).max() <= 0.5
    where = first.target_states(np.arange(21) / 10)[:, 0, :3]
    expected = -40 - 40 * np.log10(np.linalg.norm(where - a.position[1], axis=1))
    np.testing.assert_allclose(reads(first, "gate.2", "low").rssi, expected, atol=1e-9)
    fewer = trial(0, count=2, **jitter).recording.site.antennas
    np.testing.assert_array_equal(fewer.position, a.position[:2])


def test_reference_tags_are_those_that_the_scenario_names():
    references = trial().recording.site.references
    np.testing.assert_array_equal(references.position, [[1, 1, 0.5], [2, 1, 0.5]])
    assert len(trial(references=()).recording.site.references) == 0


@pytest.mark.parametrize(
    ("references", "sentence"),
    [(["reff*"], r"references.0: no tag is named 'reff\*'"), (["ref*", "low"], "references.1: 'low' is on a body that moves")],
)
def test_a_reference_that_can_not_be_one_is_refused_in_its_place(references, sentence):
    with pytest.raises(ScenarioError, match=sentence):
        trial(references=references)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"antennas": [{"position_m": [0, 0, 1]}], "count": 2}, "count asks for 2 antennas of the 1"),
        ({"antennas": [{"position_m": [0, 0, 1]}], "beams": "all"}, "antennas.0 looks nowhere"),
        ({"antennas": [{"position_m": [0, 0, 1], "aim_m": [0, 0, 1]}]}, "aim it elsewhere"),
    ],
)
def test_what_does_not_fit_is_refused(fields, sentence):
    with pytest.raises(ValidationError, match=sentence):
        LogDistanceConfig(**fields)


def test_a_pattern_that_no_tag_fits_is_an_error_that_names_the_sensor():
    with pytest.raises(ValueError, match="sensor gate: no tag is named 'lo', did you mean low"):
        trial(tags="lo")


def test_phase_changes_by_two_ways_over_a_wave_length():
    made = trial(carrier_mhz=900.0, phase_noise_rad=0.0)
    where = made.target_states(np.arange(21) / 10)[:, 0, :3]
    r = np.linalg.norm(where - PLACES[1][0], axis=1)
    phase = reads(made, "gate.2", "low").phase
    assert ((phase >= 0) & (phase < 2 * np.pi)).all()
    turned = np.exp(1j * np.diff(phase)) / np.exp(-4j * np.pi * np.diff(r) * 900e6 / SPEED_OF_LIGHT)
    np.testing.assert_allclose(turned, 1.0, atol=1e-6)
    np.testing.assert_array_equal(made.recording.site.frequencies, [900e6])


def test_a_link_has_an_offset_of_its_own_and_noise_moves_no_level():
    quiet, noisy = trial(carrier_mhz=900.0, phase_noise_rad=0.0, sigma_db=1.0), trial(carrier_mhz=900.0, phase_noise_rad=0.3, sigma_db=1.0)
    off = wrap(reads(noisy, "gate.1", "low").phase - reads(quiet, "gate.1", "low").phase)
    assert 0.1 < off.std() < 0.6
    np.testing.assert_array_equal(reads(noisy, "gate.1", "low").rssi, reads(quiet, "gate.1", "low").rssi)
    np.testing.assert_array_equal(reads(trial(sigma_db=1.0), "gate.1", "low").rssi, reads(quiet, "gate.1", "low").rssi)
    one, other = (reads(trial(carrier_mhz=900.0, phase_noise_rad=0.0, references=()), a, "ref0").phase[0] for a in ("gate.1", "gate.2"))
    r = [np.linalg.norm(np.subtract([1, 1, 0.5], PLACES[i][0])) for i in (0, 1)]
    assert abs(wrap(one - other + 4 * np.pi * (r[0] - r[1]) * 900e6 / SPEED_OF_LIGHT)) > 1e-3


def test_without_a_carrier_there_is_no_phase():
    made = trial()
    assert np.isnan(made.recording.streams["reads"].phase).all()
    assert not len(made.recording.site.frequencies)
