"""A log through the command: the same as from a recording, scored where there is a truth."""

import json
import math

import numpy as np
import pytest

from testbed.cli import main
from testbed.log_replay import replay_log
from testbed.logs import LogError
from testbed.logs.site import checked_site
from testbed.scenario import DataMissing, from_dict
from testbed.simulate import Simulator

CORNERS = [(0, 0), (6, 0), (6, 6), (0, 6)]
SITE = {
    "name": "corner",
    "log": {"kind": "tidy_csv", "start_s": 0},
    "antennas": [{"id": f"a{i}", "port": i, "position_m": [x, y, 1], "reference_dbm": -40} for i, (x, y) in enumerate(CORNERS)],
    "truth": {"kind": "csv", "height_m": 1.0},
    "prior": {"position_m": [3, 3, 1], "position_std_m": [2, 2, 0.1], "velocity_mps": [0, 0, 0]},
}


def path(t):
    return 1 + 0.5 * t, 3 + np.sin(t)


@pytest.fixture
def files(tmp_path):
    """A log of a tag that goes through four antennas' square by the law of distance, its truth, its site."""
    random, rows, true = np.random.default_rng(3), ["t,antenna,tag,rssi"], ["t,x,y"]
    for k, t in enumerate(np.arange(0, 8, 0.05)):
        x, y = path(t)
        ax, ay = CORNERS[k % 4]
        rows.append(f"{t:.3f},{k % 4},lid,{-40 - 40 * math.log10(math.hypot(x - ax, y - ay)) + random.normal():.2f}")
        true.append(f"{t:.3f},{x:.4f},{y:.4f}")
    rows.insert(7, "0.3,9,lid,-50")
    (tmp_path / "log.csv").write_text("\n".join(rows))
    (tmp_path / "truth.csv").write_text("\n".join(true))
    (tmp_path / "site.yaml").write_text(json.dumps(SITE))
    return tmp_path


def test_with_a_truth_it_is_scored_as_a_run(files, capsys):
    line = ["replay", str(files / "log.csv"), "--site", str(files / "site.yaml"), "--truth", str(files / "truth.csv")]
    with pytest.raises(SystemExit) as left:
        main([*line, "--estimator", "ukf", "--estimator", "centroid", "--out", str(files / "out"), "--json"])
    document = json.loads(capsys.readouterr().out)
    figures = document["points"][0]["estimators"]
    assert left.value.code == 0
    assert figures["ukf"]["position_error_m"]["mean"] < figures["centroid"]["position_error_m"]["mean"] < 3
    assert document["log"]["left_out"] == 1
    assert document["log"]["first_left_out"] == [{"line": 8, "reason": "an antenna port that the site does not have: '9'"}]
    assert (files / "out" / "left-out.csv").read_text().splitlines()[1].startswith("8,")
    assert "the log is replayed" in (files / "out" / "report.html").read_text(encoding="utf-8")


def test_without_a_truth_there_are_tracks_and_no_errors(files, capsys):
    with pytest.raises(SystemExit):
        main(
            [
                "replay",
                str(files / "log.csv"),
                "--site",
                str(files / "site.yaml"),
                "--estimator",
                "ukf",
                "--out",
                str(files / "o"),
                "--json",
            ]
        )
    document = json.loads(capsys.readouterr().out)
    row = document["tracks"][0]
    np.testing.assert_allclose(row["last_m"][:2], path(7.95), atol=1.0)
    assert row["used"] == 159  # the last read comes after the last report
    assert (files / "o" / "ukf.parquet").is_file()
    assert not (files / "o" / "report.html").exists()


def test_the_same_log_gives_the_same_figures(files):
    runs = [replay_log(files / "log.csv", checked_site(SITE), ["ukf"], truth=files / "truth.csv") for _ in range(2)]
    first, second = (run.result.rows["position_error_m.mean"] for run in runs)
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none.csv", "--site", "site.yaml", "--estimator", "ukf"], "not on this machine"),
        (["log.csv", "--site", "none.yaml", "--estimator", "ukf"], "can't be read"),
        (["log.csv", "--site", "log.csv", "--estimator", "ukf"], "log.csv"),
        (["log.csv", "--site", "site.yaml"], "no estimator is named"),
        (["log.csv", "--site", "site.yaml", "--estimator", "uk"], "did you mean ukf"),
        (["log.csv", "--site", "site.yaml", "--estimator", "ukf", "--truth", "log.csv"], "columns t, x and y"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_2(files, capsys, monkeypatch, arguments, says):
    monkeypatch.chdir(files)
    with pytest.raises(SystemExit) as left:
        main(["replay", *arguments])
    assert left.value.code == 2
    assert says in capsys.readouterr().err


def recorded(files, **changes):
    world = {"kind": "recorded", "protocol": "nothing is fitted", "logs": [str(files / "log.csv")], "truths": [str(files / "truth.csv")]}
    world |= {"site": SITE, **changes}
    return {"name": "recorded", "seed": 1, "trials": 2, "block": 1, "duration_s": 10, "world": world, "estimators": [{"kind": "centroid"}]}


def test_levels_are_fitted_on_the_other_piece_alone(files):
    with Simulator(from_dict(recorded(files, pieces=2, fit="others", path_loss_exponent=4))) as simulator:
        first, second = simulator.trial(0), simulator.trial(1)
    for trial in (first, second):
        np.testing.assert_allclose(trial.recording.site.antennas.reference, -40, atol=1.0)
        assert trial.recording.duration == pytest.approx(7.95 / 2, abs=0.03)
    assert not np.array_equal(first.recording.site.antennas.reference, second.recording.site.antennas.reference)
    np.testing.assert_allclose(second.target_states(np.array([0.0]))[0, 0, :2], path(7.95 / 2), atol=0.01)


def test_a_log_that_is_not_there_is_data_missing(files):
    with pytest.raises(DataMissing, match="not on this machine"):
        Simulator(from_dict(recorded(files, logs=["../nowhere/a.csv"])))


def test_a_log_that_is_broken_is_an_error_of_the_scenario(files):
    (files / "bad.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="no column is the time") as error:
        Simulator(from_dict(recorded(files, logs=[str(files / "bad.csv")])))
    assert not isinstance(error.value, (DataMissing, LogError))
