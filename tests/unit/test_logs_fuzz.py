"""Whatever bytes a log has: it is read, or refused in a sentence; never anything else. Over every format."""

from importlib import util
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from testbed.logs import LogError, read_log
from testbed.logs.registry import kinds
from testbed.logs.site import TruthModel
from testbed.logs.truth import read_truth

spec = util.spec_from_file_location("logs_fakes", Path(__file__).parent / "fakes" / "logs.py")
fakes = util.module_from_spec(spec)
spec.loader.exec_module(fakes)

relaxed = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
CELLS = ["", "0", "-1", "1e308", "nan", "inf", "1e-400", "99999999999999999999999", "'", '"', "b'", "\t", ",", "\n", "\r", "\0", "é"]
CELLS += ["\ud7ff", "[" * 40, "{}", "null", "1970-13-40T00:00:00", "//", "#"]


@st.composite
def damaged(draw, text):
    """A text with a few of its stretches cut, doubled or replaced."""
    for _ in range(draw(st.integers(1, 6))):
        a = draw(st.integers(0, len(text)))
        b = min(len(text), a + draw(st.integers(0, 30)))
        text = text[:a] + draw(st.one_of(st.sampled_from(CELLS), st.just(text[a:b] * 2), st.text(max_size=8))) + text[b:]
    return text.encode("utf-8", "surrogatepass")


def one_sentence(error):
    assert str(error)
    assert "\n" not in str(error)


def sound(path, kind, **changes):
    """Either a log all of whose rows are finite and in order, or one sentence."""
    try:
        log = read_log(path, fakes.site(kind, **changes))
    except LogError as error:
        one_sentence(error)
        return
    for stream in log.streams.values():
        assert (stream.t[1:] >= stream.t[:-1]).all()
        assert (stream.t_arrival >= stream.t).all()
    assert all(row.line >= 1 and row.reason for row in log.bad.listed)


@pytest.mark.parametrize("kind", sorted(fakes.SAMPLES))
@relaxed
@given(data=st.data())
def test_a_damaged_log(tmp_path, kind, data):
    (tmp_path / "log").write_bytes(data.draw(damaged(fakes.SAMPLES[kind])))
    sound(tmp_path / "log", kind)


@pytest.mark.parametrize("kind", kinds())
@settings(relaxed, max_examples=12)
@given(content=st.binary(max_size=300))
def test_any_bytes(tmp_path, kind, content):
    (tmp_path / "log").write_bytes(content)
    sound(tmp_path / "log", kind)


VALUES = st.one_of(st.none(), st.floats(), st.integers(-(2**62), 2**62), st.text(max_size=5), st.booleans(), st.binary(max_size=3))


@relaxed
@given(columns=st.lists(st.lists(VALUES, min_size=3, max_size=3), min_size=3, max_size=4))
def test_any_parquet(tmp_path, columns):
    arrays = {}
    for name, values in zip(("t", "antenna", "tag", "rssi"), columns, strict=False):
        try:
            arrays[name] = pa.array(values)
        except (pa.ArrowException, OverflowError):
            arrays[name] = pa.array([repr(v) for v in values])
    try:
        pq.write_table(pa.table(arrays), tmp_path / "log")
    except (pa.ArrowException, UnicodeEncodeError):
        return
    sound(tmp_path / "log", "tidy_parquet")


@settings(relaxed, max_examples=25)
@given(data=st.data())
def test_damaged_parquet(tmp_path, data):
    pq.write_table(pa.table({"t": [0.0, 1.0], "antenna": ["1", "2"], "tag": ["a", "b"]}), tmp_path / "log")
    raw = bytearray((tmp_path / "log").read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "log").write_bytes(raw)
    sound(tmp_path / "log", "tidy_parquet")


@pytest.mark.parametrize("kind", ["tum", "csv", "librsf"])
@settings(relaxed, max_examples=15)
@given(data=st.data())
def test_a_damaged_truth(tmp_path, kind, data):
    text = {
        "tum": "0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n",
        "csv": "t,x,y,z,target\n0,1,2,3,a\n1,1,2,3,a\n",
        "librsf": "point2 0 1 2 0\npoint2 1 1 2 0\n",
    }[kind]
    (tmp_path / "truth").write_bytes(data.draw(damaged(text)))
    try:
        found, _ = read_truth(tmp_path / "truth", TruthModel(kind=kind), 0.0)
    except LogError as error:
        one_sentence(error)
        return
    assert all((path.t[1:] > path.t[:-1]).all() for path in found.values())
