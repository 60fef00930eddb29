"""Catching what C code prints, below the level that Python's own redirection reaches."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO


@contextmanager
def captured() -> Iterator[TextIO]:
    """Catches what C code prints while it is open, for file descriptors 1 and 2 carry our own results and log. Yields the file it lands in.

    C's stdio has a buffer of its own that would surface after the end of the block: it is flushed on both sides.
    """
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else lambda _: None
    with tempfile.TemporaryFile("w+", errors="replace") as caught:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, ValueError):  # there is none, or it is closed
                stream.flush()
        flush(None)
        kept = {}
        try:
            for descriptor in (1, 2):
                with suppress(OSError):  # closed, as in a daemon: nothing to keep clean
                    kept[descriptor] = os.dup(descriptor)
                    os.dup2(caught.fileno(), descriptor)
            yield caught
        finally:
            flush(None)
            for descriptor, original in kept.items():
                os.dup2(original, descriptor)
                os.close(original)
