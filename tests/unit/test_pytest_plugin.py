import importlib.util
import xml.etree.ElementTree as ET

import pytest
from small_scenario import EXPECT, SMALL

import testbed
from testbed import batch, pytest_nodes
from testbed.scenario import DataMissing, Problem, from_text
from testbed.store import StoreError

pytest_plugins = ["pytester"]

HOLDS = ("centroid.position_error_m.mean <= 9", "centroid.availability >= 0.5", "world.line_of_sight >= 0")
FAILS = "centroid.position_error_m.p95 <= 0.01"
SENTENCE = r"small\.yaml:22: centroid\.position_error_m\.p95: got \d\.\d\d, want <= 0\.01 \(95 % interval -?\d+\.\d\d(-| to )\d+\.\d\d\)"


@pytest.fixture(scope="module")
def _warm():
    """Imports all that the scenario needs: pytester forgets modules that are first imported in a run of its own.

    Among them one that other packages bring along and that takes over for the standard library: forgotten, nobody would find anything.
    """
    if importlib.util.find_spec("importlib_metadata"):
        importlib.import_module("importlib_metadata")
    testbed.check_scenario(from_text(SMALL), trials=1)


@pytest.fixture
def project(pytester, _warm, monkeypatch):
    """A folder whose scenarios/ are collected, with small.yaml in it."""
    for name in ("CI", "BUILD_NUMBER"):  # there pytest's summary tells every message in full once more
        monkeypatch.delenv(name, raising=False)
    pytester.makefile(".ini", pytest="[pytest]\ntestbed_scenarios = scenarios\n")
    pytester.mkdir("scenarios")
    (pytester.path / "scenarios" / "small.yaml").write_text(SMALL + EXPECT)
    return pytester


@pytest.fixture
def runs(monkeypatch):
    """What was run, in this process: a scenario's name, trials, seed and jobs each time."""
    seen = []
    run = batch.run

    def counted(scenario, **options):
        seen.append((scenario.name, scenario.trials, scenario.seed, options["jobs"]))
        return run(scenario, **(options | {"jobs": 1}))

    monkeypatch.setattr(batch, "run", counted)
    return seen


OTHERS = ("-p", "no:benchmark", "-p", "no:hypothesispytest", "-p", "no:xdist")  # they take most of such a run's time


def pytest_run(project, *options):
    return project.runpytest_inprocess(*OTHERS, *options)


# ---------------------------------------------------------------- what is collected


def test_each_claim_is_an_item_and_collecting_runs_nothing(project, runs):
    result = pytest_run(project, "--collect-only", "-q")
    names = ("centroid.position_error_m.mean <= 9", FAILS, "centroid.availability >= 0.5", "world.line_of_sight >= 0")
    assert result.outlines[:4] == [f"scenarios/small.yaml::{name}" for name in names]
    assert runs == []


def test_an_item_stands_at_the_line_of_its_claim(project):
    items, _ = project.inline_genitems(*OTHERS)
    assert [item.location for item in items] == [("scenarios/small.yaml", line - 1, item.name) for line, item in enumerate(items, 21)]


def test_a_swept_scenario_has_an_item_a_claim_and_point(project, runs):
    swept = SMALL + EXPECT + "sweep: {duration_s: [1, 2], title: [short, '" + 60 * "x" + "a', '" + 60 * "x" + "b']}\n"
    (project.path / "scenarios" / "small.yaml").write_text(swept)
    ids = pytest_run(project, "--collect-only", "-q", "-k", "availability").outlines[:6]
    long = f"title={'x' * 39}…]"  # two values that are cut alike
    points = [f"duration_s={d}, {title}" for d, n in ((1, 2), (2, 5)) for title in ("title=short]", long, f"{long}#{n}")]
    assert ids == [f"scenarios/small.yaml::centroid.availability >= 0.5[{point}" for point in points]


def test_outside_the_roots_no_yaml_is_touched(project, runs):
    (project.mkdir("other") / "broken.yaml").write_text("{")
    (project.mkdir("scenarios2") / "broken.yaml").write_text("{")
    (project.path / "scenarios" / "notes.txt").write_text("{")
    result = pytest_run(project, "--collect-only", "-q")
    assert result.ret == pytest.ExitCode.OK
    assert all(line.startswith("scenarios/small.yaml::") for line in result.outlines[:4])
    assert "4 tests collected" in result.outlines[-1]
    assert pytest_run(project, "other/broken.yaml").ret == pytest.ExitCode.USAGE_ERROR  # "not found", as for any other such file
    assert runs == []


