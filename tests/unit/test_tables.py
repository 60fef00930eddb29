"""Every columnar type must survive Arrow and Parquet bit for bit, NaN payloads, signed zeros and empty dimensions included."""

from dataclasses import fields, is_dataclass

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import testbed.geometry
import testbed.scene
import testbed.types
from testbed import tables
from testbed.columns import Columns, Table
from testbed.types import POSITION, Decisions, Innovations, Reads, Roads, Track

TYPES = sorted(
    {
        kind
        for module in (testbed.types, testbed.scene, testbed.geometry)
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Columns) and kind not in (Columns, Table)
    },
    key=lambda kind: kind.__name__,
)
OTHER_FIELDS = {  # fields that are no arrays, by name: something for each
    "components": st.just(POSITION),
    "bodies": st.lists(st.text(st.characters(exclude_categories=["Cs"]), max_size=5), max_size=3).map(tuple),
    "frame": st.sampled_from(["world", "gate1"]),
    "extras": st.just({"weight": np.array([[np.nan, -0.0], [1e-300, 2.0]])}),
}


def raw(draw, dtype, shape):
    count = int(np.prod(shape, dtype=int))
    if dtype == "str":  # numpy drops trailing NULs from text by itself
        text = st.text(st.characters(exclude_categories=["Cs"]), max_size=6).map(lambda s: s.rstrip("\0"))
        return np.array(draw(st.lists(text, min_size=count, max_size=count)), dtype=np.str_).reshape(shape)
    if dtype == "bool":
        return np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)), dtype=bool).reshape(shape)
    size = np.dtype(dtype).itemsize
    return np.frombuffer(draw(st.binary(min_size=count * size, max_size=count * size)), dtype=dtype).reshape(shape)


@st.composite
def values(draw, kind):
    sizes = {}
    arguments = {}
    for f in fields(kind):
        if "dtype" in f.metadata:
            shape = [d if isinstance(d, int) else sizes.setdefault(d, draw(st.integers(0, 3))) for d in f.metadata["shape"]]
            arguments[f.name] = raw(draw, f.metadata["dtype"], shape)
        elif f.name == "innovations":
            arguments[f.name] = draw(values(Innovations))
        elif f.name == "decisions":
            arguments[f.name] = draw(values(Decisions))
        else:
            arguments[f.name] = draw(OTHER_FIELDS[f.name])
    with np.errstate(all="ignore"):  # any bits at all: Truth aligns the signs of whatever quaternions it gets
        return kind(**arguments)


def same(a, b):
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert (a.dtype.kind, a.shape) == (b.dtype.kind, b.shape)
        assert a.tolist() == b.tolist() if a.dtype.kind == "U" else (a.dtype, a.tobytes()) == (b.dtype, b.tobytes())
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key])
    elif is_dataclass(a):
        for f in fields(a):
            same(getattr(a, f.name), getattr(b, f.name))
    else:
        assert a == b


def reads(n):
    return Reads(t=np.arange(n), t_arrival=np.arange(n), antenna=np.zeros(n), tag=np.zeros(n), rssi=np.full(n, -50.0))


def track():
    zeros = np.zeros(2)
    return Track(
        t=[0.0, 1.0, 2.0],
        mean=np.arange(18.0).reshape(3, 2, 3),
        covariance=np.ones((3, 2, 3, 3)),
        status=np.zeros((3, 2)),
        trial=[0, 0],
        target=["a", "b"],
        used=zeros,
        refused=zeros,
        late=zeros,
        update_seconds=zeros,
        components=POSITION,
        innovations=Innovations(row=[1], t=[0.5], nis=[1.5], dof=[1], log_likelihood=[np.nan]),
    )


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_any_value_of_any_type_comes_back_from_arrow(kind, data):
    value = data.draw(values(kind))
    with np.errstate(all="ignore"):
        same(value, tables.from_arrow(tables.to_arrow(value)))


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=4, deadline=None)
@given(data=st.data())
def test_any_value_of_any_type_comes_back_from_parquet(kind, data, tmp_path_factory):
    path = tmp_path_factory.mktemp("t") / "value.parquet"
    value = data.draw(values(kind))
    tables.write(value, path)
    with np.errstate(all="ignore"):
        same(value, tables.read(path))


