"""Published tables beside a run's own figures: in numbers, in --json, on the page."""

import math

import numpy as np
import pytest
import report_fakes as fakes

import testbed
from testbed.evaluate import mean_interval
from testbed.published import compare, document
from testbed.report import album, page, study
from testbed.scenario import Figure, Publication, PublishedTable

ROWS = {
    "point": np.array([0, 0, 0, 0, 1, 1]),
    "trial": np.array([0, 1, 0, 1, 0, 1]),
    "estimator": np.array(["a", "a", "b", "b", "a", "a"]),
    "target": np.array(["t"] * 6),
    "error_m": np.array([0.5, 0.7, 0.4, 0.4, 0.9, 1.1]),
}


def table(*figures, scale=100.0):
    return Publication("A. Author", "fitted", (PublishedTable("Table 1", "cm", scale, figures),))


def beside(*figures, scale=100.0):
    return compare([table(*figures, scale=scale)], ROWS, {"point": np.array([0]), "trial": np.array([0])})[0].tables[0].cells


def figure(subject, point=0, paper=60.0, accept=None, metric="error_m"):
    return Figure(point, {"m": 9}, subject, metric, "", paper, accept, "")


def test_ours_is_the_mean_over_trials_in_the_tables_unit():
    (cell,) = beside(figure("a"))
    expected = mean_interval(np.array([50.0, 70.0]))
    assert cell.ours.mean == pytest.approx(60.0)
    assert (cell.ours.se, cell.ours.low, cell.ours.n) == (pytest.approx(expected.se), pytest.approx(expected.low), 2)
    assert cell.inside is None


def test_a_cell_takes_its_own_point():
    assert [c.ours.mean for c in beside(figure("a"), figure("a", point=1))] == pytest.approx([60.0, 100.0])


def test_a_difference_is_taken_trial_by_trial_and_its_interval_has_to_lie_inside():
    wide, narrow = beside(figure("a - b", accept=(-200.0, 300.0)), figure("a - b", accept=(10.0, 30.0)))
    assert wide.ours.mean == pytest.approx(20.0)
    assert wide.inside
    assert not narrow.inside  # the mean is, its interval is not


@pytest.mark.parametrize(("accept", "inside"), [((60.0, 61.0), True), ((59.0, 60.0), True), ((60.1, 61.0), False)])
def test_the_band_includes_its_ends(accept, inside):
    (cell,) = beside(figure("a", accept=accept))
    assert cell.inside is inside


def test_a_figure_that_the_run_does_not_have_says_why():
    (cell,) = beside(figure("a", metric="availability", accept=(0.0, 1.0)))
    assert math.isnan(cell.ours.mean)
    assert cell.inside is False
    assert "there is no 'availability'" in cell.note


def test_a_cell_whose_point_is_not_run_says_so_and_is_not_judged():
    compared = compare([table(figure("a", point=None, accept=(0.0, 1.0)))], ROWS, {})
    cell = compared[0].tables[0].cells[0]
    assert (cell.inside, cell.note) == (None, "not run: the sweep has no such point")
    (paper,) = document(compared, [])
    assert paper["tables"][0]["cells"][0]["set"] == {"m": 9}


def test_the_document_is_plain_and_has_null_for_what_is_not_there():
    compared = compare([table(figure("a", accept=(55.0, 65.0)), figure("c"))], ROWS, {"point": np.array([0]), "trial": np.array([0])})
    (paper,) = document(compared, [{"m": 2}, {"m": 3}])
    first, second = paper["tables"][0]["cells"]
    assert (paper["source"], paper["note"], paper["tables"][0]["unit"]) == ("A. Author", "fitted", "cm")
    assert (first["set"], first["paper"], first["ours"]) == ({"m": 2}, 60.0, pytest.approx(60.0))
    assert (first["accept"], first["inside"]) == ([55.0, 65.0], True)
    assert (second["ours"], second["se"], "accept" in second) == (None, None, False)


# ---------------------------------------------------------------- a whole run

PUBLISHED = {
    "source": "A. <Author>, J. Radio 2012",
    "note": "antenna places are fitted",
    "tables": [
        {
            "title": "Table 1",
            "unit": "cm",
            "scale": 100,
            "metric": "position_error_m",
            "statistic": "mean",
            "cells": [
                {"estimator": "ekf", "paper": 86.18, "accept": [0, 1]},
                {"estimator": "ekf - ukf", "paper": -3.5, "note": "read off"},
            ],
        }
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    changes = {"published": PUBLISHED, "expect": None, "estimators": [{"kind": "ekf"}, {"kind": "ukf"}]}
    return fakes.quick(tmp_path_factory.mktemp("run") / "out", changes, trials=2)


def test_a_run_outside_the_band_fails_its_expectation(folder):
    found = study.read(folder)
    assert [(c.text, c.ok) for c in found.claims] == [
        ("ekf.position_error_m.mean >= 0", True),
        ("ekf.position_error_m.mean <= 0.01", False),
    ]


def test_the_page_shows_paper_and_ours_side_by_side(folder, monkeypatch):
    monkeypatch.setattr(page, "album", lambda *_, **__: album.Album(note=""))
    text = page.page(study.read(folder))
    shown = text[text.index('<section id="published">') :]
    shown = shown[: shown.index("</section>")]
    assert '<a href="#published">' in text
    assert "A. &lt;Author&gt;, J. Radio 2012" in shown
    for words in ("antenna places are fitted", "paper", "ours ± standard error", "86.18", "−3.5", "✗ outside", "0 to 1", "read off"):
        assert words in shown


def test_a_run_in_python_has_them_in_its_document():
    small = {**fakes.QUICK, "published": PUBLISHED, "expect": {}, "estimators": [{"kind": "ekf"}, {"kind": "ukf"}], "trials": 2}
    result = testbed.run(small)
    first, second = result.document()["published"][0]["tables"][0]["cells"]
    means = {s.estimator: s.statistics["position_error_m.mean"].mean for s in result.summaries}
    assert first["ours"] == pytest.approx(100 * means["ekf"])
    assert second["ours"] == pytest.approx(100 * (means["ekf"] - means["ukf"]))
    assert not result.ok
