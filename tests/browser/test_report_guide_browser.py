"""A guided person in the report's player: the instruction of the moment, in words, and the cloud in motion."""

import pytest
from visits import Visit

import testbed
import testbed.report
from testbed import archive
from testbed.guided.words import instructions

DOCUMENT = {
    "name": "led",
    "seed": 6,
    "trials": 1,
    "duration_s": 900,
    "truth_hz": 10,
    "step_hz": 10,
    "world": {"kind": "open_floor", "length_m": 12, "width_m": 12, "posts": 0},
    "actors": [{"id": "user", "kind": "person", "motion": "guided", "guided": {"start_distance_m": 4}}],
    "tags": [{"id": "wanted", "position_m": [6, 6, 1]}],
    "targets": ["wanted"],
    "sensors": [{"id": "reader", "kind": "handheld", "on": "user"}],
    "estimators": [{"id": "better", "kind": "handheld_rb", "particles": 100}],
    "metrics": [{"kind": "guidance"}],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guided") / "run"
    testbed.run(DOCUMENT, out=folder)
    testbed.report.write(folder)
    return folder


def test_the_player_tells_what_the_person_was_told_and_moves_the_cloud(browser, run):
    told = instructions(archive.load_trial(archive.place(run, 0, 0)).walk)
    clouds = []
    with Visit(browser, run / "report.html") as visit:
        line = visit.page.locator('[data-part="told"]')
        assert visit.page.locator(".told").is_visible()
        for one in (told[0], told[2], told[-1]):
            visit.do(f"testbedPlayer.seek({one.t} + 1e-3)")
            assert line.inner_text() == one.text == visit.do("testbedPlayer.told()")
            clouds.append(visit.page.locator(".cloud").first.get_attribute("d"))
    assert told[-1].text == "You are there."
    assert len(set(clouds)) == 3
    assert all(clouds[1:])
