"""A text file in blocks of whole lines, with limits: never the whole of it in memory, whatever its size.

Blocks are UTF-8 with "\\n" between lines. Bytes that are no UTF-8 become the replacement character: the row that has them will fail by
itself where it matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from testbed.logs.bad import LogError
from testbed.progress import Progress, Silent

BLOCK = 4 << 20  # bytes
MAX_LINE = 1 << 20  # bytes
MAX_BYTES = 32 << 30
MAGIC = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd", b"PAR1": "Parquet"}
KILO = 1024


@dataclass(frozen=True)
class Block:
    """Whole lines: `text` ends in a newline; `line` is the number of its first line, from 1."""

    text: bytes
    line: int


def blocks(path: Path, progress: Progress | None = None, size: int = BLOCK) -> Iterator[Block]:
    """The file's lines, about `size` bytes at a time. LogError for a file that can't be read as text, or a line without end."""
    progress = progress or Silent()
    try:
        total = path.stat().st_size
        if path.is_dir() or total > MAX_BYTES:
            raise LogError(f"{path}: a file of up to {MAX_BYTES >> 30} GiB is wanted" + (", this is a folder" if path.is_dir() else ""))
        with path.open("rb") as file:
            _check_text(file.read(4096), path)
            file.seek(0)
            progress.start(path.name, total // KILO, 0)
            yield from _blocks(file, path, progress, size)
            progress.finish()
    except OSError as error:
        raise LogError(f"{path} can't be read: {error.strerror or error}") from None


def _blocks(file: IO[bytes], path: Path, progress: Progress, size: int) -> Iterator[Block]:
    rest, line, told = b"", 1, 0
    while True:
        new = file.read(size)
        cut = (rest + new).rfind(b"\n") + 1 if new else len(rest)
        whole, rest = (rest + new)[:cut], (rest + new)[cut:]
        if len(rest) > MAX_LINE:
            number = line + whole.count(b"\n")
            raise LogError(f"{path}: line {number} is longer than {MAX_LINE >> 10} KiB: this is no log of rows")
        if whole:
            text = _clean(whole, first=line == 1)
            yield Block(text, line)
            line += text.count(b"\n")
        reached = file.tell() // KILO
        progress.advance(reached - told, 0)
        told = reached
        if not new:
            return


def _clean(raw: bytes, first: bool) -> bytes:
    if first:
        raw = raw.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in raw:
        raw = raw.replace(b"\r\n", b"\n").replace(b"\r", b" ")
    if b"\0" in raw:
        raw = raw.replace(b"\0", b"\xef\xbf\xbd")
    if not raw.endswith(b"\n"):
        raw += b"\n"
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("utf-8", "replace").encode()
    return raw


def _check_text(head: bytes, path: Path) -> None:
    for magic, name in MAGIC.items():
        if head.startswith(magic):
            mend = "declare kind: tidy_parquet" if name == "Parquet" else "unpack it first"
            raise LogError(f"{path}: this is {name}, not text: {mend}")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise LogError(f"{path}: this is UTF-16: save it as UTF-8")


def head(path: Path, lines: int = 40) -> list[str]:
    """The first lines, to find a header in. LogError as `blocks`."""
    for block in blocks(path, size=1 << 16):
        return block.text.decode("utf-8", "replace").split("\n")[:lines]
    return []
