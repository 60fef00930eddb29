"""Strips of a report: each cell against a plain loop over reads and rounds, and the phase of a link against its range."""

import copy
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import report_fakes as fakes

from testbed.report import cases, figures_radio, strips, study
from testbed.report.figures_radio import cyclic, phase_by_range, radio_strips, runs
from testbed.units import wrap

FREE = {"channel": {"orders": 0, "diffuse": False, "edges": False}, "artefacts": "off"}
TWO_TAGS = [{**fakes.QUICK["actors"][0], "tags": [{"id": "lid", "mount": "top"}, {"id": "side", "mount": "left"}]}]


def loaded(folder):
    run = study.read(folder)
    return cases.load(run, run.recordings[0])


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A trolley with two tags; the reader is the default one, with the whole channel."""
    changes = {"actors": TWO_TAGS, "targets": ["lid", "side"], "estimators": [{"kind": "centroid"}], "expect": None}
    return loaded(fakes.quick(tmp_path_factory.mktemp("strips") / "out", changes, keep="first:1", trials=1))


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """The same in free space, with a reader without faults."""
    sensors = [{**fakes.QUICK["sensors"][0], **FREE}]
    changes = {"actors": copy.deepcopy(TWO_TAGS), "sensors": sensors, "estimators": [{"kind": "centroid"}], "expect": None}
    return loaded(fakes.quick(tmp_path_factory.mktemp("free") / "out", changes, keep="first:1", trials=1))


@pytest.fixture(scope="module")
def found(case):
    return strips.strips(case)[0]


# ---------------------------------------------------------------- cells


def by_loop(case, strip, row):
    """Phase, RSSI and reads per round of each slot of a row, visit by visit."""
    streams, antenna = case.trial.recording.streams, strip.rows[row]
    reads, rounds = streams["reads"], streams["rounds"]
    visits = sorted((float(rounds.t_start[i]), int(rounds.round[i])) for i in np.flatnonzero(rounds.antenna == antenna))
    usual = np.median(np.diff([t for t, _ in visits]))
    heard = sorted((float(reads.t[i]), float(reads.phase[i]), float(reads.rssi[i]))
                   for i in np.flatnonzero((reads.antenna == antenna) & (reads.tag == strip.tag)))  # fmt: skip
    out = np.full((3, len(strip.edges) - 1), np.nan)
    for slot, (begin, end) in enumerate(zip(strip.edges[:-1], strip.edges[1:], strict=True)):
        shown = [v for v in range(len(visits)) if begin <= visits[v][0] < end]
        earlier = [v for v in range(len(visits)) if visits[v][0] < begin]
        if not shown and earlier and begin - visits[earlier[-1]][0] < strips.PAUSE * usual:
            shown = earlier[-1:]
        if not shown:
            continue
        until = visits[shown[-1] + 1][0] if shown[-1] + 1 < len(visits) else np.inf
        mine = [h for h in heard if visits[shown[0]][0] - strips.ROUNDING <= h[0] < until - strips.ROUNDING]
        out[2, slot] = len(mine) / len(shown)
        if mine:
            out[0, slot], out[1, slot] = mine[-1][1], np.mean([h[2] for h in mine])
    return out


def test_every_cell_is_what_a_loop_over_rounds_and_reads_gives(case, found):
    assert [s.name for s in found] == ["lid", "side"]
    strip = found[0]
    for row in (0, len(strip.rows) - 1):
        phase, rssi, rounds = by_loop(case, strip, row)
        assert np.array_equal(strip.phase[row], phase, equal_nan=True)
        assert strip.rssi[row] == pytest.approx(rssi, abs=1e-9, nan_ok=True)
        assert strip.rounds[row] == pytest.approx(rounds, abs=1e-9, nan_ok=True)
    assert np.isfinite(strip.phase).sum() > 100


def test_a_strip_has_no_holes_while_a_reader_comes_by(found):
    """From 0.13 s on, when each of the eight antennas has had its first turn."""
    for strip in found:
        assert np.isfinite(strip.rounds[:, 8:]).all()


def test_rounds_that_did_not_ask_a_tag_are_not_its_silence(case):
    recording = case.trial.recording
    sets = np.ones((2, len(recording.site.tags)), dtype=bool)
    tag = int(recording.target_tags[0][0])
    sets[1, tag] = False
    rounds = recording.streams["rounds"]
    late = rounds.t_start > case.duration / 2
    streams = {**recording.streams, "rounds": rounds.with_(asked=late.astype(np.int32))}
    other = with_recording(case, streams=streams, asked_sets=sets)
    strip = next(s for s in strips.strips(other)[0] if s.tag == tag)
    assert np.isfinite(strip.rounds[:, 8:110]).all()
    assert np.isnan(strip.rounds[:, 125:]).all()


def with_recording(case, **changes):
    recording = replace(case.trial.recording, **changes)
    return replace(case, trial=replace(case.trial, recording=recording))


def test_a_log_without_rounds_shows_its_reads(case):
    streams = {"reads": case.trial.recording.streams["reads"]}
    strip = strips.strips(with_recording(case, streams=streams))[0][0]
    assert np.isnan(strip.rounds).all()
    assert np.isfinite(strip.phase).any()
    drawn = radio_strips(with_recording(case, streams=streams), "radio", "Trial 0")
    assert "reads per round" not in drawn[0].svg


def test_a_recording_in_which_nothing_was_heard_has_no_strips(case):
    reads = case.trial.recording.streams["reads"]
    counts = case.trial.recording.streams["counts"]
    streams = {**case.trial.recording.streams, "reads": reads.take(slice(0, 0)), "counts": counts.take(slice(0, 0))}
    assert radio_strips(with_recording(case, streams=streams), "radio", "Trial 0") == ()
    assert phase_by_range(with_recording(case, streams=streams), "phase", "Trial 0") is None


def test_the_line_of_sight_is_clear_only_where_the_straight_line_is(case, found):
    aim = case.aims[0]
    strip = next(s for s in found if s.tag in aim.tags)
    at = (np.arange(strip.clear.shape[1]) + 0.5) * case.duration / strip.clear.shape[1]
    near = np.clip(np.searchsorted(aim.sight.t, at), 1, len(aim.sight.t) - 1)
    for row, antenna in enumerate(strip.rows):
        column = aim.antennas.tolist().index(antenna)
        straight = aim.sight.clear[near, column] & aim.sight.clear[near - 1, column]
        blocked = ~(aim.sight.clear[near, column] | aim.sight.clear[near - 1, column])
        assert (strip.clear[row][blocked] < 0.99).all()
        assert (strip.clear[row][straight] > 0.2).all()
    assert strip.clear.min() >= 0
    assert strip.clear.max() <= 1


# ---------------------------------------------------------------- phase by range


def test_in_free_space_the_phase_is_that_of_the_range(free):
    found = strips.turning(free)
    assert found.agreement == pytest.approx(1.0, abs=1e-9)
    expected = np.interp(found.t, found.at, found.expected)  # 200 Hz: λ/2 passes in 0.17 s, so a straight line is good to 0.01 rad
    assert np.abs(wrap(found.phase - expected)).max() < 0.02


def test_a_reader_that_counts_the_other_way_round_or_to_pi_is_followed(free, monkeypatch):
    reads = free.trial.recording.streams["reads"]
    turned = with_recording(free, streams={**free.trial.recording.streams, "reads": reads.with_(phase=np.mod(-reads.phase, np.pi))})
    assert strips.turning(turned).agreement < 0.7  # taken for what the profile says, it does not fit
    monkeypatch.setattr(strips, "_reported", lambda *_: (-1, np.pi))
    assert strips.turning(turned).agreement == pytest.approx(1.0, abs=1e-9)


def test_half_turns_and_noise_leave_the_line_where_it_is(free):
    reads = free.trial.recording.streams["reads"]
    flipped = np.random.default_rng(5).random(len(reads)) < 0.1
    phase = np.mod(reads.phase + np.pi * flipped, 2 * np.pi)
    bent = strips.turning(with_recording(free, streams={**free.trial.recording.streams, "reads": reads.with_(phase=phase)}))
    clean = strips.turning(free)
    assert np.abs(wrap(bent.expected[0] - clean.expected[0])) < 0.1
    assert 0.6 < bent.agreement < 0.95


# ---------------------------------------------------------------- drawing


def test_figures_are_vectors_with_few_marks_units_and_their_own_ids(case):
    drawn = [*radio_strips(case, "radio-0", "Trial 0"), phase_by_range(case, "phase-0", "Trial 0")]
    ids = []
    for figure in drawn:
        tree = ET.fromstring(figure.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))
        assert not [e for e in tree.iter() if e.tag.endswith("}image")]
        assert len(list(tree.iter())) < 1200
        assert len(figure.svg) < 250_000
        ids += [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(ids) == len(set(ids))
    text = " ".join(re.findall(r">([^<>]+)</text>", drawn[0].svg))
    for said in ("phase (rad)", "RSSI (dBm)", "reads per round", "line of sight", "time (s)", "2π"):
        assert said in text


def test_what_is_left_out_is_said(case, monkeypatch):
    monkeypatch.setattr(strips, "MOST_ROWS", 2)
    monkeypatch.setattr(strips, "MOST_TAGS", 1)
    (only,) = radio_strips(case, "radio", "Trial 0")
    assert "further antennas read it less often and are not shown" in only.caption
    assert "1 further target tag read less often has no figure" in only.caption
    strip = strips.strips(case)[0][0]
    reads = case.reads.take(case.reads.tag == strip.tag)
    heard = np.bincount(reads.antenna, minlength=len(case.antennas))
    assert set(strip.rows.tolist()) == set(np.argsort(-heard, kind="stable")[:2].tolist())


def test_runs_are_where_a_mask_is_true():
    assert runs(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert runs(np.zeros(3, dtype=bool)) == []


def test_the_phase_colours_close_and_are_told_apart_without_red_and_green():
    lab = np.array([to_lab(colour) for colour in cyclic(24)])
    step = np.linalg.norm(np.roll(lab, -1, axis=0) - lab, axis=1)
    assert step.max() < 1.8 * step.min()  # even, across the seam too
    seen = lab[:, [0, 2]]  # what is left without the axis from green to red
    for apart in (6, 12):
        assert np.linalg.norm(np.roll(seen, -apart, axis=0) - seen, axis=1).min() > 30


def to_lab(colour):
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = matrix @ linear / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return 116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])


def test_more_reads_than_there_are_colours_share_the_last_one():
    panel = figures_radio._rounds(np.array([[0.0, 0.4, 1.0, 3.2, 40.0, np.nan]]))
    assert panel.place.tolist() == [[0, 1, 1, 4, 6, -1]]
    assert panel.ticks[-1][1] == "> 5"
    assert len(panel.colours) == 7


def test_counts_without_reads_are_shown_all_the_same(case):
    """What `detection: logistic_beta` leaves: rounds and counts, and nothing that has a phase or a level."""
    streams = case.trial.recording.streams
    bare = with_recording(case, streams={kind: streams[kind] for kind in ("rounds", "counts")})
    drawn = radio_strips(bare, "radio", "Trial 0")
    assert len(drawn) == 2
    text = " ".join(re.findall(r">([^<>]+)</text>", drawn[0].svg))
    assert "reads per round" in text
    assert "line of sight" in text
    assert "phase" not in text
    full = strips.strips(case)[0][0]
    assert np.array_equal(strips.strips(bare)[0][0].rounds, full.rounds, equal_nan=True)
