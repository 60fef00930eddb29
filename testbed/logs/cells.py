"""Lines to columns of cells, as text: by pyarrow's parser a block at a time, or row by row where cells are quoted."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from testbed.columns import Array
from testbed.logs.arrow import pc
from testbed.logs.bad import BadRows
from testbed.logs.blocks import Block

COUNT = "wrong number of cells"


@dataclass(frozen=True)
class Cells:
    """N rows: their lines in the file (N,), and for each column wanted N cells, trimmed text or as Parquet has them."""

    line: Array
    columns: dict[str, pa.Array]

    def __len__(self) -> int:
        return len(self.line)


def parse(block: Block, names: Sequence[str], wanted: Sequence[str], delimiter: str, bad: BadRows, comment: str = "") -> Cells:
    """The `wanted` columns of a block whose rows have cells called `names`. Rows with another number of cells are put down as bad.

    Empty lines, and lines that begin with `comment`, are passed over.
    """
    if b'"' in block.text or len(names) < 2:
        return _by_row(block, names, wanted, delimiter, bad, comment)
    wrong: dict[int, str] = {}

    def note(row: Any) -> str:
        wrong[row.number] = row.text
        return "skip"

    table = arrow_csv.read_csv(
        pa.py_buffer(block.text),
        arrow_csv.ReadOptions(column_names=list(names), use_threads=False, block_size=max(len(block.text) + 1, 1024)),
        arrow_csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False, invalid_row_handler=note),
        arrow_csv.ConvertOptions(
            include_columns=list(dict.fromkeys(wanted)),
            column_types={n: pa.string() for n in names},
            strings_can_be_null=False,
            check_utf8=False,
        ),
    )
    lines = block.line + np.arange(block.text.count(b"\n"))
    if wrong:
        at = np.array(sorted(wrong)) - 1
        mean = [i for i in at if wrong[i + 1].strip() and not (comment and wrong[i + 1].startswith(comment))]
        bad.add(lines[mean], COUNT, [wrong[i + 1] for i in mean])
        lines = np.delete(lines, at)
    columns = {name: pc.utf8_trim_whitespace(_one(table[name])) for name in wanted}
    return _without_comments(Cells(lines, columns), block, comment)


def _one(column: pa.ChunkedArray) -> pa.Array:
    return (
        column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], pa.string())
    )


def _without_comments(cells: Cells, block: Block, comment: str) -> Cells:
    """Without rows that are empty, or comments that happen to have the right number of cells."""
    empty = b"\n\n" in block.text or block.text.startswith(b"\n")
    if not empty and (not comment or comment.encode() not in block.text):
        return cells
    rows, mark = block.text.split(b"\n"), comment.encode() or b"\n"
    keep = np.array([rows[i].strip() != b"" and not rows[i].startswith(mark) for i in (cells.line - block.line).tolist()], dtype=bool)
    return Cells(cells.line[keep], {name: column.filter(pa.array(keep)) for name, column in cells.columns.items()})


def _by_row(block: Block, names: Sequence[str], wanted: Sequence[str], delimiter: str, bad: BadRows, comment: str) -> Cells:
    place = [list(names).index(name) for name in wanted]
    found: list[list[str]] = []
    lines: list[int] = []
    for number, text in enumerate(block.text.decode("utf-8", "replace").split("\n")[:-1], start=block.line):
        if not text.strip() or (comment and text.startswith(comment)):
            continue
        row = split_row(text, delimiter)
        if len(row) != len(names):
            bad.add(np.array([number]), COUNT, [text])
            continue
        lines.append(number)
        found.append([row[i].strip() for i in place])
    columns = {name: pa.array([row[k] for row in found], pa.string()) for k, name in enumerate(wanted)}
    return Cells(np.array(lines, dtype=np.int64), columns)


def split_row(text: str, delimiter: str) -> list[str]:
    """The cells of one line; a quote that is never closed ends with the line."""
    try:
        return next(csv.reader([text], delimiter=delimiter), [])
    except csv.Error:
        return [text]


def texts(values: Sequence[Any]) -> pa.Array:
    """Cells of plain values, as they come out of JSON: None is an empty cell."""
    return pa.array(["" if v is None else v if isinstance(v, str) else repr(v) for v in values], pa.string())