def test_without_the_setting_nothing_is_collected(project, runs):
    assert pytest_run(project, "-o", "testbed_scenarios=").ret == pytest.ExitCode.NO_TESTS_COLLECTED
    project.makefile(".ini", pytest="[pytest]")
    assert pytest_run(project).ret == pytest.ExitCode.NO_TESTS_COLLECTED
    assert runs == []


def test_a_root_may_be_a_single_file_and_there_may_be_several(project):
    (project.path / "scenarios" / "second.yml").write_text(SMALL)
    (project.mkdir("more") / "third.yaml").write_text(SMALL)
    (project.path / "more" / "fourth.yaml").write_text("{")
    ids = pytest_run(project, "--collect-only", "-q", "-o", "testbed_scenarios=scenarios/second.yml more/../more/third.yaml").outlines[:2]
    assert sorted(ids) == ["more/third.yaml::runs", "scenarios/second.yml::runs"]


def test_a_root_that_is_not_there_is_refused(project):
    result = pytest_run(project, "-o", "testbed_scenarios=scenaros")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines("ERROR: testbed_scenarios: there is no */scenaros")


def test_a_bad_file_is_a_collection_error_with_the_places_of_its_mistakes(project, runs):
    bad = (SMALL + EXPECT).replace("duration_s: 2", "duration_s: soon").replace("{max: 9}", "{max: }")
    (project.path / "scenarios" / "small.yaml").write_text(bad)
    result = pytest_run(project)
    result.assert_outcomes(errors=1)
    result.stdout.re_match_lines([r"scenarios/small\.yaml:4:13 duration_s: .*", r"scenarios/small\.yaml:21:18 expect\..*"])
    result.stdout.no_fnmatch_line("*Traceback*")
    result.stdout.no_fnmatch_line("*pytest_nodes*")
    assert runs == []


# ---------------------------------------------------------------- what happens


def test_a_claim_that_fails_is_told_in_one_sentence_and_the_others_pass(project, runs):
    result = pytest_run(project)
    result.assert_outcomes(passed=3, failed=1)
    shown = result.outlines
    head = next(i for i, line in enumerate(shown) if line.strip("_ ") == FAILS)
    result.stdout.re_match_lines([f"^scenarios/{SENTENCE}$"])
    assert shown[head + 1].startswith("scenarios/small.yaml:22: ")
    assert "short test summary" in shown[head + 2]  # nothing else is told
    assert runs == [("small", 2, 3, 1)]


def test_each_file_runs_once_however_its_items_are_ordered(project, runs):
    (project.path / "scenarios" / "second.yaml").write_text((SMALL + EXPECT).replace("name: small", "name: second"))
    files = [f"scenarios/{name}.yaml::{claim}" for claim in HOLDS for name in ("small", "second")]
    pytest_run(project, *files).assert_outcomes(passed=6)
    assert sorted(name for name, *_ in runs) == ["second", "small"]


def test_a_file_of_which_no_item_is_selected_does_not_run(project, runs):
    (project.path / "scenarios" / "second.yaml").write_text(SMALL.replace("name: small", "name: second"))
    pytest_run(project, "-k", "line_of_sight").assert_outcomes(passed=1, deselected=4)
    assert [name for name, *_ in runs] == ["small"]


def test_one_item_can_be_asked_for_by_its_id(project, runs):
    (project.path / "scenarios" / "small.yaml").write_text(SMALL + EXPECT + "sweep: {duration_s: [1, 2]}\n")
    name = "scenarios/small.yaml::centroid.availability >= 0.5"
    pytest_run(project, f"{name}[duration_s=2]", "--testbed-trials=1").assert_outcomes(passed=1)
    pytest_run(project, name, "--testbed-trials=1").assert_outcomes(passed=2)  # at all points


def test_stop_at_the_first_failure_and_begin_with_the_last_one(project, runs):
    pytest_run(project, "-x").assert_outcomes(passed=1, failed=1)
    result = pytest_run(project, "--lf", "-v")
    result.assert_outcomes(failed=1)
    assert len(runs) == 2


def test_options_replace_trials_seed_and_jobs(project, runs):
    pytest_run(project, "--testbed-trials=1", "--testbed-seed=99", "--testbed-jobs=3")
    pytest_run(project, "--testbed-jobs=auto")
    assert runs == [("small", 1, 99, 3), ("small", 2, 3, "auto")]


