"""What people look at: renders, figures, the page. Computing and drawing never mix: everything here reads recordings and results."""

from __future__ import annotations

from pathlib import Path

__all__ = ["write"]


def write(folder: Path) -> Path:
    """Make `folder`/report.html, one self-contained page, from the output folder of a run; returns its path.

    StoreError for a folder without a finished run, and where the disk refuses. See `testbed.report.page`.
    """
    from testbed.report.page import write as page  # here, so that a scenario's cameras can be read without matplotlib

    return page(folder)
