"""The studies of tracking by counts as scenarios: every figure within its band, every difference by its confidence limit."""

import pytest

import testbed
from testbed.scenario import load

NAMES = ["asynchrony", "antennas", "separation", "dead-zone", "geometry", "beyond", "late", "stops"]


@pytest.mark.parametrize("name", NAMES)
def test_every_study_says_what_it_shows_and_what_it_does_not(name):
    scenario = load(f"detection-{name}")
    assert scenario.published
    assert all(table.figures for part in scenario.published for table in part.tables)
    assert all(len(part.note) > 80 for part in scenario.published)


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_the_figures_of_the_studies_hold(name):
    verdicts = testbed.check_scenario(f"detection-{name}", jobs="auto")
    assert [str(v) for v in verdicts if not v.ok] == []
