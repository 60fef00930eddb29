"""What is said on the way: seldom, on the stream given, and never on stdout."""

import io
import sys

import pytest
from batch_fakes import scenario, work

from testbed import progress
from testbed.batch import run
from testbed.progress import Bar, Lines, Silent, choose


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

        def __call__(self):
            return self.now

    made = Clock()
    monkeypatch.setattr(progress, "monotonic", made)
    return made


def lines_of(clock, trials, seconds_each, total=None, **options):
    out = io.StringIO()
    told = Lines(out, **options)
    told.start("dock", total or trials, 0)
    for _ in range(trials):
        clock.now += seconds_each
        told.advance(1, 0)
    told.finish()
    return out.getvalue().splitlines()


def test_a_fast_run_says_where_it_begins_and_ends(clock):
    assert lines_of(clock, 1000, 0.001) == ["dock: 1000 trials", "dock: 1000 of 1000 trials, 1 s, 1000/s"]


def test_a_slow_run_speaks_about_every_tenth_and_tells_the_time_left(clock):
    said = lines_of(clock, 100, 6.0)
    assert len(said) == 2 + 9
    assert said[5] == "dock: 50 of 100 trials, 10/min, about 5 min 00 s left"
    assert said[-1] == "dock: 100 of 100 trials, 10 min 00 s, 10/min"


def test_a_middling_run_speaks_at_most_every_five_seconds(clock):
    assert len(lines_of(clock, 100, 0.11)) == 2 + 2


def test_failures_are_counted(clock):
    out = io.StringIO()
    told = Lines(out)
    told.start("dock", 10, 4)
    told.advance(4, 2)
    told.finish()
    assert out.getvalue().splitlines() == ["dock: 10 trials, 4 of them there already", "dock: 8 of 10 trials, 2 failures, 0 s"]


def test_a_sweep_is_told_point_by_point(clock):
    out = io.StringIO()
    told = Lines(out, every_s=0.0)
    told.start("dock", 6, 1, [("gates = 1", 2, 1), ("gates = 2", 4, 0)])
    for trials, failures, point in ((1, 1, 0), (2, 0, 1), (2, 1, 1)):
        clock.now += 2.0
        told.advance(trials, failures, point)
    told.finish()
    assert out.getvalue().splitlines() == [
        "dock: 6 trials at 2 points, 1 of them there already",
        "dock: done gates = 1: 2 trials, 1 failure",
        "dock: 2 of 6 trials, 1 of 2 points, 1 failure, 30/min, about 8 s left",
        "dock: 4 of 6 trials, 1 of 2 points, 1 failure, 45/min, about 3 s left",
        "dock: done gates = 2: 4 trials, 1 failure",
        "dock: 6 of 6 trials, 2 of 2 points, 2 failures, 6 s, 50/min",
    ]


def test_a_run_that_takes_long_for_a_tenth_still_speaks_each_minute(clock):
    assert len(lines_of(clock, 20, 31.0, total=1000)) == 2 + 10


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.4, "59 s"), (61, "1 min 01 s"), (3599.9, "1 h 00 min"), (7260, "2 h 01 min")]
)
def test_spans_of_time_are_readable(seconds, text):
    assert progress._span(seconds) == text


def test_a_terminal_gets_a_bar_and_a_file_gets_lines(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    assert isinstance(choose(Terminal()), Bar)
    assert isinstance(choose(io.StringIO()), Lines)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert isinstance(choose(), Lines)


@pytest.mark.parametrize("kind", [lambda out: Lines(out), lambda out: Bar(out), lambda out: Silent()], ids=["lines", "bar", "silent"])
def test_a_run_says_nothing_on_stdout(capsys, kind):
    out = io.StringIO()
    told = kind(out)
    run(scenario(title="fail=2"), work=work, progress=told)
    told.note("done")
    assert capsys.readouterr() == ("", "")
    if not isinstance(told, Silent):
        assert "10" in out.getvalue()
