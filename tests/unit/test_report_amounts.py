"""Numbers in a report: digits that their uncertainty allows, and nothing where there is nothing."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.evaluate import Interval
from testbed.report.amounts import NOTHING, capital, counted, interval, limits, listed, number, seconds


@pytest.mark.parametrize(
    ("value", "se", "text"),
    [
        (0.86179, 0.0195, "0.862"),
        (0.86179, 0.0095, "0.8618"),
        (1234.5, 25.0, "1,234"),
        (-0.124, 0.0228, "−0.124"),
        (0.5, math.nan, "0.500"),
        (100.0, 0.0, "100"),
        (0.0, 0.0, "0"),
        (-1e-9, 0.1, "0.00"),
        (3.1e7, 1e6, "3.1 × 10⁷"),
        (2e-7, 1e-8, "2.0 × 10⁻⁷"),
        (math.nan, 1.0, NOTHING),
        (math.inf, 1.0, NOTHING),
    ],
)
def test_a_number_has_two_digits_of_its_standard_error(value, se, text):
    assert number(value, se) == text


@given(st.floats(-9e5, 9e5), st.floats(1e-3, 1e3))
def test_rounding_moves_a_number_by_less_than_a_tenth_of_its_standard_error(value, se):
    shown = float(number(value, se).replace("−", "-").replace(",", ""))
    assert abs(shown - value) <= max(se / 20 * 1.0001, 0.5 if se >= 10 else 0)


def test_intervals_and_limits_are_dashes_where_they_are_unknown():
    assert interval(Interval(1.0, 0.05, 0.9, 1.1, 9)) == "0.900 to 1.100"
    assert interval(Interval(1.0, math.nan, math.nan, math.nan, 1)) == NOTHING
    assert limits(3.1, 9.84) == "3.10 to 9.84"
    assert limits(math.nan, 1.0) == NOTHING


@pytest.mark.parametrize(
    ("value", "text"), [(8.4e-5, "84 µs"), (0.0031, "3.1 ms"), (1.25, "1.2 s"), (123.4, "123 s"), (2e-8, "0.02 µs"), (math.nan, NOTHING)]
)
def test_wall_times_have_the_unit_that_suits_them(value, text):
    assert seconds(value) == text


def test_words():
    assert [counted(n, "trial") for n in (0, 1, 2000)] == ["no trials", "1 trial", "2,000 trials"]
    assert counted(2, "more kind", "more kinds") == "2 more kinds"
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcd"), most=2) == "a, b and 2 more"
    assert capital("uKF is") == "UKF is"
