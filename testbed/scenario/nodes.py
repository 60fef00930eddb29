"""YAML text as a tree of plain values that know their line and column, and the limits that a stranger's file must keep.

Built from ruamel.yaml's events: nothing is constructed but None, bool, int, float, str, lists and mappings with text keys, and
whatever is too large, too deep or multiplied by aliases is refused while it is being read, before it takes memory.
Values follow YAML 1.2's core schema, so `on` and `yes` are texts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from testbed.scenario.problems import Loc, Problem, ScenarioError, dotted, refuse

MAX_BYTES = 1_000_000
MAX_NODES = 100_000  # values in all, counted as often as aliases repeat them
MAX_DEPTH = 32
MAX_DIGITS = 40

_INT = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {word: value for value, words in ((None, "~ null Null NULL"), (True, "true True TRUE"), (False, "false False FALSE"))
          for word in words.split()} | {"": None}  # fmt: skip
_TAB = re.compile(r"^ *\t[ \t]*(?=[^\s#])", re.MULTILINE)


@dataclass(slots=True)
class Key:
    """Where a key of a mapping stands, and its value."""

    line: int
    column: int
    node: Node


@dataclass(slots=True)
class Node:
    """A value and where it begins. value : a scalar, a list of Nodes, or a dict of text to Key; size : values it holds."""

    value: Any
    line: int
    column: int
    size: int = 1
    closed: bool = True

    def plain(self) -> Any:
        """The value without its places. Aliased values are copied: nothing is shared."""
        if isinstance(self.value, dict):
            return {name: key.node.plain() for name, key in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def place(self, loc: Loc, at_key: bool = False) -> tuple[int, int]:
        """(line, column) of the value at `loc`, of its key, or of the nearest that encloses it where it is not written."""
        node, here = self, (self.line, self.column)
        for i, step in enumerate(loc):
            if isinstance(node.value, dict) and step in node.value:
                key = node.value[step]
                node, here = key.node, (key.node.line, key.node.column)
                if at_key and i == len(loc) - 1:
                    return key.line, key.column
            elif isinstance(node.value, list) and isinstance(step, int) and 0 <= step < len(node.value):
                node = node.value[step]
                here = (node.line, node.column)
            else:
                break
        return here


def read(text: str, path: str) -> Node:
    """The tree of a text. ScenarioError with all that is wrong with it as YAML: syntax, limits, doubled keys, tags."""
    root, faults = read_on(text, path)
    if faults:
        raise ScenarioError(faults)
    return root


def read_on(text: str, path: str) -> tuple[Node, list[Problem]]:
    """The tree of a text, and what is wrong with single values or keys of it; so that all else that is wrong can be told with them.

    ScenarioError for what leaves no tree to go on with: wrong syntax, too much of anything.
    """
    if len(text) > MAX_BYTES or len(text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
        raise refuse(path, f"over {MAX_BYTES // 1_000_000} MB: too large for a scenario; move long lists of tags to a csv file")
    if tab := _TAB.search(text):
        line = text.count("\n", 0, tab.start()) + 1
        raise refuse(path, "a tab in the indentation: YAML wants spaces", line, tab.end() - tab.start())
    try:
        return _Builder(path).build(YAML(typ="safe", pure=True).parse(text))
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise refuse(path, f"the character {error.character!r} is not allowed in YAML", line) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = (mark.line + 1, mark.column + 1) if mark is not None else (None, None)
        raise refuse(path, _syntax(error), *place) from None
    except (YAMLError, ValueError) as error:
        if isinstance(error, ScenarioError):
            raise
        raise refuse(path, f"not valid YAML: {str(error).splitlines()[0]}") from None


def _syntax(error: MarkedYAMLError) -> str:
    """The parser's complaint in plain words."""
    problem, context = str(error.problem or ""), str(error.context or "")
    if "mapping values are not allowed" in problem:
        return "a colon where none can stand: is this line indented like its neighbours, and is a text that holds ': ' in quotes?"
    if "'\\t'" in problem:
        return "a tab: YAML wants spaces"
    if "cannot start any token" in problem:
        return f"{problem.removeprefix('found character ').split(' ')[0]} can't begin a value: put the text in quotes"
    if "unexpected end of stream" in problem:
        return "the file ends inside a text in quotes: a closing quote is missing"
    if "expected ',' or" in problem:
        bracket = "]" if "']'" in problem else "}"
        return f"a comma or a closing {bracket} is missing before this place"
    if "expected <block end>" in problem:
        return "this line is not indented like those it belongs to"
    if "could not find expected ':'" in problem:
        return "a colon is missing after the key"
    return f"not valid YAML: {problem or context}"


