"""Columnar data: frozen dataclasses around read-only numpy arrays of declared type and shape.

Every array that flows through the testbed is a field made with `column(...)`. Its declaration says dtype, shape and
unit; construction checks them, so a mistake is caught where the data are made and named by the field. Dimensions are
letters: fields of one object that share a letter must agree on it ("N" above all, the rows of a `Table`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

type_ = type  # the builtin, for classes below with a field of that name

Array = NDArray[Any]
Shape = tuple[str | int, ...]


def column(dtype: str, shape: Shape = ("N",), unit: str = "", default: Any = None) -> Any:
    """A dataclass field that holds one array: `dtype` as numpy names it ("str" for text), `shape` in letters and numbers.

    `default` fills the array where the caller leaves the field out; a dimension that no other field has is then 0.
    """
    metadata = {"dtype": dtype, "shape": shape, "unit": unit, "fill": default}
    return field(metadata=metadata) if default is None else field(default=None, metadata=metadata)


@cache
def _declared(kind: type_) -> tuple[tuple[str, Mapping[str, Any]], ...]:
    """Names and declarations of a type's arrays, those with a default last: they need the sizes of the others."""
    found = [(f.name, f.metadata) for f in fields(kind) if "dtype" in f.metadata]
    return tuple(sorted(found, key=lambda one: one[1]["fill"] is not None))


@dataclass(frozen=True, eq=False)
class Columns:
    """Base of every columnar type: coerces, checks and freezes the arrays declared with `column`.

    Raises ValueError, naming the type and the field, for an array of the wrong rank, size or kind.
    """

    def __post_init__(self) -> None:
        sizes: dict[str, tuple[int, str]] = {}
        for name, declared in _declared(type_(self)):
            value = getattr(self, name)
            if value is None and declared["fill"] is not None:
                value = np.full([sizes.get(d, (0,))[0] if isinstance(d, str) else d for d in declared["shape"]], declared["fill"])
            object.__setattr__(self, name, self._checked(name, declared, value, sizes))

    def _checked(self, name: str, declared: Mapping[str, Any], value: Any, sizes: dict[str, tuple[int, str]]) -> Array:
        where = f"{type_(self).__name__}.{name}"
        try:
            array = np.asarray(value, dtype=np.str_ if declared["dtype"] == "str" else declared["dtype"])
        except (TypeError, ValueError) as error:
            raise ValueError(f"{where}: cannot be read as {declared['dtype']}: {error}") from None
        shape: Shape = declared["shape"]
        if array.size == 0 and array.ndim < len(shape):  # an empty list stands for no rows of whatever width
            array = array.reshape([sizes.get(d, (0,))[0] if isinstance(d, str) else d for d in shape])
        if array.ndim != len(shape):
            raise ValueError(f"{where}: wants shape {shape}, got {array.shape}")
        for dimension, size in zip(shape, array.shape, strict=True):
            if isinstance(dimension, int):
                if size != dimension:
                    raise ValueError(f"{where}: wants shape {shape}, got {array.shape}")
            elif sizes.setdefault(dimension, (size, name))[0] != size:
                raise ValueError(f"{where}: {dimension} is {size} here and {sizes[dimension][0]} in {sizes[dimension][1]}")
        view = array.view()
        view.flags.writeable = False
        return view

    def with_(self, **changes: Any) -> Self:
        """A copy with some fields replaced, checked again."""
        return replace(self, **changes)


@dataclass(frozen=True, eq=False)
class Table(Columns):
    """Columns whose arrays all share their first dimension "N": N rows, which can be picked, joined and sorted."""

    def __len__(self) -> int:
        return len(getattr(self, self.column_names()[0]))

    @classmethod
    def column_names(cls) -> list[str]:
        """Names of the fields that hold arrays, in order of declaration."""
        return [f.name for f in fields(cls) if "dtype" in f.metadata]

    def take(self, index: Array | slice) -> Self:
        """The rows that `index` (integers, a mask or a slice) picks."""
        return replace(self, **{name: getattr(self, name)[index] for name in self.column_names()})

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """All rows of `parts`, in order. Fields that are not columns are taken from the first part."""
        if not parts:
            return cls.empty()
        return replace(parts[0], **{name: np.concatenate([getattr(p, name) for p in parts]) for name in cls.column_names()})

    @classmethod
    def empty(cls) -> Self:
        """No rows."""
        declared = {f.name: f.metadata for f in fields(cls) if "dtype" in f.metadata}
        arrays = {
            name: np.empty([0 if isinstance(d, str) else d for d in m["shape"]], dtype=np.str_ if m["dtype"] == "str" else m["dtype"])
            for name, m in declared.items()
        }
        return cls(**arrays)

    def equals(self, other: Self) -> bool:
        """The same type, rows and values, bit for bit; NaN equals NaN."""
        if type_(self) is not type_(other) or len(self) != len(other):
            return False
        return all(_same(getattr(self, n), getattr(other, n)) for n in self.column_names())


def _same(a: Array, b: Array) -> bool:
    return a.shape == b.shape and bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
