"""`testbed replay LOG --site site.yaml`: the part of the command that is about real logs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import typer
from rich.table import Table

SHOWN = 10  # rows that were left out


def replay_log(log: Path, site: Path, truth: Path | None, estimators: list[str], out: Path | None, as_json: bool, force: bool) -> None:
    """Run estimators on a log, print what came of it, and leave with the command's exit code."""
    from testbed import cli, console
    from testbed import log_replay as replaying
    from testbed.logs.bad import LogError
    from testbed.progress import choose

    try:
        described = replaying.load_site(site)
        folder = cli._folder(out, described.name, several=False)
        found = replaying.replay_log(
            log, described, estimators, truth=truth, out=folder, force=force, command=sys.argv, progress=choose(sys.stderr, of="kB")
        )
    except LogError as error:
        raise typer.Exit(cli._complain(str(error))) from None
    if as_json:
        cli._print_json(_document(found))
    else:
        if found.result is not None:
            console.run(cli._out(), found.result)
        else:
            cli._out().print(_table(found))
            cli._out().print(f"no truth is known, so nothing is scored; tracks in {folder}", soft_wrap=True)
        _left_out(found, folder)
    if found.result is not None:
        page = cli._reported(folder)
        if page and not as_json:
            cli._out().print(f"report in {page}", soft_wrap=True)
        raise typer.Exit(cli._verdict([found.result]))


def _document(found: Any) -> dict[str, Any]:
    """As of a run, with what the log was."""
    document = found.result.document() if found.result is not None else {"scenario": found.scenario.name, "tracks": found.said()}
    bad = found.bad
    log = {"rows": found.log.log.rows, "left_out": len(bad), "reasons": dict(bad.reasons), "notes": found.log.log.notes}
    listed = [{"line": row.line, "reason": row.reason} for row in bad.in_order()[:SHOWN]]
    return {**document, "log": {**log, "first_left_out": listed}}


def _table(found: Any) -> Table:
    table = Table(title=f"{found.scenario.name}, replayed", title_justify="left")
    for name in ("estimator", "target", "last seen s", "at m", "available", "used", "refused", "late"):
        table.add_column(name)
    for row in found.said():
        place = ", ".join(f"{v:.2f}" for v in row["last_m"]) if row["last_m"] else "–"
        last = "–" if row["last_s"] is None else f"{row['last_s']:.1f}"
        counts = [str(row[name]) for name in ("used", "refused", "late")]
        table.add_row(row["estimator"], row["target"], last, place, f"{row['available']:.2f}", *counts)
    return table


def _left_out(found: Any, folder: Path) -> None:
    """What of the log was not used, and doubts about it, on stderr."""
    for note in found.log.log.notes:
        print(f"note: {note}", file=sys.stderr)  # noqa: T201
    if not len(found.bad):
        return
    print(found.bad.summary(), file=sys.stderr)  # noqa: T201
    for row in found.bad.in_order()[:SHOWN]:
        print(f"  {found.log.log.path.name}:{row.line}: {row.reason}", file=sys.stderr)  # noqa: T201
    if len(found.bad) > SHOWN:
        print(f"  and {len(found.bad) - SHOWN} more: see {folder / 'left-out.csv'}", file=sys.stderr)  # noqa: T201
