"""Which recordings are kept, and how large they are predicted to be."""

import numpy as np
import pytest
from batch_fakes import scenario
from hypothesis import given
from hypothesis import strategies as st

from testbed.keep import DEFAULT, Keep, predict_size


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("none", Keep()),
        ("all", Keep(all=True)),
        ("failed", Keep(failed=True)),
        ("first:3", Keep(first=3)),
        ("first:1, worst:2,failed", Keep(first=1, worst=2, failed=True)),
        (DEFAULT, Keep(first=1, failed=True)),
    ],
)
def test_what_can_be_said(text, rule):
    assert Keep.parse(text) == rule


@pytest.mark.parametrize(
    "text", ["", "some", "first", "first:", "first:-1", "first:1.5", "first:²", "all:3", "none,failed", "worst:1e9", "first:123456789"]
)
def test_what_cannot_be_said_is_refused_with_the_forms_there_are(text):
    with pytest.raises(ValueError, match="does not say which recordings to keep: none, all, failed, first:N, worst:N"):
        Keep.parse(text)


@given(st.integers(0, 50), st.integers(1, 50))
def test_the_first_are_never_more_than_there_are(first, trials):
    assert list(Keep(first=first).chosen(trials)) == list(range(min(first, trials)))
    assert len(Keep(all=True).chosen(trials)) == trials


def rows():
    errors = {0: [1.0, 1.0], 1: [9.0, np.nan], 2: [np.nan, np.nan], 3: [4.0, 8.0]}
    table = {"point": [], "trial": [], "estimator": [], "target": [], "availability": [], "position_error_m.mean": []}
    for trial, values in errors.items():
        for estimator, shift in (("ukf", 0.0), ("centroid", 100.0 * (trial == 0))):
            for target, value in enumerate(values):
                for column, cell in zip(table.values(), (0, trial, estimator, str(target), trial, value + shift), strict=True):
                    column.append(cell)
    return {name: np.array(column) for name, column in table.items()}


def test_the_worst_are_those_of_the_first_estimator_with_the_mean_over_targets():
    assert Keep(worst=2).worst_of(rows(), 0) == [1, 3]


def test_a_trial_without_a_value_is_not_among_the_worst():
    assert Keep(worst=9).worst_of(rows(), 0) == [1, 3, 0]
    assert Keep(worst=9).worst_of(rows(), 1) == []
    assert Keep(worst=9).worst_of({}, 0) == []
    assert Keep().worst_of(rows(), 0) == []


def test_without_a_position_error_the_first_metric_decides():
    table = {name: column for name, column in rows().items() if name != "position_error_m.mean"}
    assert Keep(worst=2).worst_of(table, 0) == [3, 2]


def test_the_predicted_size_grows_with_what_is_kept():
    one = predict_size(scenario(), Keep(first=1))
    assert predict_size(scenario(), Keep()) == predict_size(scenario(), Keep(failed=True)) == 0
    assert predict_size(scenario(), Keep(first=1, worst=2)) == pytest.approx(3 * one, rel=1e-6)
    assert predict_size(scenario(), Keep(all=True, worst=5)) == pytest.approx(10 * one, rel=1e-6)
    assert predict_size(scenario(sweep={"world.length_m": [5, 6]}), Keep(first=1)) == pytest.approx(2 * one, rel=1e-6)
