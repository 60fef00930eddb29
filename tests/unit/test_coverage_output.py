"""`testbed coverage`: what it prints, what it writes, what it refuses; and the maps, against the numbers that they show."""

import base64
import io
import json
import re
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib import colormaps
from PIL import Image

from testbed.archive import StoreError
from testbed.cli import main
from testbed.coverage import coverage, covered
from testbed.coverage import output as coverage_output
from testbed.report.figures_coverage import _outline, _runs, coverage_maps
from testbed.scenario import from_dict
from testbed.simulate import Simulator
from testbed.tables import unframe

SITE = """
name: site
seed: 1
trials: 1
duration_s: 1
world: {kind: open_floor, length_m: 12, width_m: 9, posts: 0}
actors:
  - {id: lift, kind: forklift, motion: kinematic, route: {waypoints_m: [[6, 4], [6, 8]]}}
sensors:
  - {id: west, kind: rfid, antennas: [{position_m: [0, 4, 1.5]}, {position_m: [0, 4, 2.5]}], power_dbm: 22}
  - {id: east, kind: rfid, antennas: {position_m: [12, 1, 1.5], yaw_deg: 150}, power_dbm: 20}
"""
FILES = {"coverage.parquet", "points.parquet", "coverage.json", "coverage.html", "coverage-read.svg", "coverage-antennas.svg",
         "coverage-level.svg"}  # fmt: skip


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "site.yaml").write_text(SITE)
    return tmp_path


@pytest.fixture
def unpainted(monkeypatch):
    """Without the figures, which take the most time."""
    monkeypatch.setattr("testbed.report.figures_coverage.coverage_maps", lambda *a: ())


@pytest.fixture(scope="module")
def mapped():
    with Simulator(from_dict(_plain())) as simulator:
        found = covered(simulator, step_m=0.5, height_m=[1.0, 2.0])
        return found, coverage_maps(found, simulator.scene, simulator.at_rest().truth)


def _plain():
    from testbed.scenario import from_text

    return from_text(SITE).document


def command(capsys, *words):
    """(exit code, stdout, stderr) of `testbed coverage`."""
    with pytest.raises(SystemExit) as left:
        main(["coverage", *map(str, words)])
    out, err = capsys.readouterr()
    return left.value.code, out, err


def test_json_on_stdout_and_the_same_in_the_folder(site, capsys):
    code, out, err = command(capsys, "site.yaml", "--step", "1", "--height", "1", "--height", "2", "--json")
    assert code == 0
    document = json.loads(out)
    assert document == json.loads((site / "runs" / "site-coverage" / "coverage.json").read_text())
    assert {f.name for f in (site / "runs" / "site-coverage").iterdir()} == FILES
    assert "648 of 648 links" in err  # 12 by 9 cells, two heights, three antennas
    found = coverage(site / "site.yaml", step_m=1, height_m=[1, 2])
    assert [h["height_m"] for h in document["heights"]] == [1, 2]
    for height, shares in zip(document["heights"], found.shares(), strict=True):
        assert list(height["share_read_by"].values()) == shares.tolist()
        assert height["dead_m2"] == pytest.approx(sum(z["area_m2"] for z in height["dead_zones"]))
    floor = (~found.inside).sum(axis=(1, 2))
    assert document["share_read_by"]["1"] == pytest.approx((found.shares()[:, 0] * floor).sum() / floor.sum())
    assert document["antennas"] == {"west.1": "west", "west.2": "west", "east.1": "east"}


def test_a_table_for_people(site, unpainted, capsys):
    code, out, _ = command(capsys, "site.yaml", "--step", "1")
    assert code == 0
    assert "share of the floor that is read" in out
    assert "by ≥ 3" in out
    assert re.search(r"dead zone at 1 m: \d+\.\d m² about \(", out)
    assert "coverage.html" in out


def test_nothing_is_overwritten_without_force(site, unpainted, capsys):
    for _ in range(2):
        assert command(capsys, "site.yaml", "--step", "2")[0] == 0
    assert (site / "runs" / "site-coverage-2").is_dir()
    before = (site / "runs" / "site-coverage" / "coverage.json").read_bytes()
    code, _, err = command(capsys, "site.yaml", "--step", "1", "--out", "runs/site-coverage")
    assert (code, (site / "runs" / "site-coverage" / "coverage.json").read_bytes()) == (2, before)
    assert "--force" in err
    assert command(capsys, "site.yaml", "--step", "1", "--out", "runs/site-coverage", "--force")[0] == 0
    assert (site / "runs" / "site-coverage" / "coverage.json").read_bytes() != before
    (site / "mine").mkdir()
    (site / "mine" / "thesis.txt").write_text("all of it")
    code, _, err = command(capsys, "site.yaml", "--out", "mine", "--force")
    assert code == 2
    assert "holds no coverage" in err
    assert [f.name for f in (site / "mine").iterdir()] == ["thesis.txt"]
    with pytest.raises(StoreError, match="is a file"):
        coverage_output.check(site / "site.yaml", force=True)


