"""Rows that are JSON objects, or Python's way of showing one, to the same columns of cells as CSV has."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from testbed.logs.bad import BadRows
from testbed.logs.blocks import Block, blocks
from testbed.logs.cells import Cells, texts
from testbed.logs.contents import Contents, Job, finished
from testbed.logs.layout import Layout

MAX_DEPTH = 20
MAX_LITERAL = 200_000  # letters that Python's own parser is given: it is recursive
NOT_JSON, NO_OBJECT = "no JSON", "no object with the keys of a read"
Row = dict[str, Any]


def read_records(job: Job, layout: Layout, unpack: Callable[[Any], Iterator[Row]], loads: Callable[[str], Any] | None = None) -> Contents:
    """A file of one record a line; `unpack` gives the reads in it, plain values by column name, `loads` makes a record of a line."""
    names = {role: list(known) for role, known in layout.names.items()}
    layout = layout.declared(job.site.log)
    for role, wanted in job.site.log.columns.items():
        names[role] = [wanted.lower()]
    taker = job.taker(layout)
    for block in blocks(job.path, job.progress):
        lines, rows = _rows(block, unpack, loads or _json, job.bad)
        if rows:
            cells, columns = _columns(lines, rows, names, job.bad)
            if len(cells):
                taker.take(cells, columns, layout)
    return finished(job, taker, layout)


def _rows(block: Block, unpack: Callable[[Any], Iterator[Row]], loads: Callable[[str], Any], bad: BadRows) -> tuple[list[int], list[Row]]:
    lines: list[int] = []
    rows: list[Row] = []
    for number, text in enumerate(block.text.decode("utf-8", "replace").split("\n")[:-1], start=block.line):
        if not text.strip():
            continue
        try:
            found = list(unpack(loads(text)))
        except (ValueError, SyntaxError, RecursionError, MemoryError, TypeError):
            bad.add(np.array([number]), NOT_JSON, [text])
            continue
        rows += found
        lines += [number] * len(found)
    return lines, rows


def _columns(lines: list[int], rows: list[Row], names: dict[str, list[str]], bad: BadRows) -> tuple[Cells, dict[str, str]]:
    """Cells by role: of each row the first of the role's names that it has. Rows without a needed one are put down."""
    found: dict[str, list[Any]] = {role: [_first(row, known) for row in rows] for role, known in names.items()}
    whole = [i for i in range(len(rows)) if all(found[role][i] is not None for role in ("time", "antenna", "tag"))]
    if len(whole) < len(rows):
        lacking = sorted(set(range(len(rows))) - set(whole))
        bad.add(np.array([lines[i] for i in lacking]), NO_OBJECT, [rows[i] for i in lacking])
    there = [role for role, values in found.items() if any(v is not None for v in values) or role in ("time", "antenna", "tag")]
    columns = {role: texts([found[role][i] for i in whole]) for role in there}
    return Cells(np.array([lines[i] for i in whole], dtype=np.int64), columns), {role: role for role in there}


def _first(row: Row, names: Sequence[str]) -> Any:
    for name in names:
        value = row.get(name)
        if value is not None and not isinstance(value, dict | list):
            return value
    return None


def _json(text: str) -> Any:
    return json.loads(text)


def literal(text: str) -> Any:
    """What Python shows of lists, dicts, numbers, texts and bytes; nothing is called. ValueError for anything else."""
    if len(text) > MAX_LITERAL:
        raise ValueError("too long")
    return ast.literal_eval(text)


def small(row: dict[Any, Any]) -> Row:
    """A row with its keys in small letters, bytes as text."""
    return {str(key).lower(): value.decode("ascii", "replace") if isinstance(value, bytes) else value for key, value in row.items()}


def nested(value: Any, inside: Sequence[str], depth: int = 0) -> Iterator[dict[Any, Any]]:
    """The objects under the keys `inside`, however lists and such keys are nested."""
    if depth > MAX_DEPTH:
        raise ValueError("nested too deeply")
    if isinstance(value, list | tuple):
        for one in value:
            yield from nested(one, inside, depth + 1)
    elif isinstance(value, dict):
        deeper = next((value[key] for key in inside if key in value), None)
        if deeper is None:
            yield value
        else:
            yield from nested(deeper, inside, depth + 1)
    else:
        raise ValueError("a list or an object is wanted")