@pytest.mark.parametrize(
    "option", ["--testbed-trials=0", "--testbed-trials=few", "--testbed-jobs=0", "--testbed-jobs=all", "--testbed-seed=x"]
)
def test_nonsense_in_an_option_is_refused(project, option):
    result = pytest_run(project, option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(f"*argument {option.partition('=')[0]}:*")


def test_a_seed_that_no_scenario_takes_is_a_collection_error(project):
    result = pytest_run(project, "--testbed-seed=-1")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines("--set seed: *")


def test_figures_are_properties_of_the_test_in_junit_xml(project):
    pytest_run(project, "--junitxml=found.xml")
    cases = {case.get("name"): case for case in ET.parse(project.path / "found.xml").iter("testcase")}
    found = {name: {p.get("name"): p.get("value") for p in case.iter("property")} for name, case in cases.items()}
    judged = {v.text: v for v in testbed.check_scenario(project.path / "scenarios" / "small.yaml")}
    for name, verdict in judged.items():
        assert float(found[name]["measured"]) == pytest.approx(verdict.value, rel=1e-11)
        assert (float(found[name]["interval_low"]), float(found[name]["interval_high"])) == pytest.approx(verdict.interval, rel=1e-11)
        assert found[name]["want"] == name.partition(" ")[2]
    assert "small.yaml:22: " in cases[FAILS].find("failure").text


def test_a_scenario_that_expects_nothing_is_one_item_that_wants_its_trials_to_run(project, runs, monkeypatch):
    (project.path / "scenarios" / "small.yaml").write_text(SMALL)
    pytest_run(project, "-v").stdout.fnmatch_lines("scenarios/small.yaml::runs PASSED*")
    crash(monkeypatch)
    pytest_run(project).assert_outcomes(errors=1)
    assert len(runs) == 2


# ---------------------------------------------------------------- what goes wrong


def crash(monkeypatch):
    from estimators.centroid import Centroid

    def update(self, event):
        raise ArithmeticError("no such luck")

    monkeypatch.setattr(Centroid, "update", update)


def test_trials_that_crash_are_errors_with_their_number_and_the_first_traceback_once(project, runs, monkeypatch):
    crash(monkeypatch)
    result = pytest_run(project)
    result.assert_outcomes(errors=4)
    first = "scenarios/small.yaml: 2 of 2 trials crashed; the first, trial 0, centroid in estimate: ArithmeticError: no such luck"
    told = [line for line in result.outlines if line.startswith(first)]
    assert told == [first, *[f"{first} (more is told at scenarios/small.yaml::{HOLDS[0]})"] * 3]
    traced = [i for i, line in enumerate(result.outlines) if "raise ArithmeticError" in line]
    assert result.outlines.index(told[0]) < traced[0] <= traced[-1] < result.outlines.index(told[1])
    assert len(runs) == 1


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (from_text(SMALL, "small.yaml").problem(("sensors", 0), "there is no post*"), "small.yaml:13:5 sensors.0: there is no post[*]"),
        (StoreError("the disk is full"), "the disk is full"),
        (ZeroDivisionError("a bug"), "scenarios/small.yaml: the testbed itself failed"),
    ],
    ids=["scenario", "store", "bug"],
)
def test_a_run_that_stops_is_an_error_of_all_items_and_is_not_tried_again(project, monkeypatch, error, told):
    tried = []

    def run(scenario, **options):
        tried.append(scenario.name)
        raise error

    monkeypatch.setattr(batch, "run", run)
    result = pytest_run(project)
    result.assert_outcomes(errors=4)
    result.stdout.fnmatch_lines(told)
    assert sum(line.startswith("Traceback") for line in result.outlines) == isinstance(error, ZeroDivisionError)
    assert tried == ["small"]


def test_ctrl_c_during_a_run_ends_the_session(project, monkeypatch):
    def run(scenario, **options):
        raise batch.Interrupted("interrupted")

    monkeypatch.setattr(batch, "run", run)
    with pytest.raises(KeyboardInterrupt):
        pytest_run(project)


@pytest.mark.parametrize("late", [False, True], ids=["found while reading", "found while running"])
def test_a_scenario_whose_data_are_not_here_is_skipped_with_the_reason(project, monkeypatch, late):
    def missing(*_, **__):
        raise DataMissing([Problem("small.yaml", 5, 8, "world.file", "../data/hall.sdf is not here")])

    monkeypatch.setattr(*((batch, "run") if late else (pytest_nodes, "load")), missing)
    result = pytest_run(project, "-rs")
    result.assert_outcomes(skipped=4 if late else 1)
    result.stdout.fnmatch_lines("SKIPPED*small.yaml:5:8 world.file: ../data/hall.sdf is not here")
