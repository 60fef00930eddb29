"""The page: complete in itself, honest about what it can't show, and the same from the same folder."""

import base64
import hashlib
import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
import report_fakes as fakes

from testbed.report import album, grids, page, study, words
from testbed.report.amounts import NOTHING
from testbed.simulate import Simulator
from testbed.store import StoreError


def no_pictures(*_, **__):
    """Renders take seconds and have tests of their own."""
    return album.Album(note="No camera pictures in this test.")


@pytest.fixture(autouse=True)
def without_pictures(monkeypatch, request):
    if "camera" not in request.node.name:
        monkeypatch.setattr(page, "album", no_pictures)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return fakes.quick(tmp_path_factory.mktemp("run") / "out")


@pytest.fixture(scope="module")
def written(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "album", no_pictures)
        return page.write(folder).read_text(encoding="utf-8")


class Reader(HTMLParser):
    """Text, tags and attributes of a page, and whether its tags close in order."""

    VOID = frozenset({"meta", "link", "input", "img", "source", "br", "use", "path", "rect"})

    def __init__(self, content):
        super().__init__()
        self.open, self.attributes, self.text, self.wrong = [], [], [], []
        self.feed(content)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag):
        if tag in self.VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


# ---------------------------------------------------------------- one file that holds everything


def test_the_markup_closes_what_it_opens(written):
    reader = Reader(written)
    assert reader.wrong == []
    assert reader.open == []


def test_nothing_is_fetched_from_anywhere(written):
    reader = Reader(written)
    for tag, name, value in reader.attributes:
        if name in ("src", "href", "data", "action", "poster", "srcset"):
            assert value.startswith(("data:", "#")), (tag, name, value[:80])
    assert "@import" not in written
    assert not re.search(r"url\((?!#)", written)
    assert "http://" not in written.replace("http://www.w3.org/2000/svg", "")  # the name of a namespace, in the script
    assert "https://" not in written


def test_the_policy_allows_the_pages_own_script_alone(written):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', written)[1].replace("&#39;", "'")
    assert policy.startswith("default-src 'none'; img-src data:;")
    script = re.findall(r"<script>(.*?)</script>", written, re.DOTALL)
    assert len(script) == 1
    digest = base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert not [name for _, name, _ in Reader(written).attributes if name.startswith("on")]


def test_the_same_folder_gives_the_same_bytes(folder, written):
    assert page.write(folder).read_text(encoding="utf-8") == written


def test_what_a_run_says_of_itself_is_text_not_markup(written):
    assert "A trolley &lt;b&gt;passes&lt;/b&gt; &amp; goes" in written
    assert "<b>passes" not in written


def test_ids_are_there_once(written):
    ids = [value for _, name, value in Reader(written).attributes if name == "id"]
    assert len(ids) == len(set(ids))


# ---------------------------------------------------------------- what it says


def test_the_summary_is_in_plain_words_with_an_interval(written):
    text = Reader(written).words
    assert re.search(r"3 trials of 4 s were simulated from seed 3 and tracked by 3 estimators \(ekf, ukf and centroid\)\.", text)
    assert re.search(r"\w+ came nearest to the truth: [\d.]+ m off on average \(95 % interval [\d.]+ to [\d.]+ m\), then", text)
    assert "✗ 1 of 2 expectations failed; no trial failed." in text


def test_the_numbers_are_the_runs_own(folder, written):
    text = Reader(written).words
    found = study.read(folder)
    for summary in found.of(0):
        mean = summary.statistics["position_error_m.mean"]
        assert f"{words.number(mean.mean, mean.se)} ± {words.number(mean.se, mean.se)}" in text
    assert str(found.manifest["scenario"]["hash"]) in text
    assert f"code {found.manifest['versions']['code']}" in text
    assert "95 % of an honest filter" in text


def test_what_had_nothing_to_speak_of_has_no_row_among_what_the_world_offered(folder):
    read = study.read(folder)
    spoken = {name for name, value in read.world[0].items() if value.n}
    assert spoken < set(read.world[0])
    assert all(row[1].text != NOTHING for row in grids.world(read, 0).rows)
    assert len(grids.world(read, 0).rows) == len({name for name in spoken if "." not in name})  # one sensor: each figure once


def test_claims_stand_with_their_values_and_whether_they_hold(written):
    text = Reader(written).words
    assert re.search(r"ekf\.position_error_m\.mean <= 5 ✓ holds", text)
    assert re.search(r"\(ekf - ukf\)\.position_error_m\.mean <= -9 ✗ failed", text)
    assert "1 of 2 hold" in text


def test_a_claim_has_its_line_in_the_scenarios_text(folder):
    lines = study.read(folder).manifest["scenario"]["text"].splitlines()
    for claim in study.read(folder).claims:
        assert re.search(r"-9|5", lines[claim.line - 1])


