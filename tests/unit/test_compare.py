"""Comparing and ranking: the statistics against closed forms and scipy, what is counted apart, the pages."""

import json
import os
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from batch_fakes import scenario, work
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from testbed import leaderboard
from testbed.batch import run
from testbed.cli import main
from testbed.compare import CompareError, adjusted, compare, read_run, read_runs
from testbed.compare import test as t_test
from testbed.report import board
from testbed.store import StoreError


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def shifted(by, spread=0.0):
    """The fakes' work with errors of the estimator "ekf" moved, and wall times."""

    def moved(block):
        result = work(block)
        rows = dict(result.rows)
        if not rows:
            return result
        ekf = rows["estimator"] == "ekf"
        rows["position_error_m.mean"] = np.where(ekf, rows["position_error_m.mean"] * (1 + spread) + by, rows["position_error_m.mean"])
        keys = {name: rows[name] for name in ("point", "trial", "estimator", "target")}
        n = len(ekf)
        per_update = np.where(ekf, 1e-3, 4e-3) * (1 + 0.01 * rows["trial"])
        timings = {
            **keys,
            "stage": np.full(n, "update"),
            "seconds": per_update * 10,
            "updates": np.full(n, 10),
            "seconds_per_update": per_update,
        }
        return replace(result, rows=rows, timings=timings)

    return moved


def bounded(by):
    def moved(block):
        result = shifted(by)(block)
        n = len(result.rows["trial"])
        more = {"position_error_m.rms": result.rows["position_error_m.mean"] * 1.1, "bound.position_bound_m.filtered": np.full(n, 0.12)}
        return replace(result, rows={**result.rows, **more})

    return moved


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """ "a" and "b" of the same trials, b's ekf 0.1 worse; "failing", in which trial 3 crashed."""
    home = tmp_path_factory.mktemp("runs")
    one = scenario(trials=30)
    run(one, out=home / "a", keep="none", work=shifted(0.0))
    run(one, out=home / "b", keep="none", work=shifted(0.1, 0.05))
    run(scenario(trials=30, title="fail=3", name="failing"), out=home / "failing", keep="none", work=bounded(-0.3))
    return home


# ---------------------------------------------------------------- statistics


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=40))
@settings(max_examples=60, deadline=None)
def test_p_is_that_of_scipys_paired_t_test(values):
    apart = np.array(values)
    p, d = t_test(apart)
    if apart.std(ddof=1) < 1e-9:
        return
    assert p == pytest.approx(stats.ttest_1samp(apart, 0.0).pvalue, rel=1e-9)
    assert d == pytest.approx(apart.mean() / apart.std(ddof=1))


def test_differences_without_spread_are_no_matter_of_chance():
    assert t_test(np.zeros(5)) == (1.0, 0.0)
    assert t_test(np.full(5, -2.0)) == (0.0, -np.inf)
    assert np.isnan(t_test(np.array([1.0]))).all()


