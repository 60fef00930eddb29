"""Scenarios over worlds that others made: everything that they expect, as it is shipped. Skipped where their files are not."""

from pathlib import Path

import pytest

from testbed.api import run
from testbed.scenario import DataMissing

REAL = Path(__file__).parents[2] / "scenarios" / "real"
pytestmark = pytest.mark.study


@pytest.mark.parametrize("name", ["aws-warehouse", "office"])
def test_what_the_scenario_expects_holds(name):
    try:
        result = run(REAL / f"{name}.yaml")
    except DataMissing as missing:
        pytest.skip(str(missing))
    assert len(result.claims) >= 3
    assert result.ok, [str(claim) for claim in result.claims if not claim.ok]