def test_how_to_run_it_again_holds_no_path_of_this_machine(folder):
    found = study.read(folder)
    assert words.commands(found) == [
        "# it was started from Python with testbed.run; the scenario below is all that it needs",
        "testbed rerun out --trial 0",
    ]
    found.manifest["command"] = ["/home/me/venv/bin/testbed", "run", "dock gate.yaml", "--trials", "4"]
    assert words.commands(found)[0] == "testbed run 'dock gate.yaml' --trials 4"
    found.manifest["command"] = ["/x/testbed/__main__.py", "run", "dock"]
    assert words.commands(found)[0] == "python -m testbed run dock"


def test_what_parts_leave_out_is_told_in_their_own_words(folder):
    told = dict(words.omissions(study.read(folder).scenario))
    assert any("sensor" in who or "radio" in who for who in told)
    documented = """What it does.

    Left out: walls,
    and rain. More of it.

    It is quick. Breaks when wet. Snow is left out as well
    """
    assert words.left_out(documented) == "walls, and rain. Breaks when wet. Snow is left out as well."
    assert words.left_out(None) == ""


# ---------------------------------------------------------------- rare runs


def test_without_a_recording_the_page_says_why_and_how(tmp_path):
    written = page.write(fakes.quick(tmp_path / "none", trials=2, keep="none")).read_text()
    assert "No recording was kept (--keep none)" in written
    assert "--keep first:1" in written
    assert 'id="player"' not in written
    assert 'id="player-data"' not in written
    assert "Distribution of the position error" in written  # over trials: it needs no recording


def test_one_trial_has_no_intervals_and_says_so(tmp_path):
    text = Reader(page.write(fakes.quick(tmp_path / "one", trials=1)).read_text()).words
    assert "1 trial of 4 s was simulated" in text
    assert "One trial gives no interval." in text
    assert "one trial says nothing of it" in text
    assert " nan" not in text.lower()
    results = text[text.index("Results") : text.index("wall time per update")]
    assert "±" not in results.replace("mean over trials ± standard error", "")


def test_failures_alone_make_a_page_with_their_tracebacks(tmp_path, monkeypatch):
    def burn(self, index, seed=None):
        raise RuntimeError("the trolley <b>caught</b> fire")

    monkeypatch.setattr(Simulator, "trial", burn)
    written = page.write(fakes.quick(tmp_path / "failed", trials=2)).read_text()
    text = Reader(written).words
    assert "2 trials of 4 s were to be simulated" in text
    assert "No estimator gave a result." in text
    assert "2 trials failed" in text
    assert "There are no results: every trial failed" in text
    assert "point/trial 0/0 and 0/1" in text
    assert "Traceback (most recent call last)" in text
    assert "<b>caught" not in written


def test_a_failed_estimator_is_named_beside_the_results_of_the_others(tmp_path, monkeypatch):
    from estimators.centroid import Centroid

    def fail(self, prior):
        raise ArithmeticError("no weights")

    monkeypatch.setattr(Centroid, "start", fail)
    text = Reader(page.write(fakes.quick(tmp_path / "part", trials=2)).read_text()).words
    assert "centroid in estimate" in text
    assert "which failed in part" in text
    assert "ekf came nearest" in text or "ukf came nearest" in text


def test_a_sweep_has_a_figure_and_a_part_for_each_point(tmp_path):
    written = page.write(fakes.quick(tmp_path / "sweep", {"sweep": {"report_hz": [2, 5]}}, trials=2)).read_text()
    text = Reader(written).words
    assert "Position error, mean (m) along the sweep" in text
    assert "2 trials of 4 s at each of 2 points of a sweep" in text
    assert "Trial 0 at report_hz = 2" in text
    assert "Trial 0 at report_hz = 5" in text
    assert written.count('id="player"') == 1  # the first recording's


def test_many_targets_are_represented_by_three(tmp_path):
    tags = [{"id": f"still{i}", "position_m": [1 + i, 3, 1]} for i in range(5)]
    folder = fakes.quick(tmp_path / "many", {"tags": tags, "targets": ["lid", "still*"]}, trials=1)
    text = Reader(page.write(folder).read_text()).words
    assert re.search(r"Of 6 targets the best, the median and the worst one are shown: \w+, \w+ and \w+\.", text)


def test_more_recordings_than_fit_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "MOST_RECORDINGS", 2)
    text = Reader(page.write(fakes.quick(tmp_path / "all", keep="all")).read_text()).words
    assert "1 more recording kept and not drawn here" in text


