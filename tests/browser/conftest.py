"""A browser, and runs whose reports it opens: made once for all files here."""

import copy
import shutil
import sys
from pathlib import Path

import pytest

import testbed
from testbed import archive
from testbed.report import cases, study, write
from testbed.report.figures import Styles
from testbed.report.figures_plan import floor_plan
from testbed.report.figures_time import error_over_time

sys.path.insert(0, str(Path(__file__).parent))
from visits import Visit

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]


@pytest.fixture(scope="session")
def browser():
    api = pytest.importorskip("playwright.sync_api", reason="the tests in a browser need playwright: pip install playwright")
    if not Path(CHROMIUM).exists():
        pytest.skip("the tests in a browser need Chromium: apt-get install chromium")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield found
        found.close()


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "dock-gate"
    testbed.run("dock-gate", trials=2, out=folder)
    write(folder)
    return folder


@pytest.fixture(scope="session")
def several(tmp_path_factory):
    """A sweep with several targets, whose labels are in each other's way."""
    document = copy.deepcopy(testbed.load("parked-only").document)
    document |= {"sweep": {"report_hz": [4, 8]}, "cameras": [], "duration_s": 4}
    folder = tmp_path_factory.mktemp("several") / "run"
    testbed.run(document, trials=2, out=folder)
    write(folder)
    return folder


@pytest.fixture
def visit(browser, demo):
    with Visit(browser, demo / "report.html") as found:
        yield found


@pytest.fixture(scope="session")
def first(demo):
    """The recording in the player: its case, its tracks, its plan and its error figure."""
    read = study.read(demo)
    case = cases.load(read, read.recordings[0])
    styles = Styles(read.estimators)
    tracks = archive.load_tracks(read.recordings[0].folder)
    return case, tracks, floor_plan(case, styles, "plan-0", ""), error_over_time(case, styles, "errors-0", "")
