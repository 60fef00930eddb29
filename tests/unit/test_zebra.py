"""A real Zebra FX7500, two antennas, tags that stand still (MIT): which side a tag is on, what was moved, and two tags with one EPC.

Protocol: nothing is fitted. The tag `0002…` lies 0.2 m to the one side in one file and 0.2 m to the other in the other; nothing else moved.
"""

from pathlib import Path

import pytest

from testbed.logs import read_log
from testbed.logs.site import checked_site
from testbed.logs.still import moved, shares_an_epc, side

DATA = Path(__file__).parents[3] / "shared" / "data" / "zebra_fx7500_aoa"
MOVES, STAYS = "000233b2ddd9014000000000", "300833b2ddd9014000000000"
SITE = {
    "log": {"kind": "zebra_fx_csv"},
    "carriers_mhz": [865.7],
    "antennas": [{"id": f"a{port}", "port": port, "position_m": [(port - 1.5) * 0.287, 0, 1]} for port in (1, 2)],
}

if not DATA.is_dir():
    pytest.skip(f"the data {DATA.name} are not on this machine", allow_module_level=True)


@pytest.fixture(scope="module")
def logs():
    return {offset: read_log(DATA / f"20250709_865.7_0.813_0.287_{offset}.csv", checked_site(SITE)) for offset in ("-0.2", "0.2")}


def reads(log, tag):
    return log.reads.take(log.reads.tag == log.tags.index(tag))


def test_golden_counts(logs):
    assert {offset: (log.rows, len(log.bad), round(log.duration, 3)) for offset, log in logs.items()} == {
        "-0.2": (1229, 0, 5.984),
        "0.2": (1082, 0, 6.087),
    }


def test_the_side_of_the_tag_is_right_in_both_files(logs):
    found = {offset: side(reads(log, MOVES), 0, 1) for offset, log in logs.items()}
    assert found["-0.2"] * found["0.2"] == -1
    assert found["0.2"] == 1


def test_the_one_tag_was_moved_and_the_other_was_not(logs):
    first, second = logs.values()
    assert moved(reads(first, MOVES), reads(second, MOVES))
    assert not moved(reads(first, STAYS), reads(second, STAYS))


def test_two_tags_with_one_epc_are_flagged_and_no_other(logs):
    for log in logs.values():
        flagged = [tag for tag in log.tags if shares_an_epc(reads(log, tag))]
        assert flagged == [STAYS]


def test_swapped_antennas_give_the_other_side(logs):
    for log in logs.values():
        assert side(reads(log, MOVES), 0, 1) == -side(reads(log, MOVES), 1, 0)


def test_a_reader_that_flips_by_pi_is_not_two_tags(logs):
    one = reads(logs["0.2"], MOVES)
    flipped = one.with_(phase=(one.phase + (one.t * 1000 % 3 < 1) * 3.141592653589793) % 6.283185307179586)
    assert not shares_an_epc(flipped)
