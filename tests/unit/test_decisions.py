"""Decisions about tags that stand still as figures of a recorded world: right ones, wrong ones, and what is refused."""

import json

import numpy as np
import pytest

import testbed
from testbed.expectations import check_scenario
from testbed.scenario import DataMissing, ScenarioError, find, from_dict

WAVE = 299792458.0 / 866.3e6
ANTENNAS = [{"id": "left", "position_m": [-0.1, 0, 1]}, {"id": "right", "position_m": [0.1, 0, 1]}]
PLACES = {"a": [[-0.1, 1, 1], [0.1, 1, 1]], "b": [[0.05, 1, 1], [0.05, 1, 1]]}


def written(folder, n, twin=False):
    """A log of tags at PLACES whose phase grows with distance; with a twin, a second tag answers as b, 6 dB weaker."""
    rows = ["t,antenna,tag,rssi,phase,channel"]
    for tag, places in PLACES.items():
        for antenna in ANTENNAS:
            d = float(np.linalg.norm(np.array(places[n]) - antenna["position_m"]))
            for k in range(20):
                other = twin and tag == "b" and k % 2
                phase = (4 * np.pi * d / WAVE + (1.5 if other else 0)) % (2 * np.pi)
                rows.append(f"{0.1 * k + 0.01 * len(tag)},{antenna['id']},{tag},{-56 if other else -50},{phase},0")
    path = folder / f"log{n}.csv"
    path.write_text("\n".join(rows) + "\n")
    return str(path)


def scenario(folder, twin=False, **still):
    said = {"between": ["left", "right"], "places_m": PLACES, "moved": {"a": True, "b": False}, "two_tags": ["b"] if twin else [], **still}
    site = {"log": {"kind": "tidy_csv"}, "carriers_mhz": [866.3], "antennas": ANTENNAS, "tags": [{"id": "a"}, {"id": "b"}]}
    logs = [written(folder, n, twin) for n in (0, 1)]
    world = {"kind": "recorded", "protocol": "nothing is fitted", "logs": logs, "site": site | {"targets": [{"id": "a", "tags": ["a"]}]}}
    return {"name": "still", "seed": 1, "trials": 2, "duration_s": 3, "world": {**world, "still": said}}


def figures(document):
    found = testbed.run(document).document()["points"][0]["world"]
    return {
        name: found[name]["mean"] if isinstance(found[name], dict) else found[name] for name in ("side_right", "moved_right", "epc_right")
    }


def test_right_decisions_are_right(tmp_path):
    assert figures(scenario(tmp_path)) == {"side_right": 1, "moved_right": 1, "epc_right": 1}


def test_what_was_otherwise_makes_the_same_decisions_wrong(tmp_path):
    assert figures(scenario(tmp_path, places_m={"a": PLACES["a"][::-1]}))["side_right"] == 0
    assert figures(scenario(tmp_path, moved={"a": False, "b": False}))["moved_right"] == 0.5
    assert figures(scenario(tmp_path, two_tags=["a"]))["epc_right"] == 0.5


def test_two_tags_with_one_epc_are_told(tmp_path):
    assert figures(scenario(tmp_path, twin=True, places_m={"a": PLACES["a"]}, moved={"a": True}))["epc_right"] == 1


@pytest.mark.parametrize(
    ("still", "said"),
    [
        ({"between": ["left", "wright"]}, "no antenna 'wright'"),
        ({"between": ["left", "left"]}, "two antennas are wanted"),
        ({"moved": {"c": True}}, "no tag 'c'"),
        ({"places_m": {"a": [[0, 0, 0]]}}, "1 places, and there are 2 logs"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, still, said):
    with pytest.raises(ScenarioError, match=said):
        from_dict(json.loads(json.dumps(scenario(tmp_path, **still))))


def test_the_three_decisions_on_the_real_logs():
    try:
        verdicts = check_scenario(find("real/zebra-still-tags"))
    except DataMissing as missing:
        pytest.skip(str(missing))
    assert len(verdicts) == 3
    assert [str(v) for v in verdicts if not v.ok] == []
