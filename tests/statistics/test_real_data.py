"""Real data under their protocols: the scenarios of scenarios/real hold on every claim. Skipped, saying so, where the data are absent."""

import pytest

from testbed.expectations import check_scenario
from testbed.scenario import DataMissing, find


@pytest.mark.study
@pytest.mark.parametrize("name", ["ble-tracks", "ble-robot-flat", "uwb-labyrinth", "zebra-still-tags", "car-on-streets"])
def test_every_claim_holds(name):
    try:
        verdicts = check_scenario(find(f"real/{name}"), jobs=2)
    except DataMissing as missing:
        pytest.skip(str(missing))
    assert verdicts
    assert [str(v) for v in verdicts if not v.ok] == []
