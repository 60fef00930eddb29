"""The coverage map in a report: there where the scenario asks for it, with the table's own figures; and what may be asked."""

import pytest

import testbed
from testbed.coverage import coverage
from testbed.coverage.output import rows
from testbed.report import write
from testbed.scenario import ScenarioError, from_dict
from testbed.scenario.schema import json_schema
from testbed.simulate import Simulator

SITE = {
    "name": "quick",
    "seed": 3,
    "trials": 1,
    "duration_s": 1,
    "world": {"kind": "open_floor"},
    "actors": [
        {"id": "t1", "kind": "trolley", "motion": "kinematic", "route": {"waypoints_m": [[1, 1], [6, 1]]},
         "tags": [{"id": "lid", "mount": "top"}]},
    ],
    "sensors": [{"id": "posts", "kind": "rfid", "antennas": {"on": "post*"}, "power_dbm": 12}, {"kind": "odometry", "on": "t1"}],
    "estimators": [{"kind": "centroid"}],
}  # fmt: skip


def asking(**coverage):
    return SITE | {"report": {"coverage": {"step_m": 0.5, **coverage}}}


def test_a_report_shows_the_coverage_that_its_scenario_asks_for(tmp_path):
    testbed.run(asking(height_m="80 cm"), out=tmp_path / "run", keep="none")
    html = write(tmp_path / "run").read_text()
    assert '<a href="#coverage">' in html
    for name in ("coverage-read", "coverage-antennas", "coverage-level"):
        assert f'<svg class="figure" id="{name}"' in html
    for cell in rows(coverage(SITE, step_m=0.5, height_m=[0.8]))[0]:
        assert f">{cell}</t" in html
    assert write(tmp_path / "run").read_text() == html


def test_no_other_report_has_one(tmp_path):
    testbed.run(SITE, out=tmp_path / "run", keep="none")
    assert 'id="coverage"' not in write(tmp_path / "run").read_text()


def test_what_is_shown_changes_nothing_of_what_is_simulated():
    assert from_dict(SITE).hash == from_dict(asking()).hash


def test_of_a_sweep_the_first_point_is_shown(tmp_path):
    swept = asking() | {"sweep": {"sensors.posts.power_dbm": [29, 12]}}
    testbed.run(swept, out=tmp_path / "run", keep="none")
    html = write(tmp_path / "run").read_text()
    assert "This is the site at sensors.posts.power_dbm = 29" in html
    strong = rows(coverage(SITE, step_m=0.5, set={"sensors.posts.power_dbm": 29}))[0]
    assert all(f">{cell}</t" in html for cell in strong)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"height_m": 9}, "report.coverage.height_m: a height of 9 m is not in the hall, which goes from 0 to 5 m"),
        ({"sensors": ["post"]}, "report.coverage.sensors: no rfid sensor is called 'post', did you mean posts?"),
        ({"sensors": "odometry"}, "no rfid sensor is called 'odometry'"),
        ({"tag": "monza4"}, "did you mean monza_4"),
        ({"step_m": 0}, "report.coverage.step_m"),
        ({"height_m": []}, "report.coverage.height_m"),
        ({"hight_m": 1}, "did you mean height_m"),
    ],
)
def test_mistakes_are_told_with_their_place_before_anything_runs(asked, said):
    with pytest.raises(ScenarioError) as wrong, Simulator(from_dict(asking(**asked)), rays=False):
        pass
    assert said in str(wrong.value)


def test_without_a_reader_there_is_nothing_to_show():
    with (
        pytest.raises(ScenarioError, match="there is no sensor of kind rfid"),
        Simulator(from_dict(asking() | {"sensors": SITE["sensors"][1:]}), rays=False),
    ):
        pass


def test_the_schema_knows_the_section():
    schema = json_schema()
    assert "report" in schema["properties"]
    assert "height_m" in schema["$defs"]["CoverageModel"]["properties"]
