"""Columnar types to Arrow tables and Parquet files, and back, bit for bit.

A value becomes one Arrow table for each leading dimension of its arrays, since a table's columns must be equally long:
a `Table` is one, a `Track` has one with a row per report time and one with a row per target. The table of the first
array is the main one, named ""; the others are named by their dimension's letter, and a field that is columnar itself
(`Track.innovations`) by the field. On disk the main table of `track.parquet` has the others beside it: `track.B.parquet`.

Trailing dimensions are fixed-size lists. Every column carries its unit, the schema carries the type's name and the fields
that are no arrays, as JSON. Reading makes only types that the program has imported: a file can't name code to run.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.columns import Array, Columns

_TYPE, _FIELDS, _SIDES, _UNIT, _SHAPE = b"testbed.type", b"testbed.fields", b"testbed.sides", b"unit", b"shape"


class NotColumnar(ValueError):
    """A file or table that holds no columnar type of this program, or not the whole of one."""


def to_arrow(value: Columns) -> dict[str, pa.Table]:
    """The Arrow tables that make up `value`: "" is the main one."""
    columns: dict[str, list[tuple[pa.Field, pa.Array]]] = {}
    plain: dict[str, Any] = {}
    tables: dict[str, pa.Table] = {}
    for f in fields(value):
        content = getattr(value, f.name)
        if "dtype" in f.metadata:
            columns.setdefault(f.metadata["shape"][0], []).append(_to_column(f.name, content, f.metadata["unit"]))
        elif isinstance(content, Columns):
            tables |= {_join(f.name, side): table for side, table in to_arrow(content).items()}
        else:
            plain[f.name] = _to_json(content, f"{type(value).__name__}.{f.name}")
    sides = {"" if i == 0 else letter: _table(pairs) for i, (letter, pairs) in enumerate(columns.items())}
    clash = sides.keys() & tables.keys()
    if clash:
        raise ValueError(f"{type(value).__name__}: {min(clash)!r} is both a dimension and a columnar field: rename one")
    tables |= sides
    metadata = {_TYPE: _name(type(value)), _FIELDS: json.dumps(plain), _SIDES: json.dumps(sorted(tables.keys() - {""}))}
    tables[""] = tables[""].replace_schema_metadata(metadata)
    return tables


def from_arrow(tables: Mapping[str, pa.Table]) -> Columns:
    """The value that `to_arrow` made these tables of. NotColumnar where they are no such tables."""
    metadata = tables[""].schema.metadata or {}
    if _TYPE not in metadata:
        raise NotColumnar("a table without a type: it was not written by the testbed")
    found = _class(metadata[_TYPE].decode())
    missing = set(json.loads(metadata[_SIDES])) - tables.keys()
    if missing:
        raise NotColumnar(f"{found.__name__}: the table {min(missing)!r} is missing")
    arguments = {name: _from_json(content) for name, content in json.loads(metadata[_FIELDS]).items()}
    letters = list(dict.fromkeys(f.metadata["shape"][0] for f in fields(found) if "dtype" in f.metadata))
    for f in fields(found):
        if "dtype" in f.metadata:
            side = f.metadata["shape"][0]
            table = tables["" if side == letters[0] else side]
            if f.name not in table.column_names:
                raise NotColumnar(f"{found.__name__}: there is no column {f.name!r}")
            arguments[f.name] = _from_column(table, f.name)
        elif f.name not in arguments:
            nested = {"" if s == f.name else s.removeprefix(f.name + "."): t for s, t in tables.items() if s.split(".")[0] == f.name}
            if "" not in nested:
                raise NotColumnar(f"{found.__name__}: there is no field {f.name!r}")
            arguments[f.name] = from_arrow(nested)
    return found(**arguments)


def write(value: Columns, path: Path) -> list[Path]:
    """Write `value` as the Parquet file `path` and, where it has more than one leading dimension, others beside it.

    Returns all files written. OSError as the system raises it.
    """
    written = []
    for side, table in to_arrow(value).items():
        place = _beside(path, side)
        write_table(table, place)
        written.append(place)
    return written


def read(path: Path) -> Columns:
    """The value written to `path`. OSError for a missing file, NotColumnar for one that holds something else."""
    main = read_table(path)
    sides = json.loads((main.schema.metadata or {}).get(_SIDES, b"[]"))
    return from_arrow({"": main, **{side: read_table(_beside(path, side)) for side in sides}})


def write_table(table: pa.Table, target: Path | pa.NativeFile) -> None:
    """One Arrow table as Parquet. Only text is dictionary-encoded: measured figures seldom repeat."""
    text: Any = [f.name for f in table.schema if pa.types.is_string(f.type)]
    pq.write_table(table, target, compression="zstd", use_dictionary=text or False, store_schema=True)


def read_table(source: Path | pa.NativeFile) -> pa.Table:
    """An Arrow table from Parquet. NotColumnar, naming the file, where it is damaged or no Parquet."""
    try:
        return pq.ParquetFile(source).read()
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise NotColumnar(f"{source if isinstance(source, os.PathLike) else 'a table'}: is no readable Parquet: {error}") from None


def frame(columns: Mapping[str, Array], units: Mapping[str, str] | None = None) -> pa.Table:
    """An Arrow table of equally long numpy columns by name, without a type of its own: results, timings."""
    return _table([_to_column(name, np.asarray(values), (units or {}).get(name, "")) for name, values in columns.items()])


def unframe(table: pa.Table) -> dict[str, Array]:
    """The numpy columns of any Arrow table made by `frame`; a null number is NaN."""
    return {name: _from_column(table, name) for name in table.column_names}


# ---------------------------------------------------------------- columns


def _table(columns: list[tuple[pa.Field, pa.Array]]) -> pa.Table:
    return pa.Table.from_arrays([array for _, array in columns], schema=pa.schema([f for f, _ in columns]))


def _to_column(name: str, array: Array, unit: str) -> tuple[pa.Field, pa.Array]:
    """An array (N, ...) as N fixed-size lists. Parquet has no lists of no elements: their shape alone is kept."""
    trailing = array.shape[1:]
    metadata = {_UNIT: unit} if unit else {}
    if trailing:
        metadata[_SHAPE] = json.dumps([array.dtype.str, *trailing])
    if 0 in trailing:
        return pa.field(name, pa.null(), metadata=metadata), pa.nulls(len(array))
    if array.dtype.kind in "UT":
        flat = pa.array(array.ravel().tolist(), type=pa.string())
    else:
        flat = pa.array(np.ascontiguousarray(array).ravel())
    for size in reversed(trailing):
        flat = pa.FixedSizeListArray.from_arrays(flat, size)
    return pa.field(name, flat.type, metadata=metadata), flat


def _from_column(table: pa.Table, name: str) -> Array:
    metadata = table.schema.field(name).metadata or {}
    dtype, *trailing = json.loads(metadata.get(_SHAPE, b"[null]"))
    if 0 in trailing:
        return np.empty((table.num_rows, *trailing), dtype=dtype)
    column = table.column(name)
    flat = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    for _ in trailing:
        flat = flat.flatten()
    if pa.types.is_string(flat.type):
        values = np.array(flat.to_pylist(), dtype=np.str_)
    else:
        values = flat.to_numpy(zero_copy_only=False)
    return values.reshape(table.num_rows, *trailing)


# ---------------------------------------------------------------- names and the rest


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> type[Columns]:
    waiting: list[type[Columns]] = [Columns]
    while waiting:
        kind = waiting.pop()
        if _name(kind) == name:
            return kind
        waiting += kind.__subclasses__()
    raise NotColumnar(f"the columnar type {name!r} is unknown here: import the module that defines it first")


def _join(field: str, side: str) -> str:
    return f"{field}.{side}" if side else field


def _beside(path: Path, side: str) -> Path:
    return path.with_name(f"{path.stem}.{side}{path.suffix}") if side else path


def _to_json(value: Any, where: str) -> Any:
    """JSON that keeps what it was: tuples become lists, dictionaries and arrays are marked."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, tuple):
        return [_to_json(v, where) for v in value]
    if isinstance(value, dict) and all(isinstance(k, str) for k in value):
        return {"dict": {k: _to_json(v, where) for k, v in value.items()}}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufcU":
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": [value.dtype.str, list(value.shape), data]}
    raise ValueError(f"{where}: a {type(value).__name__} can't be written to a file")


def _from_json(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_from_json(v) for v in value)
    if isinstance(value, dict) and "dict" in value:
        return {k: _from_json(v) for k, v in value["dict"].items()}
    if isinstance(value, dict):
        dtype, shape, data = value["array"]
        return np.frombuffer(base64.b64decode(data), dtype=dtype).reshape(shape)
    return value
