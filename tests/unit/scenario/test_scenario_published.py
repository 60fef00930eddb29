"""A paper's tables in a scenario: cells that find their point, and mistakes told in their place."""

import copy

import pytest

from testbed.scenario import Claim, ScenarioError, from_dict, from_text, json_schema, only, override

GATES = "world.gates"


def with_tables(document, *cells, **table):
    cells = cells or ({"estimator": "ekf", "at": {GATES: 2}, "paper": 86.18, "accept": [80, 95]},)
    base = {"title": "Table 1", "unit": "cm", "scale": 100, "metric": "position_error_m", "statistic": "mean", "cells": list(cells)}
    document = copy.deepcopy(document)
    document["published"] = {"source": "A. Author 2012", "note": "places are fitted", "tables": [base | table]}
    document["sweep"] = {GATES: [1, 2]}
    return document


def told(document):
    with pytest.raises(ScenarioError) as caught:
        from_dict(document)
    return str(caught.value)


def test_a_cell_finds_its_point_of_the_sweep(fakes, document):
    (paper,) = from_dict(with_tables(document)).published
    (table,) = paper.tables
    (figure,) = table.figures
    assert (paper.source, paper.note, table.title, table.unit, table.scale) == ("A. Author 2012", "places are fitted", "Table 1", "cm", 100)
    assert (figure.point, figure.subject, figure.metric, figure.statistic, figure.paper) == (1, "ekf", "position_error_m", "mean", 86.18)


def test_a_cell_may_be_about_what_the_world_offers(fakes, document):
    cell = {"estimator": "world", "at": {GATES: 2}, "metric": "line_of_sight", "accept": [40, 60]}
    scenario = from_dict(with_tables(document, cell, metric=None, statistic=None))
    (figure,) = scenario.published[0].tables[0].figures
    assert (figure.subject, figure.metric, figure.statistic) == ("world", "line_of_sight", "")
    claims = [c for c in scenario.expect if c.subject == "world" and c.point == 1]
    assert [(c.bound, c.value) for c in claims] == [("min", pytest.approx(0.4)), ("max", pytest.approx(0.6))]


def test_without_a_sweep_a_cell_is_about_the_only_point(fakes, document):
    document = with_tables(document, {"estimator": "ekf", "paper": 1.0})
    del document["sweep"]
    assert from_dict(document).published[0].tables[0].figures[0].point == 0


def test_an_accepted_band_is_two_expectations_of_one_point_in_our_own_unit(fakes, document):
    plain = from_dict(document).expect
    more = from_dict(with_tables(document)).expect[len(plain) :]
    assert more == (
        Claim("ekf", "position_error_m", "mean", "min", 0.8, point=1),
        Claim("ekf", "position_error_m", "mean", "max", 0.95, point=1),
    )
    assert [claim.concerns(0) for claim in more] == [False, False]
    assert from_dict(with_tables(document, {"estimator": "ekf", "at": {GATES: 1}, "paper": 1.0})).expect == plain


def test_an_expectation_knows_the_line_of_its_cell(fakes):
    text = (
        "name: d\nseed: 1\ntrials: 1\nduration_s: 1\nworld: {kind: hall}\nestimators: [{kind: ekf}]\n"
        "published:\n  source: A\n  note: B\n  tables:\n    - title: T\n      metric: availability\n      cells:\n"
        "        - {estimator: ekf, accept: [0, 1]}\n        - {estimator: ekf, paper: 1}\n"
    )
    assert [claim.line for claim in from_text(text).expect] == [14, 14]
    listed = text.replace("  source: A\n  note: B\n  tables:", "  - source: A\n    note: B\n    tables:")
    assert [claim.line for claim in from_text(listed).expect] == [14, 14]


def test_a_cell_whose_point_a_shorter_sweep_leaves_out_stays_without_one(fakes, document):
    scenario = override(from_dict(with_tables(document)), {"sweep": {GATES: [1]}})
    (figure,) = scenario.published[0].tables[0].figures
    assert (figure.point, figure.at) == (None, {GATES: 2})
    assert all(claim.point is None for claim in scenario.expect)
    assert from_dict(scenario.document).published == scenario.published


def test_a_difference_and_a_metric_of_its_own_for_a_cell(fakes, document):
    cells = (
        {"estimator": "ekf  -  fast", "at": {GATES: 1}, "paper": 2.0},
        {"estimator": "fast", "metric": "availability", "at": {GATES: 1}, "paper": 1},
    )
    first, second = from_dict(with_tables(document, *cells)).published[0].tables[0].figures
    assert (first.subject, first.claim.estimators) == ("ekf - fast", ("ekf", "fast"))
    assert (second.metric, second.statistic) == ("availability", "")


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        (
            {"estimator": "ekv", "at": {GATES: 1}, "paper": 1},
            "published.tables.0.cells.0.estimator: no estimator has the id 'ekv', did you mean ekf?",
        ),
        ({"estimator": "ekf", "paper": 1}, "fits 2 points of the sweep: say at which world.gates"),
        ({"estimator": "ekf", "at": {"world.gate": 1}, "paper": 1}, "the sweep does not set world.gate; it sets world.gates"),
        ({"estimator": "ekf", "at": {GATES: 1}}, "a cell says what the paper has"),
        ({"estimator": "ekf", "at": {GATES: 1}, "accept": [2, 1]}, "accept is [low, high], and 2 is above 1"),
        ({"estimator": "ekf", "at": {GATES: 1}, "papers": 1}, "extra field, did you mean paper?"),
        ({"estimator": "ekf", "metric": "position_eror_m", "at": {GATES: 1}, "paper": 1}, "no metric computes 'position_eror_m'"),
    ],
)
def test_a_mistake_is_told_in_its_place(fakes, document, cell, sentence):
    assert sentence in told(with_tables(document, cell))


def test_a_table_without_a_metric_asks_for_one(fakes, document):
    assert "which figure is meant?" in told(with_tables(document, metric=None, statistic=None))


def test_a_source_without_a_note_of_what_is_fitted_is_refused(fakes, document):
    document = with_tables(document)
    del document["published"]["note"]
    assert "published.note: missing" in told(document)


def test_the_document_rebuilds_it_and_the_hash_leaves_it_out(fakes, document):
    scenario = from_dict(with_tables(document))
    again = from_dict(scenario.document)
    assert (again.published, again.expect) == (scenario.published, scenario.expect)
    without = {name: value for name, value in with_tables(document).items() if name != "published"}
    assert from_dict(without).hash == scenario.hash
    assert override(scenario, ["trials=9"]).published == scenario.published


def test_cells_of_estimators_that_are_left_out_go_with_them(fakes, document):
    cells = [{"estimator": name, "at": {GATES: 1}, "paper": 1, "accept": [0, 1]} for name in ("ekf", "fast", "ekf - fast")]
    chosen = only(from_dict(with_tables(document, *cells)), ["fast"])
    assert [f.subject for f in chosen.published[0].tables[0].figures] == ["fast"]
    again = from_dict(chosen.document)
    assert (again.published, again.expect) == (chosen.published, chosen.expect)
    assert only(from_dict(with_tables(document)), ["fast"]).published == ()


def test_the_schema_for_editors_knows_the_section(fakes):
    schema = json_schema()
    assert "published" in schema["properties"]
    assert "CellModel" in schema["$defs"]
