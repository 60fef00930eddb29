import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from testbed.quantity import Config, DecibelMilliwatts, Degrees, Metres, MetresPerSecond, Seconds, convert
from testbed.route import Route


class Things(Config):
    range_m: Metres = 1.0
    speed_mps: MetresPerSecond = 1.0
    wait_s: Seconds = 1.0
    tilt_deg: Degrees = 0.0
    power_dbm: DecibelMilliwatts = 0.0


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        ("range_m", "30 cm", 0.3),
        ("range_m", "2", 2.0),
        ("range_m", "1e-3 km", 1.0),
        ("speed_mps", "3.6 km/h", 1.0),
        ("wait_s", "2 min", 120.0),
        ("tilt_deg", "0.5 turn", 180.0),
        ("power_dbm", "29 dBm", 29.0),
    ],
)
def test_a_text_with_a_unit_is_converted(field, text, value):
    assert getattr(Things(**{field: text}), field) == pytest.approx(value)


@pytest.mark.parametrize(
    ("field", "text", "message"),
    [
        ("range_m", "3 kg", "not a quantity in m"),
        ("range_m", "three", "not a number in m"),
        ("range_m", "nan", "not a finite number"),
        ("range_m", "inf m", "not a finite number"),
        ("range_m", "2 ** 9 m", "known unit"),
        ("range_m", "1 __import__('os').system('true')", "known unit"),
        ("range_m", "1" * 100, "text of 100 characters"),
        ("power_dbm", "2 W", "not a number in dBm"),
        ("wait_s", "2 m", "not a quantity in s"),
    ],
)
def test_a_text_that_is_no_such_quantity_is_refused(field, text, message):
    with pytest.raises(ValidationError, match=message):
        Things(**{field: text})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_are_finite(value):
    with pytest.raises(ValidationError, match="finite"):
        Things(range_m=value)


@given(st.text(max_size=80))
def test_any_text_is_a_number_or_a_value_error(text):
    with contextlib.suppress(ValueError):
        assert math.isfinite(convert(text, "m"))


def test_unknown_keys_are_refused():
    with pytest.raises(ValidationError, match="Extra inputs"):
        Things(range=3)


def test_the_schema_says_the_unit_and_allows_text():
    schema = Things.model_json_schema()["properties"]["range_m"]
    assert schema["unit"] == "m"
    assert {"type": "string"} in schema["anyOf"]


def test_way_points_at_one_place_are_named():
    with pytest.raises(ValidationError, match="way points 1 and 2 are the same place"):
        Route(waypoints_m=[(0, 0), (1, 0), (1, 0)])