def test_the_same_command_gives_the_same_bytes(site, capsys):
    for folder in ("a", "b"):
        command(capsys, "site.yaml", "--step", "1", "--out", folder)
    for name in FILES:
        assert (site / "a" / name).read_bytes() == (site / "b" / name).read_bytes(), name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--height", "40"], "a height of 40 m is not in the hall"),
        (["--step", "0"], "the step must be more than 0 m"),
        (["--tag", "monza_r7"], "monza_r6"),
        (["--sensor", "wets"], "did you mean west"),
        (["--set", "sensors.west.power_dbm=99"], "power_dbm"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_2_and_leaves_no_folder(site, capsys, words, said):
    code, out, err = command(capsys, "site.yaml", *words)
    assert code == 2
    assert out == ""
    assert said in err
    assert "Traceback" not in err
    assert not (site / "runs").exists()


def test_options_reach_the_map(site, unpainted, capsys):
    _, whole, _ = command(capsys, "site.yaml", "--step", "1", "--json")
    _, part, _ = command(capsys, "site.yaml", "--step", "1", "--json", "--sensor", "east", "--tag", "monza_r6")
    _, strong, _ = command(capsys, "site.yaml", "--step", "1", "--json", "--set", "sensors.west.power_dbm=29")
    whole, part, strong = map(json.loads, (whole, part, strong))
    assert list(part["antennas"]) == ["east.1"]
    assert part["tag"] == "monza_r6"
    assert strong["share_read_by"]["1"] > whole["share_read_by"]["1"]


def test_parquet_has_a_row_per_link_and_per_point(site, unpainted, capsys):
    command(capsys, "site.yaml", "--step", "0.5", "--out", "o")
    document = json.loads((site / "o" / "coverage.json").read_text())
    points, links = (unframe(pq.read_table(site / "o" / f"{name}.parquet")) for name in ("points", "coverage"))
    floor = ~points["inside"]
    assert len(floor) == 24 * 18
    assert floor.sum() * 0.25 == document["heights"][0]["floor_m2"]
    assert points["dead"].sum() * 0.25 == document["heights"][0]["dead_m2"]
    for n in (1, 2, 3):
        assert (points["antennas"][floor] >= n).mean() == document["share_read_by"][str(n)]
    missed = dict.fromkeys(zip(points["x_m"], points["y_m"], strict=True), 1.0)
    for x, y, p in zip(links["x_m"], links["y_m"], links["probability"], strict=True):
        missed[x, y] *= 1 - p
    np.testing.assert_allclose((1 - np.array(list(missed.values())))[floor], points["probability"][floor], atol=1e-12)
    assert set(links) >= {"antenna", "sensor", "probability", "rssi_dbm", "line_of_sight", "loss_db", "distance_m"}
    assert pq.read_schema(site / "o" / "coverage.parquet").field("rssi_dbm").metadata[b"unit"] == b"dBm"


# ---------------------------------------------------------------- the maps


def test_cells_of_the_map_have_the_colours_of_their_probabilities(mapped):
    found, drawings = mapped
    pictures = re.findall(r'<image [^>]*?base64,([^"]+)"[^>]*transform="matrix\(([^)]*)\)"', drawings[0].svg)
    assert len(pictures) == 2
    for k, (text, matrix) in enumerate(pictures):
        cells = np.asarray(Image.open(io.BytesIO(base64.b64decode("".join(text.split())))).convert("RGBA"))
        across, _, _, up, *_ = (float(v) for v in matrix.split())
        assert across > 0 > up  # the first row of the picture is the lowest of the map
        floor = ~found.inside[k]
        expected = np.round(255 * np.asarray(colormaps["cividis"](np.where(floor, found.read[k], 0.0)))).astype(int)
        assert np.abs(cells[floor].astype(int) - expected[floor]).max() <= 1
        assert (cells[~floor][:, 3] == 0).all()
    assert found.inside[0].any()


def test_runs_and_outline_of_a_mask():
    mask = np.array([[1, 1, 0], [0, 1, 0], [0, 0, 1]], dtype=bool)
    x = y = np.array([0.0, 2.0, 4.0])
    runs = _runs(mask, x, y, 2.0)
    area = sum((r[2, 0] - r[0, 0]) * (r[2, 1] - r[0, 1]) for r in runs)
    assert (len(runs), area) == (3, mask.sum() * 4.0)
    length = sum(np.abs(line[1] - line[0]).sum() for line in _outline(mask, x, y, 2.0))
    # by hand: an L of three cells has 8 sides, a cell alone 4, of 2 m
    assert length == 24.0
    assert _outline(np.zeros((2, 2), dtype=bool), x[:2], y[:2], 2.0) == []


def test_every_figure_is_whole_by_itself_and_its_caption_tells_the_shares(mapped):
    found, drawings = mapped
    assert [d.name for d in drawings] == ["coverage-read", "coverage-antennas", "coverage-level"]
    for one in drawings:
        svg = coverage_output.standalone(one)
        ElementTree.fromstring(svg)
        assert "var(--" not in svg
        assert f"at 1 m {100 * found.shares()[0, 0]:.0f} %" in one.caption
        assert "2 m above the floor" in one.svg
        assert "dead zone" in one.svg
    assert "mean RSSI (dBm)" in drawings[2].svg


def test_the_page_asks_nobody_for_anything(mapped):
    html = coverage_output.page(*mapped)
    assert not re.search(r'(?:src|href)="(?!data:|#)', html)
    assert "<script" not in html
    assert all(note in html.replace("&#39;", "'") for note in coverage_output.LEFT_OUT)


def test_a_site_that_hears_nothing_still_has_its_maps(tmp_path):
    document = _plain() | {"sensors": [{"id": "x", "kind": "rfid", "antennas": {"position_m": [0, 4, 1.5]}, "power_dbm": -30}]}
    with Simulator(from_dict(document)) as simulator:
        found = covered(simulator, step_m=1.0)
        drawings = coverage_maps(found, simulator.scene, simulator.at_rest().truth)
    coverage_output.write(found, drawings, tmp_path / "o")
    written = json.loads((tmp_path / "o" / "coverage.json").read_text())
    assert written["share_read_by"] == {"1": 0.0, "2": 0.0, "3": 0.0}
    assert written["heights"][0]["dead_share"] == 1.0