def test_a_damaged_recording_is_named_and_the_page_is_made(tmp_path):
    folder = fakes.quick(tmp_path / "damaged", trials=1)
    (fakes.place(folder) / "truth" / "truth.parquet").write_bytes(b"no parquet")
    text = Reader(page.write(folder).read_text()).words
    assert "can't be read" in text
    assert "came nearest" in text


def test_a_run_whose_plugin_is_gone_can_still_be_read(tmp_path):
    folder = fakes.quick(tmp_path / "gone", trials=2)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["scenario"]["document"]["world"] = {"kind": "burnt_down"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    text = Reader(page.write(folder).read_text()).words
    assert "can't be built on this machine any more" in text
    assert "burnt_down" in text
    assert "came nearest" in text
    assert "Lines of sight can't be made again here" in text


def test_no_estimator_and_no_target_make_a_page_too(tmp_path):
    bare = {"estimators": None, "targets": None, "actors": [], "tags": None, "expect": None}
    text = Reader(page.write(fakes.quick(tmp_path / "bare", bare, trials=1)).read_text()).words
    assert "There are no results: the scenario names no estimator, or no target." in text


def test_tracks_of_nan_and_of_the_plane_are_shown(tmp_path):
    folder = fakes.quick(tmp_path / "bent", trials=2)
    fakes.rewrite(folder, "ekf", lambda t: t.with_(mean=np.full_like(t.mean, np.nan), status=np.full_like(t.status, 2)))
    fakes.rewrite(folder, "ukf", lambda t: t.with_(components=("x", "y"), mean=t.mean[..., :2], covariance=t.covariance[..., :2, :2]))
    written = page.write(folder).read_text()
    data = json.loads(re.search(r'id="player-data">(.*?)</script>', written, re.DOTALL)[1])
    assert [one["id"] for one in data["estimators"]] == ["ekf", "ukf", "centroid"]
    assert set(data["estimators"][0]["targets"][0]["status"]) == {"2"}


# ---------------------------------------------------------------- the folder


def test_a_folder_without_a_run_or_with_an_unfinished_one_is_refused_in_a_sentence(tmp_path, folder):
    with pytest.raises(StoreError, match="holds no run"):
        page.write(tmp_path)
    unfinished = tmp_path / "unfinished"
    shutil.copytree(folder, unfinished)
    (unfinished / "trials.parquet").unlink()
    with pytest.raises(StoreError, match="--resume finishes it"):
        page.write(unfinished)


def test_a_report_that_cannot_be_written_leaves_the_old_one(folder, written, monkeypatch):
    def full(self, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(StoreError, match="No space left on device"):
        page.write(folder)
    monkeypatch.undo()
    assert (folder / "report.html").read_text() == written
    assert not list(folder.glob(".*.part"))


def test_importing_the_package_and_the_command_does_not_import_what_draws():
    import subprocess
    import sys

    script = "import sys, testbed.cli, testbed.report; print(*[m for m in ('matplotlib', 'jinja2', 'cv2') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.strip() == ""


def test_write_is_offered_by_the_package(folder, monkeypatch):
    import testbed.report

    assert testbed.report.write(folder) == folder / "report.html"


# ---------------------------------------------------------------- pictures


def test_camera_pictures_stand_in_the_page_with_their_size(tmp_path):
    pytest.importorskip("pybullet")
    folder = fakes.quick(tmp_path / "seen", {"duration_s": 2}, trials=1)
    written = page.write(folder).read_text()
    images = re.findall(r'<img src="data:image/webp;base64,([^"]+)" alt="([^"]+)" width="(\d+)" height="(\d+)"', written)
    assert [alt.split(".")[0] for _, alt, *_ in images] == ["Camera overview, middle", "In motion"]
    assert all(base64.b64decode(data)[8:12] == b"WEBP" for data, *_ in images)
    assert all(int(width) >= 300 and int(height) >= 200 for *_, width, height in images)
    calm = re.findall(r'<source media="\(prefers-reduced-motion: reduce\)" srcset="data:image/webp;base64,([^"]+)">', written)
    assert len(calm) == 1
    assert b"ANIM" not in base64.b64decode(calm[0])
    assert b"ANIM" in base64.b64decode(images[1][0])
    assert Reader(written).wrong == []
    assert list((fakes.place(folder) / "cameras").glob("*.png"))  # kept beside the recording


def test_without_what_draws_camera_pictures_are_missed_in_a_sentence(folder, monkeypatch):
    def missing(scenario, scene):
        raise ImportError("pybullet is not installed: pip install pybullet")

    monkeypatch.setattr(album.shots, "renderer_of", missing)
    found = album.album(page.cases.load(study.read(folder), study.read(folder).recordings[0]), page.Styles(["ekf"]), moving=True)
    assert found.pictures == ()
    assert found.note == "No camera pictures: pybullet is not installed: pip install pybullet"