class _Builder:
    """Turns events into nodes on a stack of its own, so that depth is a limit and not a crash."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.problems: list[Problem] = []
        self.anchors: dict[str, Node] = {}
        self.stack: list[tuple[Node, list[Any]]] = []  # open collections; [key's text, line, column] where a mapping awaits a value
        self.root: Node | None = None
        self.nodes = 0

    def build(self, events: Iterator[Any]) -> tuple[Node, list[Problem]]:
        documents = 0
        for event in events:
            line, column = event.start_mark.line + 1, event.start_mark.column + 1
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise refuse(self.path, "a second document: one scenario a file, without a line '---' inside", line, column)
                if event.version not in (None, (1, 2)):
                    raise refuse(self.path, "only YAML 1.2 is read: remove the %YAML line", line, column)
            elif isinstance(event, (MappingEndEvent, SequenceEndEvent)):
                self._close()
            elif isinstance(event, (MappingStartEvent, SequenceStartEvent, ScalarEvent, AliasEvent)):
                self._value(event, line, column)
        if self.root is None:
            raise refuse(self.path, "the file is empty", 1)
        return self.root, self.problems

    def _value(self, event: Any, line: int, column: int) -> None:
        if self._wants_key() and not isinstance(event, ScalarEvent):
            raise refuse(self.path, "a key must be a plain text", line, column)
        if isinstance(event, AliasEvent):
            node = self._alias(event, line, column)
        else:
            if event.tag is not None:
                self._complain(line, column, f"the tag {event.tag!r} is not allowed: a scenario is plain data and can't name code")
            if self._wants_key():
                self.stack[-1][1][:] = [event.value, line, column]
                return
            node = Node(self._content(event, line, column), line, column, closed=isinstance(event, ScalarEvent))
            if event.anchor:
                self.anchors[event.anchor] = node
        self.nodes += node.size
        if self.nodes > MAX_NODES:
            raise refuse(
                self.path, f"over {MAX_NODES} values (aliases counted each time they are used): too large for a scenario", line, column
            )
        self._place(node, line, column)
        if not node.closed:
            self.stack.append((node, []))
            if len(self.stack) > MAX_DEPTH:
                raise refuse(self.path, f"nested more than {MAX_DEPTH} levels deep", line, column)

    def _wants_key(self) -> bool:
        return bool(self.stack) and isinstance(self.stack[-1][0].value, dict) and not self.stack[-1][1]

    def _alias(self, event: Any, line: int, column: int) -> Node:
        node = self.anchors.get(event.anchor)
        if node is None:
            raise refuse(self.path, f"the alias *{event.anchor} has no anchor &{event.anchor} before it", line, column)
        if not node.closed:
            raise refuse(self.path, f"the alias *{event.anchor} stands inside what it names: it would never end", line, column)
        return node

    def _content(self, event: Any, line: int, column: int) -> Any:
        if isinstance(event, MappingStartEvent):
            return {}
        if isinstance(event, SequenceStartEvent):
            return []
        if event.style is not None:
            return event.value
        try:
            return scalar(event.value)
        except ValueError as error:
            self._complain(line, column, str(error))
            return 0

    def _place(self, node: Node, line: int, column: int) -> None:
        if not self.stack:
            self.root = node
            return
        parent, key = self.stack[-1]
        if isinstance(parent.value, list):
            parent.value.append(node)
            return
        name, key_line, key_column = key
        key.clear()
        if name in parent.value:
            self._complain(key_line, key_column, f"the key {name!r} stands here a second time, first in line {parent.value[name].line}")
        elif name == "<<":
            self._complain(key_line, key_column, "merge keys (<<) are not read: write the keys out, or give an alias for a whole value")
        else:
            parent.value[name] = Key(key_line, key_column, node)

    def _close(self) -> None:
        node, _ = self.stack.pop()
        node.closed = True
        parts = node.value if isinstance(node.value, list) else [key.node for key in node.value.values()]
        node.size = 1 + sum(part.size for part in parts)

    def _complain(self, line: int, column: int, message: str) -> None:
        self.problems.append(Problem(self.path, line, column, "", message))


def scalar(text: str) -> Any:
    """What an unquoted text means. ValueError for a number that is not finite or has absurdly many digits."""
    if text in _WORDS:
        return _WORDS[text]
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"a finite number is wanted, not {text}")
    if len(text) > MAX_DIGITS and (_FLOAT.fullmatch(text) or _BASED.fullmatch(text)):
        raise ValueError(f"a number of {len(text)} characters is too long")
    if _INT.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        number = float(text)
        if not math.isfinite(number):
            raise ValueError(f"a finite number is wanted, not {text}")
        return number
    return text


def checked(value: Any, path: str) -> Any:
    """A copy of plain data from Python, under the same limits as a file: what `read(...).plain()` gives for its YAML.

    Tuples become lists, numpy arrays and numbers plain ones. ScenarioError names what can't stand in a scenario.
    """
    problems: list[Problem] = []
    count = 0

    def copy(value: Any, loc: Loc) -> Any:
        nonlocal count
        count += 1
        if len(loc) > MAX_DEPTH:
            raise refuse(path, f"nested more than {MAX_DEPTH} levels deep (does it contain itself?)", where=dotted(loc[:3]))
        if count > MAX_NODES:
            raise refuse(path, f"over {MAX_NODES} values: too large for a scenario", where=dotted(loc[:1]))
        if type(value).__module__ == "numpy":
            value = value.tolist()
        if isinstance(value, dict):
            for name in [name for name in value if not isinstance(name, str)]:
                problems.append(Problem(path, None, None, dotted(loc), f"a key must be a text, not {name!r:.60}"))
            return {name: copy(item, (*loc, name)) for name, item in value.items() if isinstance(name, str)}
        if isinstance(value, (list, tuple)):
            return [copy(item, (*loc, i)) for i, item in enumerate(value)]
        if isinstance(value, float) and not math.isfinite(value):
            problems.append(Problem(path, None, None, dotted(loc), f"a finite number is wanted, not {value}"))
        elif isinstance(value, int) and abs(value) >= 10**MAX_DIGITS:
            problems.append(Problem(path, None, None, dotted(loc), f"a number of over {MAX_DIGITS} digits is too long"))
        elif not (value is None or isinstance(value, (bool, int, float, str))):
            problems.append(
                Problem(path, None, None, dotted(loc), f"{type(value).__name__} can't stand in a scenario: plain data is wanted")
            )
        return value

    result = copy(value, ())
    if problems:
        raise ScenarioError(problems)
    return result
