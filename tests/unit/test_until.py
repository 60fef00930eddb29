"""Enough trials: what may be asked for, when it is enough, and that the same number comes out however a run goes."""

import os

import numpy as np
import pytest
from batch_fakes import scenario, work

from testbed import pool
from testbed.api import run as run_testbed
from testbed.batch import run
from testbed.store import read_manifest
from testbed.until import FEWEST, NotReached, Until


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.mark.parametrize("sign", ["±", "+-", "+/-", " ± "])
def test_a_figure_and_a_width_are_read(sign):
    until = Until.parse(f"ukf.position_error_m.mean {sign} 2%")
    assert (until.claim.subject, until.claim.column, until.width, until.is_relative) == ("ukf", "position_error_m.mean", 0.02, True)


def test_a_difference_and_an_amount_are_read():
    until = Until.parse("centroid - ukf.position_error_m.p95 +- 0.05")
    assert (until.claim.subject, until.claim.column, until.width, until.is_relative) == (
        "centroid - ukf",
        "position_error_m.p95",
        0.05,
        False,
    )
    assert Until.parse("ukf.availability ± 1e-3").claim.column == "availability"


@pytest.mark.parametrize(
    "text", ["", "ukf", "ukf ± 2%", "ukf.x.mean", "ukf.x.mean ± ", "ukf.x.mean ± 0", "ukf.x.mean ± -1%", "ukf.x. = 2%"]
)
def test_what_says_nothing_is_refused_with_the_form(text):
    with pytest.raises(ValueError, match="does not say until when: write"):
        Until.parse(text)


def rows(values):
    n = len(values)
    return {
        "point": np.zeros(n, int),
        "trial": np.arange(n),
        "estimator": np.full(n, "ukf"),
        "target": np.full(n, "a"),
        "x": np.array(values),
    }


def test_it_is_enough_exactly_when_half_the_interval_is_within_the_width():
    values = np.linspace(1.0, 3.0, 40)
    reach = (lambda i: (i.high - i.low) / 2)(Until.parse("ukf.x ± 1").interval(rows(values), {}, 0))
    assert Until.parse(f"ukf.x ± {reach * 1.0001}").more(40, rows(values), {}, [0], 4) == 40
    assert Until.parse(f"ukf.x ± {reach * 0.9999}").more(40, rows(values), {}, [0], 4) == 44
    assert Until.parse(f"ukf.x ± {reach / 2.0 * 100.01}%").more(40, rows(values), {}, [0], 4) == 40  # of the mean, which is 2
    assert Until.parse(f"ukf.x ± {reach / 1.2}").more(40, rows(values), {}, [0], 4) == 60  # 40 · 1.44 in whole blocks
    assert Until.parse(f"ukf.x ± {reach / 9}").more(40, rows(values), {}, [0], 4) == 80  # never more than twice
    assert Until.parse(f"ukf.x ± {reach / 9}", most=50).more(40, rows(values), {}, [0], 4) == 50


def test_a_run_goes_on_until_the_figure_is_known_and_says_so(tmp_path):
    result = run(scenario(), out=tmp_path, keep="none", until=Until.parse("ekf.position_error_m.mean ± 6%"), work=work)
    interval = next(s for s in result.summaries if s.estimator == "ekf").statistics["position_error_m.mean"]
    assert (interval.high - interval.low) / 2 <= 0.06 * interval.mean
    assert FEWEST < result.scenario.trials == interval.n == result.until.trials
    assert result.until.is_reached
    assert result.until.looks > 1
    assert read_manifest(tmp_path)["trials"] == interval.n
    assert read_manifest(tmp_path)["until"] == "ekf.position_error_m.mean ± 6%"
    assert result.document()["until"]["reached"] is True
    assert f"reached with {interval.n} trials" in str(result)
    assert "covers somewhat less" in str(result)


def test_trials_are_the_same_in_other_processes_and_when_going_on(tmp_path):
    until = Until.parse("ekf - ukf.position_error_m.mean +- 0.08")
    first = run(scenario(), out=tmp_path, keep="none", until=until, work=work)
    bare = run(scenario(), until=until, work=work)
    threads = run(scenario(), until=until, jobs=3, executors=_threads, work=work)
    again = run(scenario(), out=tmp_path, keep="none", until=until, resume=True, work=lambda block: pytest.fail("made again"))
    for other in (bare, threads, again):
        assert list(other.rows["trial"]) == list(first.rows["trial"])
        np.testing.assert_array_equal(other.rows["position_error_m.mean"], first.rows["position_error_m.mean"])


def _threads(jobs):
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(jobs)


def test_every_point_of_a_sweep_gets_as_many_trials_as_the_widest_needs():
    result = run(scenario(sweep={"duration_s": [1, 2, 3]}), until=Until.parse("ukf.position_error_m.mean ± 8%"), work=work)
    per_point = [np.unique(result.rows["trial"][result.rows["point"] == p]).size for p in range(3)]
    assert set(per_point) == {result.until.trials}
    for s in (s for s in result.summaries if s.estimator == "ukf"):
        i = s.statistics["position_error_m.mean"]
        assert (i.high - i.low) / 2 <= 0.08 * i.mean


def test_where_it_is_not_to_be_had_the_most_is_done_and_told():
    result = run(scenario(), until=Until.parse("ekf.position_error_m.mean ± 0.01%", most=40), work=work)
    assert (result.until.trials, result.until.is_reached) == (40, False)
    assert "NOT reached within 40 trials" in str(result.until)


@pytest.mark.parametrize("figure", ["ekf.no_such.mean", "nobody.availability", "world.moon"])
def test_a_figure_that_nobody_has_is_told_after_the_first_look(figure):
    with pytest.raises(NotReached, match="no value"):
        run(scenario(), until=Until.parse(f"{figure} ± 2%"), work=work)


def test_python_takes_it_as_the_command_does():
    with pytest.raises(ValueError, match="does not say until when"):
        run_testbed(scenario(), until="soon")


def test_tasks_of_fast_blocks_grow_and_leave_something_for_each_job(monkeypatch):
    from testbed.worker import Block

    queue = pool._Queue([Block(b"", 0, (i,)) for i in range(100)] + [Block(b"", 1, (i,)) for i in range(3)])
    assert len(queue.take(2)) == 1  # nothing is known yet
    queue.learn([1], 0.1)
    assert [len(queue.take(2)) for _ in range(2)] == [10, 10]
    queue.learn([1], 0.001)
    assert len(queue.take(2)) == 21  # half of what is there for each
    queue.learn([1, 1], 5.0)
    last = queue.take(2)
    assert len(last) == 1
    queue.back(last)
    assert queue.take(1)[0] == last[0]
    queue.learn([1], 0.0)
    rest = []
    while queue:
        rest.append({block.point for block in queue.take(1)})
    assert {frozenset(points) for points in rest} == {frozenset({0}), frozenset({1})}  # tasks don't cross points
