"""What a log calls antennas and tags, to indices: EPCs in whatever dress, ports by number or name."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from testbed.columns import Array
from testbed.logs.arrow import pc
from testbed.logs.bad import LogError
from testbed.logs.site import SiteModel, port_name

MOST_TAGS = 100_000
_BYTES = re.compile(r"""[bB](['"])(.*)\1""")
_HEX = re.compile(r"[0-9A-Fa-f]{8,128}")
_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z_.:/+ -]{0,127}")


def epc(cell: str) -> str | None:
    """An EPC or a beacon's name in one dress: no b'..' around it, hex in small letters without gaps; None for what is none."""
    text = cell.strip()
    wrapped = _BYTES.fullmatch(text)
    text = (wrapped.group(2) if wrapped else text).strip()
    packed = re.sub(r"[\s-]", "", text).removeprefix("0x")
    if _HEX.fullmatch(packed):
        return packed.lower()
    return text if _NAME.fullmatch(text) else None


class TagNames:
    """Codes of the tags of a log: those of the site first, in its order. Without tags in the site, every tag that comes is taken up."""

    def __init__(self, site: SiteModel) -> None:
        self.is_open = not site.tags
        self.ids = [tag.id for tag in site.tags]
        self._code: dict[str, int] = {}
        for i, tag in enumerate(site.tags):
            name = epc(tag.epc or tag.id)
            if name is None:
                raise LogError(f"tags: {tag.epc or tag.id!r} is no EPC: letters and digits are wanted")
            if name in self._code:
                raise LogError(f"tags: {tag.id!r} has the EPC of {self.ids[self._code[name]]!r}: the log can't tell them apart")
            self._code[name] = i
        self.strangers: dict[str, int] = {}

    def codes(self, cells: pa.Array) -> Array:
        """(N,) int64: the tag of each cell; -1 for one that the site does not name, -2 for what is no name of a tag."""
        coded = pc.dictionary_encode(pc.cast(cells, pa.string()))
        known = [self._one(text) for text in coded.dictionary.to_pylist()]
        index = pc.fill_null(coded.indices, len(known)).to_numpy(zero_copy_only=False)
        found = np.array([*known, -2], dtype=np.int64)[index]
        if not self.is_open:
            for k in np.flatnonzero(np.array(known) == -1):
                name = str(coded.dictionary[int(k)].as_py())
                if name in self.strangers or len(self.strangers) < MOST_TAGS:
                    self.strangers[name] = self.strangers.get(name, 0) + int((index == k).sum())
        return found

    def _one(self, text: str | None) -> int:
        name = epc(text or "")
        if name is None:
            return -2
        if name not in self._code and self.is_open:
            if len(self.ids) >= MOST_TAGS:
                raise LogError(f"over {MOST_TAGS:,} different tags: is this column the EPC?")
            self._code[name] = len(self.ids)
            self.ids.append(name)
        return self._code.get(name, -1)


class PortNames:
    """Indices of the site's antennas by what the log calls them."""

    def __init__(self, site: SiteModel) -> None:
        self._place: Mapping[str, int] = {}
        self._of_reader: dict[tuple[str, str], int] = {}
        plain: dict[str, int] = {}
        for i, antenna in enumerate(site.antennas):
            name = port_name(antenna)
            plain[name] = -1 if name in plain else i  # of several readers: the reader must say which
            self._of_reader[(antenna.reader or "").lower(), name] = i
        for i, antenna in enumerate(site.antennas):  # an id is as good as a port, unless it is another's port
            plain.setdefault(antenna.id.strip().lower(), i)
        self._place = plain
        self.by_reader = any(i < 0 for i in plain.values())

    def indices(self, cells: pa.Array, readers: pa.Array | None = None) -> Array:
        """(N,) int64: the antenna of each cell, -1 for a port that the site does not have."""
        cells = pc.cast(cells, pa.string())
        if readers is not None and self.by_reader:
            cells = pc.binary_join_element_wise(pc.cast(readers, pa.string()), cells, "\x1f")
        coded = pc.dictionary_encode(cells)
        known = [self._one(text) for text in coded.dictionary.to_pylist()]
        index = pc.fill_null(coded.indices, len(known)).to_numpy(zero_copy_only=False)
        return np.array([*known, -1], dtype=np.int64)[index]

    def _one(self, text: str | None) -> int:
        reader, _, port = (text or "").lower().rpartition("\x1f")
        port = port.strip().removesuffix(".0")
        if reader:
            return self._of_reader.get((reader.strip(), port), -1)
        return self._place.get(port, -1)
