"""Reading what somebody else wrote: bounded in size, kept to its own folder, every refusal in a sentence.

A world file may lie wherever the scenario says, for whoever runs it chose it. What that file names may not: it lies beneath the folders
that go with the world, whatever `..` or link stands in between.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring
from pydantic import PrivateAttr

from testbed import quantity
from testbed.columns import Array

MAX_TEXT = 20_000_000  # bytes of a world, a model or a map
MAX_MESH = 50_000_000  # bytes of a mesh
MAX_DEPTH = 100  # elements in elements of an XML file
FARTHEST = 10_000.0  # m from the origin: nothing of a hall lies farther away
ENOUGH_DIGITS = 60  # characters of a text that an error shows


_noting: ContextVar[list[Path] | None] = ContextVar("noting", default=None)


class WorldFileError(quantity.UnusableFile):
    """A file that is no world, or not one that can be used. The message names the file, and in it the place."""


class FileConfig(quantity.Config):
    """Base of the sections of worlds that are read from a file. `place` is where it lies: beside the scenario, unless it is absolute."""

    _folder: Path | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any, /) -> None:
        """Keep the folder of the scenario, which the file's path is relative to; without one, that is the working directory."""
        folder = context.get("folder") if isinstance(context, dict) else None
        self._folder = None if folder is None else Path(folder)

    def __eq__(self, other: object) -> bool:
        """Whether the same is written, wherever the scenario lies."""
        return type(self) is type(other) and all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    __hash__ = None  # pyright: ignore[reportAssignmentType]  its lists and mappings have none

    def placed(self, path: str) -> Path:
        """Where a file lies that the section names. FileMissing where it isn't there, ValueError where that is no name of a file."""
        if "\0" in path:
            raise ValueError("path: it holds a byte that no file name has")
        place = Path(path) if self._folder is None else self._folder / path
        try:
            there = place.is_file()
        except OSError as error:
            raise ValueError(f"path: {said(path)} can't be looked for: {(error.strerror or str(error)).lower()}") from None
        if not there:
            raise quantity.FileMissing(f"path: there is no file {said(path)} on this machine, it would be {place.resolve()}")
        return place


@contextmanager
def noted() -> Iterator[list[Path]]:
    """The files that are read within, in their order."""
    found: list[Path] = []
    token = _noting.set(found)
    try:
        yield found
    finally:
        _noting.reset(token)


class ReadsFiles(ABC):
    """Base of halls that are made of files."""

    @abstractmethod
    def parts(self) -> list[Any]: ...

    @abstractmethod
    def bounds(self) -> Array: ...

    def files(self) -> list[Path]:
        """All files that the hall is made of, those that others include among them, each once. WorldFileError as of reading them."""
        fresh = type(self)(self.config)  # pyright: ignore  one that has read nothing yet
        with noted() as found:
            fresh.parts()
            fresh.bounds()
        return list(dict.fromkeys(found))


def read(place: Path, limit: int = MAX_TEXT) -> bytes:
    """All of a file. WorldFileError for one that can't be read or is longer than `limit` bytes."""
    noting = _noting.get()
    if noting is not None:
        noting.append(place)
    try:
        with place.open("rb") as file:
            content = file.read(limit + 1)
    except OSError as error:
        raise WorldFileError(f"{place.name}: can't be read: {(error.strerror or str(error)).lower()}") from None
    if len(content) > limit:
        raise WorldFileError(f"{place.name}: over {limit // 1_000_000} MB, which is more than a file of its kind may hold")
    return content


def read_text(place: Path, limit: int = MAX_TEXT) -> str:
    """The same as text. WorldFileError for what isn't UTF-8."""
    try:
        return read(place, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise WorldFileError(f"{place.name}: not UTF-8 text (byte {error.start})") from None


def beneath(folder: Path, path: str, name: str) -> Path:
    """The file `path` (with / between its parts) in a folder. WorldFileError, in the name of file `name`, where it would lie elsewhere."""
    parts = PurePosixPath(path)
    if not path or "\0" in path or "\\" in path or parts.is_absolute() or ":" in parts.parts[0]:
        raise WorldFileError(f"{name}: {said(path)} is no path inside the world's folders")
    inside = folder.resolve()
    place = (inside / path).resolve()
    if not place.is_relative_to(inside):
        raise WorldFileError(f"{name}: {said(path)} leads out of {folder.name}/, where everything that it names must lie")
    return place


def xml(content: bytes, name: str) -> Element:
    """The root element. WorldFileError for what is no XML, declares types or entities, or is nested deeper than MAX_DEPTH."""
    try:
        root = fromstring(content, forbid_dtd=True)
    except DefusedXmlException:
        raise WorldFileError(f"{name}: declares document types or entities, which could blow up or fetch files: take them out") from None
    except (ParseError, LookupError, ValueError) as error:
        raise WorldFileError(f"{name}: is no XML: {str(error)[:200]}") from None
    layer, depth = [root], 0
    while layer:
        depth += 1
        if depth > MAX_DEPTH:
            raise WorldFileError(f"{name}: elements lie in more than {MAX_DEPTH} others")
        layer = [child for element in layer for child in element]
    return root


def local(element: Element) -> str:
    """The tag of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def children(element: Element, tag: str) -> Iterator[Element]:
    """The children of that tag, whatever their namespace."""
    return (child for child in element if local(child) == tag)


def child(element: Element, tag: str) -> Element | None:
    """The first child of that tag."""
    return next(children(element, tag), None)


def text(element: Element | None) -> str:
    """The text of an element without the blanks round it, "" for none."""
    return "" if element is None else (element.text or "").strip()


def numbers(content: str, count: int | None, where: str, most: float = FARTHEST) -> Array:
    """(count,) float64 from a text of numbers, of any number where count is None. WorldFileError for what isn't, or lies beyond ±`most`."""
    try:
        values = np.array(content.split(), dtype=np.float64)
    except ValueError:
        raise WorldFileError(f"{where}: {said(content)} is not numbers") from None
    if count is not None and len(values) != count:
        raise WorldFileError(f"{where}: {count} numbers are wanted, not {len(values)}: {said(content)}")
    if not (np.abs(values) <= most).all():  # NaN is not
        raise WorldFileError(f"{where}: numbers up to ±{most:g} are wanted, not {values[~(np.abs(values) <= most)][0]:g}")
    return values


def said(content: object) -> str:
    """A text as an error shows it, cut where it is long."""
    shown = repr(content)
    return shown if len(shown) <= ENOUGH_DIGITS else f"{shown[: ENOUGH_DIGITS - 3]}..."
