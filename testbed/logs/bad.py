"""What a log can't give: rows that are left out, each with its line and the reason, and the error that ends the reading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array
from testbed.quantity import FileMissing, UnusableFile

LISTED = 10_000  # rows that are listed one by one; all are counted
ENOUGH = 20  # bad rows below which a log is never refused for their number
SHOWN = 60  # letters of a cell that a reason repeats


class LogError(UnusableFile):
    """A log or a site that can't be used, in one sentence that names the place and the mend."""


class LogMissing(LogError, FileMissing):
    """A log that is not on this machine."""


@dataclass(frozen=True)
class BadRow:
    """A row that was left out: its line in the file, counted from 1 (in Parquet, its row), and why."""

    line: int
    reason: str


class BadRows:
    """The rows of one file that were left out. `reasons` counts them by what is wrong, without the values."""

    def __init__(self) -> None:
        self.listed: list[BadRow] = []
        self.reasons: Counter[str] = Counter()

    def __len__(self) -> int:
        return sum(self.reasons.values())

    def add(self, lines: Array, what: str, cells: Iterable[object] | None = None) -> None:
        """Rows at `lines` (N,) for the reason `what`; with their `cells`, which the list shows."""
        if not len(lines):
            return
        self.reasons[what] += len(lines)
        room = LISTED - len(self.listed)
        if room <= 0:
            return
        said = [f"{what}: {shown(cell)}" for cell, _ in zip(cells, range(room), strict=False)] if cells is not None else [what] * len(lines)
        self.listed += [BadRow(int(line), reason) for line, reason in zip(np.asarray(lines)[:room], said[:room], strict=False)]

    def in_order(self) -> list[BadRow]:
        """The list by line."""
        return sorted(self.listed, key=lambda row: row.line)

    def check_share(self, good: int, path: str) -> None:
        """LogError where more rows are bad than good: then it is the declaration that is wrong, not the rows."""
        if len(self) > max(good, ENOUGH):
            what, times = self.reasons.most_common(1)[0]
            first = next((row for row in self.in_order() if row.reason.startswith(what)), None)
            where = f" (first in line {first.line}: {first.reason})" if first else ""
            raise LogError(
                f"{path}: {len(self)} of {len(self) + good} rows can't be used, {times} for: {what}{where}; is the log declared right?"
            )

    def summary(self) -> str:
        """In one sentence; "" where there are none."""
        if not len(self):
            return ""
        parts = [f"{times} {what}" for what, times in self.reasons.most_common(4)]
        more = len(self.reasons) - len(parts)
        return f"{len(self)} rows left out: {'; '.join(parts)}{f'; and {more} more reasons' if more > 0 else ''}"


def shown(cell: object) -> str:
    """A cell as a reason repeats it: short, on one line."""
    text = repr(str(cell))
    return text if len(text) <= SHOWN else text[: SHOWN - 2] + "…'"