def test_holm_by_hand():
    np.testing.assert_allclose(adjusted(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(adjusted(np.array([0.5, np.nan, 0.4])), [0.8, np.nan, 0.8])
    assert len(adjusted(np.array([]))) == 0


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
@settings(max_examples=60, deadline=None)
def test_holm_keeps_the_order_and_lies_between_nothing_and_bonferroni(values):
    p = np.array(values)
    found = adjusted(p)
    assert (found >= p - 1e-15).all()
    assert (found <= np.minimum(1, len(p) * p) + 1e-15).all()
    assert (np.diff(found[np.argsort(p)]) >= -1e-15).all()


def test_of_many_pairs_without_a_difference_holm_claims_one_in_one_of_twenty_families():
    """400 families of 10 pairs of nothing: 20 ± 4.4 claims expected at most; more than 34 has probability 0.001."""
    rng = np.random.default_rng(5)
    claims = 0
    for _ in range(400):
        p = np.array([t_test(rng.normal(size=12))[0] for _ in range(10)])
        claims += bool((adjusted(p) < 0.05).any())
        assert (adjusted(p) < 0.05).any() <= (p < 0.05).any()
    assert 6 < claims <= 34


# ---------------------------------------------------------------- runs


def test_runs_are_compared_on_the_same_trials_estimator_by_estimator(runs):
    a, b = read_runs([runs / "a", runs / "b"])
    ekf, ukf = compare([a, b], "run")
    assert (ekf.left.label, ekf.right.label) == ("ekf in a", "ekf in b")
    mine, theirs = (x.rows["position_error_m.mean"][x.rows["estimator"] == "ekf"].reshape(30, 2).mean(axis=1) for x in (a, b))
    assert ekf.difference.mean == pytest.approx((mine - theirs).mean())
    assert ekf.p == pytest.approx(stats.ttest_rel(mine, theirs).pvalue)
    assert ekf.p_holm == pytest.approx(2 * ekf.p)
    assert ekf.verdict == "ekf in a is lower"
    assert ekf.above.mean == 0.0
    assert ekf.d == pytest.approx((mine - theirs).mean() / (mine - theirs).std(ddof=1))
    assert ekf.difference.se < ekf.left.mean.se / 3  # pairing pays
    assert (ukf.difference.mean, ukf.p, ukf.verdict, ukf.above.mean) == (0.0, 1.0, "no difference shown", 0.5)
    assert ekf.left.quantiles[2] == pytest.approx(np.median(mine))


def test_estimators_are_compared_within_each_run(runs):
    pairs = compare(read_runs([runs / "a", runs / "b"]), "estimator")
    assert [(p.at, p.left.label, p.right.label) for p in pairs] == [("a", "ekf", "ukf"), ("b", "ekf", "ukf")]
    assert len(compare([read_run(runs / "a")], "estimator")) == 1


def test_what_crashed_is_counted_and_is_no_error(runs):
    a, failing = read_runs([runs / "a", runs / "failing"])
    [ekf] = compare([a, failing], "run", estimators=["ekf"])
    assert (ekf.left.failed, ekf.right.failed, ekf.difference.n) == (0, 1, 29)
    assert ekf.document()["right"]["failed_trials"] == 1


def test_rows_without_a_value_are_counted(runs):
    a, b = read_runs([runs / "a", runs / "b"])
    column = np.where((b.rows["trial"] < 4) & (b.rows["estimator"] == "ekf"), np.nan, b.rows["position_error_m.mean"])
    holed = replace(b, rows={**b.rows, "position_error_m.mean": column})
    ekf = compare([a, holed], "run")[0]
    assert (ekf.right.empty, ekf.right.mean.n, ekf.difference.n) == (8, 26, 26)


def test_points_of_sweeps_are_matched_by_what_they_set(tmp_path):
    for name, values in (("x", [1, 2, 3]), ("y", [3, 1])):
        run(scenario(trials=6, sweep={"duration_s": values}), out=tmp_path / name, keep="none", work=work)
    pairs = compare(read_runs([tmp_path / "x", tmp_path / "y"]), "run", estimators=["ekf"])
    assert [p.at for p in pairs] == ["duration_s = 1", "duration_s = 3"]
    assert all(p.difference.mean == 0 for p in pairs)


def test_other_targets_are_compared_trial_by_trial(runs):
    a, b = read_runs([runs / "a", runs / "b"])
    renamed = replace(b, rows={**b.rows, "target": np.char.add(b.rows["target"], "x")})
    assert compare([a, renamed], "run")[0].difference.mean == pytest.approx(compare([a, b], "run")[0].difference.mean)


def test_what_cannot_be_compared_is_told(runs):
    a, b = read_runs([runs / "a", runs / "b"])
    with pytest.raises(CompareError, match="one run has nothing to be compared with"):
        compare([a], "run")
    with pytest.raises(CompareError, match=r"not all runs have the figure 'position_error_m\.p95', did you mean"):
        compare([a, b], "run", ["position_error_m.p95"])
    with pytest.raises(CompareError, match="no estimator has the id 'kf'"):
        compare([a, b], "run", estimators=["kf"])
    with pytest.raises(CompareError, match="there is less than two estimators to compare"):
        compare([a], "estimator", estimators=["ekf"])
    with pytest.raises(CompareError, match="named twice"):
        read_runs([runs / "a", runs / "a"])


# ---------------------------------------------------------------- the leaderboard


def test_the_board_ranks_counts_and_bounds(runs):
    found = leaderboard.read(runs)
    assert [p.label for p in found.places] == ["fake", "fake (2)", "failing"]
    first, second, failing = found.places
    assert {e.estimator for e in first.entries if e.leads} == {"ekf", "ukf"}  # of one kind: chance
    assert [e.estimator for e in second.entries if e.leads] in (["ukf"], ["ukf", "ekf"])
    assert not first.has_bound
    assert failing.bound.mean == pytest.approx(0.12)
    assert [e.failed for e in failing.entries] == [1, 1]
    best = failing.entries[0]
    assert (best.estimator, best.leads, best.front) == ("ekf", True, True)
    assert not failing.entries[1].front  # slower and farther off
    assert best.cost.mean == pytest.approx(np.mean([1e-3 * (1 + 0.01 * t) for t in range(30) if t != 3]))


def test_over_all_the_error_is_by_the_least_one(runs):
    found = leaderboard.read(runs)
    over = {id: (n, led, ratio) for id, n, led, ratio in found.overall()}
    ratios = []
    for place in found.places:
        error = {e.estimator: e.error.mean for e in place.entries}
        ratios.append(error["ekf"] / min(error.values()) if min(error.values()) > 0 else None)
    expected = [r for r in ratios if r is not None]
    assert over["ekf"][2] == pytest.approx(np.exp(np.mean(np.log(expected))))
    assert over["ukf"][0] == len(expected)


def test_a_folder_without_runs_and_runs_without_the_figure_are_told(tmp_path, runs):
    with pytest.raises(StoreError, match="holds no finished run with the figure"):
        leaderboard.read(tmp_path)
    with pytest.raises(StoreError, match=r"figure no\.such"):
        leaderboard.read(runs, "no.such")


def test_an_unfinished_run_is_left_out_by_name(tmp_path):
    run(scenario(), out=tmp_path / "done", keep="none", work=work)
    run(scenario(), out=tmp_path / "half", keep="none", work=work)
    (tmp_path / "half" / "trials.parquet").unlink()
    found = leaderboard.read(tmp_path)
    assert len(found.places) == 1
    assert "half" in found.notes[0]
    assert "not finished" in found.notes[0]


# ---------------------------------------------------------------- pages and commands


def test_pages_stand_alone_escape_names_and_come_out_the_same(runs, tmp_path):
    found = leaderboard.read(runs)
    evil = replace(found, places=(replace(found.places[0], scenario="<script>x</script>"), *found.places[1:]))
    page = board.leaderboard(evil).html()
    assert page == board.leaderboard(evil).html()
    assert "<script" not in page
    assert "http" not in page.replace("http://www.w3.org", "").replace("http-equiv", "")
    for section in ("overall", "errors", "cost", "places", "notes"):
        assert f'<section id="{section}">' in page
    pairs = compare(read_runs([runs / "a", runs / "b"]), "run")
    compared = board.compared(pairs, ["a", "b"]).html()
    for markup in (page, compared):
        for figure in [part[: part.index("</svg>") + 6] for part in markup.split("<figure>")[1:]]:
            ET.fromstring(figure)
    with pytest.raises(StoreError, match="the page can't be written to"):
        board.leaderboard(found).write(tmp_path / "nowhere" / "page.html")


def test_the_commands_print_json_and_write_pages(runs, tmp_path, capsys):
    for arguments, code in (
        (["compare", str(runs / "a"), str(runs / "b"), "--json", "--html", str(tmp_path / "c.html")], 0),
        (["leaderboard", str(runs), "--json", "--html", str(tmp_path / "l.html")], 0),
        (["compare", str(runs / "a"), "--by", "run"], 2),
        (["compare", str(runs / "a"), "--by", "seed"], 2),
        (["leaderboard", str(tmp_path)], 2),
        (["compare", str(runs / "a")], 0),
    ):
        with pytest.raises(SystemExit) as leaving:
            main(arguments)
        assert leaving.value.code == code, arguments
        printed = capsys.readouterr()
        if "--json" in arguments:
            assert json.loads(printed.out)
        elif code:
            assert len(printed.err.splitlines()) == 1
        else:
            assert "ekf − ukf" in printed.out
    assert (tmp_path / "c.html").read_text().startswith("<!doctype html>")
    assert (tmp_path / "l.html").is_file()
