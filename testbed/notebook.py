"""What a notebook shows of a run: one small table a point of the sweep, claims that did not hold, failures. Plain HTML, no scripts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from testbed.console import HEADINGS, amount
from testbed.evaluate import Summary

if TYPE_CHECKING:
    from testbed.result import RunResult

MOST_POINTS = 12  # of a sweep; the others are in the table


def html(result: RunResult) -> str:
    """The figures of a result as HTML, for `_repr_html_`."""
    points = result.scenario.points()
    parts = [f"<p><b>{escape(result.scenario.title or result.scenario.name)}</b>: {escape(_state(result))}</p>"]
    for point in points[:MOST_POINTS]:
        swept = ", ".join(f"{path} = {value}" for path, value in point.set.items())
        parts.append(_table([s for s in result.summaries if s.point == point.index], swept))
    if len(points) > MOST_POINTS:
        parts.append(f"<p>and {len(points) - MOST_POINTS} more points: see <code>.table</code></p>")
    broken = [f"<li>{escape(c.text)}: got {c.value:.4g}{escape('; ' + c.note if c.note else '')}</li>" for c in result.claims if not c.ok]
    if broken:
        parts.append(f"<p>Claims that don't hold:</p><ul>{''.join(broken)}</ul>")
    return f"<div>{''.join(parts)}</div>"


def _state(result: RunResult) -> str:
    held = sum(claim.ok for claim in result.claims)
    said = [f"{result.scenario.trials} trials, {len(result.failures)} failures"]
    if result.claims:
        said.append(f"{held} of {len(result.claims)} claims hold")
    if result.until:
        said.append(str(result.until))
    if result.folder:
        said.append(f"written to {result.folder}")
    return "; ".join(said)


def _table(here: Sequence[Summary], caption: str) -> str:
    shown = [c for c in HEADINGS if any(c in s.statistics and not math.isnan(s.statistics[c].mean) for s in here)]
    head = "".join(f"<th>{escape(text)}</th>" for text in ("estimator", *(HEADINGS[c] for c in shown), "trials"))
    rows = []
    for s in here:
        n = max((i.n for i in s.statistics.values()), default=0)
        cells = "".join(
            f"<td style='text-align: right'>{escape(text)}</td>" for text in (*(amount(s.statistics.get(c)) for c in shown), str(n))
        )
        rows.append(f"<tr><th style='text-align: left'>{escape(s.estimator)}</th>{cells}</tr>")
    title = f"<caption style='text-align: left'>{escape(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