def test_the_types_tested_are_those_that_flow():
    assert {"Reads", "Rounds", "Counts", "Truth", "Track", "Prior", "Estimate", "Boxes", "Roads", "Mounts"} <= {k.__name__ for k in TYPES}


def test_nan_payloads_and_signed_zeros_survive_a_column_that_repeats_them(tmp_path):
    odd_nan = np.array([0x7FF8000000000001, 0x7FF8000000000002, 0x8000000000000000, 0] * 500, dtype=np.uint64).view(np.float64)
    value = reads(2000).with_(rssi=odd_nan)
    tables.write(value, tmp_path / "r.parquet")
    assert tables.read(tmp_path / "r.parquet").rssi.tobytes() == odd_nan.tobytes()


def test_units_and_the_type_stand_in_the_file(tmp_path):
    tables.write(reads(1), tmp_path / "r.parquet")
    schema = pq.read_schema(tmp_path / "r.parquet")
    assert schema.metadata[b"testbed.type"] == b"testbed.types:Reads"
    assert schema.field("rssi").metadata[b"unit"] == b"dBm"
    assert schema.field("t").metadata[b"unit"] == b"s"


def test_a_track_lies_in_one_file_per_leading_dimension(tmp_path):
    written = tables.write(track(), tmp_path / "track.parquet")
    assert sorted(p.name for p in written) == ["track.B.parquet", "track.decisions.parquet", "track.innovations.parquet", "track.parquet"]
    assert pq.read_table(tmp_path / "track.parquet").num_rows == 3
    assert pq.read_table(tmp_path / "track.B.parquet").column("target").to_pylist() == ["a", "b"]
    same(track(), tables.read(tmp_path / "track.parquet"))


def test_a_missing_side_is_named(tmp_path):
    found = tables.to_arrow(track())
    del found["B"]
    with pytest.raises(tables.NotColumnar, match="Track: the table 'B' is missing"):
        tables.from_arrow(found)


def test_a_missing_column_is_named():
    found = tables.to_arrow(reads(2))
    with pytest.raises(tables.NotColumnar, match="Reads: there is no column 'rssi'"):
        tables.from_arrow({"": found[""].drop_columns(["rssi"])})


def test_a_file_cannot_name_a_type_that_the_program_has_not_imported():
    table = tables.to_arrow(reads(1))[""]
    table = table.replace_schema_metadata({**table.schema.metadata, b"testbed.type": b"os:system"})
    with pytest.raises(tables.NotColumnar, match="'os:system' is unknown here"):
        tables.from_arrow({"": table})


def test_a_table_of_somebody_else_is_refused(tmp_path):
    pq.write_table(tables.frame({"x": np.arange(3)}), tmp_path / "x.parquet")
    with pytest.raises(tables.NotColumnar, match="a table without a type"):
        tables.read(tmp_path / "x.parquet")


@pytest.mark.parametrize("damage", [lambda b: b[:-10], lambda b: b"", lambda b: b"not parquet at all"])
def test_a_damaged_file_is_named(tmp_path, damage):
    path = tmp_path / "r.parquet"
    tables.write(reads(10), path)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(tables.NotColumnar, match=r"r\.parquet: is no readable Parquet"):
        tables.read(path)


def test_a_field_that_no_file_can_hold_is_refused():
    value = Roads(nodes=np.zeros((0, 2)), segments=np.zeros((0, 2)))
    object.__setattr__(track_like := track(), "components", object())
    with pytest.raises(ValueError, match=r"Track\.components: a object can't be written"):
        tables.to_arrow(track_like)
    same(value, tables.from_arrow(tables.to_arrow(value)))


def test_a_frame_of_plain_columns_comes_back():
    columns = {
        "trial": np.arange(3),
        "name": np.array(["a", "", "ccc"]),
        "x": np.array([np.nan, -0.0, 1.0]),
        "ok": np.array([True, False, True]),
    }
    found = tables.unframe(tables.frame(columns, units={"x": "m"}))
    assert list(found) == list(columns)
    for name, values_ in columns.items():
        same(values_, found[name])
